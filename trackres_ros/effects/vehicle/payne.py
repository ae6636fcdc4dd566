# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Filled rubber loses relatively most at a middle strain.

G. Kraus: Mechanical Losses in Carbon-Black-Filled Rubbers, J. Appl. Polym. Sci.: Appl. Polym. Symp. 39 (1984) 75-92.
"""

from __future__ import annotations

from trackres_ros.effects.effect import Conditions, Effect, Parameter, Terms, Values

EXPONENT = 0.6


class Payne(Effect):
    """Kraus' form E'' = E''_inf + 2 dE'' x^p/(1 + x^2p), x the strain over its critical one, that goes as load^(2/3).

    What the base model knows is the loss at nominal load; the form stands relative to it. So it is positive for every height, and
    steepest, as load^0.4, where the peak is all there is.
    """

    name = "payne"
    acts_on = "heat"
    belongs_to = "vehicle"
    text = "the rubber's loss depends on its strain, and thereby on the load"
    needs = ("speed", "weight")
    belt_only = True
    parameters = (
        Parameter("height", "1", 0.0, 10.0, 1.0, "of the peak over strain, dE'' over E''_inf", off=0.0),
        Parameter("strain", "1", 0.1, 10.0, 0.5, "at nominal load, over the one at the peak", more_starts=(2.0,)),
    )

    def terms(self, at: Conditions, p: Values) -> Terms:
        nominal = p.strain**EXPONENT
        present = (p.strain * (at.weight / at.facts.weight) ** (2.0 / 3.0)) ** EXPONENT
        levels = 2.0 * nominal / (1.0 + nominal * nominal), 2.0 * present / (1.0 + present * present)
        return Terms(loss_factor=(1.0 + p.height * levels[1]) / (1.0 + p.height * levels[0]))
