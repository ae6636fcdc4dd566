# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The rubber of road wheels or tyres dissipates energy too, less once it is warm.

Ours: F_h of a rubber layer goes as F^(4/3), see docs/model.md; it softens as exp(-b (T_w - 20)).
"""

from __future__ import annotations

import math

from trackres_ros.effects.effect import Conditions, Effect, Lag, Parameter, Terms, Values

REFERENCE_DEGC = 20.0
MOVING_MPS = 0.3
SLOWER_AT_REST = 4.0  # film of McAdams, 5.9 + 3.7 v W/(m^2 K), and 5 of radiation: 48 at 10 m/s, 11 at rest


class RoadwheelTyres(Effect):
    name = "roadwheel_tyres"
    acts_on = "torque"
    belongs_to = "vehicle"
    text = "the rubber of wheels or tyres has a loss that grows with load and falls with warming"
    only_of = "rolls"
    needs = ("speed", "weight", "ambient")
    parameters = (
        Parameter("torque", "Nm", 0.0, 1000.0, 200.0, "at nominal load and 20 degC", off=0.0, of_size=True, on_tyres=0.01),
        Parameter("softening", "1/K", 0.005, 0.03, 0.015, "fall of the loss with temperature"),
        Parameter("rise", "K/(m/s)", 0.0, 4.0, 1.0, "warming with speed"),
        Parameter("time_constant", "s", 200.0, 4000.0, 1200.0, "of the tyres' temperature while driving", more_starts=(500.0,)),
    )

    def lag(self, at: Conditions, p: Values) -> Lag:
        factor = 1.0 if abs(at.speed) > MOVING_MPS else SLOWER_AT_REST
        return Lag(at.ambient + p.rise * abs(at.speed), factor * p.time_constant, at.ambient)

    def terms(self, at: Conditions, p: Values) -> Terms:
        softness = math.exp(-p.softening * (at.own - REFERENCE_DEGC))
        of_load = (at.weight / at.facts.weight) ** (4.0 / 3.0)
        return Terms(torque=p.torque * of_load * softness * at.direction)
