# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A wet belt cools much better. Ours: one factor on U of (31)."""

from __future__ import annotations

from trackres_ros.effects.effect import Conditions, Effect, Parameter, Terms, Values


class Rain(Effect):
    name = "rain"
    acts_on = "cooling"
    belongs_to = "surroundings"
    text = "rain or a wet road cools the belt"
    belt_only = True
    parameters = (Parameter("factor", "1", 1.0, 11.0, 3.0, "factor on the film coefficient", off=1.0),)

    def terms(self, at: Conditions, p: Values) -> Terms:  # noqa: ARG002
        return Terms(film_offset_factor=p.factor, film_slope_factor=p.factor)
