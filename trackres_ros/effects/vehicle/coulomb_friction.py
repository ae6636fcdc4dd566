# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Dry friction of a slide, a screw or a seal: the same force whatever the speed, against the motion.

C. A. Coulomb: Theorie des machines simples, 1785.
"""

from __future__ import annotations

from trackres_ros.effects.effect import Conditions, Effect, Parameter, Terms, Values


class CoulombFriction(Effect):
    """F_c sign(v) of Coulomb; bounds up to a friction of 0.3 times the weight."""

    name = "coulomb_friction"
    acts_on = "torque"
    belongs_to = "vehicle"
    text = "guides, screws and seals rub with a constant force against the motion"
    only_of = "slides"
    parameters = (Parameter("friction", "Nm", 0.0, 30000.0, 2000.0, "at any speed, against the motion", off=0.0, of_size=True),)

    def terms(self, at: Conditions, p: Values) -> Terms:
        return Terms(torque=p.friction * at.direction)
