# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs `trackres explain`: the parts of the torque at one operating point."""

from typing import Any

import click

import trackres_ros as tr
from trackres_ros.tasks import options
from trackres_ros.tasks.terminal import Command, emit


@click.command("explain", cls=Command)
@options.vehicle
@options.of(tr.explain, "speed_kmh", "Speed [km/h]; negative in reverse.")
@options.of(tr.explain, "belt_degc", "Belt temperature [degC]; of a vehicle without belts none.")
@options.of(tr.explain, "ambient_degc", options.AMBIENT)
@options.of(tr.explain, "weight_kn", options.WEIGHT)
@click.option("--method", type=options.METHODS, help="Way from strain to heat; default the vehicle file's.")
@options.json
def explain_command(vehicle: str, method: str | None, as_json: bool, **point: Any) -> None:
    """Show the parts of the torque at one operating point, computed by the exact methods.

    \b
    trackres explain --vehicle xgd24d --speed-kmh 50 --belt-degc 15
    trackres explain --vehicle xgd24d --speed-kmh 50 --belt-degc 15 --weight-kn 300 --method rainflow --json
    """
    result = tr.explain(tr.load_vehicle(vehicle, method=method), **point)
    emit(result.as_dict(), as_json, lambda: repr(result))
