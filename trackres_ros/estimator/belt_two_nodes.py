# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Advances a belt with a mean and a surface temperature, see `model.thermal`."""

from __future__ import annotations

import math

from trackres_ros.arrays import Array
from trackres_ros.estimator.belt_heat import Heat
from trackres_ros.estimator.belt_uncertainty import add_noise
from trackres_ros.estimator.columns import BELT_COLUMNS, FIRST_DEPARTURE, Assembly, Belt
from trackres_ros.estimator.constants import Constants
from trackres_ros.kernels.arithmetic import squared
from trackres_ros.kernels.marks import kernel
from trackres_ros.model.thermal import phi_1, phi_2, phi_matrix

LEAST_SPREAD = 1e-5  # of the rates, between the two of a belt


@kernel
def eigenvalues(j11: float, j12: float, j21: float, j22: float) -> tuple[float, float]:
    """Middle of the two eigenvalues and half of their distance [1/s]; complex or equal ones count as close: the step is short."""
    half = 0.5 * (j11 - j22)
    least = LEAST_SPREAD * (abs(j11) + abs(j12) + abs(j21) + abs(j22))
    return 0.5 * (j11 + j22), math.sqrt(max(half * half + j12 * j21, least * least))


@kernel
def walked(j11: float, j12: float, j21: float, j22: float, dt: float) -> tuple[float, float, float]:
    """Covariance [s] of mean and surface after dt [s] in which both gain 1 per second together: of mean, both, surface.

    Notes
    -----
    It is the integral of (e^{Jt} 1)(e^{Jt} 1)'. With the eigenvalues l of J, e^{Jt} 1 = a e^{l_1 t} + b e^{l_2 t}, and
    e^{(l_i + l_j) t} has the integral dt phi_1((l_i + l_j) dt).
    """
    middle, spread = eigenvalues(j11, j12, j21, j22)
    first, second = middle + spread, middle - spread
    a1, a2 = 0.5 * (j11 + j12 - second) / spread, 0.5 * (j21 + j22 - second) / spread
    b1, b2 = 1.0 - a1, 1.0 - a2
    aa, ab, bb = dt * phi_1(2.0 * first * dt), dt * phi_1(2.0 * middle * dt), dt * phi_1(2.0 * second * dt)
    return (
        a1 * a1 * aa + 2.0 * a1 * b1 * ab + b1 * b1 * bb,
        a1 * a2 * aa + (a1 * b2 + a2 * b1) * ab + b1 * b2 * bb,
        a2 * a2 * aa + 2.0 * a2 * b2 * ab + b2 * b2 * bb,
    )


@kernel
def fading(
    belt: Array,
    assembly: Assembly,
    by_heat: tuple[float, float, float],
    jacobian: tuple[float, float, float, float],
    f1: float,
    f2: float,
    dt: float,
) -> None:
    """Add what the forcings of the departures change within dt [s], as temperatures move from their rates f1 and f2 [K/s].

    Notes
    -----
    A forcing is g + G (x(t) - x), so a departure gains dt^2 times the sum of P_i G P_k f D_ik, where P_i projects on an
    eigenvector of J, and D_ik = phi_1[l_i dt, l_k dt] is a divided difference (ours). For equal ones it is phi_1 - phi_2. So a
    hot belt's forcing by its cooling fades as it cools. `by_heat` [1/s] are the parts of J by the belt's power, and by the
    cooling of mean and surface.
    """
    j11, j12, j21, j22 = jacobian
    by_power, mean_cools, skin_cools = by_heat
    middle, spread = eigenvalues(j11, j12, j21, j22)
    first, second = (middle + spread) * dt, (middle - spread) * dt
    d11, d22 = phi_1(first) - phi_2(first), phi_1(second) - phi_2(second)
    d12 = (phi_1(first) - phi_1(second)) / (first - second)
    half, across = 0.5 * (j11 - j22), 0.5 / spread
    p11, p12, p21, p22 = 0.5 + half * across, j12 * across, j21 * across, 0.5 - half * across
    of_first_1, of_first_2 = p11 * f1 + p12 * f2, p21 * f1 + p22 * f2
    of_second_1, of_second_2 = f1 - of_first_1, f2 - of_first_2
    for cause in range(3):
        loss, cools, holds = assembly.consider_loss[cause], assembly.consider_cooling[cause], assembly.consider_capacity[cause]
        g11, g12 = by_power * loss - j11 * holds, -mean_cools * cools - j12 * holds
        g21, g22 = by_power * loss - j21 * holds, -skin_cools * cools - j22 * holds
        a1, a2 = g11 * of_first_1 + g12 * of_first_2, g21 * of_first_1 + g22 * of_first_2
        b1, b2 = g11 * of_second_1 + g12 * of_second_2, g21 * of_second_1 + g22 * of_second_2
        with_1, with_2 = d12 * a1 + d22 * b1, d12 * a2 + d22 * b2
        off_1, off_2 = d11 * a1 + d12 * b1 - with_1, d11 * a2 + d12 * b2 - with_2
        belt[0, FIRST_DEPARTURE + cause] += dt * dt * (with_1 + p11 * off_1 + p12 * off_2)
        belt[1, FIRST_DEPARTURE + cause] += dt * dt * (with_2 + p21 * off_1 + p22 * off_2)


