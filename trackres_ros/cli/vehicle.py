# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`trackres vehicle check` says whether a vehicle file is right, and what follows from it."""

from __future__ import annotations

import click

import trackres_ros as tr
from trackres_ros.cli.common import Command, default_of, emit, json_option


@click.group("vehicle")
def vehicle_group() -> None:
    """Vehicle files."""


@vehicle_group.command("check", cls=Command)
@click.argument("file", metavar="FILE|NAME")
@click.option(
    "--points",
    type=click.IntRange(10, 100_000),
    default=default_of(tr.check_vehicle, "points"),
    show_default=True,
    help="Random points at which the loss table is held against the exact method.",
)
@json_option
def check_command(file: str, points: int, as_json: bool) -> None:
    """Check a vehicle file and print what follows from it, with units.

    \b
    trackres vehicle check xgd24d
    trackres vehicle check my_vehicle.yaml --json
    """
    result = tr.check_vehicle(file, points=points)
    emit(result.as_dict(), as_json, lambda: repr(result))
