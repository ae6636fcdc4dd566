# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs `trackres record-sample`: makes a sample recording."""

from pathlib import Path
from typing import Any

import click

import trackres_ros as tr
from trackres_ros.tasks import options
from trackres_ros.tasks.partial_output import watch
from trackres_ros.tasks.terminal import Command, emit


@click.command("record-sample", cls=Command)
@options.of(tr.record_sample, "vehicle", "Vehicle whose weight is recorded.", click.STRING, metavar="FILE|NAME")
@options.of(tr.record_sample, "speed_kmh", "Speed on the lap [km/h].")
@options.of(tr.record_sample, "laps", "Laps of a circle of 100 m radius, with a stop after each.")
@options.of(tr.record_sample, "ambient_degc", "Air temperature [degC].")
@click.option("-o", "--output", "path", type=options.PATH, required=True, help="File to write, .mcap.")
@options.json
def record_sample_command(vehicle: str, path: Path, as_json: bool, **drive: Any) -> None:
    """Make a recording like a vehicle bus log: the paper's lap test, speed in steps of 1 km/h, load, air temperature.

    \b
    trackres record-sample -o lap.mcap
    """
    watch(path)
    sample = tr.record_sample(path, vehicle=vehicle, **drive)
    result = {
        "written": str(sample.path),
        "duration_s": sample.duration_s,
        "distance_m": sample.distance_m,
        "topics": str(sample.topics),
    }
    emit(
        result,
        as_json,
        lambda: (
            f"{path}: {sample.duration_s:.0f} s, {sample.distance_m:.0f} m\n"
            f"Try: trackres replay {path} --vehicle {vehicle} --topics {sample.topics} -o out.csv"
        ),
    )
