# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The drivetrain takes a torque, whatever it transmits.

Ours: one torque for all losses that do not grow with the load, c sigma_v.
"""

from __future__ import annotations

from trackres_ros.effects.effect import Conditions, Effect, Parameter, Terms, Values


class DrivetrainDrag(Effect):
    name = "drivetrain_drag"
    acts_on = "torque"
    belongs_to = "vehicle"
    text = "gears and brakes drag with a constant torque while turning"
    parameters = (Parameter("drag", "Nm", 0.0, 600.0, 150.0, "of all gears and brakes", off=0.0, of_size=True),)

    def terms(self, at: Conditions, p: Values) -> Terms:
        return Terms(torque=p.drag * at.direction)
