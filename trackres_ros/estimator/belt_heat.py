# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Computes what warms and what cools one belt: loss of the rolling rubber, film to the air, and what effects add to both."""

from __future__ import annotations

import math
from typing import NamedTuple

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
from trackres_ros.estimator.columns import TEMPERATURE
from trackres_ros.estimator.constants import Constants
from trackres_ros.jit.compiled import inlined
from trackres_ros.model.loss_table import look_up, look_up_drive
from trackres_ros.model.rubber import log_shift_factor
from trackres_ros.model.thermal import film_coefficient, surface_temperature

Array = NDArray[np.float64]

SLOWEST_LOG_SPEED = -6.0  # log10(m/s); below it the loss per metre of travel no longer changes


class Heat(NamedTuple):
    """Heat of one belt at the start of a step."""

    power: float  # W, in
    power_slope: float  # W/K, its derivative by the mean temperature
    cooling: float  # W/K, from the last node to its surroundings
    surroundings: float  # degC: air and sink of the effects together


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
def heat_of(
    k: Constants, i: int, belt: Array, speed: float, log10_speed: float, log_load: float, drive_torque: float, ambient: float
) -> Heat:
    """Heat of one belt at a speed [m/s] and an ambient temperature [degC]."""
    loss, loss_slope = loss_force(k, i, belt[0, TEMPERATURE], log10_speed, log_load, drive_torque)
    travel = abs(speed)
    cooling = film(k, i, speed) * k.assembly[i, at.AREA] + k.work[TERM_CONDUCTANCE]
    # Air and sink together are one surrounding at a temperature between theirs.
    surroundings = ambient + k.work[TERM_CONDUCTANCE] / cooling * (k.work[TERM_SINK] - ambient)
    return Heat(loss * travel + k.work[TERM_HEAT], loss_slope * travel, cooling, surroundings)
