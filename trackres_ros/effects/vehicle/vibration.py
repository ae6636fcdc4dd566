# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The belt swings at some speed and takes work for it. Ours: a resonance curve over the speed, c/(1 + ((v - v_r)/w)^2)."""

from __future__ import annotations

from trackres_ros.effects.effect import Conditions, Effect, Parameter, Terms, Values


class Vibration(Effect):
    name = "vibration"
    acts_on = "torque"
    belongs_to = "vehicle"
    text = "the belt swings, most at one speed"
    belt_only = True
    parameters = (
        Parameter("torque", "Nm", 0.0, 800.0, 150.0, "at the worst speed", off=0.0, of_size=True),
        Parameter("speed", "m/s", 1.0, 16.0, 6.0, "the worst", more_starts=(3.0, 9.0, 12.0)),
        Parameter("width", "m/s", 0.3, 2.0, 0.8, "half the range of speeds"),
    )

    def terms(self, at: Conditions, p: Values) -> Terms:
        detuning = (abs(at.speed) - p.speed) / p.width
        return Terms(torque=p.torque / (1.0 + detuning * detuning) * at.direction)
