# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Defines the result of one steady state: loads, contacts, losses, heat and torque."""

from __future__ import annotations

from trackres_ros.model.operating_point import INACTIVE
from trackres_ros.tasks.content import Content
from trackres_ros.text import decimals, html_table, listed, panel, paragraph, table

WHEEL_HEAD = {"load": "N", "half length": "mm", "strain": "1", "frequency": "Hz", "modulus": "MPa"}
"""Displayed values of a road wheel's contact, and their units."""


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
        without = [f"{', '.join(left_out)}: {INACTIVE}"] if left_out else []
        if "belt_degc" not in self:
            power = decimals(self["power_w"] / 1e3, 2)
            return [f"Torque at the wheels [Nm]: {torques}", f"Power to overcome the resistance {power} kW", *without]
        lines = [
            f"Belt tension {self['tension_n']:.0f} N; film coefficient {self['film_coefficient_w_m2k']:.1f} W/m2K",
            f"Loss per metre of travel, per assembly, of {self['assemblies'][0]} [N]: "
            + ", ".join(f"{k} {decimals(v, 1)}" for k, v in self["loss_force_n"].items()),
            f"Heat of all belts {self['heat_w'] / 1e3:.2f} kW, cooling {decimals(self['cooling_w'] / 1e3, 2)} kW",
            "",
            f"Torque at the sprockets, whole vehicle [Nm]: {torques}",
        ]
        return [*lines, *without]

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
        first = self["assemblies"][0]
        return panel(
            self._head(),
            html_table(("torque at the sprockets", "Nm"), torques),
            html_table((f"loss per metre of {first}", "N"), losses),
            html_table((f"road wheel of {first}", *WHEEL_HEAD), self._wheels(), ("", *WHEEL_HEAD.values())),
            *map(paragraph, sentences),
            listed("Remarks", self["remarks"]),
        )
