# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A term added to a fit, and what it gains there."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trackres_ros.diagnosis.base.patterns import ByPlace, ResidualPattern
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.prepare.session import Array
from trackres_ros.effects.effect import Effect
from trackres_ros.effects.learned import EmpiricalEffect

LEAST_SHARE = 0.005  # of the torque, root mean square: a smaller effect hardly matters
MODEL_ERROR = 0.004  # of the torque, root mean square and slow: error of a re-fitted base without missing physics
FORM_ERROR = 0.1  # of an effect's torque: standard deviation of its function's error
NAME, FORM, CLOCK = range(3)  # in the order of preference


@dataclass(frozen=True, eq=False)
class Candidate:
    """A term fitted together with the others."""

    name: str
    fit: Fit  # with the term
    gain: float  # in log-likelihood over the fit without
    evidence: float  # gain less the cost of its parameters, and of the places or times it was chosen from
    share: float  # of the torque, root mean square
    kept: float = 1.0  # see `visibility.EffectSensitivity`, as `d_prime`
    d_prime: float = math.nan
    level: float = math.nan  # level score over the fit without; nan where no laps have judged it

    @property
    def effect(self) -> Effect:
        """The effect itself."""
        return next(a.effect for a in self.fit.effects if a.effect.name == self.name)

    @property
    def bic_gain(self) -> float:
        """Twice the gain, less the cost of its parameters by the Bayesian information criterion."""
        samples = sum(int(mask.sum()) for mask in self.fit.problem.masks)
        return 2.0 * self.gain - math.log(samples) * sum(q.fitted for q in self.effect.parameters)

    @property
    def kind(self) -> int:
        """`NAME` of the catalogue, `FORM` over a variable or a place, or `CLOCK`: known from time or earlier torques."""
        if isinstance(self.effect, ResidualPattern):
            return FORM if isinstance(self.effect, ByPlace) else CLOCK
        return FORM if isinstance(self.effect, EmpiricalEffect) else NAME

    @property
    def is_name(self) -> bool:
        """Whether it is in the catalogue."""
        return self.kind == NAME

    @property
    def matters(self) -> bool:
        """Whether its torque is large enough for a name."""
        return self.share >= LEAST_SHARE


def same_variable(one: Effect, other: Effect) -> bool:
    """Whether both are forms over the same variable: then one of them describes it, and not a sum of both."""
    if not (isinstance(one, EmpiricalEffect) and isinstance(other, EmpiricalEffect) and one.is_function and other.is_function):
        return False
    return one.variable == other.variable


def compared(current: Fit, found: Fit, name: str, cost: float = 0.0, kept: float = 1.0, d_prime: float = math.nan) -> Candidate:
    """Gain of a fit with one more term over the one without."""
    evidence = found.log_evidence - current.log_evidence - cost
    return Candidate(name, found, found.log_likelihood - current.log_likelihood, evidence, share(found, name), kept, d_prime)


def share(found: Fit, name: str) -> float:
    """Root mean square of a term's torque over that of the torque."""
    return rms(found.contribution(name), found) / max(rms([s.torque for s in found.problem.sessions], found), 1e-12)


def spurious_gain(current: Fit) -> float:
    """Log-likelihood that a term of the clock can gain from the model's own error.

    That error does not average out: the longer a recording and the smaller its noise, the more it looks like physics.
    """
    torque = rms([s.torque for s in current.problem.sessions], current)
    samples = sum(int(mask.sum()) for mask in current.problem.masks)
    return 0.5 * samples * (MODEL_ERROR * torque * current.noise.dc_gain / current.noise.std) ** 2


def rms(series: Sequence[Array], found: Fit) -> float:
    """Root mean square over the used samples."""
    used = np.concatenate([x[m] for x, m in zip(series, found.problem.masks, strict=True)])
    return float(np.sqrt(np.mean(used[np.isfinite(used)] ** 2)))
