# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Checks that a channel can have changed as its messages say: a speed by the vehicle's acceleration, a load only slowly.

A reference follows the accepted values, at most at the greatest rate of the channel. A value further from it than noise explains
is refused and begins a doubt. A run of consistent values ends the doubt, once it has as many values as a clock jump needs, and
lasts as long as the doubt before it. So one wrong speed costs a few samples, and two alternating values are never believed.

The load of a vehicle changes at standstill, or slowly, as a tank is filled or a field is harvested. A jump of it while driving is
believed once it outlasts each manoeuvre that moves load between axles. Until then a load near the old one is used.
"""

from __future__ import annotations

import math

from trackres_ros.estimator import columns as at
from trackres_ros.estimator.columns import Run, Times
from trackres_ros.estimator.constants import LARGEST_LOAD_SHARE, Constants
from trackres_ros.estimator.feedforward import towards
from trackres_ros.kernels.marks import kernel
from trackres_ros.units import NANOSECOND

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
def follow(reference: float, value: float, elapsed: int, rate: float, slack: float) -> tuple[float, bool]:
    """The reference after some time [ns], and whether a value is within `slack` of it (ours).

    It moves towards the value by `rate` [1/s] times the time at most.
    """
    moved = towards(reference, value, rate * (elapsed * NANOSECOND))
    return moved, abs(value - moved) <= slack


@kernel
def trust(times: Times, run: Run, value: float) -> None:
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
    reached, near = follow(run.reference, value, elapsed, rate, slack)
    if near and (times.doubts == 0 or lasting > 0):
        run.reference, times.doubts = reached, 0
        return True
    agrees, moved = False, value
    if times.doubts > 0:
        moved, agrees = follow(run.doubted, value, stamp - times.doubt_stamp, rate, slack)
    if agrees:
        times.doubts += 1
        run.doubted = moved
    else:
        times.doubts, times.doubt_since = 1, stamp
        run.doubted = value
    times.doubt_stamp = stamp
    lasted = stamp - times.doubt_since
    before = lasting if lasting > 0 else min(times.doubt_since - times.last_stamp, LONGEST_RUN_NS)
    if (near or lasting > 0) and times.doubts >= k.number.jumps_to_accept and lasted >= before:
        trust(times, run, run.doubted)
        return True
    return False


@kernel
def is_load(k: Constants, channel: int) -> bool:
    """Whether a channel tells what the vehicle carries."""
    return channel == at.LOAD or channel == at.PASSENGERS or at.FIRST_AXLE <= channel < k.number.first_belt


@kernel
def nominal_of(k: Constants, channel: int) -> float:
    """Nominal load of a channel of loads [N]; of passengers the number that weighs as much as the vehicle."""
    if channel == at.PASSENGERS:
        return float(k.channel_limits[at.LOAD, 1] / LARGEST_LOAD_SHARE / k.number.passenger_weight)
    return float(k.channel_limits[channel, 1] / LARGEST_LOAD_SHARE)


@kernel
def load_is_plausible(k: Constants, times: Times, run: Run, channel: int, stamp: int, elapsed: int, value: float) -> bool:
    """Whether to accept a load, or a number of passengers, of a vehicle that drives."""
    nominal = nominal_of(k, channel)
    since = min(elapsed, LONGEST_STEP_NS)
    return is_in_reach(k, times, run, stamp, since, value, FOLLOWED_PER_S * nominal, LOAD_SLACK * nominal, LOAD_LASTS_NS)


@kernel
def load_std(k: Constants, times: Times, run: Run, channel: int, value: float, now: int) -> float:
    """Standard deviation of a load [N] that is held, or of a number of passengers: it may have changed since, or is doubted.

    Nobody boards a vehicle that drives: the number of passengers does not age.
    """
    nominal, age = nominal_of(k, channel), max(now - times.last_arrival - FRESH_LOAD_NS, 0) * NANOSECOND
    std = 0.0 if channel == at.PASSENGERS else min(LOAD_PER_S * age, LOAD_SLACK) * nominal
    return max(std, abs(run.doubted - value)) if times.doubts > 0 else std
