# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A share of the torque does not reach the sprockets.

Ours: the usual efficiency, with a smooth change between driving and braking.
"""

from __future__ import annotations

import math

from trackres_ros.effects.effect import Conditions, Effect, Parameter, Terms, Values
from trackres_ros.kernels.marks import kernel

SMOOTH = 1e-3  # of weight times radius: over it driving turns into braking


@kernel
def drives(drive_torque: float, direction: float, weight: float, radius: float) -> float:
    """1 where the motor drives and -1 where it brakes, in either direction of travel, smooth between."""
    return math.tanh(drive_torque * direction / (SMOOTH * weight * radius))


class DrivetrainEfficiency(Effect):
    """Measured before the gears: torque/eta where the motor drives, torque x eta where it brakes."""

    name = "drivetrain_efficiency"
    acts_on = "torque"
    belongs_to = "vehicle"
    text = "gears after the measured torque lose a share of it"
    needs = ("speed", "drive_torque")
    parameters = (Parameter("efficiency", "1", 0.75, 1.0, 0.92, "of the gears", off=1.0),)

    def terms(self, at: Conditions, p: Values) -> Terms:
        return Terms(drive_gain=p.efficiency ** -drives(at.drive_torque, at.direction, at.facts.weight, at.facts.radius))
