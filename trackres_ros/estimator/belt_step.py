# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Advances one belt by a step: its temperature, and the departures due to uncertain inputs, by the same dynamics.

The belt state is an array (2, BELT_COLUMNS): its mean, and its surface where that has its own temperature. Column 0 is
the temperature. The others are the departures [K] due to one standard deviation of an uncertain input. They obey the
linearised model, forced by that input.
"""

from __future__ import annotations

import math

from trackres_ros.arrays import Array
from trackres_ros.effects.stepping import WORK
from trackres_ros.estimator.belt_heat import SLOWEST_LOG_SPEED, heat_of, log_speed
from trackres_ros.estimator.belt_lumped import advance_lumped
from trackres_ros.estimator.belt_two_nodes import advance_two_nodes
from trackres_ros.estimator.belt_uncertainty import add_noise
from trackres_ros.estimator.columns import BELT_COLUMNS, TEMPERATURE, Assembly
from trackres_ros.estimator.constants import Constants
from trackres_ros.kernels.arithmetic import squared
from trackres_ros.kernels.marks import kernel

LONGEST_SUBSTEP = 0.5  # s while rolling
MOST_SUBSTEPS = 20000
# Offset in the work space, after the effects' entries: a belt before a gap and after a rest.
BEFORE = WORK
RESTED = BEFORE + 2 * BELT_COLUMNS
BEHIND_BELTS = RESTED + 2 * BELT_COLUMNS


@kernel
def roll(
    k: Constants,
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

    Both are nan where only the temperatures are wanted. `log10_middle` is log10 of the middle speed, shared by all belts in a
    short step.

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
        heat = heat_of(k, assembly, belt[0, TEMPERATURE], speed, log10, log_load, drive_torque, ambient)
        if k.number.two_nodes:
            gained, lost = advance_two_nodes(k, assembly, belt, heat, ambient_std, part)
        else:
            gained, lost = advance_lumped(k, assembly, belt, heat, ambient_std, part)
        heat_in += gained
        heat_out += lost
    return heat_in, heat_out


@kernel
def pass_gap(
    k: Constants,
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
    before, rested = k.work[BEFORE:RESTED], k.work[RESTED:BEHIND_BELTS]
    for node in range(2):
        for column in range(BELT_COLUMNS):
            before[node * BELT_COLUMNS + column] = belt[node, column]
    roll(k, assembly, belt, 0.0, 0.0, SLOWEST_LOG_SPEED, log_load, 0.0, ambient, ambient_std, dt)
    for node in range(2):
        for column in range(BELT_COLUMNS):
            rested[node * BELT_COLUMNS + column] = belt[node, column]
            belt[node, column] = before[node * BELT_COLUMNS + column]
    roll(
        k, assembly, belt, speed_from, speed_to, log_speed(0.5 * (speed_from + speed_to)), log_load, 0.0, ambient, ambient_std, dt
    )
    of_mean = (belt[0, TEMPERATURE] - rested[TEMPERATURE]) / math.sqrt(12.0)
    of_skin = (belt[1, TEMPERATURE] - rested[BELT_COLUMNS + TEMPERATURE]) / math.sqrt(12.0)
    for node in range(2):
        for column in range(BELT_COLUMNS):
            belt[node, column] = 0.5 * (belt[node, column] + rested[node * BELT_COLUMNS + column])
    add_noise(belt, squared(of_mean), of_mean * of_skin, squared(of_skin))
