# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`trackres coastdown` estimates parameters of a vehicle file from coast-downs."""

from pathlib import Path
from typing import Any

import click

import trackres_ros as tr
from trackres_ros.tasks import options
from trackres_ros.tasks.terminal import Command, emit, needs, progress, watch, with_written


@click.command("coastdown", cls=Command)
@click.argument("recordings", nargs=-1, required=True, type=options.PATH)
@options.vehicle
@options.surroundings
@options.topics("which topic or column feeds which role.")
@options.methods
@options.argument_option(tr.coastdown, "seed", "Seed of all random draws.", options.SEEDS)
@click.option(
    "--save-vehicle",
    type=options.PATH,
    metavar="NEW.yaml",
    help="Vehicle file with the estimates; written only if it predicts the hold-out coast-downs better.",
)
@click.option("--picture", type=options.PATH, metavar="P.png", help="Picture of the measured speed and of both predictions.")
@options.json
def coastdown_command(save_vehicle: Path | None, picture: Path | None, as_json: bool, **arguments: Any) -> None:
    """Estimate parameters of a vehicle file, with ranges, from recordings of coast-downs.

    With a recorded torque, only stretches without torque are used; else all stretches of free deceleration. The mass is
    fixed, and all results scale with it. Without a recorded slope or altitude, coast down in both directions.

    \b
    trackres coastdown roll_1.csv roll_2.csv --vehicle xgd24d --picture rolls.png
    trackres coastdown roll.mcap --vehicle my.yaml --topics topics.yaml --save-vehicle rolled.yaml
    """
    from trackres_ros.files.file_sets import file_set
    from trackres_ros.files.output_files import output_file, picture_file

    if save_vehicle is not None:
        output_file(save_vehicle, (".yaml",), "save_vehicle")
    if picture is not None:
        needs("a picture", "plots", "matplotlib")
        picture_file(picture, "picture")
    watch(save_vehicle, picture)
    with progress("coast-down", None):
        result = tr.coastdown(**arguments)
    with file_set():
        outputs = [*result.save_vehicle(save_vehicle)] if save_vehicle is not None and result.better else []
        if picture is not None:
            outputs.append(result.plot(picture))
    note = f"\nNot written: {save_vehicle}" if save_vehicle is not None and not result.better else ""
    report = {**result.as_dict(), "written": [str(path) for path in outputs]}
    emit(report, as_json, lambda: with_written(f"{result!r}{note}", outputs))
