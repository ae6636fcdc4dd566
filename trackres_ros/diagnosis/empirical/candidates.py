# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Unnamed candidate forms of a mismatch: curves, steps, hinges, latches and gains for one sign,
with knots within the driven range.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from trackres_ros.diagnosis.empirical.thresholds import most_on_side
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.prepare.session import Array
from trackres_ros.effects import learned
from trackres_ros.effects.effect import Conditions
from trackres_ros.effects.learned import Curve, EmpiricalEffect, SidedGain
from trackres_ros.units import STANDSTILL_MPS

DRIVEN = (0.02, 0.98)  # quantiles that bound the knots
KNOTS = {
    learned.SPEED: 5, learned.LOAD: 3, learned.AMBIENT: 2, learned.TURNING: 3, learned.CURVATURE: 3, learned.ACCELERATION: 4,
    learned.TURN: 4, learned.DRIVING_TORQUE: 4, learned.BELT: 3,
}  # fmt: skip
SIGNED = (learned.ACCELERATION, learned.TURN, learned.DRIVING_TORQUE)
BOTH_SIDES = 0.05  # least share of a signed variable on its rarer side to use both
NEAR_ZERO = 0.1  # of the range on a side: between these knots a signed curve may step
RESOLVED = 6.0  # times its noise: nearer zero a smoothed acceleration reflects the smoothing more than the drive
LEAST_RANGE = 0.02  # of its size: a smaller variation is constant
FEWEST_REVERSE = 60  # samples in reverse


def series(code: int, fit: Fit) -> list[Array]:
    """A variable of learned effects in each session of a fit, as in the live step."""
    facts, found = fit.problem.base.facts, []
    for s, p in zip(fit.problem.sessions, fit.predicted, strict=True):
        turning = np.abs(s.yaw_rate)
        curvature = turning / np.hypot(s.speed, facts.contact_length * turning + STANDSTILL_MPS)
        recorded: Any = s.speed, s.accel, s.weight, s.ambient, s.yaw_rate, s.heading, s.distance
        simulated: Any = p.at_sprockets, np.tanh(s.speed / facts.standstill), curvature, p.belt
        at = Conditions(facts, *recorded, *simulated)
        found.append(np.asarray(np.broadcast_to(learned.variable(at, code), len(s)), dtype=float))
    return found


def driven(code: int, fit: Fit) -> Array:
    """Values of the variable at compared samples; empty if it is not always known, or too imprecise."""
    found = np.concatenate([x[m] for x, m in zip(series(code, fit), fit.problem.masks, strict=True)])
    known = np.isfinite(found).all() and (code not in (learned.ACCELERATION, learned.DRIVING_TORQUE) or _resolved(fit))
    return found if known else np.empty(0)


def _resolved(fit: Fit) -> bool:
    """Whether the acceleration is precise where its curve may step: smoothing errors look like such a curve."""
    noise = max(s.accel_noise for s in fit.problem.sessions)
    largest = max(float(np.quantile(np.abs(s.accel), DRIVEN[1])) for s in fit.problem.sessions)
    return RESOLVED * noise <= NEAR_ZERO * largest


def varies(x: Array) -> bool:
    """Whether a variable varies enough for a curve."""
    if len(x) == 0:
        return False
    low, high = np.quantile(x, DRIVEN)
    return bool(high - low > LEAST_RANGE * max(abs(low), abs(high)))


def knots(code: int, x: Array, count: int) -> list[float]:
    """Knots of a curve: equally filled between, or close on either side of zero for a signed variable."""
    low, high = (float(q) for q in np.quantile(x, DRIVEN))
    if code in SIGNED and min(np.mean(x < 0.0), np.mean(x > 0.0)) > BOTH_SIDES:
        inner = NEAR_ZERO * min(-low, high)
        extra = max(0, (count - 4) // 2)
        below = np.linspace(low, -inner, extra + 2)
        above = np.linspace(inner, high, extra + 2)
        return [*below.tolist(), *above.tolist()]
    even = np.quantile(x, np.linspace(*DRIVEN, count))
    if code == learned.SPEED:  # for rarely driven speeds: half by frequency, half by distance
        even = 0.5 * (even + np.linspace(low, high, count))
    found = [float(even[0])]
    for knot in even[1:].tolist():
        if knot - found[-1] > LEAST_RANGE * (high - low):
            found.append(knot)
    return found


def followed(fit: Fit) -> list[int]:
    """Codes of the variables that a form may follow here.

    Notes
    -----
    A curve over an acceleration derived from speeds shows their error: at a steady speed, the apparent acceleration
    is error, and its inertia is not in the torque. So such a curve needs a measured acceleration. A curve over the driving
    torque, which includes that inertia, needs a small error.
    """
    measured = all("accel" in s.given for s in fit.problem.sessions)
    return [code for code in KNOTS if varies(driven(code, fit)) and (code != learned.ACCELERATION or measured)]


def candidates(fit: Fit) -> dict[str, EmpiricalEffect]:
    """All forms with knots of their own here, by their names."""
    facts = fit.problem.base.facts
    found: list[EmpiricalEffect] = []
    x = {code: driven(code, fit) for code in learned.VARIABLES}
    shown = followed(fit)
    found += [Curve(code, knots(code, x[code], KNOTS[code])) for code in shown]
    if learned.DRIVING_TORQUE in shown:
        most = {side: most_on_side(x[learned.DRIVING_TORQUE], side) for side in (learned.DRIVES, learned.BRAKES)}
        reverse = np.concatenate([s.speed[m] < 0.0 for s, m in zip(fit.problem.sessions, fit.problem.masks, strict=True)])
        if reverse.sum() >= FEWEST_REVERSE:  # forwards, a negative torque brakes
            most[learned.NEGATIVE] = most_on_side(np.where(reverse, 1.0, -1.0) * x[learned.DRIVING_TORQUE], 1)
        found += [SidedGain(side, one) for side, one in most.items() if min(most.values()) > 0.0]
    size = facts.weight * facts.radius
    return {effect.name: learned.sized(effect, size) for effect in found}
