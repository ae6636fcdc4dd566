# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs `trackres simulate`: computes torque and temperature of a speed profile."""

from __future__ import annotations

from pathlib import Path

import click

import trackres_ros as tr
from trackres_ros.cli.common import (
    Command,
    default_of,
    emit,
    json_option,
    method_options,
    number,
    progress,
    surroundings_option,
    vehicle_option,
)
from trackres_ros.cli.partial_output import watch


@click.command("simulate", cls=Command)
@vehicle_option
@surroundings_option
@click.option("--speed-kmh", type=number(-100, 100), help="Speed after the ramp [km/h].")
@click.option(
    "--ramp-s",
    type=number(0, 1e5),
    default=default_of(tr.simulate, "ramp_s"),
    show_default=True,
    help="Time from rest to that speed [s].",
)
@click.option("--duration-s", type=number(1e-3, 1e7), help="How long to simulate [s]; 2500 with --speed-kmh.")
@click.option(
    "--profile",
    type=click.Path(path_type=Path),
    metavar="P.csv",
    help="CSV or Parquet with time_s and speed_mps or speed_kmh instead of --speed-kmh, optionally with weight_n, "
    "ambient_degc and grade; linear interpolation between rows.",
)
@click.option("--ambient-degc", type=number(-60, 60), help="Ambient temperature [degC]; default the vehicle file's.")
@click.option(
    "--initial-degc", type=number(-60, 150), help="Belt temperature at the start [degC]; default the ambient temperature."
)
@click.option("--weight-kn", type=number(0.1, 1e5), help="Weight of the whole vehicle [kN]; default the vehicle file's.")
@method_options
@click.option("--dt", type=number(1e-4, 10), default=default_of(tr.simulate, "dt"), show_default=True, help="Time step [s].")
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), required=True, help="Result: .csv, .csv.gz, .parquet, .mf4 or .mcap."
)
@json_option
def simulate_command(
    vehicle: str,
    surroundings: Path | None,
    speed_kmh: float | None,
    ramp_s: float,
    duration_s: float | None,
    profile: Path | None,
    ambient_degc: float | None,
    initial_degc: float | None,
    weight_kn: float | None,
    method: str | None,
    thermal: str | None,
    dt: float,
    output: Path,
    as_json: bool,
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
    from trackres_ros.offline.energy import taken_text

    watch(output)
    described = tr.load_vehicle(vehicle, method=method, thermal=thermal, surroundings=surroundings)
    with progress("simulating", None):
        result = tr.simulate(
            described,
            speed_kmh=speed_kmh,
            ramp_s=ramp_s,
            duration_s=duration_s,
            profile=profile,
            ambient_degc=ambient_degc,
            initial_degc=initial_degc,
            weight_kn=weight_kn,
            dt=dt,
            output=output,
        )
    for note in result.notes:
        click.echo(f"trackres: {note}", err=True)
    report = {**result.as_dict(), "output": str(output)}
    emit(report, as_json, lambda: f"{result!r}\n{taken_text(report['drive'])}\n{report['rows']} rows in {output}")
