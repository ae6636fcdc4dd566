# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs `trackres simulate`: computes torque and temperature of a speed profile."""

from pathlib import Path
from typing import Any

import click

import trackres_ros as tr
from trackres_ros.tasks import options
from trackres_ros.tasks.partial_output import watch
from trackres_ros.tasks.terminal import Command, emit, progress


@click.command("simulate", cls=Command)
@options.vehicle
@options.surroundings
@options.of(tr.simulate, "speed_kmh", "Speed after the ramp [km/h].")
@options.of(tr.simulate, "ramp_s", "Time from rest to that speed [s]; 50 with --speed-kmh.")
@options.of(tr.simulate, "duration_s", "How long to simulate [s]; 2500 with --speed-kmh.")
@click.option(
    "--profile",
    type=options.PATH,
    metavar="P.csv",
    help="CSV or Parquet with time_s and speed_mps or speed_kmh instead of --speed-kmh, optionally with weight_n, "
    "ambient_degc and grade; linear interpolation between rows.",
)
@options.of(tr.simulate, "ambient_degc", options.AMBIENT)
@options.of(tr.simulate, "initial_degc", "Belt temperature at the start [degC]; default the ambient temperature.")
@options.of(tr.simulate, "weight_kn", options.WEIGHT)
@options.methods
@options.of(tr.simulate, "dt", "Time step [s].")
@click.option("-o", "--output", type=options.PATH, required=True, help="Result: .csv, .csv.gz, .parquet, .mf4 or .mcap.")
@options.json
def simulate_command(
    vehicle: str, surroundings: Path | None, method: str | None, thermal: str | None, output: Path, as_json: bool, **asked: Any
) -> None:
    """Compute torque and belt temperature along a speed profile.

    \b
    trackres simulate --vehicle xgd24d --speed-kmh 50 -o out.csv
    trackres simulate --vehicle xgd24d --profile laps.csv --ambient-degc -15 -o out.mcap

    Columns: time_s, speed_mps, weight_n, ambient_degc, belt_degc (mean over the assemblies), resistance_torque_nm, which is the
    sum of hysteresis_nm, bearing_nm, wind_nm and effects_nm (of the vehicle file's effects), inertia_nm, drive_torque_nm
    (resistance and inertia); whole vehicle.
    With a grade in the profile also grade_nm, which the drive torque includes.
    """
    from trackres_ros.estimator.energy import taken_text

    watch(output)
    described = tr.load_vehicle(vehicle, method=method, thermal=thermal, surroundings=surroundings)
    with progress("simulating", None):
        result = tr.simulate(described, output=output, **asked)
    for note in result.notes:
        click.echo(f"trackres: {note}", err=True)
    report = {**result.as_dict(), "output": str(output)}
    emit(report, as_json, lambda: f"{result!r}\n{taken_text(report['drive'])}\n{report['rows']} rows in {output}")
