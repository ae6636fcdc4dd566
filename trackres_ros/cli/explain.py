# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs `trackres explain`: the parts of the torque at one operating point."""

from __future__ import annotations

import click

import trackres_ros as tr
from trackres_ros.cli.common import Command, emit, json_option, number, vehicle_option


@click.command("explain", cls=Command)
@vehicle_option
@click.option("--speed-kmh", type=number(-200, 200), required=True, help="Speed [km/h]; negative in reverse.")
@click.option("--belt-degc", type=number(-60, 150), help="Belt temperature [degC]; of a vehicle without belts none.")
@click.option("--ambient-degc", type=number(-60, 60), help="Ambient temperature [degC]; default the vehicle file's.")
@click.option("--weight-kn", type=number(0.1, 1e5), help="Weight of the whole vehicle [kN]; default the vehicle file's.")
@click.option(
    "--method", type=click.Choice(["rainflow", "spectral"]), help="Way from strain to heat; default the vehicle file's."
)
@json_option
def explain_command(
    vehicle: str,
    speed_kmh: float,
    belt_degc: float | None,
    ambient_degc: float | None,
    weight_kn: float | None,
    method: str | None,
    as_json: bool,
) -> None:
    """Show the parts of the torque at one operating point, computed by the exact methods.

    \b
    trackres explain --vehicle xgd24d --speed-kmh 50 --belt-degc 15
    trackres explain --vehicle xgd24d --speed-kmh 50 --belt-degc 15 --weight-kn 300 --method rainflow --json
    """
    described = tr.load_vehicle(vehicle, method=method)
    result = tr.explain(described, speed_kmh=speed_kmh, belt_degc=belt_degc, ambient_degc=ambient_degc, weight_kn=weight_kn)
    emit(result.as_dict(), as_json, lambda: repr(result))
