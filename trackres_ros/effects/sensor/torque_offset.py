# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The torque sensor has an offset. Ours: M + o."""

from __future__ import annotations

from trackres_ros.effects.effect import Conditions, Effect, Parameter, Terms, Values


class TorqueOffset(Effect):
    name = "torque_offset"
    acts_on = "sensor"
    belongs_to = "sensor"
    text = "the torque sensor has an offset"
    parameters = (Parameter("offset", "Nm", -2000.0, 2000.0, 150.0, "reading at zero torque", off=0.0, of_size=True),)

    def terms(self, at: Conditions, p: Values) -> Terms:  # noqa: ARG002
        return Terms(sensor_offset=p.offset)
