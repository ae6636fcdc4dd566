# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Explains one operating point: loads, contacts, losses, heat and torque of a steady state."""

from __future__ import annotations

from typing import Any

import click

from trackres_ros.errors import InputError
from trackres_ros.model import operating_point
from trackres_ros.tasks import options
from trackres_ros.tasks.arguments import (
    AMBIENT,
    BELT,
    SPEED,
    WEIGHT,
    VehicleGiven,
    as_vehicle,
    check_weight,
    limited,
    load_vehicle,
)
from trackres_ros.tasks.results import Content
from trackres_ros.tasks.terminal import Command, emit
from trackres_ros.text import decimals, html_table, listed, panel, paragraph, table
from trackres_ros.units import KMH_PER_MPS
from trackres_ros.vehicle import RoadVehicle

LEAST_SHARE, LARGEST_SHARE = 0.05, 20.0  # of the nominal weight; a single point may be an unusual one
WHEEL_HEAD = {"load": "N", "half length": "mm", "strain": "1", "frequency": "Hz", "modulus": "MPa"}
"""Displayed values of a road wheel's contact, and their units."""


@limited(speed_kmh=SPEED, belt_degc=BELT, ambient_degc=AMBIENT, weight_kn=WEIGHT)
def explain(
    vehicle: VehicleGiven,
    *,
    speed_kmh: float,
    belt_degc: float | None = None,
    ambient_degc: float | None = None,
    weight_kn: float | None = None,
) -> OperatingPoint:
    """Compute the parts of the torque [Nm] at one operating point, by the exact methods.

    Parameters
    ----------
    vehicle
        A vehicle, the path of its file, or the name of a shipped one.
    speed_kmh
        [km/h]; negative in reverse.
    belt_degc
        Mean belt temperature [degC]; none for a vehicle without belts.
    ambient_degc, weight_kn
        Ambient temperature [degC] and weight of the whole vehicle [kN]; by default the vehicle file's.

    Returns
    -------
    OperatingPoint
        A mapping of wheel loads, contacts, tension, losses, heat, torque by part and the rainflow matrix; without belts only
        torque by part.

    Raises
    ------
    InputError
        For a weight or a speed that the vehicle cannot have.

    Examples
    --------
    >>> import trackres_ros as tr
    >>> point = tr.explain("xgd24d", speed_kmh=50, belt_degc=15)
    >>> {part: round(torque) for part, torque in point["torque_nm"].items()}
    {'hysteresis': 2604, 'bearing': 734, 'wind': 255, 'effects': 0, 'inertia': 0, 'resistance': 3593}
    """
    machine = as_vehicle(vehicle)
    check_weight(machine, weight_kn, LEAST_SHARE, LARGEST_SHARE)
    weight = None if weight_kn is None else weight_kn * 1e3
    speed = speed_kmh / KMH_PER_MPS
    if isinstance(machine, RoadVehicle):
        if belt_degc is not None:
            raise InputError("belt_degc", belt_degc, f"none for {machine.name}: the base model road_load has no belts")
        return OperatingPoint(operating_point.explain_road(machine, speed, ambient_degc, weight))
    if belt_degc is None:
        raise InputError("belt_degc", "nothing", "the mean temperature of the belts [degC]")
    return OperatingPoint(operating_point.explain(machine, speed, belt_degc, ambient_degc, weight))


