# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The belt gives heat to the ground it lies on and to its wheels.

H. S. Carslaw, J. C. Jaeger: Conduction of Heat in Solids, 2nd ed., Oxford 1959: contact of half spaces.
"""

from __future__ import annotations

import math

from trackres_ros.effects.effect import Conditions, Effect, Parameter, Terms, Values


class GroundConduction(Effect):
    """G_c sqrt(v) (T - T_ground), the contact time's square root; the ground is at the air's temperature."""

    name = "ground_conduction"
    acts_on = "cooling"
    belongs_to = "vehicle"  # its rubber conducts worst of what the heat goes through, whatever the ground
    text = "ground and wheels take heat out of the belt where they touch it"
    needs = ("speed", "ambient")
    belt_only = True
    parameters = (Parameter("conductance", "W/K/(m/s)^0.5", 0.0, 300.0, 80.0, "of one belt, at 1 m/s", off=0.0),)

    def terms(self, at: Conditions, p: Values) -> Terms:
        return Terms(conductance=p.conductance * math.sqrt(abs(at.speed)), sink=at.ambient)
