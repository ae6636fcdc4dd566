# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads the estimator's settings from a topics file: age limits, the belt sensor, and the mass of a passenger."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import Any

from trackres_ros.errors import InputError
from trackres_ros.estimator.settings import Settings
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.roles import base_role

AGE_LIMITS = {
    "speed": "speed_max_age_s",
    "load": "load_hold_s",
    "passengers": "passengers_hold_s",
    "ambient": "ambient_hold_s",
    "accel": "motion_hold_s",
    "grade": "motion_hold_s",
    "torque": "torque_hold_s",
    "latitude": "position_hold_s",
    "longitude": "position_hold_s",
    "enable": "enable_hold_s",
}
"""Setting behind `max_age_s` of a role; several roles may share one, then the smallest applies."""
LIKE_MOTION = ("yaw_rate", "heading", "wheel_speed", "specific_force")
"""Roles with the age limit of an acceleration, without a `max_age_s` of their own."""
FAST = ("speed", "accel", "grade")
"""Roles whose age limit follows the period in which they come, unless a topics file gives the limit of one of them."""
SLOWEST_S = 0.01
FIELDS = {"passenger_kg": "kg_each", "belt_sensor": "sensor", "belt_measured_std_k": "std_k"}
"""Field of a topics file behind a setting; behind all others it is `max_age_s`."""
ENABLE_HOLD_S = 0.5
"""Default duration of an enable [s]; as the age limit of a trusted speed."""


def settings_for(settings: Settings, topics: Topics | None, roles: Collection[str] = ()) -> Settings:
    """Settings with the values that a topics file gives, and an enable that lasts `ENABLE_HOLD_S` where `roles` have one.

    Raises
    ------
    InputError
        As `given_by`, and for an age limit out of range.
    """
    changes: dict[str, Any] = {}
    if settings.enable_hold_s == 0.0 and "enable" in (*(topics or ()), *roles):
        changes["enable_hold_s"] = ENABLE_HOLD_S
    if topics is None:
        return replace(settings, **changes)
    if settings.belt_sensor == "auto" and any(base_role(role) == "belt" for role in topics):
        changes["belt_sensor"] = "surface"
    changes |= given_by(topics)
    try:
        return replace(settings, **changes)
    except InputError as error:
        raise InputError(f"{topics.origin}: max_age_s: {error.where}", error.given, error.allowed, error.remedy) from None


def longest_age_s(settings: Settings, role: str) -> float:
    """How long the last value of a role is used [s]. One of a belt, odometer or altimeter is used as long as a gap is bridged."""
    base = base_role(role)
    return float(getattr(settings, "motion_hold_s" if base in LIKE_MOTION else AGE_LIMITS.get(base, "bridge_s")))


def given_by(topics: Topics) -> dict[str, Any]:
    """The settings that a topics file gives, by name.

    Raises
    ------
    InputError
        For an age limit of a role without one, or for belts with different sensors.
    """
    changes: dict[str, Any] = {}
    for role in topics:
        limit = topics[role].max_age_s
        if limit is None or role == "direction":  # that of its own
            continue
        name = AGE_LIMITS.get(base_role(role))
        if name is None:
            raise InputError(f"{topics.origin}: {role}: max_age_s", limit, f"an age limit on {', '.join(AGE_LIMITS)}")
        changes[name] = limit if role == "enable" else min(limit, changes.get(name, limit))
        if role in FAST:
            changes["slow_input_max_age_s"] = SLOWEST_S
    kinds = {(topics[role].sensor, topics[role].std_k) for role in topics if base_role(role) == "belt"}
    if len(kinds) > 1:
        raise InputError(f"{topics.origin}: belt", sorted(map(str, kinds)), "one sensor and std_k for all belts")
    sensor, std_k = kinds.pop() if kinds else ("", None)
    kg_each = topics["passengers"].kg_each if "passengers" in topics else None
    of_fields = {"passenger_kg": kg_each, "belt_sensor": sensor or None, "belt_measured_std_k": std_k}
    return changes | {name: value for name, value in of_fields.items() if value is not None}
