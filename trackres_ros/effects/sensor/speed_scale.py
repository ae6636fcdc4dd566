# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The speed is scaled wrong, by a wrong radius for one. Ours: v (1 + e)."""

from __future__ import annotations

from trackres_ros.effects.effect import Conditions, Effect, Parameter, Terms, Values


class SpeedScale(Effect):
    name = "speed_scale"
    acts_on = "sensor"
    belongs_to = "sensor"
    text = "the measured speed is off by a factor"
    parameters = (Parameter("error", "1", -0.15, 0.15, 0.03, "true over measured speed, minus one", off=0.0),)

    def terms(self, at: Conditions, p: Values) -> Terms:  # noqa: ARG002
        return Terms(speed_factor=1.0 + p.error)
