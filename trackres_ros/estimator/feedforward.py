# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Makes the feed-forward torque: chosen parts, limited in size and rate, faded during a dropout of the speed.

Between two steps it moves to its target, or to zero while nothing may push the vehicle. The session updates it at messages. The
live node and the exported C ask for its value at each of their outputs.
"""

from __future__ import annotations

import math

from trackres_ros.arrays import Array
from trackres_ros.effects.stepping import TERM
from trackres_ros.estimator import columns as layout
from trackres_ros.estimator.columns import Assembly, Motion, Part, Times
from trackres_ros.estimator.constants import Constants, Numbers
from trackres_ros.estimator.guards import LAST_ARRIVAL, Memory, not_enabled
from trackres_ros.estimator.plausible import step_towards
from trackres_ros.estimator.records import Inputs
from trackres_ros.kernels.marks import kernel
from trackres_ros.units import NANOSECOND

# At a step

FEEDFORWARD_STEP_S = 0.02  # between two outputs at the default rate: so far the feed-forward moves at once, the rest follows

CLAMPED, LIMITED = int(layout.Reason.FEEDFORWARD_CLAMPED), int(layout.Reason.FEEDFORWARD_RATE_LIMITED)


@kernel
def fade(age: float, max_age: float, fade_s: float) -> float:
    """Share of the feed-forward at an age of the speed [s]: 1 until `max_age`, 0 `fade_s` later, linear between
    (ours).
    """
    return min(1.0, max(0.0, 1.0 - (age - max_age) / fade_s))


@kernel
def rate_towards(number: Numbers, target: float) -> float:
    """Largest change of the feed-forward [Nm/s] on its way to a target: from its limit, zero is reached within the time of a
    fade, as nothing may push a vehicle that stands or is not enabled (ours).
    """
    rate = number.feedforward_rate
    return max(rate, number.feedforward_limit / number.feedforward_fade) if target == 0.0 else rate


@kernel
def finite(torque: float) -> float:
    """A torque, or 0 in place of one that is no number."""
    return torque if math.isfinite(torque) else 0.0


@kernel
def approach(number: Numbers, value: float, target: float, seconds: float) -> float:
    """Feed-forward [Nm] after some time [s] on its way from a value to a target. One of the other sign goes to zero first, at the
    rate to zero, as it pushes the wrong way (ours).
    """
    start, goal, remaining = finite(value), finite(target), max(0.0, seconds)
    if start * goal < 0.0:
        room = rate_towards(number, 0.0) * remaining
        if not abs(start) < room:
            return step_towards(start, 0.0, room)
        start, remaining = 0.0, remaining * (1.0 - abs(start) / room)
    return step_towards(start, goal, rate_towards(number, goal) * remaining)


@kernel
def present_target(motion: Motion) -> float:
    """What the feed-forward is on its way to [Nm]."""
    return 0.0 if motion.to_zero > 0.0 else motion.feedforward_target


@kernel
def feedforward(
    k: Constants, terms: Array, motion: Motion, total: Part, of_effects: float, inputs: Inputs, dt: float
) -> tuple[float, int]:
    """Chosen parts [Nm], limited in size and rate, and the reasons for limits; store the target in `motion` (ours).

    It starts from the present output, which followed the last target and faded during a dropout of the speed. From there it
    moves at once by what the rate allows in `FEEDFORWARD_STEP_S`, or in a shorter `dt`. At standstill no rolling resistance is
    fed forward; with `inputs.fed` 0 nothing is. The limit is of the present weight, at most the nominal one. Where it falls, the
    output follows at its rate.
    """
    number, reasons, share = k.number, 0, inputs.fed
    nominal = present_weight = 0.0
    for i in range(inputs.load.shape[0]):
        assembly = Assembly(k.assembly[i])
        nominal += assembly.nominal_load * assembly.radius
        present_weight += inputs.load[i] * assembly.radius
    limit = number.feedforward_limit * (present_weight / nominal if present_weight < nominal else 1.0)
    target = number.feed_grade * total.grade if not math.isnan(inputs.grade) else 0.0  # a slope by place is of the surroundings
    if motion.rolls > 0.0:
        target += (
            number.feed_hysteresis * total.hysteresis
            + number.feed_bearing * total.bearing
            + number.feed_wind * total.wind
            + of_effects
        )
    if not math.isnan(inputs.acceleration):  # one filtered from the speed would feed the controller's own noise back to it
        target += number.feed_inertia * (total.inertia + terms[TERM.fed_inertia])
    target *= terms[TERM.fed_gain] * share
    if not abs(target) <= limit:
        target = math.copysign(limit, target) if abs(target) > limit else 0.0
        reasons |= CLAMPED
    previous = approach(number, motion.feedforward, present_target(motion), dt - motion.update_age)
    previous *= fade(dt, max(number.speed_max_age, motion.longest_age), number.feedforward_fade)
    output = approach(number, previous, target, min(dt, FEEDFORWARD_STEP_S))
    if output != target:
        reasons |= LIMITED
    motion.feedforward_target, motion.update_age, motion.to_zero = target, FEEDFORWARD_STEP_S, 1.0 - share
    return output, reasons


# Between two steps

ENABLE_OLD = int(layout.Reason.ENABLE_OLD)


@kernel
def age_of_speed(memory: Memory, time_ns: int) -> float:
    """Time from the arrival of the last accepted speed to another one [s]."""
    return float((time_ns - Times(memory.times[layout.SPEED]).last_arrival) * NANOSECOND)


@kernel
def last_update(k: Constants, memory: Memory, motion: Motion, time_ns: int) -> tuple[float, float, int]:
    """The last change of the target of the feed-forward before an arrival [ns]: its value [Nm] and the age of the speed [s] then,
    and the reason why it has been on its way to zero since, else 0.

    Messages store these changes with `update_feedforward`. An enable expires between them, at a time of its own.
    """
    reason = not_enabled(k, memory, time_ns)
    if (reason != 0) == (motion.to_zero > 0.0):
        return motion.feedforward, motion.update_age, reason
    change_ns = time_ns
    if reason == ENABLE_OLD:
        change_ns = min(time_ns, memory.times[layout.ENABLE, LAST_ARRIVAL] + k.number.enable_hold_ns)
    age = age_of_speed(memory, change_ns)
    value = approach(k.number, motion.feedforward, present_target(motion), age - motion.update_age)
    return value, max(motion.update_age, age), reason


@kernel
def update_feedforward(k: Constants, memory: Memory, motion: Motion, time_ns: int) -> None:
    """Direct the feed-forward at an arrival [ns]: to zero once it is not enabled or the vehicle may stand, afterwards back."""
    motion.feedforward, motion.update_age, reason = last_update(k, memory, motion, time_ns)
    motion.to_zero = 1.0 if reason != 0 else 0.0


@kernel
def feedforward_at(k: Constants, memory: Memory, motion: Array, time_ns: int) -> tuple[float, float, int]:
    """Feed-forward at an arrival [ns] without its fading, the value that it is on its way to [Nm], and the reason why that is
    zero, else 0.
    """
    motion_row = Motion(motion)
    value, age, reason = last_update(k, memory, motion_row, time_ns)
    target = 0.0 if reason != 0 else finite(motion_row.feedforward_target)
    return approach(k.number, value, target, age_of_speed(memory, time_ns) - age), target, reason
