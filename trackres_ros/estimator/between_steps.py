# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The feed-forward between two steps: on its way to its target, or to zero while nothing may push the vehicle.

The session turns it at messages. The live node and the exported C ask for its value at each of their outputs.
"""

from __future__ import annotations

from trackres_ros.arrays import Array
from trackres_ros.estimator import columns as at
from trackres_ros.estimator.columns import Motion, Times
from trackres_ros.estimator.constants import Constants
from trackres_ros.estimator.feedforward import finite, followed, present_target
from trackres_ros.estimator.guards import LAST_ARRIVAL, Memory, not_enabled
from trackres_ros.kernels.marks import kernel
from trackres_ros.units import NANOSECOND

ENABLE_OLD = int(at.Reason.ENABLE_OLD)


@kernel
def age_of_speed(memory: Memory, now: int) -> float:
    """Time from the arrival of the last accepted speed to another one [s]."""
    return float((now - Times(memory.times[at.SPEED]).last_arrival) * NANOSECOND)


@kernel
def last_turn(k: Constants, memory: Memory, motion: Motion, now: int) -> tuple[float, float, int]:
    """The last turn of the feed-forward before an arrival [ns]: its value [Nm] and the age of the speed [s] then, and the reason
    why it has been on its way to zero since, else 0.

    Messages store their turns with `turn`. An enable expires between them, at a time of its own.
    """
    unfed = not_enabled(k, memory, now)
    if (unfed != 0) == (motion.unfed > 0.0):
        return motion.feedforward, motion.turned, unfed
    since = now
    if unfed == ENABLE_OLD:
        since = min(now, memory.times[at.ENABLE, LAST_ARRIVAL] + k.number.enable_hold_ns)
    age = age_of_speed(memory, since)
    value = followed(k.number, motion.feedforward, present_target(motion), age - motion.turned)
    return value, max(motion.turned, age), unfed


@kernel
def turn(k: Constants, memory: Memory, motion: Motion, now: int) -> None:
    """Turn the feed-forward at an arrival [ns]: to zero once it is not enabled or the vehicle may stand, afterwards back."""
    motion.feedforward, motion.turned, unfed = last_turn(k, memory, motion, now)
    motion.unfed = 1.0 if unfed != 0 else 0.0


@kernel
def fed_now(k: Constants, memory: Memory, motion: Array, now: int) -> tuple[float, float, int]:
    """Feed-forward at an arrival [ns] without its fading, the value that it is on its way to [Nm], and the reason why that is
    zero, else 0.
    """
    last = Motion(motion)
    value, turned, unfed = last_turn(k, memory, last, now)
    target = 0.0 if unfed != 0 else finite(last.feedforward_target)
    return followed(k.number, value, target, age_of_speed(memory, now) - turned), target, unfed
