# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`trackres compound`: a rubber file from the sweep of a DMA instrument."""

from pathlib import Path

import click

from trackres_ros.tasks import options
from trackres_ros.tasks.terminal import Command, Commands, emit, needs, output_folder, progress


@click.group("compound", cls=Commands)
def compound_group() -> None:
    """Rubber compounds."""


@compound_group.command("fit", cls=Command)
@click.argument("sweep", metavar="SWEEP.csv", type=options.PATH)
@click.option(
    "--vehicle",
    default="xgd24d",
    metavar="FILE|NAME",
    shell_complete=options.vehicles_to_complete,
    help="The vehicle to equip with the compound; all else stays as in its file.",
)
@click.option(
    "--frequency-hz", type=options.Number(1e-9, 1e9), metavar="HZ", help="Frequency of the sweep, if its file does not give it."
)
@click.option("-o", "--output", type=options.FOLDER, default=Path("compound"), metavar="DIR", help="Folder to write into.")
@options.json
def fit_command(sweep: Path, vehicle: str, frequency_hz: float | None, output: Path, as_json: bool) -> None:
    """Fit a compound to a DMA sweep: master curve, shift, rubber file and a vehicle file with it.

    SWEEP.csv is the text export of an instrument: column names with units (after the name or on a line below) for temperature,
    frequency, storage modulus (E' or G'), loss modulus or tan delta; tab, semicolon or comma between cells,
    decimal points or commas. For shift identifiability, coverage and extrapolation, see
    docs/compound.md.

    \b
    trackres compound fit sweep.csv
    trackres compound fit sweep.txt --vehicle my_vehicle.yaml -o my_compound
    """
    from trackres_ros.tools.compound.run import fit_and_write, found_text

    needs("pictures", "plots", "matplotlib")
    with progress("fitting", None):
        fit_result = fit_and_write(sweep, vehicle, output_folder(output), frequency_hz)
    emit(fit_result, as_json, lambda: found_text(fit_result))
