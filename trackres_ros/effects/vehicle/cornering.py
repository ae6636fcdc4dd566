# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Side force in bends turns the contact out of the direction of travel.

M. Mitschke, H. Wallentowitz: Dynamik der Kraftfahrzeuge, Springer: resistance in bends.
"""

from __future__ import annotations

from trackres_ros.effects.effect import Conditions, Effect, Parameter, Terms, Values
from trackres_ros.units import GRAVITY


class Cornering(Effect):
    """M = (m v yaw)^2 R1 / C_alpha: the side force times its slip angle."""

    name = "cornering"
    acts_on = "torque"
    belongs_to = "vehicle"  # of its tracks or tyres
    text = "the side force of a bend needs a slip angle, which needs traction"
    only_of = "rolls"
    needs = ("speed", "yaw_rate")
    parameters = (
        Parameter("compliance", "rad/N", 0.0, 2.5e-6, 1.25e-6, "slip angle per side force of the whole vehicle", off=0.0),
    )

    def terms(self, at: Conditions, p: Values) -> Terms:
        side_force = at.weight / GRAVITY * at.speed * at.yaw_rate
        return Terms(torque=p.compliance * side_force * side_force * at.facts.radius * at.direction)
