# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A standing belt cools by natural convection and radiation only. Ours: U_0 times 1 - s exp(-(v/v_w)^2)."""

from __future__ import annotations

import math

from trackres_ros.effects.effect import Conditions, Effect, Parameter, Terms, Values

WALKING_MPS = 1.0


class StillAir(Effect):
    name = "still_air"
    acts_on = "cooling"
    belongs_to = "vehicle"  # of where its belts run
    text = "the belt cools much more slowly at standstill than the film coefficient implies"
    belt_only = True
    parameters = (Parameter("share", "1", 0.0, 0.9, 0.7, "share of the film coefficient that is missing at rest", off=0.0),)

    def terms(self, at: Conditions, p: Values) -> Terms:
        paces = at.speed / WALKING_MPS
        share = 1.0 - p.share * math.exp(-paces * paces)
        return Terms(film_offset_factor=share)
