# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`trackres vehicle`: files to choose from and to begin with, whether one is right, and where two differ."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

import trackres_ros as tr
from trackres_ros.cli.common import Command, default_of, emit, json_option
from trackres_ros.text.numbers import figures

LONGEST = 24  # of a text beside numbers; --json has it whole


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


@vehicle_group.command("list", cls=Command)
@json_option
def list_command(as_json: bool) -> None:
    """List the vehicles that are shipped, which go by their names wherever a vehicle file does."""
    from trackres_ros.offline.vehicle_files import shipped
    from trackres_ros.text.table import table

    found = shipped()
    runs = {"tracks": "live, replay, diagnose", "road_load": "diagnose"}
    rows = [(v["name"], v["title"], runs[v["model"]]) for v in found]
    emit({"vehicles": found}, as_json, lambda: table(rows, ("name", "what it is", "for"), numbers=False))


@vehicle_group.command("new", cls=Command)
@click.argument("name", metavar="NAME")
@click.option("--like", default="xgd24d", show_default=True, metavar="VEHICLE", help="The shipped vehicle to begin with.")
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path(),
    show_default="here",
    metavar="DIR",
    help="Folder to write into.",
)
@json_option
def new_command(name: str, like: str, output: Path, as_json: bool) -> None:
    """Write a vehicle file to begin with: that of a shipped vehicle under another name.

    \b
    trackres vehicle new truck7 -o vehicles
    trackres vehicle new loader --like agri3t
    """
    from trackres_ros.offline.vehicle_files import new_vehicle

    written = new_vehicle(name, output, like)

    def text() -> str:
        return f"Written: {', '.join(map(str, written))}\nNext: change its values, then trackres vehicle check {written[0]}"

    emit({"written": [str(path) for path in written]}, as_json, text)


@vehicle_group.command("diff", cls=Command)
@click.argument("one", metavar="A")
@click.argument("other", metavar="B")
@json_option
def diff_command(one: str, other: str, as_json: bool) -> None:
    """Show the values in which two vehicle files differ.

    \b
    trackres vehicle diff xgd24d report/vehicle.yaml
    """
    from trackres_ros.offline.vehicle_files import differences
    from trackres_ros.text.table import table

    found = differences(one, other)

    def cells(d: dict[str, Any]) -> tuple[str, ...]:
        ratio = "" if d["ratio"] is None else f"{100.0 * (d['ratio'] - 1.0):+.1f} %"
        spans = ["" if span is None else f"{figures(span[0])} to {figures(span[1])}" for span in d["ranges"] or (None, None)]
        return d["path"], d["unit"], _shown(d["one"]), _shown(d["other"]), ratio, *spans

    def text() -> str:
        head = ("value", "unit", one, other, "change", f"range of {one}", f"range of {other}")
        return table(map(cells, found), head, numbers=False) if found else "They have the same values."

    emit({"differences": found}, as_json, text)


def _shown(value: Any) -> str:
    if isinstance(value, float | int) and not isinstance(value, bool):
        return figures(value)
    text = "-" if value is None else str(value)
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}..."
