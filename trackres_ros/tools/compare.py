# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs `trackres compare`."""

from pathlib import Path
from typing import Any

import click

from trackres_ros.errors import InputError
from trackres_ros.tasks import options
from trackres_ros.tasks.terminal import Command, emit, needs, output_folder, print_warnings, progress

A_NUMBER = "A|A:B|A,B,C"


@click.command("compare", cls=Command)
@click.argument("one")
@click.argument("other")
@click.option(
    "--speed-kmh", metavar=A_NUMBER, help="Two designs: speeds; default 30, and 5 (or a tenth) to the maximum of the slower one."
)
@click.option("--belt-degc", metavar=A_NUMBER, help="Two designs: belt temperatures of the table; default -20:80.")
@click.option("--ambient-degc", metavar=A_NUMBER, help="Two designs: air temperatures; default that of the file ONE.")
@click.option("--weight-kn", metavar=A_NUMBER, help="Two designs: weights of the whole vehicle; default each file's own.")
@click.option(
    "--cycle",
    multiple=True,
    metavar="DRIVE",
    help="Of two designs: a drive. A recording, a speed profile as simulate takes it, or stages or laps; may be repeated. "
    "stages without.",
)
@click.option("-o", "--output", type=options.FOLDER, metavar="DIR", help="Folder for pictures of both.")
@options.json
def compare_command(one: str, other: str, output: Path | None, as_json: bool, **asked_for: Any) -> None:
    """Show the significant differences between two days, vehicles, reports or designs.

    ONE and OTHER are each a folder of trackres fleet, all of it or a part (results:truck-01, results:truck-01@2026-03,
    results@2026-03-14), a folder of trackres diagnose, or a vehicle file. For two vehicle files, the command lists the values
    that differ. With tracks it also compares resistance, belt temperature and energy, with uncertainties; without belts it
    compares resistance and energy over speed.

    A:B means five numbers from A to B, A:B:N means N. The drive "stages" is ten minutes each at a third, two thirds and all
    of the slower vehicle's maximum speed; "laps" is ten laps of 628 m with a stop after each.

    \b
    trackres compare results:truck-01@2026-01 results:truck-01@2026-03
    trackres compare xgd24d my_design.yaml --speed-kmh 50 --ambient-degc -15,15
    trackres compare xgd24d my_design.yaml --weight-kn 200,270,340 --cycle stages --cycle lap.mcap
    """
    from trackres_ros.files.file_sets import file_set
    from trackres_ros.files.output_files import output_folder as usable_folder
    from trackres_ros.tasks.vehicle import differences, differences_text
    from trackres_ros.tools.design.compare import asked_of, compare_designs, wheels_compared, wheels_text
    from trackres_ros.tools.design.compare_text import designs_text, draw_designs
    from trackres_ros.tools.fleet.compare import compare, compare_text, draw_overlay

    if output is not None:
        needs("a picture", "plots", "matplotlib")
        usable_folder(output)
    with print_warnings():
        found = compare(one, other)
    asked, designs = asked_of((one, other), **asked_for), None
    try:
        found["values"] = values = differences(one, other)
        text = "\n".join(["Values that differ", differences_text(one, other, values)])
    except InputError:  # one of them is no vehicle file
        text = compare_text(found)
    if (wheels := wheels_compared((one, other))) is not None:
        found["wheels"] = wheels
        text += "\n" + wheels_text(wheels, (one, other))
    if asked is not None:
        with progress("operating points", asked.points) as advance:
            found["designs"] = designs = compare_designs(asked, advance)
    if output is not None:
        output_folder(output)
        with file_set():
            found["written"] = str(draw_overlay(found, output / "compare.png"))
            if designs is not None:
                found["written"] += f", {draw_designs(designs, output / 'designs.png')}"
    emit(found, as_json, lambda: "\n".join([text, *([designs_text(designs)] if designs is not None else [])]))
