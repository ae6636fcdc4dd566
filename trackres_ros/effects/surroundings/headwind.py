# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A steady wind blows over the ground. Equation (35) of docs/model.md with the speed through the air."""

from __future__ import annotations

import math

from trackres_ros.effects.effect import Conditions, Effect, Parameter, Terms, Values


class Headwind(Effect):
    """1/2 rho C_d A [(v+w)|v+w| - v|v|] R1 with w, the wind against the way the vehicle points."""

    name = "headwind"
    acts_on = "torque"
    belongs_to = "surroundings"
    text = "a steady wind blows: against the vehicle one way, with it the other"
    only_of = "rolls"
    needs = ("speed", "heading")
    parameters = (
        Parameter("from_ahead", "m/s", -20.0, 20.0, 4.0, "wind that comes from heading 0", off=0.0),
        Parameter("from_left", "m/s", -20.0, 20.0, 4.0, "wind that comes from heading +90 deg", off=0.0),
    )

    def terms(self, at: Conditions, p: Values) -> Terms:
        headwind = p.from_ahead * math.cos(at.heading) + p.from_left * math.sin(at.heading)
        air_speed = at.speed + headwind
        change = air_speed * abs(air_speed) - at.speed * abs(at.speed)
        return Terms(torque=0.5 * at.facts.air_density * at.facts.drag_area * change * at.facts.radius)
