# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Advances one belt by a step: its temperature, and the departures due to uncertain inputs, by the same dynamics.

A belt state has the shape (2, BELT_COLUMNS): its mean, and its surface where that has its own temperature. Column 0 is the
temperature. The others are the departures [K] due to one standard deviation of an uncertain input. They obey the linearised
model, forced by that input, and their squares sum to the variance. An input that affects heat and torque keeps their
correlation.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from trackres_ros.arrays import Array
from trackres_ros.effects.effect import SOFTENING_FROM_DEGC
from trackres_ros.effects.stepping import TERM
from trackres_ros.estimator.columns import BELT_COLUMNS, FIRST_DEPARTURE, TEMPERATURE, Assembly, Belt
from trackres_ros.estimator.constants import Constants
from trackres_ros.estimator.records import Scratch
from trackres_ros.kernels.marks import kernel, squared
from trackres_ros.model.loss_table import look_up, look_up_drive
from trackres_ros.model.rubber import log_shift_factor
from trackres_ros.model.thermal import film_coefficient, phi_1, phi_2, phi_matrix, surface_temperature

# Uncertainty of a belt's temperature


@kernel
def belt_variance(belt: Array, of_mean: float, of_surface: float) -> float:
    """Variance [K^2] of h'T, the sum of (h'd_c)^2, with h = (of_mean, of_surface)."""
    total = 0.0
    for column in range(FIRST_DEPARTURE, BELT_COLUMNS):
        total += squared(of_mean * belt[0, column] + of_surface * belt[1, column])
    return total


@kernel
def add_noise(belt: Array, of_mean: float, of_both: float, of_skin: float) -> None:
    """Add an independent covariance W [K^2] of the two nodes to the random part: the factor of N N' + W (Cholesky)."""
    mean, skin = Belt(belt[0]), Belt(belt[1])
    c11 = squared(mean.noise_1) + squared(mean.noise_2) + of_mean
    c21 = mean.noise_1 * skin.noise_1 + mean.noise_2 * skin.noise_2 + of_both
    c22 = squared(skin.noise_1) + squared(skin.noise_2) + of_skin
    mean.noise_1, mean.noise_2 = math.sqrt(c11), 0.0
    skin.noise_1 = c21 / mean.noise_1 if c11 > 0.0 else 0.0
    skin.noise_2 = math.sqrt(max(c22 - squared(skin.noise_1), 0.0))


@kernel
def correct_belt(
    belt: Array, measured_degc: float, variance: float, expected_degc: float, of_mean: float, of_surface: float
) -> None:
    """Correct a belt by a measured temperature z [degC] of variance r [K^2], by the Kalman update; change `belt`.

    Notes
    -----
    With h = (of_mean, of_surface): k = sum d_c (h'd_c) / (sum (h'd_c)^2 + r), T += k (z - h'T), d_c -= k h'd_c; k sqrt(r) joins
    the random part. The uncertainty of parameters is considered, not estimated (Schmidt's filter [6]). The update reduces the
    departures, but they grow back with time, as the parameters stay wrong.
    """
    innovation = measured_degc - expected_degc
    total = belt_variance(belt, of_mean, of_surface) + variance
    gain_1 = gain_2 = 0.0
    for column in range(FIRST_DEPARTURE, BELT_COLUMNS):
        departure = of_mean * belt[0, column] + of_surface * belt[1, column]
        gain_1 += belt[0, column] * departure / total
        gain_2 += belt[1, column] * departure / total
    Belt(belt[0]).temperature += gain_1 * innovation
    Belt(belt[1]).temperature += gain_2 * innovation
    for column in range(FIRST_DEPARTURE, BELT_COLUMNS):
        departure = of_mean * belt[0, column] + of_surface * belt[1, column]
        belt[0, column] -= gain_1 * departure
        belt[1, column] -= gain_2 * departure
    noise = math.sqrt(variance)
    of_mean, of_skin = gain_1 * noise, gain_2 * noise
    add_noise(belt, squared(of_mean), of_mean * of_skin, squared(of_skin))


# Heating and cooling

SLOWEST_LOG_SPEED = -6.0  # log10(m/s); below it the loss per metre of travel no longer changes


