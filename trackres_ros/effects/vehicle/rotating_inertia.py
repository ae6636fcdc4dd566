# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Rotating parts are left out of the vehicle file, or counted too high.

Equation (36) of docs/model.md; what is added to its factor is ours.
"""

from __future__ import annotations

import copy
from dataclasses import replace

from trackres_ros.effects.effect import Conditions, Effect, Parameter, Terms, Values
from trackres_ros.units import GRAVITY


class RotatingInertia(Effect):
    name = "rotating_inertia"
    acts_on = "torque"
    belongs_to = "vehicle"
    text = (
        "rotating parts need torque to accelerate and return it; a wrong rotating_mass_factor in the vehicle file looks the same"
    )
    needs = ("speed", "accel")
    parameters: tuple[Parameter, ...] = (Parameter("factor", "1", -0.1, 0.8, 0.1, "added to the rotating-mass factor", off=0.0),)

    def beyond(self, factor: float) -> RotatingInertia:
        """The same effect for a rotating-mass factor of the vehicle file: both together are no less than 1."""
        effect = copy.copy(self)
        (q,) = self.parameters
        effect.parameters = (replace(q, low=max(q.low, min(0.0, 1.0 - factor))),)
        return effect

    def terms(self, at: Conditions, p: Values) -> Terms:
        return Terms(torque=p.factor * at.weight / GRAVITY * at.accel * at.facts.radius)
