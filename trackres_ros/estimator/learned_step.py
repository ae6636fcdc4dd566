# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Moves the torque of a step by what was learned of the vehicle, and keeps how much each thing that can be learned would move it.

A departure d from the file moves the torque by d times its sensitivity, which for the belts has the warmth in it that a departure
has made so far. It is first order: at a departure of a fifth the rest is less than a hundredth of the torque.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trackres_ros.estimator import columns as at
from trackres_ros.jit.arithmetic import squared
from trackres_ros.jit.compiled import inlined

Array = NDArray[np.float64]

BELTS = at.OF_BELT + 1  # the first of what can be learned act through hysteresis


@inlined
def learned_hysteresis(part: Array, learned: Array) -> float:
    """What was learned adds to the hysteresis [Nm], without its sign."""
    more = 0.0
    for which in range(BELTS):
        more += learned[at.DEPARTURES + which] * part[at.PART_BY + which]
    return float(more * learned[at.LEARNED_ON])


@inlined
def learned_elsewhere(part: Array, learned: Array) -> float:
    """What was learned adds to bearings and wind [Nm]."""
    more = (
        learned[at.DEPARTURES + at.OF_BEARING] * part[at.PART_BEARING] + learned[at.DEPARTURES + at.OF_DRAG] * part[at.PART_WIND]
    )
    return float(more * learned[at.LEARNED_ON])


@inlined
def learn_from(total: Array, learned: Array, sign: float, drive_gain: float) -> float:
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
    by = learned[at.SENSITIVITIES :]
    for which in range(BELTS):
        by[which] = total[at.PART_BY + which] * sign * drive_gain
    by[at.OF_BEARING] = total[at.PART_BEARING] * drive_gain
    by[at.OF_DRAG] = total[at.PART_WIND] * drive_gain
    by[at.OF_MASS] = total[at.PART_INERTIA] * drive_gain
    if learned[at.LEARNED_ON] <= 0.0:
        return 0.0
    total[at.PART_HYSTERESIS] += learned_hysteresis(total, learned) * sign
    total[at.PART_BEARING] *= 1.0 + learned[at.DEPARTURES + at.OF_BEARING]
    total[at.PART_WIND] *= 1.0 + learned[at.DEPARTURES + at.OF_DRAG]
    total[at.PART_INERTIA] *= 1.0 + learned[at.DEPARTURES + at.OF_MASS]
    return float(learned[at.LEARNED_TORQUE] * sign)


@inlined
def learned_variance(learned: Array) -> float:
    """Variance of the resistance by all that can be learned, and by what wanders [Nm^2].

    Inertia is no resistance, so its sensitivity does not count.
    """
    variance = squared(learned[at.LEARNED_SLOW])
    for column in range(at.LEARNABLE):
        moved = 0.0
        for row in range(column, at.LEARNABLE):
            if row != at.OF_MASS:
                moved += learned[at.LEARNED_FACTOR + row * at.LEARNABLE + column] * learned[at.SENSITIVITIES + row]
        variance += moved * moved
    return float(variance)
