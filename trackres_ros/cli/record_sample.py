# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs `trackres record-sample`: makes a sample recording."""

from __future__ import annotations

from pathlib import Path

import click

import trackres_ros as tr
from trackres_ros.cli.common import Command, default_of, emit, json_option, number, whole
from trackres_ros.cli.partial_output import watch


@click.command("record-sample", cls=Command)
@click.option(
    "--vehicle",
    default=default_of(tr.record_sample, "vehicle"),
    show_default=True,
    metavar="FILE|NAME",
    help="Vehicle whose weight is recorded.",
)
@click.option(
    "--speed-kmh",
    type=number(1, 50),
    default=default_of(tr.record_sample, "speed_kmh"),
    show_default=True,
    help="Speed on the lap [km/h].",
)
@click.option(
    "--laps",
    type=whole(1, 1000),
    default=default_of(tr.record_sample, "laps"),
    show_default=True,
    help="Laps of a circle of 100 m radius, with a stop after each.",
)
@click.option(
    "--ambient-degc",
    type=number(-60, 60),
    default=default_of(tr.record_sample, "ambient_degc"),
    show_default=True,
    help="Air temperature [degC].",
)
@click.option("-o", "--output", "path", type=click.Path(path_type=Path), required=True, help="File to write, .mcap.")
@json_option
def record_sample_command(vehicle: str, speed_kmh: float, laps: int, ambient_degc: float, path: Path, as_json: bool) -> None:
    """Make a recording like a vehicle bus log: the paper's lap test, speed in steps of 1 km/h, load, air temperature.

    \b
    trackres record-sample -o lap.mcap
    """
    watch(path)
    sample = tr.record_sample(path, vehicle=vehicle, speed_kmh=speed_kmh, laps=laps, ambient_degc=ambient_degc)
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
