# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Compares the speed with wheel speeds and with the odometer. Both serve only this check."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from trackres_ros.estimator import columns as at
from trackres_ros.estimator.constants import Constants
from trackres_ros.jit.compiled import inlined
from trackres_ros.units import NANOSECOND

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

# What is remembered behind `plausible_speed.RUN`: the odometer where a comparison began and its last value, the way by the speed
# since then, unsigned and signed, the largest step of the odometer [m], and whether the last comparison disagreed.
BEGAN, LAST, WAY, NET, STEP, APART = range(2, 8)
TRACKED = 8
NOTHING_TRACKED = (math.nan, math.nan, math.nan, math.nan, 0.0, 0.0, 0.0, 0.0)
SHARE = 0.25  # wheels slip, and their radii are nominal ones
SLOW_MPS = 1.0  # pulses of a slow wheel come too seldom: those of the ZTBus show nothing up to 0.6 m/s
COMPARED_M, COMPARED_STEPS = 50.0, 8.0  # a comparison takes so far, and so many steps of the odometer
FARTHEST_M = 1000.0  # more at once is an odometer that begins anew


@inlined
def forget_way(tracked: Array) -> None:
    """Begin the comparison with the odometer anew."""
    tracked[BEGAN], tracked[WAY], tracked[NET], tracked[APART] = math.nan, 0.0, 0.0, 0.0


@inlined
def odometer_came(tracked: Array, distance: float) -> None:
    """Take in a distance [m]; compares it with the way by the speed where both are long enough."""
    moved = abs(distance - tracked[LAST])
    if moved > FARTHEST_M:
        forget_way(tracked)
    elif moved > tracked[STEP]:
        tracked[STEP] = moved
    tracked[LAST] = distance
    if math.isnan(tracked[BEGAN]):
        tracked[BEGAN], tracked[WAY], tracked[NET] = distance, 0.0, 0.0
    by_odometer, step = abs(distance - tracked[BEGAN]), tracked[STEP]
    longest = max(by_odometer, tracked[WAY])
    if step > 0.0 and longest >= max(COMPARED_M, COMPARED_STEPS * step):
        off = min(abs(by_odometer - tracked[WAY]), abs(by_odometer - abs(tracked[NET])))
        apart = 1.0 if off > SHARE * longest + step else 0.0
        forget_way(tracked)
        tracked[BEGAN], tracked[APART] = distance, apart


@inlined
def drive_on(k: Constants, tracked: Array, speed: float, elapsed: int) -> None:
    """Count the way by a speed [m/s] that held for so long [ns]; over a gap that nobody knows it begins anew."""
    seconds = elapsed * NANOSECOND
    if seconds > k.number.bridge:
        forget_way(tracked)
        return
    tracked[WAY] += abs(speed) * seconds
    tracked[NET] += speed * seconds


@inlined
def disagrees(k: Constants, times: IntArray, values: Array, speed: float, stamp: int, now: int) -> bool:
    """Whether the speed [m/s] has been out of the range of all fresh wheel speeds for longer than a pause may last."""
    size, low, high = abs(speed), math.inf, 0.0
    for channel in range(k.number.first_wheel, times.shape[0]):
        if times[channel, at.SEEN] and now - times[channel, at.LAST_ARRIVAL] <= k.number.motion_hold_ns:
            low, high = min(low, abs(values[channel])), max(high, abs(values[channel]))
    apart = low < math.inf and (size > (1.0 + SHARE) * high + SLOW_MPS or size < (1.0 - SHARE) * low - SLOW_MPS)
    of_speed = times[at.SPEED]
    if not apart or of_speed[at.DISAGREES_SINCE] == 0:
        of_speed[at.DISAGREES_SINCE] = stamp if apart else 0
    return apart and stamp - of_speed[at.DISAGREES_SINCE] > k.number.disagreeing_ns
