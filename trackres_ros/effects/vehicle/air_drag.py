# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The air density or the drag area differs from that of the vehicle file.

Equation (35) of docs/model.md; a share of it is ours.
"""

from __future__ import annotations

from trackres_ros.effects.effect import Conditions, Effect, Parameter, Terms, Values


class AirDrag(Effect):
    name = "air_drag"
    acts_on = "torque"
    belongs_to = "vehicle"  # of its drag area above all; the air's density varies by a tenth
    text = "air density or drag area differ from the vehicle file"
    parameters = (Parameter("share", "1", -0.7, 2.0, 0.3, "added share of the file's air drag", off=0.0),)

    def terms(self, at: Conditions, p: Values) -> Terms:
        drag = 0.5 * at.facts.air_density * at.facts.drag_area * at.speed * abs(at.speed)
        return Terms(torque=p.share * drag * at.facts.radius)
