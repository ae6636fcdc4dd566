# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Advances a belt with one temperature, the paper's: C dT/dt = P - U A_h (T - T_a), (26, 30), see `model.thermal`."""

from __future__ import annotations

import math

from trackres_ros.arrays import Array
from trackres_ros.estimator.belt_heat import Heat
from trackres_ros.estimator.columns import Assembly, Belt
from trackres_ros.estimator.constants import Constants
from trackres_ros.kernels.arithmetic import squared
from trackres_ros.kernels.marks import kernel
from trackres_ros.model.thermal import phi_1, phi_2


@kernel
def advance_lumped(
    k: Constants, assembly: Assembly, belt: Array, heat: Heat, ambient_std: float, dt: float
) -> tuple[float, float]:
    """Advance a belt with one node, as `belt_step.roll`: f = (P - U A_h (T - T_a)) / C and J = df/dT.

    Notes
    -----
    T += dt phi_1(J dt) f, and a departure d += dt phi_1(J dt) (J d + g) + dt^2 (phi_1 - phi_2)(J dt) g' f [5]: the forcing by its
    cause is g + g' (T(t) - T), so that of a hot belt fades as the belt cools. A random part is multiplied by
    exp(J dt) = 1 + dt phi_1(J dt) J and gains the variance q^2 dt phi_1(2 J dt), the integral of q^2 exp(2 J t). Heat in and out
    are integrals of the same linear model.
    """
    power, power_slope, cooling, surroundings = heat
    state, per_capacity = Belt(belt[0]), 1.0 / assembly.capacity
    above = state.temperature - surroundings
    gained, lost = power * per_capacity, cooling * above * per_capacity
    f, j = gained - lost, (power_slope - cooling) * per_capacity
    mean = dt * phi_1(j * dt)
    state.temperature += mean * f
    if not k.number.with_uncertainty:
        return math.nan, math.nan
    consider, second = state.consider, dt * dt * phi_2(j * dt)
    fades = (dt * mean - second) * f
    for cause in range(3):
        of_loss, of_cooling = assembly.consider_loss[cause], assembly.consider_cooling[cause]
        of_capacity = assembly.consider_capacity[cause]
        forced = gained * of_loss - lost * of_cooling - f * of_capacity
        slope = (power_slope * of_loss - cooling * of_cooling) * per_capacity - j * of_capacity
        consider[cause] += mean * (j * consider[cause] + forced) + fades * slope
    state.consider_ambient += mean * (j * state.consider_ambient + cooling * per_capacity * ambient_std)
    gains = squared(k.number.process_noise) * dt * phi_1(2.0 * j * dt)
    state.noise_1 = math.sqrt(squared(state.noise_1 * (1.0 + mean * j)) + gains)
    departure = second * f
    return power * dt + power_slope * departure, cooling * (above * dt + departure)
