# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Oil and grease of a slide, a screw or a motor: a force that grows with the speed.

N. P. Petrov, 1883: friction of a film of oil.
"""

from __future__ import annotations

from trackres_ros.effects.effect import Conditions, Effect, Parameter, Terms, Values


class ViscousFriction(Effect):
    """F_v v of a film of oil at one temperature."""

    name = "viscous_friction"
    acts_on = "torque"
    belongs_to = "vehicle"
    text = "friction grows in proportion to the speed"
    only_of = "slides"
    parameters = (Parameter("coefficient", "Nm/(m/s)", 0.0, 1e6, 20000.0, "torque over speed", off=0.0, of_size=True),)

    def terms(self, at: Conditions, p: Values) -> Terms:
        return Terms(torque=p.coefficient * at.speed)