@kernel
def advance_two_nodes(
    k: Constants, assembly: Assembly, belt: Array, heat: Heat, ambient_std: float, dt: float
) -> tuple[float, float]:
    """Advance a belt with two nodes, as `belt_step.roll` (ours); f are their rates and J the derivatives of these.

    Notes
    -----
    C dT/dt = P - U A_h (T_s - T_a) and xi C dT_s/dt = xi P + (1 - xi) K (T - T_s) - U A_h (T_s - T_a). Temperatures and
    departures move by dt phi_1(J dt) times their rates [5]. The random part also gains q^2 times what is `walked`. Heat in and
    out are integrals of the same linear model.
    """
    power, power_slope, cooling, surroundings = heat
    mean, skin, per_capacity = Belt(belt[0]), Belt(belt[1]), 1.0 / assembly.capacity
    share, between, above = assembly.surface_share, mean.temperature - skin.temperature, skin.temperature - surroundings
    per_skin, inner = per_capacity / share, (1.0 - share) * assembly.inner_conductance
    gained, slope = power * per_capacity, power_slope * per_capacity  # uniform in the rubber
    lost = cooling * above
    j11, j12 = slope, -cooling * per_capacity
    j21, j22 = slope + inner * per_skin, -(inner + cooling) * per_skin
    f1 = gained - lost * per_capacity
    f2 = gained + (inner * between - lost) * per_skin
    m11, m12, m21, m22 = phi_matrix(j11 * dt, j12 * dt, j21 * dt, j22 * dt, 1.0)
    mean.temperature += dt * (m11 * f1 + m12 * f2)
    skin.temperature += dt * (m21 * f1 + m22 * f2)
    if not k.number.with_uncertainty:
        return math.nan, math.nan
    for column in range(FIRST_DEPARTURE, BELT_COLUMNS):
        first, second = belt[0, column], belt[1, column]
        slope_1, slope_2 = j11 * first + j12 * second, j21 * first + j22 * second
        cause = column - FIRST_DEPARTURE
        if cause < 3:
            heating, holding = gained * assembly.consider_loss[cause], assembly.consider_capacity[cause]
            chilling = lost * assembly.consider_cooling[cause]
            slope_1 += heating - chilling * per_capacity - f1 * holding
            slope_2 += heating - chilling * per_skin - f2 * holding
        elif cause == 3:  # the ambient temperature
            slope_1 += cooling * per_capacity * ambient_std
            slope_2 += cooling * per_skin * ambient_std
        belt[0, column] = first + dt * (m11 * slope_1 + m12 * slope_2)
        belt[1, column] = second + dt * (m21 * slope_1 + m22 * slope_2)
    fading(belt, assembly, (slope, cooling * per_capacity, cooling * per_skin), (j11, j12, j21, j22), f1, f2, dt)
    of_mean, of_both, of_skin = walked(j11, j12, j21, j22, dt)
    rate = squared(k.number.process_noise)
    add_noise(belt, rate * of_mean, rate * of_both, rate * of_skin)
    p11, p12, p21, p22 = phi_matrix(j11 * dt, j12 * dt, j21 * dt, j22 * dt, 2.0)
    departure_1 = dt * dt * (p11 * f1 + p12 * f2)
    departure_2 = dt * dt * (p21 * f1 + p22 * f2)
    return power * dt + power_slope * departure_1, cooling * (above * dt + departure_2)
