# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Gives a replay what a diagnosis has: the acceleration from both sides, and the steps that are compared."""

from __future__ import annotations

from dataclasses import replace

from trackres_ros.diagnosis.base.loading import gate_settings
from trackres_ros.diagnosis.prepare.gate import ComparedTorque, with_acceleration
from trackres_ros.errors import InputError
from trackres_ros.recording.recording import Recording
from trackres_ros.vehicle import AnyVehicle


def with_both_sides(recording: Recording, vehicle: AnyVehicle) -> tuple[Recording, ComparedTorque | None]:
    """The recording with its acceleration, and the steps that a diagnosis compares; none where it would refuse, with a note."""
    facts = gate_settings(vehicle)
    source = with_acceleration(recording, facts)
    try:
        return source, ComparedTorque(recording, facts)
    except InputError as error:
        return replace(source, notes=(*source.notes, f"no error as a diagnosis has it: {error}")), None
