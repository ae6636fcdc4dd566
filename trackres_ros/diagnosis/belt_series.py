"""Belt temperature and loss along a whole series: the live step's own equations, without its doubt, fast enough to fit with."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from trackres_ros.compiled import compiled
from trackres_ros.model.loss_table import look_up
from trackres_ros.model.rubber import log_shift_factor
from trackres_ros.model.thermal import phi_1, phi_matrix

Array = NDArray[np.float64]

SLOWEST_LOG_SPEED = -6.0
(
    FIRST_X,
    STEP_X,
    FIRST_LOG_LOAD,
    STEP_LOG_LOAD,
    GLASS_TRANSITION,
    WLF_C1,
    WLF_C2,
    CAPACITY,
    SURFACE_SHARE,
    AREA,
    FILM_OFFSET,
    FILM_SLOPE,
    INNER_RESISTANCE,
    SOFTENING,
    SOFTENING_FROM,
) = range(15)
CONSTANTS = 15
LEAST_RESISTANCE = 1e-6  # K/W: below it mean and surface are one


@compiled
def roll_along(
    constants: Array,
    table: Array,
    step: float,
    speed: Array,
    log_load: Array,
    ambient: Array,
    loss_factor: Array,
    film_offset_factor: Array,
    film_slope_factor: Array,
    conductance: Array,
    sink: Array,
    heat: Array,
    start_mean: float,
    start_surface: float,
    loss: Array,
    mean: Array,
    surface: Array,
) -> None:
    """Fill `loss` [N] and the temperatures of belt and surface [degC], each as it is at its sample.

    Parameters
    ----------
    constants
        See the names above.
    table
        Loss table, shape (1, x, load).
    step
        Time between samples [s].
    speed, log_load, ...
        Series of shape (n,): inputs and the terms of the effects, of one belt.
    start_mean, start_surface
        Temperatures at the first sample [degC].
    """
    inner_resistance = constants[INNER_RESISTANCE]
    capacity, area = constants[CAPACITY], constants[AREA]
    two_nodes = inner_resistance > LEAST_RESISTANCE
    share = constants[SURFACE_SHARE]
    skin_capacity = share * capacity
    inner = (1.0 - share) / inner_resistance if two_nodes else 0.0
    hot, outer = start_mean, start_surface
    for i in range(speed.shape[0]):
        travel = abs(speed[i])
        log_speed = math.log10(travel) if travel > 1e-6 else SLOWEST_LOG_SPEED
        shift, shift_slope = log_shift_factor(hot, constants[GLASS_TRANSITION], constants[WLF_C1], constants[WLF_C2])
        value, slope = look_up(
            table,
            0,
            constants[FIRST_X],
            constants[STEP_X],
            constants[FIRST_LOG_LOAD],
            constants[STEP_LOG_LOAD],
            shift + log_speed,
            log_load[i],
        )
        factor = loss_factor[i] * math.exp(-constants[SOFTENING] * (hot - constants[SOFTENING_FROM]))
        loss[i] = value * factor
        loss_slope = (slope * shift_slope - constants[SOFTENING] * value) * factor
        mean[i], surface[i] = hot, outer
        film = constants[FILM_OFFSET] * film_offset_factor[i] + constants[FILM_SLOPE] * film_slope_factor[i] * travel
        cooling = film * area
        power, power_slope = loss[i] * travel + heat[i], loss_slope * travel
        to_sink = conductance[i] * (sink[i] - outer)
        if not two_nodes:
            rate = (power - cooling * (hot - ambient[i]) + to_sink) / capacity
            growth = (power_slope - cooling - conductance[i]) / capacity
            hot += step * phi_1(growth * step) * rate
            outer = hot
            continue
        gained, slope = power / capacity, power_slope / capacity  # alike all through the rubber
        lost, carried = cooling * (outer - ambient[i]) - to_sink, cooling + conductance[i]
        rate_mean = gained - lost / capacity
        rate_surface = gained + (inner * (hot - outer) - lost) / skin_capacity
        m11, m12, m21, m22 = phi_matrix(
            step * slope,
            -step * carried / capacity,
            step * (slope + inner / skin_capacity),
            -step * (inner + carried) / skin_capacity,
            1,
        )
        hot += step * (m11 * rate_mean + m12 * rate_surface)
        outer += step * (m21 * rate_mean + m22 * rate_surface)


@compiled
def follow(target: Array, time_constant: Array, step: float, start: float, out: Array) -> None:
    """First-order lag along a series, exact for a target that holds over each step; `out` at each sample."""
    now = start
    for i in range(target.shape[0]):
        out[i] = now
        now += (target[i] - now) * -math.expm1(-step / time_constant[i])
