# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The sun shines on the belt. Ours: flux times the sunlit share of A_h."""

from __future__ import annotations

from trackres_ros.effects.effect import Conditions, Effect, Parameter, Terms, Values

SUNLIT_SHARE = 0.25  # of the cooled area: what a belt shows in one direction


class Solar(Effect):
    name = "solar"
    acts_on = "cooling"
    belongs_to = "surroundings"
    text = "the sun heats the belt"
    belt_only = True
    parameters = (Parameter("flux", "W/m^2", 0.0, 1000.0, 400.0, "absorbed by the sunlit area of the belt", off=0.0),)

    def terms(self, at: Conditions, p: Values) -> Terms:
        return Terms(heat=p.flux * SUNLIT_SHARE * at.facts.cooled_area)