class OperatingPoint(Content):
    """One operating point; see `trackres_ros.explain`. A mapping with the content of `as_dict`.

    Torques (``torque_nm``), heat and cooling are of the whole vehicle; ``contact``, ``tension_n``, ``loss_force_n`` and
    ``rainflow`` of the first assembly. Without belts it holds only torques and power.
    """

    def _head(self) -> str:
        belt = f"belt {decimals(self['belt_degc'], 1)} degC, " if "belt_degc" in self else ""
        return (
            f"{self['vehicle']}: {decimals(self['speed_mps'] * 3.6, 1)} km/h, {belt}"
            f"ambient {decimals(self['ambient_degc'], 1)} degC, {self['weight_n'] / 1e3:.1f} kN, {self['method']}"
        )

    def _sentences(self) -> list[str]:
        torques = ", ".join(f"{k} {decimals(v)}" for k, v in self["torque_nm"].items())
        left_out = self["effects_left_out"]
        inactive = [f"{', '.join(left_out)}: {operating_point.INACTIVE}"] if left_out else []
        if "belt_degc" not in self:
            power = decimals(self["power_w"] / 1e3, 2)
            return [f"Torque at the wheels [Nm]: {torques}", f"Power to overcome the resistance {power} kW", *inactive]
        lines = [
            f"Belt tension {self['tension_n']:.0f} N; film coefficient {self['film_coefficient_w_m2k']:.1f} W/m2K",
            f"Loss per metre of travel, per assembly, of {self['assemblies'][0]} [N]: "
            + ", ".join(f"{k} {decimals(v, 1)}" for k, v in self["loss_force_n"].items()),
            f"Heat of all belts {self['heat_w'] / 1e3:.2f} kW, cooling {decimals(self['cooling_w'] / 1e3, 2)} kW",
            "",
            f"Torque at the sprockets, whole vehicle [Nm]: {torques}",
        ]
        return [*lines, *inactive]

    def _wheels(self) -> list[tuple[str, ...]]:
        """Of each road wheel of the first assembly its number, and a text for each of `WHEEL_HEAD`."""
        return [
            (
                str(i), f"{load:.0f}", f"{c['half_length_m'] * 1e3:.2f}", f"{c['max_strain']:.4f}", f"{c['frequency_hz']:.1f}",
                f"{c['modulus_mpa']:.2f}",
            )
            for i, (load, c) in enumerate(zip(self["wheel_loads_n"][0], self["contact"], strict=True), 1)
        ]  # fmt: skip

    def __repr__(self) -> str:
        remarks = [f"  ! {remark}" for remark in self["remarks"]]
        if "belt_degc" not in self:
            return "\n".join([self._head(), *remarks, *self._sentences()])
        head = ["", *(f"{name}\n{unit}" for name, unit in WHEEL_HEAD.items())]
        wheels = table(self._wheels(), head, indent=2)
        return "\n".join([self._head(), *remarks, "", f"Road wheels of {self['assemblies'][0]}", wheels, "", *self._sentences()])

    def _repr_html_(self) -> str:
        torques = [(part, decimals(value)) for part, value in self["torque_nm"].items()]
        if "belt_degc" not in self:
            wheels = html_table(("torque at the wheels", "Nm"), torques)
            return panel(self._head(), wheels, *map(paragraph, self._sentences()[1:]), listed("Remarks", self["remarks"]))
        losses = [(part, decimals(value, 1)) for part, value in self["loss_force_n"].items()]
        sentences = [line for line in self._sentences() if line and not line.startswith(("Torque", "Loss"))]
        first_assembly = self["assemblies"][0]
        return panel(
            self._head(),
            html_table(("torque at the sprockets", "Nm"), torques),
            html_table((f"loss per metre of {first_assembly}", "N"), losses),
            html_table((f"road wheel of {first_assembly}", *WHEEL_HEAD), self._wheels(), ("", *WHEEL_HEAD.values())),
            *map(paragraph, sentences),
            listed("Remarks", self["remarks"]),
        )


@click.command("explain", cls=Command)
@options.vehicle
@options.argument_option(explain, "speed_kmh", "Speed [km/h]; negative in reverse.")
@options.argument_option(explain, "belt_degc", "Belt temperature [degC]; of a vehicle without belts none.")
@options.argument_option(explain, "ambient_degc", options.AMBIENT)
@options.argument_option(explain, "weight_kn", options.WEIGHT)
@click.option("--method", type=options.METHODS, help="Way from strain to heat; default the vehicle file's.")
@options.json
def explain_command(vehicle: str, method: str | None, as_json: bool, **point: Any) -> None:
    """Show the parts of the torque at one operating point, computed by the exact methods.

    \b
    trackres explain --vehicle xgd24d --speed-kmh 50 --belt-degc 15
    trackres explain --vehicle xgd24d --speed-kmh 50 --belt-degc 15 --weight-kn 300 --method rainflow --json
    """
    result = explain(load_vehicle(vehicle, method=method), **point)
    emit(result.as_dict(), as_json, lambda: repr(result))
