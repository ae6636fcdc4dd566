# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The loss modulus grows with frequency more, or less, than the shift factor says.

Ours: F_h times (v/v_r)^m, as E'' over a few decades is often fitted by a power.
"""

from __future__ import annotations

from trackres_ros.effects.effect import Conditions, Effect, Parameter, Terms, Values

REFERENCE_MPS = 5.0
SLOWEST_MPS = 0.1


class Frequency(Effect):
    name = "frequency"
    acts_on = "heat"
    belongs_to = "vehicle"
    text = "the rubber's loss rises with frequency, so with speed"
    belt_only = True
    parameters = (Parameter("exponent", "1", -0.1, 0.25, 0.1, "of frequency, added to that of the rubber file", off=0.0),)

    def terms(self, at: Conditions, p: Values) -> Terms:
        return Terms(loss_factor=(max(abs(at.speed), SLOWEST_MPS) / REFERENCE_MPS) ** p.exponent)
