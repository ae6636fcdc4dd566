# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Makes the feed-forward torque: chosen parts, limited in size and rate, faded during a dropout of the speed."""

from __future__ import annotations

import math

from trackres_ros.effects.stepping import TERM_FED_GAIN, TERM_FED_INERTIA
from trackres_ros.estimator import columns as at
from trackres_ros.estimator.columns import Assembly, Motion, Part
from trackres_ros.estimator.constants import Constants, Numbers
from trackres_ros.estimator.records import Inputs
from trackres_ros.kernels.marks import kernel

FEEDFORWARD_STEP_S = 0.02  # between two outputs at the default rate: so far the feed-forward moves at once, the rest follows

CLAMPED, LIMITED = int(at.Reason.FEEDFORWARD_CLAMPED), int(at.Reason.FEEDFORWARD_RATE_LIMITED)


@kernel
def fade(age: float, max_age: float, fade_s: float) -> float:
    """Share of the feed-forward at an age of the speed [s]: 1 until `max_age`, 0 `fade_s` later, linear between
    (ours).
    """
    return min(1.0, max(0.0, 1.0 - (age - max_age) / fade_s))


@kernel
def towards(here: float, there: float, room: float) -> float:
    """From one value to another, by no more than `room`; nowhere if one of the three is no number."""
    way = there - here
    if abs(way) > room >= 0.0:
        return here + math.copysign(room, way)
    return there if abs(way) <= room else here


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
def followed(number: Numbers, value: float, target: float, lasted: float) -> float:
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
    return 0.0 if motion.unfed > 0.0 else motion.feedforward_target


@kernel
def feedforward(k: Constants, motion: Motion, total: Part, of_effects: float, inputs: Inputs, dt: float) -> tuple[float, int]:
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
        wanted += number.feed_inertia * (total.inertia + k.work[TERM_FED_INERTIA])
    wanted *= k.work[TERM_FED_GAIN] * fed
    if not abs(wanted) <= limit:
        wanted = math.copysign(limit, wanted) if abs(wanted) > limit else 0.0
        reasons |= CLAMPED
    last = followed(number, motion.feedforward, present_target(motion), dt - motion.turned)
    last *= fade(dt, max(number.speed_max_age, motion.longest_age), number.feedforward_fade)
    moved = followed(number, last, wanted, min(dt, FEEDFORWARD_STEP_S))
    if moved != wanted:
        reasons |= LIMITED
    motion.feedforward_target, motion.turned, motion.unfed = wanted, FEEDFORWARD_STEP_S, 1.0 - fed
    return moved, reasons
