# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The road has a slope that is not measured. The grade of the torque in docs/model.md, G_v R_1 sin(gamma)."""

from __future__ import annotations

import math

from trackres_ros.effects.effect import Conditions, Effect, Parameter, Terms, Values


class Grade(Effect):
    name = "grade"
    acts_on = "torque"
    belongs_to = "surroundings"
    text = "the road rises or falls steadily"
    only_of = "rolls"
    parameters = (Parameter("grade", "1", -0.3, 0.3, 0.01, "rise over run the way the vehicle points", off=0.0),)

    def terms(self, at: Conditions, p: Values) -> Terms:
        rise = p.grade / math.sqrt(1.0 + p.grade * p.grade)
        return Terms(torque=at.weight * at.facts.radius * rise)
