# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Sensor errors of a diagnosis: corrected only in the topics file, by the line of the role."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from trackres_ros.effects.effect import Active, VehicleConstants, conditions, together
from trackres_ros.errors import one_line
from trackres_ros.recording.bindings import TopicBinding
from trackres_ros.recording.roles import Conversion
from trackres_ros.recording.topics_files import correct_bindings, line_of

NOTHING_KNOWN = conditions(VehicleConstants(1.0, 1.0, 0.0, 0.0, 1.0, 1, 0.0, 0.0))  # a sensor's error is independent of the drive


def sensor_lines(
    sensors: Sequence[Active], bindings_by_name: Mapping[str, Mapping[str, TopicBinding]], torque_scale: float
) -> dict[str, str]:
    """Lines for the topics file by role, which correct the effects of sensors and replace the bindings of the recordings.

    `recorded` has these by the name of the recording. Where they differ, each line ends with the names that it is for, and
    its key has them too. `torque_scale` is the measured over the true torque, from the vehicle file. Torques that are added,
    as of two sides, get a line each; the offset is divided among them.
    """
    names: dict[str, dict[str, list[str]]] = {}
    for name, bindings in bindings_by_name.items() if sensors else ():
        for role, line in _lines(sensors, bindings, torque_scale).items():
            names.setdefault(role, {}).setdefault(line, []).append(one_line(name))
    entries = [
        (role, line, "" if len(recordings) == len(bindings_by_name) else ", ".join(recordings))
        for role in names
        for line, recordings in names[role].items()
    ]
    return {
        f"{role} of {recordings}" if recordings else role: f"{line}  # {recordings}" if recordings else line
        for role, line, recordings in entries
    }


def file_phrase(lines: Mapping[str, str]) -> str:
    """Name the file for the lines. Lines of several recordings cannot be in one file."""
    has_names = any(" of " in role for role in lines)
    return f"in the topics file{' of each recording' if has_names else ''}, replace the line of the role with"


def _lines(sensors: Sequence[Active], bindings: Mapping[str, TopicBinding], torque_scale: float) -> dict[str, str]:
    terms = together([active.terms(NOTHING_KNOWN) for active in sensors])
    gain = terms.sensor_gain
    of_torque = Conversion(1.0 / gain, -terms.sensor_offset * torque_scale / gain)
    torques = {
        role: replace(torque, delay_s=torque.delay_s + terms.sensor_delay)
        for role, torque in correct_bindings("torque", of_torque, bindings).items()
    }
    new_bindings = correct_bindings("speed", Conversion(terms.speed_factor), bindings) | torques
    return {
        role: line_of(role, binding) for role, binding in new_bindings.items() if binding != bindings.get(role, TopicBinding())
    }
