# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The driving side of the belt is strained by the torque it carries. Ours."""

from __future__ import annotations

from trackres_ros.effects.effect import Conditions, Effect, Parameter, Terms, Values


class TensionTorque(Effect):
    """Loss grows with the tension F0 + M/(n R1) over F0, by a share of it."""

    name = "tension_torque"
    acts_on = "heat"
    belongs_to = "vehicle"
    text = "the torque stretches the belt, which increases its loss"
    needs = ("speed", "drive_torque")
    belt_only = True
    parameters = (Parameter("share", "1", 0.0, 0.3, 0.1, "growth of the loss over growth of the tension", off=0.0),)

    def terms(self, at: Conditions, p: Values) -> Terms:
        drive_tension = abs(at.drive_torque) / (at.facts.assemblies * at.facts.radius)
        return Terms(loss_factor=1.0 + p.share * drive_tension / at.facts.tension)
