# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Checks that a vehicle can have changed its speed as its messages say.

A reference follows the accepted speeds, by the vehicle's greatest acceleration at most. A speed that is further from it than
noise, resolution and delay explain is refused, and doubt begins. Then nothing is accepted until a run of speeds ends the doubt:
they agree with one another, as many of them as a clock jump needs, for as long as the doubt lasted before them, and the vehicle
can have reached them by then. So one wrong value costs a few samples, two values in turn are never believed, and no doubt lasts
longer than the vehicle needs from the old speed to the new one.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from trackres_ros.estimator import columns as at
from trackres_ros.estimator.constants import Constants
from trackres_ros.estimator.feedforward import towards
from trackres_ros.estimator.motion_step import LARGEST_QUANTUM
from trackres_ros.jit.compiled import inlined
from trackres_ros.units import NANOSECOND

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

# What is remembered: the reference of the accepted speeds and that of the run in doubt [m/s]; behind them what `speed_witnesses`
# remembers of the odometer.
REFERENCE, RUN = range(2)
LONGEST_RUN_NS = 2_000_000_000  # by then the feed-forward has gone: waiting for more makes nothing safer


@inlined
def follow(k: Constants, reference: float, speed: float, elapsed: int, quantum: float) -> tuple[float, bool]:
    """The reference [m/s] after so long [ns], and whether a speed is near enough to it."""
    moved = towards(reference, speed, k.number.max_acceleration * (elapsed * NANOSECOND))
    slack = k.number.speed_slack + (quantum if quantum < LARGEST_QUANTUM else 0.0)
    return moved, abs(speed - moved) <= slack


@inlined
def trust(times: IntArray, tracked: Array, speed: float) -> None:
    """Take a speed for the vehicle's, whatever was before."""
    tracked[REFERENCE], tracked[RUN] = speed, math.nan
    times[at.DOUBTS] = 0


@inlined
def seems_to_stand(k: Constants, tracked: Array) -> bool:
    """Whether the speeds in doubt are those of a standing vehicle."""
    return bool(abs(tracked[RUN]) <= k.number.speed_slack)


@inlined
def is_plausible(k: Constants, times: IntArray, tracked: Array, stamp: int, elapsed: int, speed: float, quantum: float) -> bool:
    """Whether to accept a speed that comes so long [ns] after the last accepted one; takes note of one in doubt."""
    reached, near = follow(k, tracked[REFERENCE], speed, elapsed, quantum)
    if near and times[at.DOUBTS] == 0:
        tracked[REFERENCE] = reached
        return True
    agrees, run = False, speed
    if times[at.DOUBTS] > 0:
        run, agrees = follow(k, tracked[RUN], speed, stamp - times[at.DOUBT_STAMP], quantum)
    if agrees:
        times[at.DOUBTS] += 1
        tracked[RUN] = run
    else:
        times[at.DOUBTS], times[at.DOUBT_SINCE] = 1, stamp
        tracked[RUN] = speed
    times[at.DOUBT_STAMP] = stamp
    lasted = stamp - times[at.DOUBT_SINCE]
    before = min(times[at.DOUBT_SINCE] - times[at.LAST_STAMP], LONGEST_RUN_NS)
    if near and times[at.DOUBTS] >= k.number.jumps_to_accept and lasted >= before:
        trust(times, tracked, tracked[RUN])
        return True
    return False
