# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The torque comes late. Ours."""

from __future__ import annotations

from trackres_ros.effects.effect import Conditions, Effect, Parameter, Terms, Values


class Delay(Effect):
    """M(t - tau) in a fit. It moves what the sensor shows, not what the vehicle needs, so a feed-forward is left as it is."""

    name = "delay"
    acts_on = "sensor"
    belongs_to = "sensor"
    text = "the measured torque lags behind the speed"
    needs = ("speed", "accel")
    parameters = (Parameter("time", "s", 0.0, 1.0, 0.2, "delay of the torque", off=0.0),)

    def terms(self, at: Conditions, p: Values) -> Terms:  # noqa: ARG002
        return Terms(sensor_delay=p.time)
