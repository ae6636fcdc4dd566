# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs `trackres sweep`, `trackres sensitivity` and `trackres compare`."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from trackres_ros.errors import InputError
from trackres_ros.files.file_sets import file_set
from trackres_ros.files.output_files import not_an_input, output_file
from trackres_ros.tasks import options
from trackres_ros.tasks.terminal import (
    Command,
    emit,
    needs,
    output_folder,
    picture_beside,
    picture_if_possible,
    print_warnings,
    progress,
    watch,
    with_written,
)
from trackres_ros.units import KMH_PER_MPS

if TYPE_CHECKING:
    from trackres_ros.vehicle import Vehicle

TABLES = (".csv", ".csv.gz", ".parquet")
OUTCOMES = ("warm_nm", "cold_nm", "belt_degc", "kwh_per_km")

USUAL_KMH = 30.0
A_NUMBER = "A|A:B|A,B,C"

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
    metavar="PATH=A:B:N",
    help="PATH=A:B:N varies a value from A to B in N steps; PATH=A,B,C lists values; PATH alone takes the file's range. "
    "A and B may be changes such as +20%. May be repeated, for all combinations.",
)
@speed_option
@click.option("--ambient-degc", metavar=A_NUMBER, help="Air temperatures [degC]; default the vehicle file's.")
@click.option("--cycle", metavar="DRIVE", help="Energy of a drive: a recording, a speed profile, stages or laps; see compare.")
@click.option("--engine", default="local", help="tcp://HOST:PORT of a running dask scheduler, or local.")
@click.option("--workers", type=options.WORKERS, help="Processes of a local engine.")
@click.option("-o", "--output", type=options.PATH, help="Table, .csv, .csv.gz or .parquet; with a picture, .png.")
@options.json
def sweep_command(
    vehicle: str,
    vary: tuple[str, ...],
    speed_kmh: float | None,
    ambient_degc: str | None,
    cycle: str | None,
    engine: str,
    workers: int | None,
    output: Path | None,
    as_json: bool,
) -> None:
    """Vary values of a vehicle file: resistance cold and warm, belt temperature, energy.

    A PATH is a path shown by vehicle check, or enough of its words in order. The same value of several axles,
    tracks or wheels moves together, for example axles.load. Several air temperatures are varied like a value.

    \b
    trackres sweep my.yaml --vary belt.thickness=0.025:0.045:9
    trackres sweep my.yaml --vary axles.load=+20% --ambient-degc -10,30
    trackres sweep xgd24d --vary loss_modulus_scale=0.6:1.2:7 --vary road_wheels.radius=0.12,0.13,0.14 -o sweep.csv
    """
    from trackres_ros.files.resources import find_vehicle
    from trackres_ros.output.table import write_table
    from trackres_ros.tools.design.sweep import SweepRequest, draw, sweep
    from trackres_ros.tools.design.values import AIR, AIR_DEGC, ALLOWED, DEGREES, Variation, numbers, variation
    from trackres_ros.vehicle import files_of, load

    file = None if output is None else output_file(output, TABLES)
    picture = None if file is None else picture_beside(file)
    watch(file, picture)
    machine = load(find_vehicle(vehicle))
    not_an_input(file, [cycle, *files_of(machine)], "output")
    variations: list[Variation] = [variation(machine, text) for text in vary]
    air: tuple[float, ...] = (machine.chassis.ambient,)
    if ambient_degc is not None:
        air = numbers("--ambient-degc", ambient_degc, AIR_DEGC)
    if len(air) > 1:
        variations.append(Variation((AIR,), DEGREES, (air,)))
    if not variations:
        raise InputError("--vary", "nothing", ALLOWED, "or give several --ambient-degc")
    own_air = ambient_degc is None or len(air) > 1
    request = SweepRequest(vehicle, tuple(variations), _cruise_speed(machine, speed_kmh), air[0], cycle, own_air)
    with progress("points", len(request.points)) as advance:
        result = sweep(request, engine, workers, advance)
    outputs = []
    if file is not None and picture is not None:
        with file_set():
            write_table(file, result.columns)
            outputs.append(str(file))
            with picture_if_possible(picture):
                needs("a picture", "plots", "matplotlib")
                outputs.append(str(draw(result, picture)))
    emit({**result.as_dict(), "written": outputs}, as_json, lambda: with_written(result.text(), outputs))


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
    speed = _cruise_speed(load(find_vehicle(vehicle)), speed_kmh)
    with ExitStack() as bars:

        def begin_bar(label: str, total: int) -> Callable[[float], None]:
            bars.close()
            return bars.enter_context(progress(label, total))

        result = sensitivity(vehicle, speed, ambient_degc, samples, seed, begin_bar)
    outputs = [] if picture is None else [str(draw_tornado(result, outcome, picture))]
    emit({**result.as_dict(), "written": outputs}, as_json, lambda: with_written(result.text(outcome), outputs))