class Heat(NamedTuple):
    """Heat of one belt at the start of a step."""

    power: float  # W, in
    power_slope: float  # W/K, its derivative by the mean temperature
    cooling: float  # W/K, from the last node to its surroundings
    surroundings: float  # degC: air and sink of the effects together


@kernel
def log_speed(speed: float) -> float:
    """log10 of a speed [m/s], bounded below."""
    magnitude = abs(speed)
    return math.log10(magnitude) if magnitude > 1e-6 else SLOWEST_LOG_SPEED


@kernel
def loss_force(
    k: Constants, terms: Array, assembly: Assembly, belt_degc: float, log10_speed: float, log_load: float, drive_torque: float
) -> tuple[float, float]:
    """Loss F_h [N] of one assembly and its derivative [N/K] by the belt temperature T.

    Notes
    -----
    F_h = F(x, ln G) + c_1(x) M_D + c_2(x) |M_D| at x = log10(a_T v): the loss of (25) to (29) from `model.loss_table`, the shift
    a_T of (3, 4). Effects multiply it by their factor and by exp(-softening (T - T_0)) (ours).
    """
    log_shift, shift_slope = log_shift_factor(belt_degc, k.number.glass_transition, k.number.wlf_c1, k.number.wlf_c2)
    x, table = log_shift + log10_speed, int(assembly.table)
    first_x, step_x = k.number.first_x, k.number.step_x
    at_rest, slope = look_up(k.loss, table, first_x, step_x, assembly.first_log_load, assembly.step_log_load, x, log_load)
    c_1, c_2 = look_up_drive(k.drive, table, first_x, step_x, x)
    loss = at_rest + drive_torque * c_1 + abs(drive_torque) * c_2
    factor, softening = terms[TERM.loss_factor], terms[TERM.softening]
    if softening != 0.0:
        factor *= math.exp(-softening * (belt_degc - SOFTENING_FROM_DEGC))
    return loss * factor, (slope * shift_slope - softening * loss) * factor


@kernel
def film(terms: Array, assembly: Assembly, speed: float) -> float:
    """Film coefficient U = U_0 + U_1 |v| [W/m^2/K] (31), with the effects on U_0 and U_1."""
    offset, slope = assembly.film_offset * terms[TERM.film_offset_factor], assembly.film_slope * terms[TERM.film_slope_factor]
    return film_coefficient(speed, offset, slope)


@kernel
def surface(
    k: Constants, terms: Array, assembly: Assembly, belt: Array, ambient: float, speed: float
) -> tuple[float, float, float]:
    """Surface temperature T_s [degC], and its derivatives by mean and surface: the row h of the measurement.

    The flux through layer and film is one (ours): T_s = (K T + U A_h T_a) / (K + U A_h).
    """
    shown_degc, share, inner = belt[1 if k.number.two_nodes else 0, TEMPERATURE], 1.0, assembly.skin_conductance
    if math.isfinite(inner):
        u = film(terms, assembly, speed)
        shown_degc = surface_temperature(shown_degc, ambient, u, assembly.area, inner)
        share = inner / (inner + u * assembly.area)
    return (shown_degc, 0.0, share) if k.number.two_nodes else (shown_degc, share, 0.0)


@kernel
def heat_of(
    k: Constants, terms: Array, assembly: Assembly, temperature: float, speed: float, log10_speed: float, log_load: float,
    drive_torque: float, ambient: float,
) -> Heat:  # fmt: skip
    """Heat P = F_h |v| (26) and cooling U A_h of one belt at a speed v [m/s] and an ambient temperature T_a [degC].

    Air and a sink of effects are one surrounding at a temperature between theirs (ours).
    """
    loss, loss_slope = loss_force(k, terms, assembly, temperature, log10_speed, log_load, drive_torque)
    travel, to_sink = abs(speed), terms[TERM.conductance]
    cooling = film(terms, assembly, speed) * assembly.area + to_sink
    surroundings = ambient + to_sink / cooling * (terms[TERM.sink] - ambient)
    return Heat(loss * travel + terms[TERM.heat], loss_slope * travel, cooling, surroundings)


# One temperature


