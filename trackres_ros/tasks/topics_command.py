# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs `trackres topics`: lists and guesses topics files."""

from pathlib import Path

import click

from trackres_ros.tasks import options
from trackres_ros.tasks.terminal import Command, Commands, emit


@click.group("topics", cls=Commands)
def topics_group() -> None:
    """Topics files: which topic or column feeds which role."""


@topics_group.command("list")
@options.json
def list_command(as_json: bool) -> None:
    """List the shipped topics files; commands accept their names instead of a path."""
    from trackres_ros.recording.topics_files import shipped, shipped_text

    found = shipped()
    emit({"topics": found}, as_json, lambda: shipped_text(found))


@topics_group.command("guess", cls=Command)
@click.argument("recording", nargs=-1, required=True, type=options.PATH)
@options.dbc
@options.json
@click.pass_context
def guess_command(context: click.Context, recording: tuple[Path, ...], as_json: bool) -> None:
    """Print the guessed topics file of a recording, to check and save.

    \b
    trackres topics guess drive.mf4 > topics.yaml
    trackres topics guess bus.blf --dbc bus.dbc > topics.yaml
    """
    from trackres_ros.recording.topics_files import guessed_topics

    lines = guessed_topics(recording, options.with_databases(context, None, None))
    emit({"lines": lines}, as_json, lambda: "\n".join(lines))
