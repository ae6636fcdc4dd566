# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Advances a belt with one temperature, the paper's: C dT/dt = P - h A (T - Ta), see `model.thermal`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from trackres_ros.estimator import columns as at
from trackres_ros.estimator.belt_heat import Heat
from trackres_ros.estimator.columns import CONSIDER_1, CONSIDER_AMBIENT, NOISE_1, TEMPERATURE
from trackres_ros.estimator.constants import Constants
from trackres_ros.jit.compiled import inlined
from trackres_ros.model.thermal import phi_1, phi_2

Array = NDArray[np.float64]


@inlined
def advance_lumped(k: Constants, i: int, belt: Array, heat: Heat, ambient_std: float, dt: float) -> tuple[float, float]:
    """`belt_step.advance_belt` of a belt with one node."""
    power, power_slope, cooling, surroundings = heat
    temperature, per_capacity = belt[0, TEMPERATURE], 1.0 / k.assembly[i, at.CAPACITY]
    gained, lost = power * per_capacity, cooling * (temperature - surroundings) * per_capacity
    rate, growth = gained - lost, (power_slope - cooling) * per_capacity
    mean = dt * phi_1(growth * dt)
    belt[0, TEMPERATURE] = temperature + mean * rate
    if not k.number.with_uncertainty:
        return math.nan, math.nan
    for cause in range(3):
        forced = (
            gained * k.assembly[i, at.CONSIDER_LOSS + cause]
            - lost * k.assembly[i, at.CONSIDER_COOLING + cause]
            - rate * k.assembly[i, at.CONSIDER_CAPACITY + cause]
        )
        belt[0, CONSIDER_1 + cause] += mean * (growth * belt[0, CONSIDER_1 + cause] + forced)
    belt[0, CONSIDER_AMBIENT] += mean * (growth * belt[0, CONSIDER_AMBIENT] + cooling * per_capacity * ambient_std)
    kept = belt[0, NOISE_1] * (1.0 + mean * growth)
    belt[0, NOISE_1] = math.sqrt(kept * kept + k.number.process_noise * k.number.process_noise * dt)
    departure = dt * dt * phi_2(growth * dt) * rate
    return power * dt + power_slope * departure, cooling * ((temperature - surroundings) * dt + departure)
