# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Checks that wheel speeds and odometer agree with the speed, and that the vehicle can have reached it.

How a speed may change is in `plausible_change`: within noise, resolution and delay of what the vehicle's greatest acceleration
allows. No doubt lasts longer than the vehicle needs from the old speed to the new one. Wheel speeds and the odometer are used
only for this check.
"""

from __future__ import annotations

import math

from trackres_ros.arrays import Array, IntArray
from trackres_ros.estimator.columns import SPEED, Run, Times, Tracked
from trackres_ros.estimator.constants import Constants
from trackres_ros.estimator.motion_step import LARGEST_QUANTUM
from trackres_ros.estimator.plausible_change import follow, is_in_reach
from trackres_ros.kernels.marks import kernel
from trackres_ros.units import NANOSECOND

SEEN, LAST_ARRIVAL = Times.seen, Times.last_arrival
NOTHING_TRACKED = (math.nan, math.nan, 0.0, 0.0, 0.0, 0.0, 0.0)
SHARE = 0.25  # wheels slip, and their radii are nominal ones
SLOW_MPS = 1.0  # pulses of a slow wheel are too rare: those of the ZTBus show nothing up to 0.6 m/s
COMPARED_M, COMPARED_STEPS = 50.0, 8.0  # a comparison takes so far, and so many steps of the odometer
FARTHEST_M = 1000.0  # no odometer has larger steps


@kernel
def slack_of(k: Constants, quantum: float) -> float:
    """How far a speed [m/s] may be from where the vehicle can be: the slack, and one step of a quantised speed."""
    return float(k.number.speed_slack + (quantum if quantum < LARGEST_QUANTUM else 0.0))


@kernel
def move_clock(times: Times, by: int) -> None:
    """Move all that is remembered of the speed's clock by a jump of it [ns]."""
    times.last_stamp += by
    times.doubt_since += by
    times.doubt_stamp += by


@kernel
def is_near(k: Constants, run: Run, elapsed: int, speed: float, quantum: float) -> bool:
    """Whether the vehicle can have reached a speed some time [ns] after the last accepted one."""
    return follow(run.reference, speed, elapsed, k.number.max_acceleration, slack_of(k, quantum))[1]


@kernel
def seems_to_stand(k: Constants, run: Run) -> bool:
    """Whether the doubtful speeds are those of a standing vehicle."""
    return bool(abs(run.doubted) <= k.number.speed_slack)


@kernel
def speed_is_plausible(k: Constants, times: Times, run: Run, stamp: int, elapsed: int, speed: float, quantum: float) -> bool:
    """Whether to accept a speed some time [ns] after the last accepted one; record a doubtful one."""
    return is_in_reach(k, times, run, stamp, elapsed, speed, k.number.max_acceleration, slack_of(k, quantum), 0)


@kernel
def forget_way(tracked: Tracked) -> None:
    """Restart the comparison with the odometer."""
    tracked.began, tracked.way, tracked.net = math.nan, 0.0, 0.0
    tracked.apart = 0.0


@kernel
def odometer_came(k: Constants, tracked: Tracked, distance: float, elapsed: int) -> None:
    """Process a distance [m] some time [ns] after the last one; compare it with the integrated speed where both are long enough.

    Of two changes in a row, the smaller one is a step of the odometer: a pause or a reset makes only one large change (ours).
    """
    moved = abs(distance - tracked.last)
    if 0.0 < moved <= FARTHEST_M:
        tracked.step = max(tracked.step, min(moved, tracked.change))
        tracked.change = moved
    tracked.last = distance
    if elapsed * NANOSECOND > k.number.bridge:
        forget_way(tracked)
    within = SHARE * max(COMPARED_M, COMPARED_STEPS * tracked.step) + tracked.step  # the tolerance of a comparison
    if math.isnan(tracked.began) or moved > within:
        tracked.began, tracked.way, tracked.net = distance, 0.0, 0.0
    by_odometer, step = abs(distance - tracked.began), tracked.step if tracked.step > 0.0 else tracked.change
    longest = max(by_odometer, tracked.way)
    if step > 0.0 and longest >= max(COMPARED_M, COMPARED_STEPS * step):
        off = min(abs(by_odometer - tracked.way), abs(by_odometer - abs(tracked.net)))
        apart = 1.0 if off > SHARE * longest + step else 0.0
        forget_way(tracked)
        tracked.began, tracked.apart = distance, apart


@kernel
def integrate_speed(k: Constants, tracked: Tracked, speed: float, elapsed: int) -> None:
    """Integrate a speed [m/s] over its duration [ns]; restart after an unknown gap."""
    seconds = elapsed * NANOSECOND
    if seconds > k.number.bridge:
        forget_way(tracked)
        return
    tracked.way += abs(speed) * seconds
    tracked.net += speed * seconds


@kernel
def disagrees(k: Constants, times: IntArray, values: Array, last_speed: float, speed: float, now: int) -> bool:
    """Whether, at an arrival [ns], two speeds [m/s] have contradicted all wheel speeds for longer than the speed may pause.

    Only fresh wheel speeds are compared, up to the age that a speed may have: they came between the two. Without any the verdict
    stays, but no longer than a gap is bridged (ours).
    """
    slow, fast, low, high, newest = min(abs(last_speed), abs(speed)), max(abs(last_speed), abs(speed)), math.inf, 0.0, 0
    hold_ns = max(k.number.motion_hold_ns, k.number.disagreeing_ns)
    for channel in range(k.number.first_wheel, times.shape[0]):
        if times[channel, SEEN]:
            newest = max(newest, times[channel, LAST_ARRIVAL])
            if now - times[channel, LAST_ARRIVAL] <= hold_ns:
                low, high = min(low, abs(values[channel])), max(high, abs(values[channel]))
    of_speed = Times(times[SPEED])
    compared = low < math.inf
    apart = slow > (1.0 + SHARE) * high + SLOW_MPS or fast < (1.0 - SHARE) * low - SLOW_MPS
    if (compared and not apart) or (not compared and (now - newest) * NANOSECOND > k.number.bridge):
        of_speed.disagrees_since = 0
    elif compared and of_speed.disagrees_since == 0:
        of_speed.disagrees_since = now
    until = min(now, newest + hold_ns)
    return of_speed.disagrees_since != 0 and until - of_speed.disagrees_since > k.number.disagreeing_ns
