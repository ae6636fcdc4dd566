# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The ground gives way, and making the rut takes work. M. G. Bekker: Introduction to Terrain-Vehicle Systems, Ann Arbor 1969."""

from __future__ import annotations

from trackres_ros.effects.effect import Conditions, Effect, Parameter, Terms, Values


class SoftGround(Effect):
    """Bekker: b k z^(n+1)/(n+1) with z = (p/k)^(1/n), so it goes as load^((n+1)/n)."""

    name = "soft_ground"
    acts_on = "torque"
    belongs_to = "surroundings"
    text = "the vehicle sinks in and pushes a rut"
    only_of = "rolls"
    needs = ("speed", "weight")
    parameters = (
        Parameter("torque", "Nm", 0.0, 10000.0, 1000.0, "at nominal load", off=0.0, of_size=True),
        Parameter("exponent", "1", 0.3, 1.2, 0.8, "of sinkage, n"),
    )

    def terms(self, at: Conditions, p: Values) -> Terms:
        of_load = (at.weight / at.facts.weight) ** ((p.exponent + 1.0) / p.exponent)
        return Terms(torque=p.torque * of_load * at.direction)
