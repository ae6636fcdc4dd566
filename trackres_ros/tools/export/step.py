# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Interface of a controller, in the restricted Python of the kernels: inputs of one moment, or one message, into the live step.

These functions are only translated; they call the guards and the step of the live node.
"""

from __future__ import annotations

import math

from trackres_ros.arrays import Array, IntArray
from trackres_ros.estimator import columns as layout
from trackres_ros.estimator.columns import Motion, Times
from trackres_ros.estimator.constants import Constants
from trackres_ros.estimator.feedforward import FEEDFORWARD_STEP_S, age_of_speed, fade, feedforward_at
from trackres_ros.estimator.guards import Memory, forget_others, longest_age, not_enabled
from trackres_ros.estimator.kernel import feed, rest
from trackres_ros.estimator.records import FARTHEST_NS, FIRST_NS, LAST_NS, LONGEST_STEP_S, Scratch, State
from trackres_ros.units import NANOSECOND

STEPPED, WAITED, WRONG_TIME = 1, 0, -2
PARTS = 2.0**32  # of a nanosecond: of smaller ones no caller can make enough
DISORDER_NS = round(FEEDFORWARD_STEP_S / NANOSECOND)
SPEED_IMPLAUSIBLE = int(layout.Reason.SPEED_IMPLAUSIBLE)
NOW, LATEST, PART = range(3)  # of the clock: its time, the latest one since the last accepted speed, and what rounding has left


def arrived(motion: Motion, clock: IntArray, arrival: int) -> None:
    """Move the clock to an arrival [ns]. Time does not go back: one a little before the last, as of two queues, is with it.

    By more than the time between two outputs it is another clock, and nobody knows how much time has passed: the speed is old
    until the next one, and the feed-forward begins anew from zero.
    """
    if arrival < clock[NOW] - DISORDER_NS:
        clock[NOW], clock[LATEST] = arrival, FARTHEST_NS
        motion.feedforward = motion.feedforward_target = 0.0
    else:
        clock[NOW] = max(clock[NOW], arrival)
        clock[LATEST] = max(clock[LATEST], clock[NOW])


def outcome_of(clock: IntArray, stepped: bool) -> int:
    """What a step or message gave; the age of the speed begins anew at an accepted one."""
    if stepped:
        clock[LATEST] = clock[NOW]
    return STEPPED if stepped else WAITED


def step(
    k: Constants, memory: Memory, carried: State, scratch: Scratch, clock: IntArray, given: Array, dt: float, out: Array
) -> int:
    """Process the inputs of a moment, `dt` [s] after the last one: the speed last, so that its step has all the others.

    Parameters
    ----------
    clock
        Time of the last step, the latest one, and what rounding has left of them, shape (3,): `NOW`, `LATEST` and `PART`.
    given
        A value of each channel, nan without a new one; shape (channels,).
    out
        Row of results; filled if there is an accepted speed.

    Returns
    -------
    int
        `STEPPED` with an accepted speed; `WAITED` without; `WRONG_TIME`, and nothing has changed, if `dt` is negative,
        no number or above `LONGEST_STEP_S`, or the clock at its end.
    """  # fmt: skip
    if not 0.0 <= dt <= LONGEST_STEP_S:
        return WRONG_TIME
    elapsed = dt / NANOSECOND + clock[PART] / PARTS
    whole = math.floor(elapsed + 0.5)
    now = clock[NOW] + whole
    if now > LAST_NS:
        return WRONG_TIME
    clock[NOW], clock[LATEST], clock[PART] = now, max(clock[LATEST], now), math.floor((elapsed - whole) * PARTS + 0.5)
    for channel in range(layout.SPEED + 1, given.shape[0]):
        if not math.isnan(given[channel]):
            times = Times(memory.times[channel])  # what a call gives is new, also where no time has passed since the last one
            stamp = max(now, times.last_stamp + 1) if times.seen else now
            feed(k, memory, carried, scratch, channel, stamp, now, given[channel], out)
    if math.isnan(given[layout.SPEED]):
        return WAITED
    return outcome_of(clock, feed(k, memory, carried, scratch, layout.SPEED, now, now, given[layout.SPEED], out))


def take_message(
    k: Constants, memory: Memory, carried: State, scratch: Scratch, clock: IntArray, channel: int, stamp: int, arrival: int,
    value: float, out: Array,
) -> int:  # fmt: skip
    """Process one message with its own stamp and its arrival [ns], as the live node does; see `step`."""
    if not (FIRST_NS <= stamp <= LAST_NS and FIRST_NS <= arrival <= LAST_NS):
        return WRONG_TIME
    arrived(Motion(carried.motion), clock, arrival)
    if channel < 0 or channel >= memory.values.shape[0]:
        return WAITED
    return outcome_of(clock, feed(k, memory, carried, scratch, channel, stamp, clock[NOW], value, out))


def feedforward_now(k: Constants, memory: Memory, motion: Array, latest: int) -> float:
    """The feed-forward [Nm] between two speeds, at the latest time [ns]; it fades once the speed is old."""
    if Times(memory.times[layout.SPEED]).seen == 0 or Motion(motion).started <= 0.0:
        return 0.0
    fed, _, _ = feedforward_at(k, memory, motion, latest)
    return fed * fade(age_of_speed(memory, latest), longest_age(k, memory), k.number.feedforward_fade)


def reasons_now(k: Constants, memory: Memory, latest: int) -> int:
    """Reasons that came up since the last step."""
    reason = not_enabled(k, memory, latest)
    return reason | SPEED_IMPLAUSIBLE if Times(memory.times[layout.SPEED]).doubts > 0 else reason


def is_stale(k: Constants, memory: Memory, latest: int) -> bool:
    """Whether the last accepted speed is too old to be trusted, or there is none."""
    return Times(memory.times[layout.SPEED]).seen == 0 or age_of_speed(memory, latest) > longest_age(k, memory)


def rest_after(k: Constants, memory: Memory, carried: State, scratch: Scratch, ambient: float, seconds: float) -> None:
    """Restart after the vehicle stood, or was switched off: belts and effects have cooled, messages are forgotten.

    An ambient temperature that its guard would refuse is the last known, and a time that is no number the longest.
    """
    is_plausible = k.channel_limits[layout.AMBIENT, 0] <= ambient <= k.channel_limits[layout.AMBIENT, 1]
    there = ambient if is_plausible else math.nan
    off = LONGEST_STEP_S if math.isnan(seconds) else min(max(seconds, 0.0), LONGEST_STEP_S)
    if Motion(carried.motion).started > 0.0:
        rest(k, carried, scratch, there, k.number.ambient_unknown_std, off)
    forget_others(memory, -1)
