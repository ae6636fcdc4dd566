# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The torque sensor shows a share too much or too little. Ours: M (1 + e)."""

from __future__ import annotations

from trackres_ros.effects.effect import Conditions, Effect, Parameter, Terms, Values


class TorqueGain(Effect):
    name = "torque_gain"
    acts_on = "sensor"
    belongs_to = "sensor"
    text = "the torque sensor's scale is off; a wrong radius in the model looks the same"
    parameters = (Parameter("error", "1", -0.15, 0.15, 0.03, "relative", off=0.0),)

    def terms(self, at: Conditions, p: Values) -> Terms:  # noqa: ARG002
        return Terms(sensor_gain=1.0 + p.error)