def _cruise_speed(vehicle: Vehicle, speed_kmh: float | None) -> float:
    """The requested speed, or the usual one [m/s]."""
    return min(USUAL_KMH / KMH_PER_MPS, vehicle.chassis.max_speed) if speed_kmh is None else speed_kmh / KMH_PER_MPS


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
@click.option("--draws", type=click.IntRange(8, 1 << 14), default=256, help="Two designs: draws from the ranges of the files.")
@options.seed(1)
@click.option("-o", "--output", type=options.FOLDER, metavar="DIR", help="Folder for pictures of both.")
@options.json
def compare_command(one: str, other: str, output: Path | None, as_json: bool, **arguments: Any) -> None:
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
    from trackres_ros.files.output_files import output_folder as usable_folder
    from trackres_ros.tasks.vehicle import differences, differences_text
    from trackres_ros.tools.design.compare import compare_designs, request_of, wheels_compared, wheels_text
    from trackres_ros.tools.design.compare_text import designs_text, draw_designs, draw_energy
    from trackres_ros.tools.fleet.compare import compare, compare_text, draw_overlay

    if output is not None:
        needs("a picture", "plots", "matplotlib")
        usable_folder(output)
    with print_warnings():
        comparison = compare(one, other)
    request, designs = request_of((one, other), **arguments), None
    try:
        comparison["values"] = values = differences(one, other)
        text = "\n".join(["Values that differ", differences_text(one, other, values)])
    except InputError:  # one of them is no vehicle file
        text = compare_text(comparison)
    if (wheels := wheels_compared((one, other))) is not None:
        comparison["wheels"] = wheels
        text += "\n" + wheels_text(wheels, (one, other))
    if request is not None:
        with progress("operating points", request.points) as advance:
            comparison["designs"] = designs = compare_designs(request, advance)
    if output is not None:
        output_folder(output)
        with file_set():
            comparison["written"] = str(draw_overlay(comparison, output / "compare.png"))
            if designs is not None:
                pictures = draw_designs(designs, output / "designs.png"), draw_energy(designs, output / "energy.png")
                comparison["written"] += "".join(f", {picture}" for picture in pictures)
    emit(comparison, as_json, lambda: "\n".join([text, *([designs_text(designs)] if designs is not None else [])]))


@click.command("road-load", cls=Command)
@click.argument("vehicle", shell_complete=options.vehicles_to_complete)
@click.option(
    "--speed-kmh", metavar=A_NUMBER, help="Four speeds or more; default ten, from a tenth of the maximum to the maximum."
)
@ambient_option
@click.option("--weight-kn", type=options.Number(0.1, 1e5), help="Weight of the whole vehicle [kN]; default the vehicle file's.")
@click.option("--belt-degc", type=options.Number(-60.0, 150.0), help="Belt temperature [degC]; default settled at each speed.")
@click.option("--coefficients", metavar="A,B,C", help="Coefficients of a coast-down to compare with [N, N/(m/s), N/(m/s)^2].")
@click.option("--per-kmh", is_flag=True, help="The given coefficients are for a speed in km/h.")
@click.option("--save-vehicle", type=options.PATH, metavar="NEW.yaml", help="Vehicle file with the given road load.")
@options.json
def road_load_command(
    vehicle: str, coefficients: str | None, per_kmh: bool, save_vehicle: Path | None, as_json: bool, **arguments: Any
) -> None:
    """Show the road load of a vehicle as A + B v + C v^2, or compare it with given coefficients.

    The force along a level, straight road at constant speed. --save-vehicle changes three values of the file, in their
    ranges, so that its force is that of the coefficients; the remaining error is shown.

    \b
    trackres road-load xgd24d --ambient-degc -10
    trackres road-load bmw_i3 --coefficients 118,0.55,0.033 --per-kmh --save-vehicle rolled.yaml
    """
    from trackres_ros.files.resources import find_vehicle
    from trackres_ros.tools.design.road_load import (
        coefficients_of,
        ends_reached,
        request_of,
        road_load,
        values_for,
        write_vehicle,
    )
    from trackres_ros.vehicle import files_of, load_any

    if save_vehicle is not None and coefficients is None:
        raise InputError("--save-vehicle", str(save_vehicle), "only with --coefficients")
    file = None if save_vehicle is None else output_file(save_vehicle, (".yaml",), "save_vehicle")
    watch(file)
    machine = load_any(find_vehicle(vehicle))
    not_an_input(file, files_of(machine), "save_vehicle")
    request, target = request_of(machine, **arguments), coefficients_of(coefficients, per_kmh)
    result = road_load(request, target)
    report, text, outputs = result.as_dict(), result.text(), list[str]()
    if file is not None and target is not None:
        values = values_for(request, target)
        with file_set():
            outputs = [str(path) for path in write_vehicle(machine, file, values, target)]
        written = road_load(replace(request, vehicle=load_any(file)), target)
        report |= {"values": values, "at_an_end_of_its_range": ends_reached(machine, values), "saved": written.as_dict()}
        ends = [f"at an end of its range: {path}" for path in ends_reached(machine, values)]
        text = "\n".join([text, "", "With the values of the new file", written.text(), *ends])
    emit({**report, "written": outputs}, as_json, lambda: with_written(text, outputs))
