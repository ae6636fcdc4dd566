"""Step 5, first half: what each effect would gain, to first order, and what the best of them would gain from noise alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear
from scipy.signal import lfilter

from trackres_ros.diagnosis.fitting import LARGE, Fit
from trackres_ros.diagnosis.other_forms import other_forms
from trackres_ros.diagnosis.separability import Sensitivity, base_columns
from trackres_ros.diagnosis.whitening import MOST_LAGS, Noise, improved, whole_past

Array = NDArray[np.float64]

TURNS = 3  # of coefficients and noise
FLIPPED_TOGETHER = 20  # samples whose sign the bootstrap flips as one: what whitening left of their likeness stays
REPLICATES, QUICK_REPLICATES = 99, 39
NEARLY_LARGEST = 6
GUMBEL_95 = (-np.log(-np.log(0.95)) - np.euler_gamma) * np.sqrt(6.0) / np.pi  # standard deviations from mean to 95th percentile


@dataclass(frozen=True, eq=False)
class Screened:
    """First-order gains in log-likelihood of effects over a fit, and what noise alone reaches.

    Attributes
    ----------
    gains
        Best first; over a fit whose effects may have another form, see `other_forms`.
    taken
        What other forms of the effects in the fit take of each effect's gain.
    threshold
        What the best gains by noise alone once in twenty.
    reached
        Largest gain of each replicate of the bootstrap.
    """

    gains: tuple[tuple[Sensitivity, float], ...]
    taken: Mapping[str, float]
    threshold: float
    reached: Array


def screen(fit: Fit, candidates: Sequence[Sensitivity], replicates: int, rng: np.random.Generator) -> Screened:
    """Gain of each candidate, and the distribution of the largest under noise of the fit's own kind.

    Notes
    -----
    The noise is fitted with each candidate anew: a slow effect that is left out looks like slow noise, and whitening with
    that would hide it.
    """
    own, forms = base_columns(fit), other_forms(fit)
    linear = _Linear(fit, own, forms)
    movers = [linear.mover(c) for c in candidates]
    residual = linear.lagged(np.concatenate(fit.residuals))
    found = linear.gains(residual, movers)
    gains = sorted(zip(candidates, found, strict=True), key=lambda pair: -pair[1])
    taken: dict[str, float] = {}
    if forms.shape[1]:
        strict = _Linear(fit, own, forms[:, :0])
        plain = strict.gains(residual, [strict.mover(c) for c in candidates])
        names = dict.fromkeys(c.effect.name for c in candidates)
        taken = {name: max(0.0, _best(name, candidates, plain) - _best(name, candidates, found)) for name in names}
    reached = np.zeros(replicates)
    for i in range(replicates):
        drawn = linear.lagged(linear.drawn(rng))
        before = linear.likelihood(drawn, linear.own, at_home=True)
        # One turn tells which come near the largest; only those are turned to the end.
        nearly = sorted(movers, key=lambda m: -linear.likelihood(drawn, m, at_home=True, turns=1))[:NEARLY_LARGEST]
        reached[i] = max((linear.likelihood(drawn, m, at_home=True) - before for m in nearly), default=0.0)
    return Screened(tuple(gains), taken, largest_by_noise(reached), reached)


def largest_by_noise(reached: Array) -> float:
    """What largest values exceed once in twenty: of the Gumbel distribution with their mean and standard deviation.

    It hangs on the draws by two thirds as much as their own quantile does.
    """
    if len(reached) < 2:
        return np.inf
    return float(reached.mean() + GUMBEL_95 * reached.std(ddof=1))


def _best(name: str, candidates: Sequence[Sensitivity], gains: Sequence[float]) -> float:
    return max(gain for c, gain in zip(candidates, gains, strict=True) if c.effect.name == name)


Lagged = Mapping[str, Array]
"""Rows of each kind that count, and those before them: shapes (1 + lags, rows) or (1 + lags, rows, columns)."""


@dataclass(frozen=True, eq=False)
class _Mover:
    """What may move to explain a residual: columns, bounds, and the weight of the priors and where they pull, per parameter."""

    columns: Lagged
    low: Array
    high: Array
    prior: Array
    pull: Array


class _Linear:
    """The fit, linearised, with further columns of which each may move by about one: likelihoods by linear algebra."""

    def __init__(self, fit: Fit, own: Array, further: Array) -> None:
        self._fit = fit
        first, rows = 0, dict[str, list[NDArray[np.int64]]]()
        for segment in fit.problem.segments:
            rows.setdefault(segment.kind, []).append(first + np.flatnonzero(whole_past(segment.mask, MOST_LAGS)))
            first += len(segment.measured)
        self._at = {kind: np.concatenate(of) for kind, of in rows.items()}
        self._columns = np.column_stack([own * np.array([f.scale for f in fit.free]), further])
        far = np.full(self._columns.shape[1], np.inf)
        prior = np.array([*(f.scale / f.std for f in fit.free), *np.ones(further.shape[1])])
        pulls = [(x - f.nominal) / f.std for f, x in zip(fit.free, fit.point, strict=True)]
        pull = -np.array([*pulls, *np.zeros(further.shape[1])])
        self.own = _Mover(self.lagged(self._columns), -far, far, prior, pull)

    def lagged(self, rows: Array) -> Lagged:
        """Rows of all segments, one after the other, as the whitening needs them."""
        return {
            kind: np.stack([rows[at - i] for i in range(len(self._fit.noises[kind].phi) + 1)]) for kind, at in self._at.items()
        }

    def mover(self, candidate: Sensitivity) -> _Mover:
        """The fit's own parameters and the amplitudes of a candidate, in units of its typical ones."""
        amplitudes = [(q, q.start - q.off, q.off) for q in candidate.effect.parameters if q.off is not None]
        limits = [sorted(((q.low - off) / span, (q.high - off) / span)) for q, span, off in amplitudes]
        spans = np.array([span for _, span, _ in amplitudes])
        own = self.own
        return _Mover(
            self.lagged(np.column_stack([self._columns, candidate.columns * spans])),
            np.append(own.low, [low - 1e-9 for low, _ in limits]),
            np.append(own.high, [high + 1e-9 for _, high in limits]),
            np.append(own.prior, np.full(len(limits), 1.0 / LARGE)),
            np.append(own.pull, np.zeros(len(limits))),
        )

    def gains(self, residual: Lagged, movers: Sequence[_Mover]) -> list[float]:
        """In log-likelihood of each mover over the fit's own."""
        null = self.likelihood(residual, self.own)
        return [self.likelihood(residual, m) - null for m in movers]

    def likelihood(self, residual: Lagged, mover: _Mover, at_home: bool = False, turns: int = TURNS) -> float:
        """Of a residual with a mover's parameters free within their bounds, and the noise fitted along.

        `at_home` takes the parameters of the fit for true, as they are in what is drawn: no candidate gains by
        bringing them back into their ranges.
        """
        pull = np.zeros_like(mover.pull) if at_home else mover.pull
        noises, left = dict(self._fit.noises), residual
        moved = np.zeros(len(mover.prior))
        for _ in range(turns):
            parts_x, parts_e = [np.diag(mover.prior)], [pull]
            for kind, noise in noises.items():
                weight = np.sqrt(noise.weights(_white(left[kind], noise)))
                parts_e.append(weight * _white(residual[kind], noise))
                parts_x.append(weight[:, np.newaxis] * _white(mover.columns[kind], noise))
            moved = _bounded(np.concatenate(parts_x), np.concatenate(parts_e), mover.low, mover.high)
            left = {kind: rows - mover.columns[kind] @ moved for kind, rows in residual.items()}
            noises = {kind: improved(left[kind][1:].T, left[kind][0], noise) for kind, noise in noises.items()}
        total = sum(float(noise.log_density(_white(left[kind], noise)).sum()) for kind, noise in noises.items())
        return total - 0.5 * float(((mover.prior * moved - pull) ** 2).sum())

    def drawn(self, rng: np.random.Generator) -> Array:
        """A residual of noise alone: the whitened one with signs flipped by the piece, coloured again."""
        parts, fit = [], self._fit
        for white, segment in zip(fit.white, fit.problem.segments, strict=True):
            noise = fit.noises[segment.kind]
            e = np.nan_to_num(white) * noise.std
            pieces = len(e) // FLIPPED_TOGETHER + 1
            e = e * np.repeat(rng.choice((-1.0, 1.0), pieces), FLIPPED_TOGETHER)[: len(e)]
            parts.append(coloured(e, noise, rng))
        return np.concatenate(parts)


def _white(lagged: Array, noise: Noise) -> Array:
    """Whitened rows over the noise's standard deviation."""
    return np.asarray(np.tensordot(np.concatenate(([1.0], -noise.phi)), lagged, 1) / noise.std)


def coloured(white: Array, noise: Noise, rng: np.random.Generator) -> Array:
    """Noise out of innovations, begun in its steady state."""
    lead = rng.choice(white[white != 0.0], 500) if np.any(white) else np.zeros(500)
    return np.asarray(lfilter([1.0], np.concatenate(([1.0], -noise.phi)), np.concatenate((lead, white)))[500:])


def _bounded(x: Array, e: Array, low: Array, high: Array) -> Array:
    normal, right = x.T @ x, x.T @ e
    ridge = 1e-9 * np.trace(normal) / len(normal) * np.eye(len(normal))
    free = np.linalg.solve(normal + ridge, right)
    if np.all((free >= low) & (free <= high)):
        return free
    factor = np.linalg.cholesky(normal + ridge)
    return np.asarray(lsq_linear(factor.T, np.linalg.solve(factor, right), (low, high), method="bvls").x)
