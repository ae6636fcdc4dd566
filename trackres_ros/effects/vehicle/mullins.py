# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""New rubber softens for good over its first kilometres.

L. Mullins: Softening of Rubber by Deformation, Rubber Chem. Technol. 42 (1969) 339-362; the fading over distance is ours.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from trackres_ros.effects.effect import Conditions, Effect, Parameter, Terms, Values

LEAST_EXCESS = 0.005  # a smaller one hardly matters, see `naming.LEAST_SHARE`: the belt has run in


class Mullins(Effect):
    name = "mullins"
    acts_on = "heat"
    belongs_to = "vehicle"
    text = "a new belt has a larger loss until it has run in"
    needs = ("speed", "distance")
    belt_only = True
    parameters = (
        Parameter("excess", "1", 0.0, 0.25, 0.12, "loss at the first start over that of the run-in belt", off=0.0),
        Parameter("distance", "m", 500.0, 20000.0, 3000.0, "over which it fades", more_starts=(1000.0, 10000.0)),
    )

    def values_after(self, values: Mapping[str, float], distance: float) -> dict[str, float]:
        excess = values["excess"] * math.exp(-distance / values["distance"])
        return {**values, "excess": excess if excess >= LEAST_EXCESS else 0.0}

    def terms(self, at: Conditions, p: Values) -> Terms:
        return Terms(loss_factor=1.0 + p.excess * math.exp(-at.distance / p.distance))
