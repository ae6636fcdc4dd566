# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Holds the settings of the estimator: one table of units, limits and meanings, from which docs and parameters are made.

A topics file gives some of them: age limits, the belt sensor, where a torque is measured, and the mass of a passenger.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from trackres_ros.errors import InputError
from trackres_ros.files.dataclass_reader import Limits, check_values
from trackres_ros.model.resistance import TORQUE_TERMS, TorqueTerm
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.roles import PASSENGER_KG, base_role

# Table


def setting(default: float, unit: str, low: float, high: float, meaning: str) -> Any:
    """A field with limits and meaning in its metadata."""
    return field(default=default, metadata={"limits": Limits(unit, low, high, meaning), "meaning": meaning})


@dataclass(frozen=True)
class Settings:
    """Settings of the estimator; the field metadata holds limits and meaning of each."""

    initial_belt_std_k: float = setting(15.0, "K", 0.0, 100.0, "standard deviation of the belt temperature at a cold start")
    process_noise_k: float = setting(0.02, "K/sqrt(s)", 0.0, 10.0, "random walk of the belt temperature, for unmodelled effects")
    ambient_std_k: float = setting(2.0, "K", 0.0, 30.0, "standard deviation of a given ambient temperature")
    ambient_unknown_std_k: float = setting(
        10.0, "K", 0.0, 60.0, "standard deviation of an assumed ambient temperature, the last known or else the nominal one"
    )
    belt_measured_std_k: float = setting(3.0, "K", 0.01, 60.0, "standard deviation of a measured belt temperature")
    gap_s: float = setting(1.0, "s", 0.05, 60.0, "a longer pause in the speed is reported as a gap")
    bridge_s: float = setting(30.0, "s", 0.1, 600.0, "the speed is interpolated over gaps up to this length")
    clock_jump_s: float = setting(
        1.0, "s", 0.05, 3600.0, "a stamp that differs more from the time expected by arrival is not accepted at once"
    )
    jumps_to_accept: int = setting(3, "1", 2, 100, "number of consecutive consistent stamps that are accepted as a clock jump")
    load_hold_s: float = setting(60.0, "s", 0.1, 1e6, "longest age of the last load; then the nominal one is used")
    passengers_hold_s: float = setting(3600.0, "s", 1.0, 1e6, "longest age of the last passenger count; counts come at stops")
    passenger_kg: float = setting(PASSENGER_KG, "kg", 1.0, 500.0, "mass of a passenger, added to the vehicle file's loads")
    ambient_hold_s: float = setting(1800.0, "s", 1.0, 1e6, "longest age of the last ambient temperature")
    motion_hold_s: float = setting(
        0.5, "s", 0.01, 60.0, "longest age of an acceleration, grade, yaw rate, heading or wheel speed"
    )
    torque_hold_s: float = setting(0.5, "s", 0.01, 60.0, "longest age of a measured torque")
    position_hold_s: float = setting(
        10.0, "s", 0.2, 600.0, "longest age of the last position, extrapolated by the speed, on a route of the surroundings"
    )
    enable_hold_s: float = setting(
        0.0,
        "s",
        0.0,
        60.0,
        "longest age of an enable; then the feed-forward goes to zero. 0: none needed, "
        "or 0.5 s with the role enable in the topics file",
    )
    stuck_s: float = setting(120.0, "s", 1.0, 1e6, "a moving speed that has not changed for longer is reported as stuck")
    speed_std_mps: float = setting(0.02, "m/s", 0.0, 5.0, "noise of the speed, without its quantisation")
    acceleration_std: float = setting(0.5, "m/s^2", 0.01, 20.0, "standard deviation of the vehicle's own acceleration")
    acceleration_time_s: float = setting(3.0, "s", 0.05, 600.0, "time constant of the vehicle's acceleration")
    feedforward_rate: float = setting(20000.0, "Nm/s", 1.0, 1e9, "largest change of the feed-forward torque")
    feedforward_share: float = setting(
        0.10, "1", 0.001, 2.0, "largest feed-forward torque over weight (at most nominal) x sprocket radius"
    )
    speed_max_age_s: float = setting(
        0.5, "s", 0.01, 60.0, "longest age of a trusted speed; then the feed-forward fades and the live status is stale"
    )
    slow_input_max_age_s: float = setting(
        1.5,
        "s",
        0.01,
        60.0,
        "largest age limit of a speed, acceleration, grade, yaw rate or heading that comes rarely: one and a half of its period",
    )
    feedforward_fade_s: float = setting(1.0, "s", 0.01, 60.0, "time in which the feed-forward then goes to zero")
    belt_std_warn_k: float = setting(25.0, "K", 0.1, 1000.0, "a belt temperature with a larger standard deviation is reported")
    feedforward_parts: tuple[TorqueTerm, ...] = field(
        default=("hysteresis", "bearing", "wind"),
        metadata={
            "meaning": f"parts summed in the feed-forward, of {', '.join(TORQUE_TERMS)}; "
            "inertia is included only while an acceleration is given"
        },
    )
    belt_sensor: Literal["auto", "mean", "surface"] = field(
        default="auto",
        metadata={
            "meaning": "what a measured belt temperature shows: mean, or surface (infrared); auto: surface for a belt of a "
            "topics file, else mean"
        },
    )

    torque_at: Literal["sprockets", "motor"] = field(
        default="sprockets",
        metadata={
            "meaning": "where the measured torque acts: at the sprockets or wheels, or at the motor; the vehicle file's ratio "
            "and efficiency then convert it"
        },
    )

    def __post_init__(self) -> None:
        check_values(self, "setting")


# Settings of a topics file

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
FIELDS = {"passenger_kg": "kg_each", "belt_sensor": "sensor", "belt_measured_std_k": "std_k", "torque_at": "at"}
"""Field of a topics file behind a setting; behind all others it is `max_age_s`."""
ENABLE_HOLD_S = 0.5
"""Default duration of an enable [s]; as the age limit of a trusted speed."""


def settings_for(settings: Settings, topics: Topics | None, roles: Collection[str] = ()) -> Settings:
    """Settings with the values that a topics file gives, and an enable that lasts `ENABLE_HOLD_S` where `roles` have one.

    Raises
    ------
    InputError
        As `settings_of`, and for an age limit out of range.
    """
    changes: dict[str, Any] = {}
    if settings.enable_hold_s == 0.0 and "enable" in (*(topics or ()), *roles):
        changes["enable_hold_s"] = ENABLE_HOLD_S
    if topics is None:
        return replace(settings, **changes)
    if settings.belt_sensor == "auto" and any(base_role(role) == "belt" for role in topics):
        changes["belt_sensor"] = "surface"
    changes |= settings_of(topics)
    try:
        return replace(settings, **changes)
    except InputError as error:
        raise InputError(f"{topics.origin}: max_age_s: {error.where}", error.given, error.allowed, error.remedy) from None


def longest_age_s(settings: Settings, role: str) -> float:
    """How long the last value of a role is used [s]. One of a belt, odometer or altimeter is used as long as a gap is bridged."""
    base = base_role(role)
    return float(getattr(settings, "motion_hold_s" if base in LIKE_MOTION else AGE_LIMITS.get(base, "bridge_s")))


def settings_of(topics: Topics) -> dict[str, Any]:
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
    torque_at = topics["torque"].at or None if "torque" in topics else None
    of_fields = {"passenger_kg": kg_each, "belt_sensor": sensor or None, "belt_measured_std_k": std_k, "torque_at": torque_at}
    return changes | {name: value for name, value in of_fields.items() if value is not None}
