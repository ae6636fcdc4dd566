# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Computes heating and cooling of one belt: loss of the rolling rubber, film to the air, and the effects on both."""

from __future__ import annotations

import math
from typing import NamedTuple

from trackres_ros.arrays import Array
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
from trackres_ros.estimator.columns import TEMPERATURE, Assembly
from trackres_ros.estimator.constants import Constants
from trackres_ros.kernels.marks import kernel
from trackres_ros.model.loss_table import look_up, look_up_drive
from trackres_ros.model.rubber import log_shift_factor
from trackres_ros.model.thermal import film_coefficient, surface_temperature

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
    k: Constants, assembly: Assembly, belt_degc: float, log10_speed: float, log_load: float, drive_torque: float
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
    factor, softening = k.work[TERM_LOSS_FACTOR], k.work[TERM_SOFTENING]
    if softening != 0.0:
        factor *= math.exp(-softening * (belt_degc - SOFTENING_FROM_DEGC))
    return loss * factor, (slope * shift_slope - softening * loss) * factor


@kernel
def film(k: Constants, assembly: Assembly, speed: float) -> float:
    """Film coefficient U = U_0 + U_1 |v| [W/m^2/K] (31), with the effects on U_0 and U_1."""
    return film_coefficient(speed, assembly.film_offset * k.work[TERM_FILM_OFFSET], assembly.film_slope * k.work[TERM_FILM_SLOPE])


@kernel
def surface(k: Constants, assembly: Assembly, belt: Array, ambient: float, speed: float) -> tuple[float, float, float]:
    """Surface temperature T_s [degC], and its derivatives by mean and surface: the row h of the measurement.

    The flux through layer and film is one (ours): T_s = (K T + U A_h T_a) / (K + U A_h).
    """
    shown, share, inner = belt[1 if k.number.two_nodes else 0, TEMPERATURE], 1.0, assembly.skin_conductance
    if math.isfinite(inner):
        u = film(k, assembly, speed)
        shown = surface_temperature(shown, ambient, u, assembly.area, inner)
        share = inner / (inner + u * assembly.area)
    return (shown, 0.0, share) if k.number.two_nodes else (shown, share, 0.0)


@kernel
def heat_of(
    k: Constants, assembly: Assembly, temperature: float, speed: float, log10_speed: float, log_load: float, drive_torque: float,
    ambient: float,
) -> Heat:  # fmt: skip
    """Heat P = F_h |v| (26) and cooling U A_h of one belt at a speed v [m/s] and an ambient temperature T_a [degC].

    Air and a sink of effects are one surrounding at a temperature between theirs (ours).
    """
    loss, loss_slope = loss_force(k, assembly, temperature, log10_speed, log_load, drive_torque)
    travel, to_sink = abs(speed), k.work[TERM_CONDUCTANCE]
    cooling = film(k, assembly, speed) * assembly.area + to_sink
    surroundings = ambient + to_sink / cooling * (k.work[TERM_SINK] - ambient)
    return Heat(loss * travel + k.work[TERM_HEAT], loss_slope * travel, cooling, surroundings)