@kernel
def advance_lumped(
    k: Constants, assembly: Assembly, belt: Array, heat: Heat, ambient_std: float, dt: float
) -> tuple[float, float]:
    """Advance a belt with one node, as `roll`: f = (P - U A_h (T - T_a)) / C and J = df/dT.

    Notes
    -----
    T += dt phi_1(J dt) f, and a departure d += dt phi_1(J dt) (J d + g) + dt^2 (phi_1 - phi_2)(J dt) g' f [5]: the forcing by its
    cause is g + g' (T(t) - T), so that of a hot belt fades as the belt cools. A random part is multiplied by
    exp(J dt) = 1 + dt phi_1(J dt) J and gains the variance q^2 dt phi_1(2 J dt), the integral of q^2 exp(2 J t). Heat in and out
    are integrals of the same linear model.
    """
    power, power_slope, cooling, surroundings = heat
    state, per_capacity = Belt(belt[0]), 1.0 / assembly.capacity
    excess = state.temperature - surroundings
    heating, loss = power * per_capacity, cooling * excess * per_capacity
    f, j = heating - loss, (power_slope - cooling) * per_capacity
    mean = dt * phi_1(j * dt)
    state.temperature += mean * f
    if not k.number.with_uncertainty:
        return math.nan, math.nan
    consider, second_order = state.consider, dt * dt * phi_2(j * dt)
    fades = (dt * mean - second_order) * f
    for cause in range(3):
        of_loss, of_cooling = assembly.consider_loss[cause], assembly.consider_cooling[cause]
        of_capacity = assembly.consider_capacity[cause]
        forcing = heating * of_loss - loss * of_cooling - f * of_capacity
        slope = (power_slope * of_loss - cooling * of_cooling) * per_capacity - j * of_capacity
        consider[cause] += mean * (j * consider[cause] + forcing) + fades * slope
    state.consider_ambient += mean * (j * state.consider_ambient + cooling * per_capacity * ambient_std)
    gains = squared(k.number.process_noise) * dt * phi_1(2.0 * j * dt)
    state.noise_1 = math.sqrt(squared(state.noise_1 * (1.0 + mean * j)) + gains)
    departure = second_order * f
    return power * dt + power_slope * departure, cooling * (excess * dt + departure)


# Mean and surface

LEAST_SPREAD = 1e-5  # of the rates, between the two of a belt


@kernel
def eigenvalues(j11: float, j12: float, j21: float, j22: float) -> tuple[float, float]:
    """Middle of the two eigenvalues and half of their distance [1/s]; complex or equal ones count as close: the step is short."""
    half = 0.5 * (j11 - j22)
    least_spread = LEAST_SPREAD * (abs(j11) + abs(j12) + abs(j21) + abs(j22))
    return 0.5 * (j11 + j22), math.sqrt(max(half * half + j12 * j21, least_spread * least_spread))


@kernel
def noise_covariance(j11: float, j12: float, j21: float, j22: float, dt: float) -> tuple[float, float, float]:
    """Covariance [s] of mean and surface after dt [s] in which both gain 1 per second together: of mean, both, surface.

    Notes
    -----
    It is the integral of (e^{Jt} 1)(e^{Jt} 1)'. With the eigenvalues l of J, e^{Jt} 1 = a e^{l_1 t} + b e^{l_2 t}, and
    e^{(l_i + l_j) t} has the integral dt phi_1((l_i + l_j) dt).
    """
    centre, spread = eigenvalues(j11, j12, j21, j22)
    root_1, root_2 = centre + spread, centre - spread
    a1, a2 = 0.5 * (j11 + j12 - root_2) / spread, 0.5 * (j21 + j22 - root_2) / spread
    b1, b2 = 1.0 - a1, 1.0 - a2
    aa, ab, bb = dt * phi_1(2.0 * root_1 * dt), dt * phi_1(2.0 * centre * dt), dt * phi_1(2.0 * root_2 * dt)
    return (
        a1 * a1 * aa + 2.0 * a1 * b1 * ab + b1 * b1 * bb,
        a1 * a2 * aa + (a1 * b2 + a2 * b1) * ab + b1 * b2 * bb,
        a2 * a2 * aa + 2.0 * a2 * b2 * ab + b2 * b2 * bb,
    )


