# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Advances a belt with a mean temperature and that of its surface, see `model.thermal`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from trackres_ros.estimator import columns as at
from trackres_ros.estimator.belt_heat import Heat
from trackres_ros.estimator.belt_uncertainty import add_noise
from trackres_ros.estimator.columns import BELT_COLUMNS, CONSIDER_1, CONSIDER_AMBIENT, TEMPERATURE
from trackres_ros.estimator.constants import Constants
from trackres_ros.jit.compiled import inlined
from trackres_ros.model.thermal import phi_matrix

Array = NDArray[np.float64]


@inlined
def advance_two_nodes(k: Constants, i: int, belt: Array, heat: Heat, ambient_std: float, dt: float) -> tuple[float, float]:
    """`belt_step.advance_belt` of a belt with two nodes."""
    power, power_slope, cooling, surroundings = heat
    temperature, per_capacity = belt[0, TEMPERATURE], 1.0 / k.assembly[i, at.CAPACITY]
    share, outer = k.assembly[i, at.SURFACE_SHARE], belt[1, TEMPERATURE]
    per_skin, inner = per_capacity / share, (1.0 - share) * k.assembly[i, at.INNER_CONDUCTANCE]
    gained, slope = power * per_capacity, power_slope * per_capacity  # alike all through the rubber
    lost = cooling * (outer - surroundings)
    j11, j12 = slope, -cooling * per_capacity
    j21, j22 = slope + inner * per_skin, -(inner + cooling) * per_skin
    rate_1 = gained - lost * per_capacity
    rate_2 = gained + (inner * (temperature - outer) - lost) * per_skin
    m11, m12, m21, m22 = phi_matrix(j11 * dt, j12 * dt, j21 * dt, j22 * dt, 1)
    belt[0, TEMPERATURE] = temperature + dt * (m11 * rate_1 + m12 * rate_2)
    belt[1, TEMPERATURE] = outer + dt * (m21 * rate_1 + m22 * rate_2)
    if not k.number.with_uncertainty:
        return math.nan, math.nan
    for column in range(CONSIDER_1, BELT_COLUMNS):
        first, second = belt[0, column], belt[1, column]
        slope_1, slope_2 = j11 * first + j12 * second, j21 * first + j22 * second
        if column < CONSIDER_AMBIENT:
            cause = column - CONSIDER_1
            heating = gained * k.assembly[i, at.CONSIDER_LOSS + cause]
            chilling, holding = lost * k.assembly[i, at.CONSIDER_COOLING + cause], k.assembly[i, at.CONSIDER_CAPACITY + cause]
            slope_1 += heating - chilling * per_capacity - rate_1 * holding
            slope_2 += heating - chilling * per_skin - rate_2 * holding
        elif column == CONSIDER_AMBIENT:
            slope_1 += cooling * per_capacity * ambient_std
            slope_2 += cooling * per_skin * ambient_std
        belt[0, column] = first + dt * (m11 * slope_1 + m12 * slope_2)
        belt[1, column] = second + dt * (m21 * slope_1 + m22 * slope_2)
    add_noise(belt, k.number.process_noise * math.sqrt(dt), k.number.process_noise * math.sqrt(dt))
    p11, p12, p21, p22 = phi_matrix(j11 * dt, j12 * dt, j21 * dt, j22 * dt, 2)
    departure_1 = dt * dt * (p11 * rate_1 + p12 * rate_2)
    departure_2 = dt * dt * (p21 * rate_1 + p22 * rate_2)
    return power * dt + power_slope * departure_1, cooling * ((outer - surroundings) * dt + departure_2)
