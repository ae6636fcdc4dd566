# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Guide lugs rub on wheels, teeth on the sprocket.

Ours: Coulomb's friction of the belt tension and of the torque that the teeth carry.
"""

from __future__ import annotations

from trackres_ros.effects.effect import Conditions, Effect, Parameter, Terms, Values


class LugFriction(Effect):
    name = "lug_friction"
    acts_on = "torque"
    belongs_to = "vehicle"
    text = "guide lugs and drive teeth rub, with the tension and with the torque they carry"
    needs = ("speed", "drive_torque")
    belt_only = True
    parameters = (
        Parameter("of_tension", "1", 0.0, 0.03, 0.005, "friction over belt tension", off=0.0),
        Parameter("of_torque", "1", 0.0, 0.06, 0.015, "friction over torque", off=0.0),
    )

    def terms(self, at: Conditions, p: Values) -> Terms:
        of_tension = p.of_tension * at.facts.tension * at.facts.assemblies * at.facts.radius
        return Terms(torque=(of_tension + p.of_torque * abs(at.drive_torque)) * at.direction)
