# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Checks that the vehicle can have changed its speed as its messages say.

A reference follows the accepted speeds, at most at the vehicle's greatest acceleration. A speed further from it than
noise, resolution and delay explain is refused and begins a doubt. Then nothing is accepted until a run of consistent speeds
ends the doubt. The run has as many speeds as a clock jump needs, lasts as long as the doubt before it, and can have been
reached by the vehicle. So one wrong value costs a few samples, and two alternating values are never believed. No doubt
lasts longer than the vehicle needs from the old speed to the new one.
"""

from __future__ import annotations

import math

from trackres_ros.estimator.columns import Times, Tracked
from trackres_ros.estimator.constants import Constants
from trackres_ros.estimator.feedforward import towards
from trackres_ros.estimator.motion_step import LARGEST_QUANTUM
from trackres_ros.jit.compiled import inlined
from trackres_ros.units import NANOSECOND

LONGEST_RUN_NS = 2_000_000_000  # by then the feed-forward is zero: a longer wait is no safer


@inlined
def follow(k: Constants, reference: float, speed: float, elapsed: int, quantum: float) -> tuple[float, bool]:
    """The reference [m/s] after some time [ns], and whether a speed is close enough to it (ours).

    It moves towards the speed by a_max t at most; "close" is within the slack and one step of a quantised speed.
    """
    moved = towards(reference, speed, k.number.max_acceleration * (elapsed * NANOSECOND))
    slack = k.number.speed_slack + (quantum if quantum < LARGEST_QUANTUM else 0.0)
    return moved, abs(speed - moved) <= slack


@inlined
def trust(times: Times, tracked: Tracked, speed: float) -> None:
    """Accept a speed as the vehicle's, independent of its history."""
    tracked.reference, tracked.run = speed, math.nan
    times.doubts = 0


@inlined
def seems_to_stand(k: Constants, tracked: Tracked) -> bool:
    """Whether the doubtful speeds are those of a standing vehicle."""
    return bool(abs(tracked.run) <= k.number.speed_slack)


@inlined
def is_plausible(k: Constants, times: Times, tracked: Tracked, stamp: int, elapsed: int, speed: float, quantum: float) -> bool:
    """Whether to accept a speed some time [ns] after the last accepted one; record a doubtful one."""
    reached, near = follow(k, tracked.reference, speed, elapsed, quantum)
    if near and times.doubts == 0:
        tracked.reference = reached
        return True
    agrees, run = False, speed
    if times.doubts > 0:
        run, agrees = follow(k, tracked.run, speed, stamp - times.doubt_stamp, quantum)
    if agrees:
        times.doubts += 1
        tracked.run = run
    else:
        times.doubts, times.doubt_since = 1, stamp
        tracked.run = speed
    times.doubt_stamp = stamp
    lasted = stamp - times.doubt_since
    before = min(times.doubt_since - times.last_stamp, LONGEST_RUN_NS)
    if near and times.doubts >= k.number.jumps_to_accept and lasted >= before:
        trust(times, tracked, tracked.run)
        return True
    return False
