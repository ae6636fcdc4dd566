# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs `trackres sweep` and `trackres sensitivity`."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import click

from trackres_ros.files.file_sets import file_set
from trackres_ros.files.output_files import not_an_input, output_file
from trackres_ros.tasks import options
from trackres_ros.tasks.terminal import Command, emit, needs, picture_beside, picture_if_possible, progress, watch, with_written
from trackres_ros.units import KMH_PER_MPS

if TYPE_CHECKING:
    from trackres_ros.vehicle import Vehicle

TABLES = (".csv", ".csv.gz", ".parquet")
OUTCOMES = ("warm_nm", "cold_nm", "belt_degc", "kwh_per_km")

USUAL_KMH = 30.0

speed_option = click.option(
    "--speed-kmh",
    type=options.Number(0.1, 150.0),
    help=f"Constant speed [km/h]; default {USUAL_KMH:g}, or the vehicle's maximum if lower.",
)
ambient_option = click.option(
    "--ambient-degc", type=options.Number(-60.0, 60.0), help="Air temperature [degC]; default the vehicle file's."
)


@click.command("sweep", cls=Command)
@click.argument("vehicle", shell_complete=options.vehicles_to_complete)
@click.option(
    "--vary",
    multiple=True,
    required=True,
    metavar="PATH=A:B:N",
    help="PATH=A:B:N varies a value from A to B in N steps; PATH=A,B,C lists values; PATH alone takes the file's range. "
    "A and B may be changes such as +20%. May be repeated, for all combinations.",
)
@speed_option
@ambient_option
@click.option("--cycle", metavar="DRIVE", help="Energy of a drive: a recording, a speed profile, stages or laps; see compare.")
@click.option("--engine", default="local", help="tcp://HOST:PORT of a running dask scheduler, or local.")
@click.option("--workers", type=options.WORKERS, help="Processes of a local engine.")
@click.option("-o", "--output", type=options.PATH, help="Table, .csv, .csv.gz or .parquet; with a picture, .png.")
@options.json
def sweep_command(
    vehicle: str,
    vary: tuple[str, ...],
    speed_kmh: float | None,
    ambient_degc: float | None,
    cycle: str | None,
    engine: str,
    workers: int | None,
    output: Path | None,
    as_json: bool,
) -> None:
    """Vary values of a vehicle file: resistance cold and warm, belt temperature, energy.

    A PATH is a path shown by vehicle check, or enough of its words in order. The same value of several axles,
    tracks or wheels moves together, for example axles.load.

    \b
    trackres sweep my.yaml --vary belt.thickness=0.025:0.045:9
    trackres sweep my.yaml --vary axles.load=+20%
    trackres sweep xgd24d --vary loss_modulus_scale=0.6:1.2:7 --vary road_wheels.radius=0.12,0.13,0.14 -o sweep.csv
    """
    from trackres_ros.files.resources import find_vehicle
    from trackres_ros.output.table import write_table
    from trackres_ros.tools.design.sweep import SweepRequest, draw, sweep
    from trackres_ros.tools.design.values import varied
    from trackres_ros.vehicle import files_of, load

    file = None if output is None else output_file(output, TABLES)
    picture = None if file is None else picture_beside(file)
    watch(file, picture)
    described = load(find_vehicle(vehicle))
    not_an_input(file, [cycle, *files_of(described)], "output")
    air = described.chassis.ambient if ambient_degc is None else ambient_degc
    of_each = tuple(varied(described, one) for one in vary)
    asked = SweepRequest(vehicle, of_each, _held(described, speed_kmh), air, cycle, own_air=ambient_degc is None)
    with progress("points", len(asked.points)) as advance:
        found = sweep(asked, engine, workers, advance)
    written = []
    if file is not None and picture is not None:
        with file_set():
            write_table(file, found.columns)
            written.append(str(file))
            with picture_if_possible(picture):
                needs("a picture", "plots", "matplotlib")
                written.append(str(draw(found, picture)))
    emit({**found.as_dict(), "written": written}, as_json, lambda: with_written(found.text(), written))


@click.command("sensitivity", cls=Command)
@click.argument("vehicle", shell_complete=options.vehicles_to_complete)
@speed_option
@ambient_option
@click.option("--of", "outcome", type=click.Choice(OUTCOMES), default=OUTCOMES[0], help="Result to examine.")
@click.option("--samples", type=click.IntRange(8, 1 << 16), default=64, help="Samples of each value; a power of two.")
@options.seed(1)
@click.option("-o", "--output", type=options.PATH, metavar="P.png", help="Picture, .png or .svg.")
@options.json
def sensitivity_command(
    vehicle: str,
    speed_kmh: float | None,
    ambient_degc: float | None,
    outcome: str,
    samples: int,
    seed: int,
    output: Path | None,
    as_json: bool,
) -> None:
    """Find the value of a vehicle file to measure first: its share of the torque's uncertainty.

    All values vary over their ranges. "alone" is the share of the variance that disappears once this value is known; "with
    others" is the share that remains once all others are known (Sobol's indices, with 95 % intervals).

    \b
    trackres sensitivity xgd24d --speed-kmh 30 -o tornado.png
    trackres sensitivity my.yaml --of belt_degc --samples 128
    """
    from trackres_ros.files.resources import find_vehicle
    from trackres_ros.tools.design.sensitivity import draw_tornado, sensitivity
    from trackres_ros.vehicle import load

    needs("trackres sensitivity", "design", "SALib")
    picture = None if output is None else output_file(output, (".png", ".svg"))
    if picture is not None:
        needs("a picture", "plots", "matplotlib")
        watch(picture)
    speed = _held(load(find_vehicle(vehicle)), speed_kmh)
    with ExitStack() as bars:

        def shown(what: str, total: int) -> Callable[[float], None]:
            bars.close()
            return bars.enter_context(progress(what, total))

        found = sensitivity(vehicle, speed, ambient_degc, samples, seed, shown)
    written = [] if picture is None else [str(draw_tornado(found, outcome, picture))]
    emit({**found.as_dict(), "written": written}, as_json, lambda: with_written(found.text(outcome), written))


def _held(vehicle: Vehicle, speed_kmh: float | None) -> float:
    """The requested speed, or the usual one [m/s]."""
    return min(USUAL_KMH / KMH_PER_MPS, vehicle.chassis.max_speed) if speed_kmh is None else speed_kmh / KMH_PER_MPS
