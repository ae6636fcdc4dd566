# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A screw, a gear or a tilted slide rubs more one way than the other. Ours."""

from __future__ import annotations

from trackres_ros.effects.effect import Conditions, Effect, Parameter, Terms, Values


class FrictionByDirection(Effect):
    """d |v|: friction that grows with the speed by a coefficient that is greater by d forward, and smaller by d in reverse.

    A constant that differs by direction is the same as an offset of the force, wherever it moves.
    """

    name = "friction_by_direction"
    acts_on = "torque"
    belongs_to = "vehicle"
    text = "friction grows more with speed in one direction than in the other"
    only_of = "slides"
    parameters = (
        Parameter(
            "forward",
            "Nm/(m/s)",
            -20000.0,
            20000.0,
            2000.0,
            "more torque over speed forward, less in reverse",
            off=0.0,
            of_size=True,
        ),
    )

    def terms(self, at: Conditions, p: Values) -> Terms:
        return Terms(torque=p.forward * abs(at.speed))