@kernel
def add_fading(
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
    centre, spread = eigenvalues(j11, j12, j21, j22)
    root_1, root_2 = (centre + spread) * dt, (centre - spread) * dt
    d11, d22 = phi_1(root_1) - phi_2(root_1), phi_1(root_2) - phi_2(root_2)
    d12 = (phi_1(root_1) - phi_1(root_2)) / (root_1 - root_2)
    half, per_spread = 0.5 * (j11 - j22), 0.5 / spread
    p11, p12, p21, p22 = 0.5 + half * per_spread, j12 * per_spread, j21 * per_spread, 0.5 - half * per_spread
    of_first_1, of_first_2 = p11 * f1 + p12 * f2, p21 * f1 + p22 * f2
    of_second_1, of_second_2 = f1 - of_first_1, f2 - of_first_2
    for cause in range(3):
        loss, cooling, capacity = (
            assembly.consider_loss[cause],
            assembly.consider_cooling[cause],
            assembly.consider_capacity[cause],
        )
        g11, g12 = by_power * loss - j11 * capacity, -mean_cools * cooling - j12 * capacity
        g21, g22 = by_power * loss - j21 * capacity, -skin_cools * cooling - j22 * capacity
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
    """Advance a belt with two nodes, as `roll` (ours); f are their rates and J the derivatives of these.

    Notes
    -----
    C dT/dt = P - U A_h (T_s - T_a) and xi C dT_s/dt = xi P + (1 - xi) K (T - T_s) - U A_h (T_s - T_a). Temperatures and
    departures move by dt phi_1(J dt) times their rates [5]. The random part also gains q^2 times `noise_covariance`. Heat in and
    out are integrals of the same linear model.
    """
    power, power_slope, cooling, surroundings = heat
    mean, skin, per_capacity = Belt(belt[0]), Belt(belt[1]), 1.0 / assembly.capacity
    share, difference, excess = assembly.surface_share, mean.temperature - skin.temperature, skin.temperature - surroundings
    per_skin, inner = per_capacity / share, (1.0 - share) * assembly.inner_conductance
    power_rate, slope = power * per_capacity, power_slope * per_capacity  # uniform in the rubber
    loss = cooling * excess
    j11, j12 = slope, -cooling * per_capacity
    j21, j22 = slope + inner * per_skin, -(inner + cooling) * per_skin
    f1 = power_rate - loss * per_capacity
    f2 = power_rate + (inner * difference - loss) * per_skin
    m11, m12, m21, m22 = phi_matrix(j11 * dt, j12 * dt, j21 * dt, j22 * dt, 1.0)
    mean.temperature += dt * (m11 * f1 + m12 * f2)
    skin.temperature += dt * (m21 * f1 + m22 * f2)
    if not k.number.with_uncertainty:
        return math.nan, math.nan
    for column in range(FIRST_DEPARTURE, BELT_COLUMNS):
        departure_mean, departure_skin = belt[0, column], belt[1, column]
        slope_1, slope_2 = j11 * departure_mean + j12 * departure_skin, j21 * departure_mean + j22 * departure_skin
        cause = column - FIRST_DEPARTURE
        if cause < 3:
            heating, capacity = power_rate * assembly.consider_loss[cause], assembly.consider_capacity[cause]
            chilling = loss * assembly.consider_cooling[cause]
            slope_1 += heating - chilling * per_capacity - f1 * capacity
            slope_2 += heating - chilling * per_skin - f2 * capacity
        elif cause == 3:  # the ambient temperature
            slope_1 += cooling * per_capacity * ambient_std
            slope_2 += cooling * per_skin * ambient_std
        belt[0, column] = departure_mean + dt * (m11 * slope_1 + m12 * slope_2)
        belt[1, column] = departure_skin + dt * (m21 * slope_1 + m22 * slope_2)
    add_fading(belt, assembly, (slope, cooling * per_capacity, cooling * per_skin), (j11, j12, j21, j22), f1, f2, dt)
    of_mean, of_both, of_skin = noise_covariance(j11, j12, j21, j22, dt)
    rate = squared(k.number.process_noise)
    add_noise(belt, rate * of_mean, rate * of_both, rate * of_skin)
    p11, p12, p21, p22 = phi_matrix(j11 * dt, j12 * dt, j21 * dt, j22 * dt, 2.0)
    departure_1 = dt * dt * (p11 * f1 + p12 * f2)
    departure_2 = dt * dt * (p21 * f1 + p22 * f2)
    return power * dt + power_slope * departure_1, cooling * (excess * dt + departure_2)


# A step

LONGEST_SUBSTEP = 0.5  # s while rolling
MOST_SUBSTEPS = 20000


@kernel
def roll_belt(
    k: Constants,
    terms: Array,
    assembly: Assembly,
    belt: Array,
    speed_from: float,
    speed_to: float,
    log10_middle: float,
    log_load: float,
    drive_torque: float,
    ambient: float,
    ambient_std: float,
    dt: float,
) -> tuple[float, float]:
    """Advance one belt by dt [s] with the speed linear between two values [m/s]; change `belt`, return heat in and out [J].

    Both are nan where only the temperatures are wanted. `terms` are those of the effects. `log10_middle` is log10 of the middle
    speed, shared by all belts in a short step.

    Notes
    -----
    In each part of a step the speed is constant: T += dt phi_1(J dt) f, exponential Rosenbrock-Euler [5]. The model linearised at
    its start is solved exactly. It is of second order in dt for the nonlinear model, without a limit on dt at rest. Heat in and
    out are integrals of the same linear model, so their difference is the heat stored to rounding.
    """
    steps = 1
    if dt > LONGEST_SUBSTEP and not speed_from == speed_to == 0.0:
        steps = min(int(math.ceil(dt / LONGEST_SUBSTEP)), MOST_SUBSTEPS)
    heat_in, heat_out, part = 0.0, 0.0, dt / steps
    for step in range(steps):
        speed = speed_from + (speed_to - speed_from) * (step + 0.5) / steps
        log10 = log10_middle if steps == 1 else log_speed(speed)
        heat = heat_of(k, terms, assembly, belt[0, TEMPERATURE], speed, log10, log_load, drive_torque, ambient)
        if k.number.two_nodes:
            gain, loss = advance_two_nodes(k, assembly, belt, heat, ambient_std, part)
        else:
            gain, loss = advance_lumped(k, assembly, belt, heat, ambient_std, part)
        heat_in += gain
        heat_out += loss
    return heat_in, heat_out


@kernel
def pass_gap(
    k: Constants,
    scratch: Scratch,
    assembly: Assembly,
    belt: Array,
    speed_from: float,
    speed_to: float,
    log_load: float,
    ambient: float,
    ambient_std: float,
    dt: float,
) -> None:
    """Pass a gap too long to bridge (ours): the mean of a rest and of a drive throughout, as uncertain as the two differ.

    A temperature anywhere between the two has their difference over sqrt(12) as its standard deviation.
    """
    old_belt, rested_belt, terms = scratch.gap_belts[0], scratch.gap_belts[1], scratch.effects.terms
    for node in range(2):
        for column in range(BELT_COLUMNS):
            old_belt[node, column] = belt[node, column]
    roll_belt(k, terms, assembly, belt, 0.0, 0.0, SLOWEST_LOG_SPEED, log_load, 0.0, ambient, ambient_std, dt)
    for node in range(2):
        for column in range(BELT_COLUMNS):
            rested_belt[node, column] = belt[node, column]
            belt[node, column] = old_belt[node, column]
    roll_belt(
        k,
        terms,
        assembly,
        belt,
        speed_from,
        speed_to,
        log_speed(0.5 * (speed_from + speed_to)),
        log_load,
        0.0,
        ambient,
        ambient_std,
        dt,
    )
    of_mean = (belt[0, TEMPERATURE] - rested_belt[0, TEMPERATURE]) / math.sqrt(12.0)
    of_skin = (belt[1, TEMPERATURE] - rested_belt[1, TEMPERATURE]) / math.sqrt(12.0)
    for node in range(2):
        for column in range(BELT_COLUMNS):
            belt[node, column] = 0.5 * (belt[node, column] + rested_belt[node, column])
    add_noise(belt, squared(of_mean), of_mean * of_skin, squared(of_skin))
