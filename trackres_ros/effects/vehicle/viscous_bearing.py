# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Grease and oil in bearings are stiff when cold, and have a temperature of their own.

A. Palmgren: Ball and Roller Bearing Engineering, 3rd ed., Burbank 1959. The temperature of the bearing is ours: it is warmed by
all of its friction. Where that is half of the grease and half of the load, its heat falls half as steeply as the viscosity.
The state settles as it does near its target. In cold grease it lags the exact balance by up to a third of the rise.
"""

from __future__ import annotations

import math

from trackres_ros.effects.effect import Conditions, Effect, Lag, Parameter, Terms, Values

REFERENCE_DEGC = 20.0
HEAT_FALLS = 0.5
MOVING_MPS = 0.3
SLOWER_AT_REST = 4.0  # film of McAdams, 5.9 + 3.7 v W/(m^2 K), and 5 of radiation: 48 at 10 m/s, 11 at rest


class ViscousBearing(Effect):
    """c v^(2/3) exp(-b (T_b - 20)): Palmgren's speed-dependent bearing torque with a viscosity that falls with temperature."""

    name = "viscous_bearing"
    acts_on = "torque"
    belongs_to = "vehicle"
    text = "grease in the bearings resists in proportion to speed, less when warm"
    only_of = "rolls"
    needs = ("speed", "ambient")
    parameters = (
        Parameter("coefficient", "Nm/(m/s)^(2/3)", 0.0, 400.0, 54.0, "drag at 20 degC", off=0.0, of_size=True),
        Parameter("thinning", "1/K", 0.03, 0.07, 0.05, "fall of viscosity with temperature"),
        Parameter("rise", "K/(m/s)", 0.0, 12.0, 1.5, "warming with speed, by friction as at 20 degC", more_starts=(0.2, 8.0)),
        Parameter("time_constant", "s", 200.0, 4000.0, 1000.0, "of its temperature while driving, if the friction stayed"),
    )

    def lag(self, at: Conditions, p: Values) -> Lag:
        factor = 1.0 if abs(at.speed) > MOVING_MPS else SLOWER_AT_REST
        decay_rate = HEAT_FALLS * p.thinning
        x = math.log1p(decay_rate * p.rise * abs(at.speed) * math.exp(-decay_rate * (at.ambient - REFERENCE_DEGC)))
        w = x * (1.0 - math.log1p(x) / (2.0 + x))  # Lambert's function to 2 % (S. Winitzki 2003): heat and cooling are equal
        return Lag(at.ambient + w / decay_rate, factor * p.time_constant / (1.0 + w), at.ambient)

    def terms(self, at: Conditions, p: Values) -> Terms:
        viscosity = math.exp(-p.thinning * (at.own - REFERENCE_DEGC))
        return Terms(torque=p.coefficient * abs(at.speed) ** (2.0 / 3.0) * viscosity * at.direction)
