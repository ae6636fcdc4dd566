"""One step of one assembly's belt: temperature, and what each cause of doubt makes of it, through the same dynamics.

The belt state is an array (2, BELT_COLUMNS): its mean, and its surface where that has a temperature of its own. Column 0 is
the temperature.
The others are departures [K] that one standard deviation of a cause makes: they obey the model's linearisation,
forced by that cause, so their squares sum to the variance, and a cause that moves heat and torque together stays one.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from trackres_ros.effects.effect import SOFTENING_FROM_DEGC
from trackres_ros.effects.stepping import (
    TERM_CONDUCTANCE,
    TERM_FILM_OFFSET,
    TERM_FILM_SLOPE,
    TERM_HEAT,
    TERM_LOSS_FACTOR,
    TERM_SINK,
    TERM_SOFTENING,
)
from trackres_ros.estimator import columns as at
from trackres_ros.estimator.columns import BELT_COLUMNS, DOUBT_1, DOUBT_AMBIENT, NOISE_1, NOISE_2, TEMPERATURE
from trackres_ros.estimator.constants import Constants
from trackres_ros.jit.compiled import compiled, inlined
from trackres_ros.model.loss_table import look_up, look_up_drive
from trackres_ros.model.rubber import log_shift_factor
from trackres_ros.model.thermal import film_coefficient, phi_1, phi_2, phi_matrix, surface_temperature

Array = NDArray[np.float64]

SLOWEST_LOG_SPEED = -6.0  # log10(m/s); below it the loss per metre of travel no longer changes


@inlined
def log_speed(speed: float) -> float:
    """log10 of a speed [m/s], bounded below."""
    magnitude = abs(speed)
    return math.log10(magnitude) if magnitude > 1e-6 else SLOWEST_LOG_SPEED


@inlined
def loss_force(
    k: Constants, i: int, belt_degc: float, log10_speed: float, log_load: float, drive_torque: float
) -> tuple[float, float]:
    """Loss [N] of one assembly and its derivative [N/K] by the belt temperature."""
    table = int(k.assembly[i, at.TABLE])
    shift, shift_slope = log_shift_factor(belt_degc, k.number.glass_transition, k.number.wlf_c1, k.number.wlf_c2)
    x = shift + log10_speed
    loss, slope = look_up(
        k.loss,
        table,
        k.number.first_x,
        k.number.step_x,
        k.assembly[i, at.FIRST_LOG_LOAD],
        k.assembly[i, at.STEP_LOG_LOAD],
        x,
        log_load,
    )
    signed, unsigned = look_up_drive(k.drive, table, k.number.first_x, k.number.step_x, x)
    total = loss + drive_torque * signed + abs(drive_torque) * unsigned
    factor, softening = k.work[TERM_LOSS_FACTOR], k.work[TERM_SOFTENING]
    if softening != 0.0:
        factor *= math.exp(-softening * (belt_degc - SOFTENING_FROM_DEGC))
    return total * factor, (slope * shift_slope - softening * total) * factor


@inlined
def film(k: Constants, i: int, speed: float) -> float:
    """Film coefficient of a belt [W/m^2/K]."""
    return film_coefficient(
        speed,
        k.assembly[i, at.FILM_OFFSET] * k.work[TERM_FILM_OFFSET],
        k.assembly[i, at.FILM_SLOPE] * k.work[TERM_FILM_SLOPE],
    )


@inlined
def surface(k: Constants, i: int, belt: Array, ambient: float, speed: float) -> tuple[float, float, float]:
    """Surface temperature [degC], and its derivatives by mean and surface, shape of a row of the measurement matrix."""
    value, share = belt[1 if k.number.two_nodes else 0, TEMPERATURE], 1.0
    inner = k.assembly[i, at.SKIN_CONDUCTANCE]
    if math.isfinite(inner):
        to_air = film(k, i, speed)
        value = surface_temperature(value, ambient, to_air, k.assembly[i, at.AREA], inner)
        share = inner / (inner + to_air * k.assembly[i, at.AREA])
    return (value, 0.0, share) if k.number.two_nodes else (value, share, 0.0)


@inlined
def belt_variance(belt: Array, of_mean: float, of_surface: float) -> float:
    """Variance [K^2] of of_mean x mean + of_surface x surface."""
    total = 0.0
    for column in range(DOUBT_1, BELT_COLUMNS):
        departure = of_mean * belt[0, column] + of_surface * belt[1, column]
        total += departure * departure
    return total


@inlined
def advance_belt(
    k: Constants,
    i: int,
    belt: Array,
    speed: float,
    log10_speed: float,
    log_load: float,
    drive_torque: float,
    ambient: float,
    ambient_std: float,
    dt: float,
) -> tuple[float, float]:
    """Advance one belt by dt [s] at constant speed [m/s]; changes `belt`, returns heat in and out [J] over the step, which are
    not a number where only the temperatures are wanted.

    Notes
    -----
    Exponential Rosenbrock-Euler: the model linearised at the start of the step is solved exactly, to second order in dt for
    the true one, and without a limit on dt where nothing rolls. Heat in and out are integrals of the same linear model, so
    their difference is the heat stored to rounding.
    """
    temperature = belt[0, TEMPERATURE]
    loss, loss_slope = loss_force(k, i, temperature, log10_speed, log_load, drive_torque)
    travel = abs(speed)
    power, power_slope = loss * travel + k.work[TERM_HEAT], loss_slope * travel
    cooling = film(k, i, speed) * k.assembly[i, at.AREA] + k.work[TERM_CONDUCTANCE]
    # Air and sink together are one surrounding at a temperature between theirs.
    ambient += k.work[TERM_CONDUCTANCE] / cooling * (k.work[TERM_SINK] - ambient)
    per_capacity = 1.0 / k.assembly[i, at.CAPACITY]
    if not k.number.two_nodes:
        gained, lost = power * per_capacity, cooling * (temperature - ambient) * per_capacity
        rate, growth = gained - lost, (power_slope - cooling) * per_capacity
        mean = dt * phi_1(growth * dt)
        belt[0, TEMPERATURE] = temperature + mean * rate
        if not k.number.with_doubt:
            return math.nan, math.nan
        for cause in range(3):
            forced = (
                gained * k.assembly[i, at.LOSS_DOUBT + cause]
                - lost * k.assembly[i, at.COOLING_DOUBT + cause]
                - rate * k.assembly[i, at.CAPACITY_DOUBT + cause]
            )
            belt[0, DOUBT_1 + cause] += mean * (growth * belt[0, DOUBT_1 + cause] + forced)
        belt[0, DOUBT_AMBIENT] += mean * (growth * belt[0, DOUBT_AMBIENT] + cooling * per_capacity * ambient_std)
        kept = belt[0, NOISE_1] * (1.0 + mean * growth)
        belt[0, NOISE_1] = math.sqrt(kept * kept + k.number.process_noise * k.number.process_noise * dt)
        departure = dt * dt * phi_2(growth * dt) * rate
        return power * dt + power_slope * departure, cooling * ((temperature - ambient) * dt + departure)

    share, outer = k.assembly[i, at.SURFACE_SHARE], belt[1, TEMPERATURE]
    per_skin, inner = per_capacity / share, (1.0 - share) * k.assembly[i, at.INNER_CONDUCTANCE]
    gained, slope = power * per_capacity, power_slope * per_capacity  # alike all through the rubber
    lost = cooling * (outer - ambient)
    j11, j12 = slope, -cooling * per_capacity
    j21, j22 = slope + inner * per_skin, -(inner + cooling) * per_skin
    rate_1 = gained - lost * per_capacity
    rate_2 = gained + (inner * (temperature - outer) - lost) * per_skin
    m11, m12, m21, m22 = phi_matrix(j11 * dt, j12 * dt, j21 * dt, j22 * dt, 1)
    belt[0, TEMPERATURE] = temperature + dt * (m11 * rate_1 + m12 * rate_2)
    belt[1, TEMPERATURE] = outer + dt * (m21 * rate_1 + m22 * rate_2)
    if not k.number.with_doubt:
        return math.nan, math.nan
    for column in range(DOUBT_1, BELT_COLUMNS):
        first, second = belt[0, column], belt[1, column]
        slope_1, slope_2 = j11 * first + j12 * second, j21 * first + j22 * second
        if column < DOUBT_AMBIENT:
            cause = column - DOUBT_1
            heating = gained * k.assembly[i, at.LOSS_DOUBT + cause]
            chilling, holding = lost * k.assembly[i, at.COOLING_DOUBT + cause], k.assembly[i, at.CAPACITY_DOUBT + cause]
            slope_1 += heating - chilling * per_capacity - rate_1 * holding
            slope_2 += heating - chilling * per_skin - rate_2 * holding
        elif column == DOUBT_AMBIENT:
            slope_1 += cooling * per_capacity * ambient_std
            slope_2 += cooling * per_skin * ambient_std
        belt[0, column] = first + dt * (m11 * slope_1 + m12 * slope_2)
        belt[1, column] = second + dt * (m21 * slope_1 + m22 * slope_2)
    add_noise(belt, k.number.process_noise * math.sqrt(dt), k.number.process_noise * math.sqrt(dt))
    p11, p12, p21, p22 = phi_matrix(j11 * dt, j12 * dt, j21 * dt, j22 * dt, 2)
    departure_1 = dt * dt * (p11 * rate_1 + p12 * rate_2)
    departure_2 = dt * dt * (p21 * rate_1 + p22 * rate_2)
    return power * dt + power_slope * departure_1, cooling * ((outer - ambient) * dt + departure_2)


@compiled
def add_noise(belt: Array, first: float, second: float) -> None:
    """Fold one more independent departure [K] of the two nodes into the noise columns, as a lower 2 x 2 factor."""
    c11 = belt[0, NOISE_1] ** 2 + belt[0, NOISE_2] ** 2 + first * first
    c21 = belt[0, NOISE_1] * belt[1, NOISE_1] + belt[0, NOISE_2] * belt[1, NOISE_2] + first * second
    c22 = belt[1, NOISE_1] ** 2 + belt[1, NOISE_2] ** 2 + second * second
    belt[0, NOISE_1] = math.sqrt(c11)
    belt[0, NOISE_2] = 0.0
    belt[1, NOISE_1] = c21 / belt[0, NOISE_1] if c11 > 0.0 else 0.0
    belt[1, NOISE_2] = math.sqrt(max(c22 - belt[1, NOISE_1] ** 2, 0.0))


@compiled
def correct_belt(belt: Array, measured: float, variance: float, expected: float, of_mean: float, of_surface: float) -> None:
    """Correct a belt by a measured temperature [degC] of a variance [K^2]: the Kalman update, changes `belt`.

    Notes
    -----
    Doubt in parameters is considered, not estimated (Schmidt's filter): the update takes its share of the departures away, but
    as the parameters stay wrong they grow back with time.
    """
    innovation = measured - expected
    total = belt_variance(belt, of_mean, of_surface) + variance
    gain_1 = gain_2 = 0.0
    for column in range(DOUBT_1, BELT_COLUMNS):
        departure = of_mean * belt[0, column] + of_surface * belt[1, column]
        gain_1 += belt[0, column] * departure / total
        gain_2 += belt[1, column] * departure / total
    belt[0, TEMPERATURE] += gain_1 * innovation
    belt[1, TEMPERATURE] += gain_2 * innovation
    for column in range(DOUBT_1, BELT_COLUMNS):
        departure = of_mean * belt[0, column] + of_surface * belt[1, column]
        belt[0, column] -= gain_1 * departure
        belt[1, column] -= gain_2 * departure
    noise = math.sqrt(variance)
    add_noise(belt, gain_1 * noise, gain_2 * noise)
