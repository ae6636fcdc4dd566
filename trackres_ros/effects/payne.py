"""Filled rubber loses relatively most at a middle strain."""

from __future__ import annotations

from trackres_ros.effects.effect import Conditions, Effect, Number, Parameter, Terms, Values


class Payne(Effect):
    """Kraus' form E'' = E''_inf + 2 dE'' x^p/(1 + x^2p), x the strain over its critical one, that goes as load^(2/3)."""

    name = "payne"
    acts_on = "heat"
    text = "the rubber's loss depends on how far it is strained, so on the load"
    needs = ("speed", "weight")
    belt_only = True
    parameters = (
        Parameter("height", "1", 0.0, 0.6, 0.2, "of the peak over strain, as a share of the loss", off=0.0),
        Parameter("strain", "1", 0.1, 10.0, 0.5, "at nominal load, over the one at the peak", more_starts=(2.0,)),
    )
    EXPONENT = 0.6

    def terms(self, at: Conditions, p: Values) -> Terms:
        at_load = self._peak(p["strain"] * (at.weight / at.facts.weight) ** (2.0 / 3.0))
        return Terms(loss_factor=1.0 + p["height"] * (at_load - self._peak(p["strain"])))

    def _peak(self, strain: Number) -> Number:
        power = strain**self.EXPONENT
        return 2.0 * power / (1.0 + power * power)
