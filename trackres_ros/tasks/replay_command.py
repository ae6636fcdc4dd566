# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs `trackres replay`: sends a recording through the estimator."""

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import click

import trackres_ros as tr
from trackres_ros.errors import encodable, one_line
from trackres_ros.tasks import options
from trackres_ros.tasks.partial_output import watch
from trackres_ros.tasks.terminal import Command, emit, picture_beside, picture_if_possible, progress


@click.command("replay", cls=Command)
@click.argument("recording", nargs=-1, required=True, type=options.PATH)
@options.vehicle
@options.surroundings
@options.topics("which topic, field or column feeds which role; without it, guessed by message type, or by name and unit.")
@options.params
@options.methods
@click.option("--resume", type=options.PATH, metavar="STATE", help="Continue from a state saved by --save-state.")
@click.option("--save-state", type=options.PATH, metavar="STATE", help="Save the state at the end.")
@click.option(
    "--learning",
    default="off",
    metavar="off|watch|on",
    help="Learn vehicle parameters from the measured torque, as the live node does; on: use them.",
)
@click.option("--save-vehicle", type=options.PATH, metavar="V.yaml", help="Write a vehicle file with the learned parameters.")
@click.option(
    "--both-sides",
    is_flag=True,
    help="Compute an unrecorded acceleration from the speeds before and after, and give the error, as diagnose does.",
)
@click.option(
    "-o",
    "--output",
    type=options.PATH,
    help="Result: .parquet, .csv, .csv.gz or .mf4 as a table, .mcap as topics; with a picture, .png. Default: a table "
    "in this folder, named after the recording: Parquet, or .csv.gz without pyarrow.",
)
@options.json
def replay_command(
    recording: tuple[Path, ...],
    vehicle: str,
    surroundings: Path | None,
    method: str | None,
    thermal: str | None,
    output: Path | None,
    as_json: bool,
    **asked: Any,
) -> None:
    """Compute resistance torque and belt temperature over a recording.

    RECORDING is a rosbag2 folder, .mcap, .db3, ROS 1 .bag (several are read in sequence), or one .csv, .csv.gz,
    .parquet or .xlsx with time_s and speed_mps (or speed_kmh), or with columns that the topics file names; or one .mf4, .blf,
    .asc, .log (candump) or .mat, whose channels are named there too or guessed by name and unit.

    \b
    trackres replay lap.mcap --vehicle xgd24d --topics topics.yaml -o out.mcap
    trackres replay drive.csv --vehicle xgd24d

    Messages are processed in the order they were logged and by their own stamps, so the same recording always gives the same
    bits.
    """
    from trackres_ros.files.file_sets import file_set
    from trackres_ros.files.output_files import no_two_alike

    output = output or _table_of(recording[0])
    picture = picture_beside(output)
    no_two_alike({"output": picture, "save_state": asked["save_state"]})
    watch(output, picture, asked["save_state"], asked["save_vehicle"])
    described = tr.load_vehicle(vehicle, method=method, thermal=thermal, surroundings=surroundings)
    with file_set():
        with progress("replaying", None) as advance:
            result = tr.replay(recording, described, output=output, progress=advance, **asked)
        written = [str(path) for path in result.written]
        with picture_if_possible(picture):
            result.plot(picture)
            written.append(str(picture))
    emit(
        {**result.as_dict(), "written": written},
        as_json,
        lambda: "\n".join([repr(result), one_line(f"Written: {', '.join(written)}")]),
    )


def _table_of(recording: Path) -> Path:
    """The default table of a replay; bytes of the name that are no UTF-8 are escaped, for whoever prints it."""
    from trackres_ros.recording.opening import stem

    name = encodable(stem(recording)) or "recording"
    return Path(f"{name}_replay{'.parquet' if find_spec('pyarrow') else '.csv.gz'}")
