# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`trackres topics`: the topics files that are shipped."""

from __future__ import annotations

import click

from trackres_ros.cli.common import Commands, emit, json_option


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
