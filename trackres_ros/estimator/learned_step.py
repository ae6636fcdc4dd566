# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Moves the torque of a step by the learned departures, and keeps the sensitivity to each of them.

A departure d from the file moves the torque by d times its sensitivity, which for belts includes the warming due to the
departure. This is first order: at a departure of a fifth the error is less than a hundredth of the torque. All of it is ours.
"""

from __future__ import annotations

from trackres_ros.estimator.columns import LEARNABLE, OF_BEARING, OF_BELT, OF_DRAG, OF_MASS, Learned, Part
from trackres_ros.kernels.arithmetic import squared
from trackres_ros.kernels.marks import kernel

BELTS = OF_BELT + 1  # the first departures act through hysteresis


@kernel
def learned_hysteresis(part: Part, learned: Learned) -> float:
    """Learned change of the hysteresis [Nm], without its sign: the sum of d dM/dd."""
    more, departures, by = 0.0, learned.departures, part.by
    for which in range(BELTS):
        more += departures[which] * by[which]
    return float(more * learned.on)


@kernel
def learned_elsewhere(part: Part, learned: Learned) -> float:
    """Learned change of bearings and wind [Nm]."""
    departures = learned.departures
    return float((departures[OF_BEARING] * part.bearing + departures[OF_DRAG] * part.wind) * learned.on)


@kernel
def learn_from(total: Part, learned: Learned, sign: float, drive_gain: float, of_drag: float) -> float:
    """Keep the sensitivities of a step, and move its parts by the learned departures; return the slow disturbance before the gain
    [Nm].

    Parameters
    ----------
    total
        Parts of all assemblies by the file; they are changed.
    sign
        Direction of travel, smooth through zero: nothing pushes at rest.
    drive_gain
        Effects' gain of a torque at the sprockets. The disturbance is learned with it, as the sensor shows it.
    of_drag
        The effects' torque that grows with the drag area, at that of the file [Nm]; they look at the learned one themselves.
    """
    departures, sensitivities, by = learned.departures, learned.sensitivities, total.by
    for which in range(BELTS):
        sensitivities[which] = by[which] * sign * drive_gain
    sensitivities[OF_BEARING] = total.bearing * drive_gain
    sensitivities[OF_DRAG] = (total.wind + of_drag) * drive_gain
    sensitivities[OF_MASS] = total.inertia * drive_gain
    if learned.on <= 0.0:
        return 0.0
    total.hysteresis += learned_hysteresis(total, learned) * sign
    total.bearing *= 1.0 + departures[OF_BEARING]
    total.wind *= 1.0 + departures[OF_DRAG]
    total.inertia *= 1.0 + departures[OF_MASS]
    return float(learned.torque * sign / drive_gain)


@kernel
def learned_variance(total: Part, learned: Learned, rolling_bearing: float, drive_gain: float) -> float:
    """Variance of the resistance due to the learned departures and the slow disturbance [Nm^2]: s'FF's + slow^2.

    s are the sensitivities without the sign of travel, as at rest friction has a size too; `rolling_bearing` is that of the
    bearings [N]. F is the factor of the departures' covariance. Inertia is no resistance, so its s is excluded.
    """
    variance, factor, by = squared(learned.slow), learned.factor, total.by
    bearing, wind = total.arm * rolling_bearing * drive_gain, abs(learned.sensitivities[OF_DRAG])
    for column in range(OF_MASS):
        moved = factor[OF_BEARING * LEARNABLE + column] * bearing + factor[OF_DRAG * LEARNABLE + column] * wind
        for row in range(BELTS):
            moved += factor[row * LEARNABLE + column] * by[row] * drive_gain
        variance += squared(moved)
    return float(variance)
