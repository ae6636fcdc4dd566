# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The compound is another: its loss falls more, or less, with temperature.

Ours: F_h times exp(-b (T - T_0)), with T_0 of `effect.py`.
"""

from __future__ import annotations

from trackres_ros.effects.effect import Conditions, Effect, Parameter, Terms, Values


class CompoundTemperature(Effect):
    name = "compound_temperature"
    acts_on = "heat"
    belongs_to = "vehicle"
    text = "the rubber's loss falls with temperature faster or slower than the rubber file says"
    belt_only = True
    parameters = (Parameter("slope", "1/K", -0.03, 0.03, 0.006, "further fall of the loss with temperature", off=0.0),)

    def terms(self, at: Conditions, p: Values) -> Terms:  # noqa: ARG002
        return Terms(softening=p.slope)
