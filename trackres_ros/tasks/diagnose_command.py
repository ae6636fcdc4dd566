# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs `trackres diagnose` and `trackres effects`."""

from pathlib import Path
from typing import Any

import click

import trackres_ros as tr
from trackres_ros.tasks import options
from trackres_ros.tasks.partial_output import watch
from trackres_ros.tasks.terminal import Command, emit, print_warnings, stages


@click.command("diagnose", cls=Command)
@click.argument("recordings", nargs=-1, required=True, type=options.PATH)
@options.vehicle
@options.surroundings
@options.topics("which topic or column feeds which role.")
@click.option("--hide", multiple=True, metavar="CHANNEL", help="Ignore a channel, such as grade or yaw_rate; may be repeated.")
@click.option(
    "--holdout",
    metavar="N|NAMES",
    help="How many of the last recordings or laps to hold out, or names of recordings or laps (day2.mcap: 5) with commas.",
)
@options.methods
@options.of(tr.diagnose, "seed", "Seed of all random draws.", options.SEEDS)
@click.option("--quick", is_flag=True, help="Fewer draws for thresholds.")
@click.option("--keep-suspected", is_flag=True, help="Also write effects that fit but that laps left out do not confirm.")
@click.option("--effects", type=options.PATH, metavar="DIR", help="Folder with your own effects, one Python file each.")
@click.option("--no-page", is_flag=True, help="Write no report.html and no pictures, which take long; remove earlier ones.")
@options.folder("Folder for the report; created if needed.")
@options.json
def diagnose_command(
    recordings: tuple[Path, ...], holdout: str | None, no_page: bool, output: Path, as_json: bool, **asked: Any
) -> None:
    """Find where measurement and simulation differ and which physics is missing; write a vehicle file with it.

    Each RECORDING with a measured torque is a session: a bag, a table, an MDF file, a CAN log or a MATLAB file
    (docs/recordings.md).

    \b
    trackres diagnose day1.mcap day2.mcap --vehicle xgd24d --topics topics.yaml -o report

    Writes report.json, report.html, vehicle.yaml and pictures, and prints the verdict. Effects of the site,
    the weather or the ground go to surroundings.yaml instead; sensor corrections are printed as lines for the topics file.
    The exit code is 0 for any verdict.
    """
    from trackres_ros.files.output_files import not_an_input, output_folder
    from trackres_ros.tasks.diagnose import DATA_FILES

    output_folder(output, names=DATA_FILES)  # before hours of work
    for name in DATA_FILES:
        not_an_input(output / name, [*recordings, asked["vehicle"], asked["surroundings"]], "output")
    watch(output)
    held = None if holdout is None else int(holdout) if holdout.isdecimal() else [name.strip() for name in holdout.split(",")]
    with stages() as on_stage:
        found = tr.diagnose(recordings, holdout=held, on_stage=on_stage, **asked)
        on_stage("report")
        with print_warnings():
            found.report(output, page=not no_page)
    emit(
        found.as_dict(),
        as_json,
        lambda: f"{found!r}\n{output}: {', '.join(str(path.relative_to(output)) for path in found.written)}",
    )


@click.command("effects", cls=Command)
@click.option("--effects", type=options.PATH, metavar="DIR", help="Folder with your own effects.")
@options.json
def effects_command(effects: Path | None, as_json: bool) -> None:
    """List the catalogue of effects with descriptions and parameters."""
    listed = [effect.describe() for effect in tr.effects.catalogue(effects).values()]

    def text() -> str:
        lines = []
        for effect in listed:
            of = f"{effect['acts_on']}, of the {effect['belongs_to']}"
            lines.append(f"{effect['name']} ({of}): {effect['text']}; needs {', '.join(effect['needs'])}")
            lines += [
                f"    {name} {q['low']:g} to {q['high']:g} {q['unit']}: {q['text']}" for name, q in effect["parameters"].items()
            ]
        return "\n".join(lines)

    emit({"effects": listed}, as_json, text)
