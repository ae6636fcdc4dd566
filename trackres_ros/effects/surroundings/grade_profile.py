# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The site is a plane that is not level, driven in changing directions.

Ours: G_v R_1 sin(gamma) of docs/model.md along a plane.
"""

from __future__ import annotations

import math

from trackres_ros.effects.effect import Conditions, Effect, Parameter, Terms, Values


class GradeProfile(Effect):
    name = "grade_profile"
    acts_on = "torque"
    belongs_to = "surroundings"
    text = "the ground is a tilted plane: uphill one way, downhill the other, again on each lap"
    only_of = "rolls"
    needs = ("speed", "heading")
    parameters = (
        Parameter("rise_ahead", "1", -0.3, 0.3, 0.01, "rise over run along heading 0", off=0.0),
        Parameter("rise_left", "1", -0.3, 0.3, 0.01, "rise over run along heading +90 deg", off=0.0),
    )

    def terms(self, at: Conditions, p: Values) -> Terms:
        rise = p.rise_ahead * math.cos(at.heading) + p.rise_left * math.sin(at.heading)
        return Terms(torque=at.weight * at.facts.radius * rise / math.sqrt(1.0 + rise * rise))
