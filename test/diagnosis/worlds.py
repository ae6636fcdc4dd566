# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A world in which a test says what each effect gains: a round of the search runs in it, and nothing is simulated or fitted."""

from collections.abc import Mapping
from types import SimpleNamespace

import numpy as np
from trackres_ros.diagnosis.selection.naming import Candidate
from trackres_ros.diagnosis.selection.screening import Gain, Screened

from trackres_ros.diagnosis.selection.visibility import EffectSensitivity, Separability
from trackres_ros.effects.effect import Parameter

LAPS, LAP = 20, 5  # laps of so many samples each
LEVEL = -300.0  # log-likelihood of a fit with no effect: only differences count
TORQUE_NM = 100.0
MOVED = 0.5  # of the typical size: where an effect is best to first order
QUIET = 1e6  # Nm of noise, beside which the model's own error gains nothing


class Plain:
    """Noise whose whitened residuals are log-densities themselves, so that a test can say what each sample gains."""

    dc_gain, phi = 1.0, np.empty(0)

    def __init__(self, std=QUIET):
        self.std = std

    def log_density(self, white):
        return white


class Model:
    """A fit as the choice sees it: effects, what each lap gains by them, and what they cost."""

    def __init__(self, world, effects, start=None, problem=None):
        self.world, self.effect_names = world, tuple(e.name for e in effects)
        self.effects = tuple(SimpleNamespace(effect=e, values=e.values()) for e in effects)
        self.problem = problem or world.problem
        self.at = dict(start or {})
        self.noises = {"torque": world.noise}
        self.noise = world.noise
        self.laps = world.gains_of(self.effect_names)
        # Values before the first sample of a lap are unknown and have no weight.
        row = np.concatenate([[np.nan, *np.full(LAP - 1, x / (LAP - 1))] for x in self.laps])
        self.white = [row]
        self.log_likelihood = LEVEL + float(self.laps.sum())
        self.log_evidence = self.log_likelihood - sum(world.costs[name] for name in self.effect_names)
        self.residuals = [np.where(np.arange(LAPS * LAP) % 2, 1.0, -1.0)]
        self.free = tuple(SimpleNamespace(key=(e.name, q.name), std=1.0) for e in effects for q in e.parameters)
        self.predicted = (SimpleNamespace(at_sprockets=np.full(LAPS * LAP, float(len(effects)))),)

    def contribution(self, name):
        return [np.full(LAPS * LAP, self.world.shares[name] * TORQUE_NM)]

    def std_of(self, effect, parameter):
        return self.world.stds.get((effect, parameter), 0.5)


class Kind:
    """An effect of one parameter of size, or of such as are given."""

    def __init__(self, name, acts_on="torque", parameters=None):
        self.name, self.acts_on = name, acts_on
        self.parameters = parameters or (Parameter("size", "Nm", -100.0, 100.0, 10.0, "of it", off=0.0),)

    def values(self):
        return {q.name: q.start for q in self.parameters}


class World:
    """What nature would gain by each effect, alone and together.

    Parameters
    ----------
    gains
        Of each effect: in all, spread evenly, or of each lap.
    together
        Of sets of effects that are no sum of the others.
    first_order
        What screening takes for the gain of an effect that is far from linear.
    """

    def __init__(
        self, gains, together: Mapping = {}, costs=2.0, shares=0.1, taken=0.0, threshold=5.0, std=QUIET, first_order: Mapping = {}
    ):  # fmt: skip
        self.gains = {name: np.broadcast_to(g if np.ndim(g) else g / LAPS, LAPS).astype(float) for name, g in gains.items()}
        self.together = {frozenset(names): value for names, value in together.items()}
        self.effects = {name: Kind(name) for name in gains}
        self.threshold, self.first_order = threshold, first_order
        self.costs, self.shares, self.taken = (
            {name: x.get(name, default) if isinstance(x, dict) else x for name in gains}
            for x, default in ((costs, 2.0), (shares, 0.1), (taken, 0.0))
        )
        self.stds = {(name, "size"): 0.5 for name in gains}
        self.noise = Plain(std)
        segment = SimpleNamespace(
            kind="torque", mask=np.ones(LAPS * LAP, dtype=bool), block=np.repeat(np.arange(7, 7 + LAPS), LAP)
        )
        session = SimpleNamespace(torque=np.full(LAPS * LAP, TORQUE_NM))
        self.problem = SimpleNamespace(segments=(segment,), sessions=(session,), masks=(segment.mask,))
        self.fitted = []

    def gains_of(self, names):
        if frozenset(names) in self.together:
            return np.broadcast_to(self.together[frozenset(names)] / LAPS, LAPS).astype(float)
        return sum((self.gains[name] for name in names), np.zeros(LAPS))

    def fit(self, problem, effects=(), start=None, noises=None, rounds=3):
        self.fitted.append((tuple(e.name for e in effects), dict(start or {}), rounds))
        return Model(self, effects, start, problem)

    def separability(self, effects, current, columns):
        names = tuple(effects)
        assert not set(names) & set(current.effect_names)
        return Separability(tuple(self.seen(name) for name in names), (), names, np.eye(len(names)))

    def seen(self, name, start=None, d_prime=5.0, kept=0.8):
        effect = self.effects[name]
        return EffectSensitivity(effect, start or effect.values(), np.empty(0), kept, d_prime, 0.0, np.empty(0))

    def screen(self, current, visible, replicates, rng, by_noise):
        before = self.gains_of(current.effect_names).sum()
        gains = {s.effect.name: self.gains_of((*current.effect_names, s.effect.name)).sum() - before for s in visible}
        gains |= {name: gain for name, gain in self.first_order.items() if name in gains}
        best_first = sorted(
            ((s, Gain(gains[s.effect.name], np.array([MOVED]), False)) for s in visible), key=lambda x: -x[1].value
        )
        taken = {name: gain for name, gain in self.taken.items() if gain}
        return Screened(tuple(best_first), taken, self.threshold if by_noise is None else by_noise, np.zeros(replicates))


def candidate(name="x", gain=10.0, criterion=8.0, taken=0.0, share=0.1, fit=None):
    return Candidate(name, fit, gain, criterion, 0.0, 0.5, 5.0, share, taken)
