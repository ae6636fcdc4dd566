# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Air cools the belt more, or less, than the vehicle file says, at rest and with speed.

Ours: a factor each on U_0 and U_1 of (31); a plate has 11 + 3.7 v W/(m^2 K) with radiation (McAdams), twice that at most.
"""

from __future__ import annotations

from trackres_ros.effects.effect import Conditions, Effect, Parameter, Terms, Values


class Convection(Effect):
    name = "convection"
    acts_on = "cooling"
    belongs_to = "vehicle"  # of where its belts run
    text = "the air cools the belt more or less than assumed, with another dependence on speed"
    belt_only = True
    parameters = (
        Parameter("offset", "1", 0.2, 3.0, 1.5, "factor on the film coefficient at rest", off=1.0, more_starts=(0.6,)),
        Parameter("slope", "1", 0.3, 6.0, 1.5, "factor on its growth with speed", off=1.0, more_starts=(0.6,)),
    )

    def terms(self, at: Conditions, p: Values) -> Terms:  # noqa: ARG002
        return Terms(film_offset_factor=p.offset, film_slope_factor=p.slope)
