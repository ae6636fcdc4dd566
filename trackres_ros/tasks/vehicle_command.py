# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs `trackres vehicle`: lists, creates, checks and compares vehicle files."""

from pathlib import Path

import click

import trackres_ros as tr
from trackres_ros.tasks import options
from trackres_ros.tasks.terminal import Command, Commands, emit


@click.group("vehicle", cls=Commands)
def vehicle_group() -> None:
    """Vehicle files."""


@vehicle_group.command("check", cls=Command)
@click.argument("file", metavar="FILE|NAME")
@options.of(
    tr.check_vehicle,
    "points",
    "Number of random points for comparing the loss table with the exact method.",
)
@options.json
def check_command(file: str, points: int, as_json: bool) -> None:
    """Check a vehicle file and print the derived values with units.

    \b
    trackres vehicle check xgd24d
    trackres vehicle check my_vehicle.yaml --json
    """
    result = tr.check_vehicle(file, points=points)
    emit(result.as_dict(), as_json, lambda: repr(result))


@vehicle_group.command("list", cls=Command)
@options.json
def list_command(as_json: bool) -> None:
    """List the shipped vehicles; commands accept their names instead of a path."""
    from trackres_ros.tasks.vehicle import shipped, shipped_text

    found = shipped()
    emit({"vehicles": found}, as_json, lambda: shipped_text(found))


@vehicle_group.command("new", cls=Command)
@click.argument("name", metavar="NAME")
@click.option("--like", default="xgd24d", metavar="VEHICLE", help="The shipped vehicle to start from.")
@click.option(
    "-o", "--output", type=options.FOLDER, default=Path(), show_default="here", metavar="DIR", help="Folder to write into."
)
@options.json
def new_command(name: str, like: str, output: Path, as_json: bool) -> None:
    """Write a vehicle file to start from: a copy of a shipped vehicle under a new name.

    \b
    trackres vehicle new truck7 -o vehicles
    trackres vehicle new loader --like agri3t
    """
    from trackres_ros.tasks.vehicle import new_vehicle

    written = new_vehicle(name, output, like)
    text = f"Written: {', '.join(map(str, written))}\nNext: change its values, then trackres vehicle check {written[0]}"
    emit({"written": [str(path) for path in written]}, as_json, lambda: text)


@vehicle_group.command("diff", cls=Command)
@click.argument("one", metavar="A")
@click.argument("other", metavar="B")
@options.json
def diff_command(one: str, other: str, as_json: bool) -> None:
    """Show the values in which two vehicle files differ.

    \b
    trackres vehicle diff xgd24d report/vehicle.yaml
    """
    from trackres_ros.tasks.vehicle import differences, differences_text

    found = differences(one, other)
    emit({"differences": found}, as_json, lambda: differences_text(one, other, found))
