# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Road load along a series: the same effects and the same forces as in the step of a tracked vehicle, without belts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trackres_ros.effects.stepping import TERM_DRIVE_GAIN, TERM_TORQUE, look, step_effects
from trackres_ros.jit.compiled import compiled
from trackres_ros.model.resistance import direction, grade_force, inertia_force, wind_force

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]


@compiled
def run_road_load(
    effect_rows: IntArray,
    effect_values: Array,
    work: Array,
    memory: Array,
    radius: float,
    rolling_coefficient: float,
    rolling_rise: float,
    drag_area: float,
    air_density: float,
    rotating_mass_factor: float,
    step: float,
    speed: Array,
    accel: Array,
    weight: Array,
    ambient: Array,
    grade: Array,
    yaw_rate: Array,
    heading: Array,
    torque: Array,
    outcome: IntArray,
) -> None:
    """Fill `torque`, at the driven wheels [Nm], and the `outcome` of the effects for each sample.

    Parameters
    ----------
    effect_rows, effect_values, work, memory
        See `effects.stepping`.
    radius, rolling_coefficient, rolling_rise, drag_area, air_density, rotating_mass_factor
        [m], of the weight, [s/m] its growth with speed, [m^2], [kg/m^3], effective over true mass.
    step
        Time between samples [s].
    speed, accel, weight, ambient, grade, yaw_rate, heading
        Series of shape (n,) in SI, degC.
    """
    last_torque = last_others = 0.0
    for i in range(speed.shape[0]):
        rolling = (rolling_coefficient + rolling_rise * abs(speed[i])) * weight[i] * direction(speed[i])
        others = radius * (
            rolling
            + wind_force(speed[i], drag_area, air_density)
            + inertia_force(accel[i], weight[i], rotating_mass_factor)
            + grade_force(grade[i], weight[i])
        )
        drive = last_torque + others - last_others  # as in `kernel.act`
        look(work, speed[i], accel[i], weight[i], ambient[i], yaw_rate[i], heading[i], np.nan, drive)
        outcome[i] = step_effects(effect_rows, effect_values, memory, work, step if i > 0 else 0.0)
        torque[i] = (others + work[TERM_TORQUE]) * work[TERM_DRIVE_GAIN]
        last_torque, last_others = torque[i], others
