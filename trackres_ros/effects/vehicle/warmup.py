# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Gear oil and bearings, lumped, drag more after a stop until they are warm. Ours."""

from __future__ import annotations

from collections.abc import Mapping

from trackres_ros.effects.effect import Conditions, Effect, Lag, Parameter, Terms, Values
from trackres_ros.text import figures

MOVING_MPS = 0.3
GONE = 3.0  # time constants: then 5 % are left


class WarmUp(Effect):
    """c (1 - w): w goes to 1 with one time constant while it drives, and back to 0 with another while it stands."""

    name = "warmup"
    acts_on = "torque"
    belongs_to = "vehicle"
    text = "oil and bearings drag more after a stop, until they are warm"
    only_of = "rolls"
    parameters = (
        Parameter("torque", "Nm", 0.0, 2500.0, 200.0, "when cold", off=0.0, of_size=True, on_tyres=0.01),
        Parameter("time_constant", "s", 30.0, 1500.0, 300.0, "of warming while driving", more_starts=(100.0, 800.0)),
        Parameter("cooling", "s", 300.0, 40000.0, 7200.0, "time constant of cooling while standing"),
    )

    def acts(self, values: Mapping[str, float]) -> tuple[str, str]:
        torque, minutes = figures(values["torque"]), figures(GONE * values["time_constant"] / 60.0, 2)
        return "after a stop", f"the drive train drags: {torque} Nm more at first, gone after some {minutes} min of driving"

    def lag(self, at: Conditions, p: Values) -> Lag:
        if abs(at.speed) > MOVING_MPS:
            return Lag(1.0, p.time_constant, 0.0)
        return Lag(0.0, p.cooling, 0.0)

    def terms(self, at: Conditions, p: Values) -> Terms:
        return Terms(torque=p.torque * (1.0 - at.own) * at.direction)
