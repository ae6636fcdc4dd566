# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs `trackres explain`: the parts of the torque at one operating point."""

from __future__ import annotations

from typing import Any

import click

import trackres_ros as tr
from trackres_ros.cli.common import Command, Number, ambient_option, emit, json_option, vehicle_option, weight_option


@click.command("explain", cls=Command)
@vehicle_option
@click.option("--speed-kmh", type=Number(-200, 200), required=True, help="Speed [km/h]; negative in reverse.")
@click.option("--belt-degc", type=Number(-60, 150), help="Belt temperature [degC]; of a vehicle without belts none.")
@ambient_option
@weight_option
@click.option(
    "--method", type=click.Choice(["rainflow", "spectral"]), help="Way from strain to heat; default the vehicle file's."
)
@json_option
def explain_command(vehicle: str, method: str | None, as_json: bool, **point: Any) -> None:
    """Show the parts of the torque at one operating point, computed by the exact methods.

    \b
    trackres explain --vehicle xgd24d --speed-kmh 50 --belt-degc 15
    trackres explain --vehicle xgd24d --speed-kmh 50 --belt-degc 15 --weight-kn 300 --method rainflow --json
    """
    result = tr.explain(tr.load_vehicle(vehicle, method=method), **point)
    emit(result.as_dict(), as_json, lambda: repr(result))
