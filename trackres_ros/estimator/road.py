# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Computes the speeds and forces of a step that all assemblies share, and their torque."""

from __future__ import annotations

import math
from typing import NamedTuple

from trackres_ros.arrays import Array
from trackres_ros.effects.stepping import TERM_DRIVE_GAIN, TERM_TORQUE
from trackres_ros.estimator.belt_heat import log_speed
from trackres_ros.estimator.constants import Constants
from trackres_ros.kernels.marks import kernel
from trackres_ros.model.resistance import bearing_force, direction, grade_force, inertia_force, wind_force


class Road(NamedTuple):
    """Shared quantities of all assemblies in a step: speeds [m/s], forces on the whole vehicle [N], surroundings, time [s]."""

    last_speed: float
    speed: float
    log10_middle: float
    log10_speed: float
    sign: float
    weight: float
    bearing: float
    rolling_bearing: float  # `bearing` in forward travel, also at a crawl, where the smooth sign does not reduce it yet
    wind: float
    uphill: float
    inertia: float
    last_drive: float
    ambient: float
    ambient_std: float
    dt: float


@kernel
def road_now(
    k: Constants,
    last_speed: float,
    speed: float,
    accel: float,
    grade: float,
    weight: float,
    last_drive: float,
    ambient: float,
    ambient_std: float,
    dt: float,
) -> Road:
    """Forces on the whole vehicle at the end of a step; an unknown grade is level.

    Notes
    -----
    Bearing sign(v) f_b G_v (34), wind 1/2 rho_a C_d A_f v|v| (35), inertia delta_m G_v/g dv/dt (36), corrected as in
    `model.resistance`. Ours: the grade G_v sin(gamma), f_b that grows with the speed, and tanh(v/v_0) for sign(v).
    """
    number = k.number
    rolling = number.bearing_friction + number.rolling_rise * abs(speed)
    return Road(
        last_speed,
        speed,
        log_speed(0.5 * (last_speed + speed)),
        log_speed(speed),
        direction(speed),
        weight,
        bearing_force(speed, weight, rolling),
        rolling * weight,
        wind_force(speed, number.drag_area, number.air_density),
        grade_force(0.0 if math.isnan(grade) else grade, weight),
        inertia_force(accel, weight, number.rotating_mass_factor),
        last_drive,
        ambient,
        ambient_std,
        dt,
    )


@kernel
def torque_of_place(against: float, speed: float) -> float:
    """Torque by place [Nm]: sign(v) times the torque against travel (ours); 0 where unknown, and at standstill."""
    return 0.0 if math.isnan(against) else against * direction(speed)


@kernel
def driving_torque(work: Array, resisting: float, of_place: float, uphill: float, inertia: float) -> tuple[float, float]:
    """Torque M at the sprockets [Nm]: the sum of its parts (32) and effects, times the effects' gain (ours). Also return the
    effects' and the place's share.
    """
    without_gain = resisting + work[TERM_TORQUE] + of_place + uphill + inertia
    driving = without_gain * work[TERM_DRIVE_GAIN]
    return driving, work[TERM_TORQUE] + of_place + driving - without_gain
