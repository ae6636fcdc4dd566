# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`trackres topics`: the topics files that are shipped."""

from __future__ import annotations

from pathlib import Path

import click

from trackres_ros.cli.common import DBC, Command, Commands, dbc_option, emit, json_option, with_databases


@click.group("topics", cls=Commands)
def topics_group() -> None:
    """Topics files: which topic or column feeds which role."""


@topics_group.command("list")
@json_option
def list_command(as_json: bool) -> None:
    """List the topics files that are shipped, which go by their names wherever a topics file does."""
    from trackres_ros.recording.shipped_topics import shipped, shipped_text

    found = shipped()
    emit({"topics": found}, as_json, lambda: shipped_text(found))


@topics_group.command("guess", cls=Command)
@click.argument("recording", nargs=-1, required=True, type=click.Path(path_type=Path))
@dbc_option
@json_option
@click.pass_context
def guess_command(context: click.Context, recording: tuple[Path, ...], as_json: bool) -> None:
    """Print the topics file that a recording is read with where none is named, to check and to keep.

    \b
    trackres topics guess drive.mf4 > topics.yaml
    trackres topics guess bus.blf --dbc bus.dbc > topics.yaml
    """
    from trackres_ros.recording.guessed_topics import guessed_topics

    lines = guessed_topics(recording, with_databases(None, context.meta[DBC]))
    emit({"lines": lines}, as_json, lambda: "\n".join(lines))
