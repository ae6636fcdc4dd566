# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Estimates the acceleration from a speed that may be quantised, as many buses send it, to 1 km/h.

It is a Kalman filter on speed and acceleration, the acceleration returning to zero over a while (Singer's model). A quantised
speed says only that the true one lies within half a step: while the prediction does too, it is not corrected, so a staircase of
repeated values does not become a staircase of accelerations.

R. A. Singer, Estimating optimal tracking filter performance for manned maneuvering targets, IEEE Trans. Aerosp. Electron.
Syst. AES-6 (1970) 473-483.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from trackres_ros.estimator.columns import (
    COV_ACCEL,
    COV_BOTH,
    COV_SPEED,
    FILTERED_ACCEL,
    FILTERED_SPEED,
    QUANTUM,
    ROLLS,
    STARTED,
)
from trackres_ros.jit.compiled import inlined

Array = NDArray[np.float64]

LARGEST_QUANTUM = 1.0  # m/s: a greater smallest step is not a quantum
SAME_VALUE = 1e-6  # m/s: rounding of a scaled bus value
# Standard deviations of the speed's noise, besides half a quantum: one sample in 5e8 of a speed at rest is further off than six,
# at 50 Hz one in four months. Once it rolls the half of that will do, and keeps a crawl from going on and off.
ROLLS_FROM, ROLLS_UNTIL = 6.0, 3.0


@inlined
def start_motion(motion: Array, speed: float, speed_variance: float, acceleration_variance: float) -> None:
    """Begin the filter at a first speed [m/s]."""
    motion[FILTERED_SPEED] = speed
    motion[FILTERED_ACCEL] = 0.0
    motion[COV_SPEED] = speed_variance
    motion[COV_BOTH] = 0.0
    motion[COV_ACCEL] = acceleration_variance
    motion[STARTED] = 1.0


@inlined
def rolls(motion: Array, speed: float, speed_variance: float) -> float:
    """1 while the speed [m/s] is more than the noise that its sensor has at rest, else 0."""
    noise = ROLLS_UNTIL if motion[ROLLS] > 0.0 else ROLLS_FROM
    quantum = motion[QUANTUM] if motion[QUANTUM] < LARGEST_QUANTUM else 0.0
    return 1.0 if abs(speed) > noise * math.sqrt(speed_variance) + 0.5 * quantum else 0.0


@inlined
def advance_motion(
    motion: Array,
    speed: float,
    last_speed: float,
    dt: float,
    speed_variance: float,
    acceleration_variance: float,
    acceleration_time: float,
) -> None:
    """Take in one more speed [m/s] after dt [s] > 0; changes `motion`."""
    step = abs(speed - last_speed)
    if SAME_VALUE < step < motion[QUANTUM]:
        motion[QUANTUM] = step
    keep = math.exp(-dt / acceleration_time)
    reach = acceleration_time * (1.0 - keep)
    predicted = motion[FILTERED_SPEED] + reach * motion[FILTERED_ACCEL]
    accel = keep * motion[FILTERED_ACCEL]
    gained = acceleration_variance * (1.0 - keep * keep)
    c11 = motion[COV_SPEED] + 2.0 * reach * motion[COV_BOTH] + reach * reach * motion[COV_ACCEL] + gained * dt * dt / 3.0
    c12 = keep * (motion[COV_BOTH] + reach * motion[COV_ACCEL]) + gained * dt / 2.0
    c22 = keep * keep * motion[COV_ACCEL] + gained
    half = 0.5 * motion[QUANTUM] if motion[QUANTUM] < LARGEST_QUANTUM else 0.0
    departure = speed - predicted
    innovation = math.copysign(max(abs(departure) - half, 0.0), departure)
    total = c11 + speed_variance + half * half / 3.0
    gain_speed, gain_accel = c11 / total, c12 / total
    motion[FILTERED_SPEED] = predicted + gain_speed * innovation
    motion[FILTERED_ACCEL] = accel + gain_accel * innovation
    motion[COV_SPEED] = c11 - gain_speed * c11
    motion[COV_BOTH] = c12 - gain_speed * c12
    motion[COV_ACCEL] = c22 - gain_accel * c12
