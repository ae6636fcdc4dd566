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
from trackres_ros.estimator.plausible import towards
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
def approach(number: Numbers, value: float, target: float, lasted: float) -> float:
    """Feed-forward [Nm] after some time [s] on its way from a value to a target. One of the other sign goes to zero first, at the
    rate to zero, as it pushes the wrong way (ours).
    """
    here, there, left = finite(value), finite(target), max(0.0, lasted)
    if here * there < 0.0:
        room = rate_towards(number, 0.0) * left
        if not abs(here) < room:
            return towards(here, 0.0, room)
        here, left = 0.0, left * (1.0 - abs(here) / room)
    return towards(here, there, rate_towards(number, there) * left)


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
    number, reasons, fed = k.number, 0, inputs.fed
    nominal = present = 0.0
    for i in range(inputs.load.shape[0]):
        assembly = Assembly(k.assembly[i])
        nominal += assembly.nominal_load * assembly.radius
        present += inputs.load[i] * assembly.radius
    limit = number.feedforward_limit * (present / nominal if present < nominal else 1.0)
    wanted = number.feed_grade * total.grade if not math.isnan(inputs.grade) else 0.0  # a slope by place is of the surroundings
    if motion.rolls > 0.0:
        wanted += (
            number.feed_hysteresis * total.hysteresis
            + number.feed_bearing * total.bearing
            + number.feed_wind * total.wind
            + of_effects
        )
    if not math.isnan(inputs.acceleration):  # one filtered from the speed would feed the controller's own noise back to it
        wanted += number.feed_inertia * (total.inertia + terms[TERM.fed_inertia])
    wanted *= terms[TERM.fed_gain] * fed
    if not abs(wanted) <= limit:
        wanted = math.copysign(limit, wanted) if abs(wanted) > limit else 0.0
        reasons |= CLAMPED
    last = approach(number, motion.feedforward, present_target(motion), dt - motion.update_age)
    last *= fade(dt, max(number.speed_max_age, motion.longest_age), number.feedforward_fade)
    moved = approach(number, last, wanted, min(dt, FEEDFORWARD_STEP_S))
    if moved != wanted:
        reasons |= LIMITED
    motion.feedforward_target, motion.update_age, motion.to_zero = wanted, FEEDFORWARD_STEP_S, 1.0 - fed
    return moved, reasons


# Between two steps

ENABLE_OLD = int(layout.Reason.ENABLE_OLD)


@kernel
def age_of_speed(memory: Memory, now: int) -> float:
    """Time from the arrival of the last accepted speed to another one [s]."""
    return float((now - Times(memory.times[layout.SPEED]).last_arrival) * NANOSECOND)


@kernel
def last_update(k: Constants, memory: Memory, motion: Motion, now: int) -> tuple[float, float, int]:
    """The last change of the target of the feed-forward before an arrival [ns]: its value [Nm] and the age of the speed [s] then,
    and the reason why it has been on its way to zero since, else 0.

    Messages store these changes with `update_feedforward`. An enable expires between them, at a time of its own.
    """
    stopped = not_enabled(k, memory, now)
    if (stopped != 0) == (motion.to_zero > 0.0):
        return motion.feedforward, motion.update_age, stopped
    since = now
    if stopped == ENABLE_OLD:
        since = min(now, memory.times[layout.ENABLE, LAST_ARRIVAL] + k.number.enable_hold_ns)
    age = age_of_speed(memory, since)
    value = approach(k.number, motion.feedforward, present_target(motion), age - motion.update_age)
    return value, max(motion.update_age, age), stopped


@kernel
def update_feedforward(k: Constants, memory: Memory, motion: Motion, now: int) -> None:
    """Direct the feed-forward at an arrival [ns]: to zero once it is not enabled or the vehicle may stand, afterwards back."""
    motion.feedforward, motion.update_age, stopped = last_update(k, memory, motion, now)
    motion.to_zero = 1.0 if stopped != 0 else 0.0


@kernel
def feedforward_at(k: Constants, memory: Memory, motion: Array, now: int) -> tuple[float, float, int]:
    """Feed-forward at an arrival [ns] without its fading, the value that it is on its way to [Nm], and the reason why that is
    zero, else 0.
    """
    last = Motion(motion)
    value, age, stopped = last_update(k, memory, last, now)
    target = 0.0 if stopped != 0 else finite(last.feedforward_target)
    return approach(k.number, value, target, age_of_speed(memory, now) - age), target, stopped
