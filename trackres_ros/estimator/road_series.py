# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Computes road load along a series: the same effects and the same forces as in the step of a tracked vehicle, without belts."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackres_ros.effects.stepping import TERM_DRIVE_GAIN, TERM_TORQUE, EffectTable, look, step_effects
from trackres_ros.estimator.records import Series
from trackres_ros.estimator.road import torque_of_place
from trackres_ros.jit.compiled import inlined
from trackres_ros.jit.entries import entry
from trackres_ros.model.resistance import direction, grade_force, inertia_force, wind_force

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]


class RoadLoad(NamedTuple):
    """Constants of a vehicle on wheels."""

    radius: float  # m
    rolling_coefficient: float  # of the weight
    rolling_rise: float  # s/m, its growth with speed
    drag_area: float  # m^2
    air_density: float  # kg/m^3
    rotating_mass_factor: float  # effective over true mass


@inlined
def road_load_along(
    effects: EffectTable, work: Array, memory: Array, vehicle: RoadLoad, series: Series, torque: Array, outcome: IntArray
) -> None:
    """Fill `torque`, at the driven wheels [Nm], and the `outcome` of the effects for each time of a drive.

    Parameters
    ----------
    effects, work, memory
        See `effects.stepping`.
    """
    last_torque = last_others = 0.0
    for i in range(series.times.shape[0]):
        speed, weight = series.speeds[i], series.weights[i]
        rolling = (vehicle.rolling_coefficient + vehicle.rolling_rise * abs(speed)) * weight * direction(speed)
        others = torque_of_place(series.torques_by_place[i], speed) + vehicle.radius * (
            rolling
            + wind_force(speed, vehicle.drag_area, vehicle.air_density)
            + inertia_force(series.accelerations[i], weight, vehicle.rotating_mass_factor)
            + grade_force(series.grades[i], weight)
        )
        drive = last_torque + others - last_others  # as in `kernel.act`
        turning = series.yaw_rates[i], series.headings[i], series.distances[i]
        look(work, speed, series.accelerations[i], weight, series.ambients[i], *turning, drive, math.nan)
        dt = series.times[i] - series.times[i - 1] if i > 0 else 0.0
        outcome[i] = step_effects(effects.rows, effects.values, memory, work, dt)
        torque[i] = (others + work[TERM_TORQUE]) * work[TERM_DRIVE_GAIN]
        last_torque, last_others = torque[i], others


run_road_load = entry(road_load_along)
