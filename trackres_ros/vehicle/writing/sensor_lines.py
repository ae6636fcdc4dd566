# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Sensor errors of a diagnosis: corrected only in the topics file, by the line of the role."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

from trackres_ros.effects.effect import Active, VehicleConstants, conditions, together
from trackres_ros.recording.binding import TopicBinding
from trackres_ros.recording.roles import base_role
from trackres_ros.vehicle.writing.yaml_edit import flow

FIGURES = 6
REPLACED = "in the topics file, replace the line of the role with"
NOTHING_KNOWN = conditions(VehicleConstants(1.0, 1.0, 0.0, 0.0, 1.0, 1, 0.0, 0.0))  # a sensor's error is independent of the drive


def sensor_lines(sensors: Sequence[Active], bindings: Mapping[str, TopicBinding], torque_scale: float) -> dict[str, str]:
    """Lines for the topics file by role, which correct the effects of sensors and replace the bindings of the recordings.

    `torque_scale` is the measured over the true torque, from the vehicle file. Torques that are added, as of two sides,
    get a line each; the offset is divided among them.
    """
    if not sensors:
        return {}
    terms = together([active.terms(NOTHING_KNOWN) for active in sensors])
    speed = bindings.get("speed", TopicBinding())
    faster = replace(speed, scale=speed.scale * terms.speed_factor, offset=speed.offset * terms.speed_factor)
    corrected = {"speed": (speed, faster)}
    sides = [role for role in bindings if base_role(role) == "torque" != role]
    torques = sides if sides and "torque" not in bindings else ["torque"]
    gain, offset = terms.sensor_gain, terms.sensor_offset * torque_scale / len(torques)
    for role in torques:
        torque = bindings.get(role, TopicBinding())
        delay_s = torque.delay_s + terms.sensor_delay
        stronger = replace(torque, scale=torque.scale / gain, offset=(torque.offset - offset) / gain, delay_s=delay_s)
        corrected[role] = torque, stronger
    return {role: f"{role}: {flow(_said(after))}" for role, (before, after) in corrected.items() if after != before}


def _said(binding: TopicBinding) -> dict[str, Any]:
    """Keys of a line: all that differ from the default, with the unit in the scale, which also replaces that of the file."""
    found: dict[str, Any] = {"sum": [_said(part) for part in binding.parts]} if binding.parts else {}
    for item in fields(TopicBinding):
        value = getattr(binding, item.name)
        given = value != item.default or (item.name == "scale" and binding.converts)
        if given and item.name not in ("parts", "unit", "converts"):
            found[item.name] = float(f"{value:.{FIGURES}g}") if isinstance(value, float) else value
    return found
