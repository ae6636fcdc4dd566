# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Seals and plain bearings have a friction that is greatest just after they start to slide.

R. Stribeck, Z. VDI 46 (1902) 1341-1348; the Gaussian form: B. Armstrong-Helouvry et al., Automatica 30 (1994) 1083-1138.
"""

from __future__ import annotations

import math

from trackres_ros.effects.effect import Conditions, Effect, Parameter, Terms, Values


class Stribeck(Effect):
    name = "stribeck"
    acts_on = "torque"
    belongs_to = "vehicle"
    text = "seals rub with a constant torque, and with more at a crawl"
    parameters = (
        Parameter("constant", "Nm", 0.0, 300.0, 100.0, "friction at speed", off=0.0, of_size=True),
        Parameter("breakaway", "Nm", 0.0, 400.0, 100.0, "added at a crawl", off=0.0, of_size=True),
        Parameter("speed", "m/s", 0.2, 5.0, 1.0, "over which that fades", more_starts=(3.0,)),
    )

    def terms(self, at: Conditions, p: Values) -> Terms:
        relative = at.speed / p.speed
        slow_share = math.exp(-relative * relative)
        return Terms(torque=(p.constant + p.breakaway * slow_share) * at.direction)
