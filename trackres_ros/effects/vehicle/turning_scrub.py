# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The ground contact slides sideways where the path is curved.

H. E. Merritt: The Evolution of a Tank Transmission, Proc. IMechE 154 (1946).
"""

from __future__ import annotations

from trackres_ros.effects.effect import Conditions, Effect, Parameter, Terms, Values


class TurningScrub(Effect):
    """M = mu G L R1 / 4R, after Merritt's steering of tracked vehicles; mu lumps the share of the contact that slides."""

    name = "turning_scrub"
    acts_on = "torque"
    belongs_to = "vehicle"  # of its contact length and rubber; hard grounds differ less in friction
    text = "turning makes the contact slide sideways over the ground"
    only_of = "rolls"
    needs = ("speed", "yaw_rate")
    parameters = (Parameter("friction", "1", 0.0, 1.5, 0.3, "friction times the share of the contact that slides", off=0.0),)

    def terms(self, at: Conditions, p: Values) -> Terms:
        arm = 0.25 * at.facts.contact_length * at.facts.radius
        return Terms(torque=p.friction * arm * at.weight * at.curvature * at.direction)
