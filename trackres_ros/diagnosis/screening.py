"""Step 5, first half: what each effect would gain, to first order, and what the best of them would gain from noise alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear
from scipy.signal import lfilter

from trackres_ros.diagnosis.fitting import Fit, log_likelihood, valid_rows
from trackres_ros.diagnosis.separability import Sensitivity, base_columns, split_rows
from trackres_ros.diagnosis.whitening import Noise

Array = NDArray[np.float64]

TURNS = 3  # of coefficients and noise
FLIPPED_TOGETHER = 20  # samples whose sign the bootstrap flips as one: what whitening left of their likeness stays
REPLICATES, QUICK_REPLICATES = 99, 39
LEVEL = 0.95


@dataclass(frozen=True, eq=False)
class Screened:
    """First-order gains in log-likelihood of effects over a fit, and what noise alone reaches."""

    gains: tuple[tuple[Sensitivity, float], ...]  # best first
    threshold: float
    reached: Array  # largest gain of each replicate of the bootstrap


def screen(fit: Fit, candidates: Sequence[Sensitivity], replicates: int, rng: np.random.Generator) -> Screened:
    """Gain of each candidate, and the distribution of the largest under noise of the fit's own kind.

    Notes
    -----
    The noise is fitted with each candidate anew: a slow effect that is left out looks like slow noise, and whitening with
    that would hide it.
    """
    linear = _Linear(fit)
    residual = np.concatenate(fit.residuals)
    null = linear.likelihood(residual, None)
    gains = sorted(((c, linear.likelihood(residual, c) - null) for c in candidates), key=lambda pair: -pair[1])
    reached = np.zeros(replicates)
    for i in range(replicates):
        drawn = linear.drawn(rng)
        before = linear.likelihood(drawn, None, at_home=True)
        reached[i] = max((linear.likelihood(drawn, c, at_home=True) - before for c in candidates), default=0.0)
    threshold = float(np.quantile(reached, LEVEL)) if replicates else np.inf
    return Screened(tuple(gains), threshold, reached)


class _Linear:
    """The fit, linearised: likelihoods by linear algebra."""

    def __init__(self, fit: Fit) -> None:
        self._fit = fit
        self._lags = {kind: len(noise.phi) for kind, noise in fit.noises.items()}
        self._own = base_columns(fit) * np.array([f.scale for f in fit.free])
        self._prior = np.array([f.scale / f.std for f in fit.free])
        departure = np.array([(x - f.nominal) / f.std for f, x in zip(fit.free, fit.point, strict=True)])
        self._departure = departure

    def likelihood(self, residual: Array, candidate: Sensitivity | None, at_home: bool = False) -> float:
        """Of a residual with the fit's parameters, and a candidate's amplitudes within their bounds, free to move.

        `at_home` takes the parameters of the fit for true, as they are in what is drawn: no candidate gains by
        bringing them back into their ranges.
        """
        columns, low, high = self._own, np.full(self._own.shape[1], -np.inf), np.full(self._own.shape[1], np.inf)
        prior, shift = self._prior, np.zeros_like(self._departure) if at_home else -self._departure
        if candidate is not None:
            limits = [
                ((q.low - q.off) / (q.start - q.off), (q.high - q.off) / (q.start - q.off))
                for q in candidate.effect.parameters
                if q.off is not None
            ]
            spans = np.array([q.start - q.off for q in candidate.effect.parameters if q.off is not None])
            columns = np.column_stack([columns, candidate.columns * spans])
            low = np.append(low, [min(pair) - 1e-9 for pair in limits])
            high = np.append(high, [max(pair) + 1e-9 for pair in limits])
            prior, shift = np.append(prior, np.zeros(len(limits))), np.append(shift, np.zeros(len(limits)))
        noises: Mapping[str, Noise] = self._fit.noises
        moved = np.zeros(columns.shape[1])
        for _ in range(TURNS):
            e, x = self._white(residual, noises), self._white(columns, noises)
            moved = _bounded(np.vstack([x, np.diag(prior)]), np.append(e, shift), low, high)
            left = split_rows(residual - columns @ moved, self._fit)
            noises = self._fit.problem.noises(left, self._lags)
        return log_likelihood(self._fit.problem, left, noises) - 0.5 * float(((prior * moved - shift) ** 2).sum())

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

    def _white(self, rows: Array, noises: Mapping[str, Noise]) -> Array:
        return valid_rows(self._fit.problem.white(split_rows(rows, self._fit), noises))


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
