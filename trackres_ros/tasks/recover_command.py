# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs `trackres recover`: repairs an unfinished recording."""

from pathlib import Path

import click

import trackres_ros as tr
from trackres_ros.tasks import options
from trackres_ros.tasks.partial_output import watch
from trackres_ros.tasks.terminal import Command, emit


@click.command("recover", cls=Command)
@click.argument("recording", type=options.PATH)
@click.option("-o", "--output", type=options.PATH, required=True, help="File to write, .mcap.")
@options.json
def recover_command(recording: Path, output: Path, as_json: bool) -> None:
    """Repair an MCAP recording that a kill, a crash or a power cut left unfinished. The original file stays.

    RECORDING is the .mcap.part that `trackres live --record` left behind, or any truncated .mcap.

    \b
    trackres recover drive.mcap.part -o drive.mcap
    """
    watch(output)
    found = tr.recover(recording, output=output)
    result = {
        "written": str(found.path),
        "messages": found.messages,
        "duration_s": found.duration_s,
        "lost_bytes": found.lost_bytes,
    }
    lost = f"; the last {found.lost_bytes} bytes of {recording} are incomplete and dropped" if found.lost_bytes else ""
    emit(result, as_json, lambda: f"{output}: {found.messages} messages, {found.duration_s:.1f} s{lost}")
