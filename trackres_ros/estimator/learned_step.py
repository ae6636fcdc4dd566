# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Moves the torque of a step by what was learned of the vehicle, and keeps how much each thing that can be learned would move it.

A departure d from the file moves the torque by d times its sensitivity, which for the belts has the warmth in it that a departure
has made so far. It is first order: at a departure of a fifth the rest is less than a hundredth of the torque. All of it is ours.
"""

from __future__ import annotations

from trackres_ros.estimator.columns import LEARNABLE, OF_BEARING, OF_BELT, OF_DRAG, OF_MASS, Learned, Part
from trackres_ros.jit.arithmetic import squared
from trackres_ros.jit.compiled import inlined

BELTS = OF_BELT + 1  # the first of what can be learned act through hysteresis


@inlined
def learned_hysteresis(part: Part, learned: Learned) -> float:
    """What was learned adds to the hysteresis [Nm], without its sign: the sum of d dM/dd."""
    more, departures, by = 0.0, learned.departures, part.by
    for which in range(BELTS):
        more += departures[which] * by[which]
    return float(more * learned.on)


@inlined
def learned_elsewhere(part: Part, learned: Learned) -> float:
    """What was learned adds to bearings and wind [Nm]."""
    departures = learned.departures
    return float((departures[OF_BEARING] * part.bearing + departures[OF_DRAG] * part.wind) * learned.on)


@inlined
def learn_from(total: Part, learned: Learned, sign: float, drive_gain: float) -> float:
    """Keep the sensitivities of a step, and move its parts by what was learned; a torque that goes on besides [Nm].

    Parameters
    ----------
    total
        Parts of all assemblies, as the file has them; they are moved.
    sign
        Direction of travel, smooth through zero: at rest nothing pushes.
    drive_gain
        What effects make of a torque at the sprockets.
    """
    departures, sensitivities, by = learned.departures, learned.sensitivities, total.by
    for which in range(BELTS):
        sensitivities[which] = by[which] * sign * drive_gain
    sensitivities[OF_BEARING] = total.bearing * drive_gain
    sensitivities[OF_DRAG] = total.wind * drive_gain
    sensitivities[OF_MASS] = total.inertia * drive_gain
    if learned.on <= 0.0:
        return 0.0
    total.hysteresis += learned_hysteresis(total, learned) * sign
    total.bearing *= 1.0 + departures[OF_BEARING]
    total.wind *= 1.0 + departures[OF_DRAG]
    total.inertia *= 1.0 + departures[OF_MASS]
    return float(learned.torque * sign)


@inlined
def learned_variance(learned: Learned) -> float:
    """Variance of the resistance by all that can be learned, and by what wanders [Nm^2]: s'FF's + slow^2.

    s are the sensitivities, F the factor of the departures' covariance. Inertia is no resistance, so its s does not count.
    """
    variance, factor, sensitivities = squared(learned.slow), learned.factor, learned.sensitivities
    for column in range(LEARNABLE):
        moved = 0.0
        for row in range(column, LEARNABLE):
            if row != OF_MASS:
                moved += factor[row * LEARNABLE + column] * sensitivities[row]
        variance += moved * moved
    return float(variance)
