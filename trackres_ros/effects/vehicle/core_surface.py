# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The inside of the belt is hotter than its skin.

The conductance K is that of (26) with two nodes, see docs/model.md; a resistance in its place is ours.
"""

from __future__ import annotations

from trackres_ros.effects.effect import Conditions, Effect, Parameter, Terms, Values


class CoreSurface(Effect):
    """The mean and the surface with 1/K between them, K about 6 k A/H; at 0 K/W they are one."""

    name = "core_surface"
    acts_on = "cooling"
    belongs_to = "vehicle"
    text = "heat must flow from the inside of the belt to its surface, so the inside runs hotter"
    belt_only = True
    parameters = (Parameter("resistance", "K/W", 0.0, 0.01, 0.004, "from the mean of one belt to its surface", off=0.0),)

    def terms(self, at: Conditions, p: Values) -> Terms:  # noqa: ARG002
        return Terms(inner_resistance=p.resistance)
