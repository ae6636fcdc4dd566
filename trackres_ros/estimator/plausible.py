# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Checks that a channel can have changed as its messages say: a speed by the vehicle's acceleration, a load only slowly.

A reference follows the accepted values, at most at the greatest rate of the channel. A value further from it than noise explains
is refused and begins a doubt. A run of consistent values ends the doubt, once it has as many values as a clock jump needs, and
lasts as long as the doubt before it. So one wrong speed costs a few samples, and two alternating values are never believed.
No doubt of a speed lasts longer than the vehicle needs from the old speed to the new one.

The load of a vehicle changes at standstill, or slowly, as a tank is filled or a field is harvested. A jump of it while driving is
believed once it outlasts each manoeuvre that moves load between axles. Until then a load near the old one is used.
Wheel speeds and the odometer are used only to check the speed.
"""

from __future__ import annotations

import math

from trackres_ros.arrays import Array, IntArray
from trackres_ros.estimator import columns as layout
from trackres_ros.estimator.columns import SPEED, Run, Times, Tracked
from trackres_ros.estimator.constants import LARGEST_LOAD_SHARE, Constants
from trackres_ros.estimator.motion import LARGEST_QUANTUM
from trackres_ros.kernels.marks import kernel
from trackres_ros.units import NANOSECOND

# Changes

LONGEST_RUN_NS = 2_000_000_000  # by then the feed-forward is zero: a longer wait is no safer
LOAD_LASTS_NS = 10_000_000_000  # ours: braking from 50 km/h at 2 m/s^2 takes 7 s, and moves load between axles
# Shares of the nominal load, ours. Bumps move the load of an axle by a tenth to three tenths (dynamic load coefficient; Cebon,
# Handbook of Vehicle-Road Interaction, 1999), and a sensor smooths them.
LOAD_SLACK = 0.25
FOLLOWED_PER_S = LOAD_SLACK / (LOAD_LASTS_NS * NANOSECOND)  # a slow change is believed as late as a jump that lasts
LONGEST_STEP_NS = 1_000_000_000  # of a reference of loads: a pause in them allows no jump
LOAD_PER_S = LOAD_SLACK / 60.0  # what nobody measures: a tank for a third of the weight is filled in minutes
FRESH_LOAD_NS = 2_000_000_000  # an older load is reported as held, while it is valid


@kernel
def step_towards(start: float, goal: float, room: float) -> float:
    """From one value to another, by no more than `room`; nowhere if one of the three is no number."""
    way = goal - start
    if abs(way) > room >= 0.0:
        return start + math.copysign(room, way)
    return goal if abs(way) <= room else start


@kernel
def follow_reference(reference: float, value: float, elapsed: int, rate: float, slack: float) -> tuple[float, bool]:
    """The reference after some time [ns], and whether a value is within `slack` of it (ours).

    It moves towards the value by `rate` [1/s] times the time at most.
    """
    level = step_towards(reference, value, rate * (elapsed * NANOSECOND))
    return level, abs(value - level) <= slack


@kernel
def trust_value(times: Times, run: Run, value: float) -> None:
    """Accept a value, independent of its history."""
    run.reference, run.doubted = value, math.nan
    times.doubts = 0


@kernel
def is_in_reach(
    k: Constants, times: Times, run: Run, stamp: int, elapsed: int, value: float, rate: float, slack: float, lasting: int
) -> bool:
    """Whether to accept a value some time [ns] after the last accepted one; record a doubtful one.

    A run that lasts for `lasting` [ns] is believed wherever it is, and a value near the reference ends the doubt. With 0 nothing
    but a run does. It must then be within reach of the last accepted value, and last as long as the doubt before it,
    `LONGEST_RUN_NS` at most.
    """
    follow_level, is_close = follow_reference(run.reference, value, elapsed, rate, slack)
    if is_close and (times.doubts == 0 or lasting > 0):
        run.reference, times.doubts = follow_level, 0
        return True
    agrees, level = False, value
    if times.doubts > 0:
        level, agrees = follow_reference(run.doubted, value, stamp - times.doubt_stamp, rate, slack)
    if agrees:
        times.doubts += 1
        run.doubted = level
    else:
        times.doubts, times.doubt_since = 1, stamp
        run.doubted = value
    times.doubt_stamp = stamp
    run_ns = stamp - times.doubt_since
    least_ns = lasting if lasting > 0 else min(times.doubt_since - times.last_stamp, LONGEST_RUN_NS)
    if (is_close or lasting > 0) and times.doubts >= k.number.jumps_to_accept and run_ns >= least_ns:
        trust_value(times, run, run.doubted)
        return True
    return False


@kernel
def is_load(k: Constants, channel: int) -> bool:
    """Whether a channel tells what the vehicle carries."""
    return channel == layout.LOAD or channel == layout.PASSENGERS or layout.FIRST_AXLE <= channel < k.number.first_belt


@kernel
def nominal_of(k: Constants, channel: int) -> float:
    """Nominal load of a channel of loads [N]; of passengers the number that weighs as much as the vehicle."""
    if channel == layout.PASSENGERS:
        return float(k.channel_limits[layout.LOAD, 1] / LARGEST_LOAD_SHARE / k.number.passenger_weight)
    return float(k.channel_limits[channel, 1] / LARGEST_LOAD_SHARE)


@kernel
def load_is_plausible(k: Constants, times: Times, run: Run, channel: int, stamp: int, elapsed: int, value: float) -> bool:
    """Whether to accept a load, or a number of passengers, of a vehicle that drives."""
    nominal = nominal_of(k, channel)
    step_ns = min(elapsed, LONGEST_STEP_NS)
    return is_in_reach(k, times, run, stamp, step_ns, value, FOLLOWED_PER_S * nominal, LOAD_SLACK * nominal, LOAD_LASTS_NS)


@kernel
def load_std(k: Constants, times: Times, run: Run, channel: int, value: float, time_ns: int) -> float:
    """Standard deviation of a load [N] that is held, or of a number of passengers: it may have changed since, or is doubted.

    Nobody boards a vehicle that drives: the number of passengers does not age.
    """
    nominal, age_s = nominal_of(k, channel), max(time_ns - times.last_arrival - FRESH_LOAD_NS, 0) * NANOSECOND
    std = 0.0 if channel == layout.PASSENGERS else min(LOAD_PER_S * age_s, LOAD_SLACK) * nominal
    return max(std, abs(run.doubted - value)) if times.doubts > 0 else std


# Speeds

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
def move_clock(times: Times, shift: int) -> None:
    """Shift the remembered stamps of the speed by a jump of its clock [ns]."""
    times.last_stamp += shift
    times.doubt_since += shift
    times.doubt_stamp += shift


@kernel
def is_near(k: Constants, run: Run, elapsed: int, speed: float, quantum: float) -> bool:
    """Whether the vehicle can have reached a speed some time [ns] after the last accepted one."""
    return follow_reference(run.reference, speed, elapsed, k.number.max_acceleration, slack_of(k, quantum))[1]


@kernel
def seems_to_stand(k: Constants, run: Run) -> bool:
    """Whether the doubtful speeds are those of a standing vehicle."""
    return bool(abs(run.doubted) <= k.number.speed_slack)


@kernel
def speed_is_plausible(k: Constants, times: Times, run: Run, stamp: int, elapsed: int, speed: float, quantum: float) -> bool:
    """Whether to accept a speed some time [ns] after the last accepted one; record a doubtful one."""
    return is_in_reach(k, times, run, stamp, elapsed, speed, k.number.max_acceleration, slack_of(k, quantum), 0)


@kernel
def forget_way(odometer: Tracked) -> None:
    """Restart the comparison with the odometer."""
    odometer.began, odometer.way, odometer.net = math.nan, 0.0, 0.0
    odometer.apart = 0.0


@kernel
def take_odometer(k: Constants, odometer: Tracked, distance: float, elapsed: int) -> None:
    """Process a distance [m] some time [ns] after the last one; compare it with the integrated speed where both are long enough.

    Of two changes in a row, the smaller one is a step of the odometer: a pause or a reset makes only one large change (ours).
    """
    step_m = abs(distance - odometer.last)
    if 0.0 < step_m <= FARTHEST_M:
        odometer.step = max(odometer.step, min(step_m, odometer.change))
        odometer.change = step_m
    odometer.last = distance
    if elapsed * NANOSECOND > k.number.bridge:
        forget_way(odometer)
    tolerance = SHARE * max(COMPARED_M, COMPARED_STEPS * odometer.step) + odometer.step  # the tolerance of a comparison
    if math.isnan(odometer.began) or step_m > tolerance:
        odometer.began, odometer.way, odometer.net = distance, 0.0, 0.0
    by_odometer, step = abs(distance - odometer.began), odometer.step if odometer.step > 0.0 else odometer.change
    length = max(by_odometer, odometer.way)
    if step > 0.0 and length >= max(COMPARED_M, COMPARED_STEPS * step):
        error = min(abs(by_odometer - odometer.way), abs(by_odometer - abs(odometer.net)))
        mismatch = 1.0 if error > SHARE * length + step else 0.0
        forget_way(odometer)
        odometer.began, odometer.apart = distance, mismatch


@kernel
def integrate_speed(k: Constants, odometer: Tracked, speed: float, elapsed: int) -> None:
    """Integrate a speed [m/s] over its duration [ns]; restart after an unknown gap."""
    seconds = elapsed * NANOSECOND
    if seconds > k.number.bridge:
        forget_way(odometer)
        return
    odometer.way += abs(speed) * seconds
    odometer.net += speed * seconds


@kernel
def speeds_disagree(k: Constants, times: IntArray, values: Array, last_speed: float, speed: float, time_ns: int) -> bool:
    """Whether, at an arrival [ns], two speeds [m/s] have contradicted all wheel speeds for longer than the speed may pause.

    Only fresh wheel speeds are compared, up to the age that a speed may have: they came between the two. Without any the verdict
    stays, but no longer than a gap is bridged (ours).
    """
    low_speed, high_speed, low, high, newest_ns = (
        min(abs(last_speed), abs(speed)),
        max(abs(last_speed), abs(speed)),
        math.inf,
        0.0,
        0,
    )
    hold_ns = max(k.number.motion_hold_ns, k.number.disagreeing_ns)
    for channel in range(k.number.first_wheel, times.shape[0]):
        if times[channel, SEEN]:
            newest_ns = max(newest_ns, times[channel, LAST_ARRIVAL])
            if time_ns - times[channel, LAST_ARRIVAL] <= hold_ns:
                low, high = min(low, abs(values[channel])), max(high, abs(values[channel]))
    of_speed = Times(times[SPEED])
    has_wheels = low < math.inf
    is_apart = low_speed > (1.0 + SHARE) * high + SLOW_MPS or high_speed < (1.0 - SHARE) * low - SLOW_MPS
    if (has_wheels and not is_apart) or (not has_wheels and (time_ns - newest_ns) * NANOSECOND > k.number.bridge):
        of_speed.disagrees_since = 0
    elif has_wheels and of_speed.disagrees_since == 0:
        of_speed.disagrees_since = time_ns
    end_ns = min(time_ns, newest_ns + hold_ns)
    return of_speed.disagrees_since != 0 and end_ns - of_speed.disagrees_since > k.number.disagreeing_ns
