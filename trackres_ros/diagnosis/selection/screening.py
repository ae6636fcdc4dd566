# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Step 5, first half: the first-order gain of each effect, and the largest gain from noise alone."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from trackres_ros.diagnosis.inference.fitting import LARGE, Fit
from trackres_ros.diagnosis.inference.noise import LARGEST_ROOT, SHORT_ROOT, Noise, autoregression, improved, shortened, solved
from trackres_ros.diagnosis.prepare.session import MOST_LAGS, Array, whole_past
from trackres_ros.diagnosis.selection.form_error import other_forms
from trackres_ros.diagnosis.selection.visibility import EffectSensitivity, base_columns
from trackres_ros.progress import counted

TURNS = 3  # of coefficients and noise
FLIPPED_TOGETHER = 20  # samples whose sign the bootstrap flips together: keeps the correlation after whitening
REPLICATES, QUICK_REPLICATES = 99, 39
NEARLY_LARGEST = 4
DRAWS = "thresholds of noise alone"
FIRST_SHARE, PLAINLY = 0.4, 3.0  # of the draws; a clear result differs from the threshold by at least this factor
GUMBEL_95 = (-np.log(-np.log(0.95)) - np.euler_gamma) * np.sqrt(6.0) / np.pi  # standard deviations from mean to 95th percentile
MOST_DRAWN_ROWS = 7200  # two hours of driving
STRETCH = 200  # consecutive rows kept together in a subset


class Gain(NamedTuple):
    """First-order gain in log-likelihood, the amplitudes over the typical ones, and whether the noise is short."""

    value: float
    moved: Array
    short: bool


@dataclass(frozen=True, eq=False)
class Screened:
    """First-order gains in log-likelihood of effects over a fit, and those of noise alone."""

    gains: tuple[tuple[EffectSensitivity, Gain], ...]  # best first; over a fit whose effects may have another form
    form_error_gain: Mapping[str, float]  # part that other forms of the fitted effects explain
    threshold: float  # gain of the best candidate by noise alone with 5 % probability
    reached: Array  # largest gain of each replicate of the bootstrap
    short_gains: tuple[tuple[EffectSensitivity, Gain], ...] = ()  # the same under noise kept short; none if the fit's is short


def screen(
    fit: Fit, candidates: Sequence[EffectSensitivity], replicates: int, rng: np.random.Generator, by_noise: float | None = None
) -> Screened:
    """Gain of each candidate, and the distribution of the largest one under the fit's noise, unless that gain `by_noise`
    is given. Clear first draws end the bootstrap.

    Notes
    -----
    The noise is fitted again with each candidate: a missing slow effect looks like slow noise, and whitening with
    that would hide it. The gain by noise hardly depends on its duration: of more than `MOST_DRAWN_ROWS` rows,
    only evenly spaced stretches are drawn, with weaker priors.
    """
    own, forms = base_columns(fit), other_forms(fit)
    linear = _Linear(fit, own, forms)
    movers = [linear.mover(c) for c in candidates]
    residual = linear.lagged(np.concatenate(fit.residuals))
    found = linear.gains(residual, movers)
    gains = _best_first(candidates, found)
    if not gains:
        return Screened((), {}, np.inf, np.zeros(0))
    short = linear.short_gains(residual, movers)
    short_gains = _best_first(candidates, short) if short else ()
    form_error_gain: dict[str, float] = {}
    if forms.shape[1]:
        strict = _Linear(fit, own, forms[:, :0])
        plain = strict.gains(residual, [strict.mover(c) for c in candidates])
        names = dict.fromkeys(c.effect.name for c in candidates)
        form_error_gain = {name: max(0.0, _best(name, candidates, plain) - _best(name, candidates, found)) for name in names}
    if by_noise is not None:
        return Screened(gains, form_error_gain, by_noise, np.zeros(0), short_gains)
    few = linear if linear.rows <= MOST_DRAWN_ROWS else _Linear(fit, own, forms, MOST_DRAWN_ROWS)
    movers = movers if few is linear else [few.mover(c) for c in candidates]
    rank = few.ranking(movers)

    def largest(drawn: Lagged) -> float:
        before = few.likelihood(drawn, few.own, centred_on_fit=True).value
        nearly = [movers[j] for j in np.argsort(-rank(drawn))[:NEARLY_LARGEST]]
        return max((few.likelihood(drawn, m, centred_on_fit=True).value - before for m in nearly), default=0.0)

    def largest_of(count: int) -> Array:
        return np.array([largest(few.lagged(few.drawn(rng))) for _ in counted(range(count), DRAWS, count)])

    first = math.ceil(FIRST_SHARE * replicates)
    reached = largest_of(first)
    if 1.0 / PLAINLY < gains[0][1].value / largest_by_noise(reached) < PLAINLY:
        reached = np.concatenate((reached, largest_of(replicates - first)))
    return Screened(gains, form_error_gain, largest_by_noise(reached), reached, short_gains)


def largest_by_noise(reached: Array) -> float:
    """95th percentile of the Gumbel distribution with the mean and standard deviation of the largest values.

    It varies between draws by two thirds as much as their own quantile.
    """
    if len(reached) < 2:
        return np.inf
    return float(reached.mean() + GUMBEL_95 * reached.std(ddof=1))


def _best_first(candidates: Sequence[EffectSensitivity], gains: Sequence[Gain]) -> tuple[tuple[EffectSensitivity, Gain], ...]:
    return tuple(sorted(zip(candidates, gains, strict=True), key=lambda pair: -pair[1].value))


def _best(name: str, candidates: Sequence[EffectSensitivity], gains: Sequence[Gain]) -> float:
    return max(gain.value for c, gain in zip(candidates, gains, strict=True) if c.effect.name == name)


Lagged = Mapping[str, Array]
"""Used rows of each kind, and those before them: shapes (1 + lags, rows) or (1 + lags, rows, columns)."""


@dataclass(frozen=True, eq=False)
class _Mover:
    """Free parameters for explaining a residual."""

    columns: Lagged
    low: Array
    high: Array
    prior: Array
    pull: Array


class _Linear:
    """The linearised fit, with additional columns of about unit prior: likelihoods by linear algebra."""

    def __init__(self, fit: Fit, own: Array, further: Array, most_rows: int = sys.maxsize) -> None:
        self._fit = fit
        short = shortened(fit.noise)
        self._short = None if short is None else {**fit.noises, "torque": short}
        first, rows = 0, dict[str, list[NDArray[np.int64]]]()
        for segment in fit.problem.segments:
            rows.setdefault(segment.kind, []).append(first + np.flatnonzero(whole_past(segment.mask, MOST_LAGS)))
            first += len(segment.measured)
        all_rows = {kind: np.concatenate(of) for kind, of in rows.items()}
        self.rows = sum(map(len, all_rows.values()))
        share = min(1.0, most_rows / max(self.rows, 1))
        self._at = {kind: _thinned(at, share) for kind, at in all_rows.items()}
        self._lighter = float(np.sqrt(share))
        self._columns = np.column_stack([own * np.array([f.scale for f in fit.free]), further])
        far = np.full(self._columns.shape[1], np.inf)
        prior = self._lighter * np.array([*(f.scale / f.std for f in fit.free), *np.ones(further.shape[1])])
        pulls = [(x - f.nominal) / f.std for f, x in zip(fit.free, fit.point, strict=True)]
        pull = -np.array([*pulls, *np.zeros(further.shape[1])])
        self.own = _Mover(self.lagged(self._columns), -far, far, prior, pull)

    def lagged(self, rows: Array) -> Lagged:
        """Concatenated rows of all segments with their lags, for the whitening."""
        return {
            kind: np.stack([rows[at - i] for i in range(len(self._fit.noises[kind].phi) + 1)]) for kind, at in self._at.items()
        }

    def mover(self, candidate: EffectSensitivity) -> _Mover:
        """The fit's own parameters and the amplitudes of a candidate, in units of its typical ones."""
        amplitudes = [(q, q.start - q.off, q.off) for q in candidate.effect.parameters if q.off is not None]
        limits = [sorted(((q.low - off) / span, (q.high - off) / span)) for q, span, off in amplitudes]
        spans = np.array([span for _, span, _ in amplitudes])
        own = self.own
        return _Mover(
            self.lagged(np.column_stack([self._columns, candidate.columns * spans])),
            np.append(own.low, [low - 1e-9 for low, _ in limits]),
            np.append(own.high, [high + 1e-9 for _, high in limits]),
            np.append(own.prior, np.full(len(limits), self._lighter / LARGE)),
            np.append(own.pull, np.zeros(len(limits))),
        )

    def gains(self, residual: Lagged, movers: Sequence[_Mover]) -> list[Gain]:
        """Gains in log-likelihood of each mover over the fit's own."""
        null = self.likelihood(residual, self.own).value

        def gain(mover: _Mover) -> Gain:
            found = self.likelihood(residual, mover)
            return found._replace(value=found.value - null, moved=found.moved[len(self.own.prior) :])

        return [gain(mover) for mover in counted(movers, "screening of the candidates", len(movers))]

    def short_gains(self, residual: Lagged, movers: Sequence[_Mover]) -> list[Gain]:
        """The same under noise kept away from a random walk; none if the fit's noise is."""
        short = self._short
        if short is None:
            return []
        null = self._turned(residual, self.own, short, False, SHORT_ROOT)[0]
        found = [self._turned(residual, m, short, False, SHORT_ROOT) for m in movers]
        return [Gain(value - null, moved[len(self.own.prior) :], True) for value, moved in found]

    def ranking(self, movers: Sequence[_Mover]) -> Callable[[Lagged], Array]:
        """Function for the gain of each mover on a residual, without bounds and new noise: cheap, for ranking."""
        count, noises = len(self.own.prior), self._fit.noises
        prior = np.concatenate([self.own.prior, *(m.prior[count:] for m in movers)])
        white = {
            kind: _white(
                np.concatenate([self.own.columns[kind], *(m.columns[kind][:, :, count:] for m in movers)], axis=2), noise
            )
            for kind, noise in noises.items()
        }
        normal = np.sum([np.diag(prior**2), *(x.T @ x for x in white.values())], axis=0)
        normal[np.diag_indices_from(normal)] *= 1.0 + 1e-9
        taken = np.linalg.solve(normal[:count, :count], normal[:count, count:])  # explained by the fit's own parameters
        left = normal[count:, count:] - normal[count:, :count] @ taken
        ends = np.cumsum([len(m.prior) - count for m in movers])
        parts = [slice(end - len(m.prior) + count, end) for end, m in zip(ends, movers, strict=True)]
        inverses = [np.linalg.inv(left[part, part]) for part in parts]

        def gains(residual: Lagged) -> Array:
            e = {kind: _white(residual[kind], noise) for kind, noise in noises.items()}
            pulls = np.sum([white[kind].T @ (noise.weights(e[kind]) * e[kind]) for kind, noise in noises.items()], axis=0)
            rest = pulls[count:] - taken.T @ pulls[:count]
            return np.array([rest[part] @ inverse @ rest[part] for part, inverse in zip(parts, inverses, strict=True)])

        return gains

    def likelihood(self, residual: Lagged, mover: _Mover, centred_on_fit: bool = False) -> Gain:
        """Likelihood of a residual with a mover's parameters free within their bounds, and the noise fitted too.

        `centred_on_fit` treats the fit's parameters as true, as in drawn residuals: no candidate gains by
        returning them to their ranges.
        """
        found = Gain(*self._turned(residual, mover, self._fit.noises, centred_on_fit), False)
        if self._short is None:
            return found
        return max(found, Gain(*self._turned(residual, mover, self._short, centred_on_fit), True), key=lambda gain: gain.value)

    def _turned(
        self,
        residual: Lagged,
        mover: _Mover,
        begin: Mapping[str, Noise],
        centred_on_fit: bool,
        largest_root: float = LARGEST_ROOT,
    ) -> tuple[float, Array]:
        """Likelihood and parameter changes, from alternating coefficients and noise, with an initial noise."""
        pull = np.zeros_like(mover.pull) if centred_on_fit else mover.pull
        noises, left = dict(begin), residual
        moved = np.zeros(len(mover.prior))
        for turn in range(TURNS):
            parts_x, parts_e = [np.diag(mover.prior)], [pull]
            for kind, noise in noises.items():
                white = _white(residual[kind], noise)
                weight = np.sqrt(noise.weights(_white(left[kind], noise) if turn else white))
                parts_e.append(weight * white)
                parts_x.append(weight[:, np.newaxis] * _white(mover.columns[kind], noise))
            moved = _bounded(np.concatenate(parts_x), np.concatenate(parts_e), mover.low, mover.high)
            left = {kind: rows - mover.columns[kind] @ moved for kind, rows in residual.items()}
            noises = {
                kind: improved(left[kind][1:].T, left[kind][0], noise, largest_root=largest_root)
                for kind, noise in noises.items()
            }
        total = sum(float(noise.log_density(_white(left[kind], noise)).sum()) for kind, noise in noises.items())
        return total - 0.5 * float(((mover.prior * moved - pull) ** 2).sum()), moved

    def drawn(self, rng: np.random.Generator) -> Array:
        """A residual of noise alone: the whitened one with signs flipped in pieces, then coloured again."""
        parts, fit = [], self._fit
        for white, segment in zip(fit.white, fit.problem.segments, strict=True):
            noise = fit.noises[segment.kind]
            e = np.nan_to_num(white) * noise.std
            pieces = len(e) // FLIPPED_TOGETHER + 1
            e = e * np.repeat(rng.choice((-1.0, 1.0), pieces), FLIPPED_TOGETHER)[: len(e)]
            parts.append(coloured(e, noise, rng))
        return np.concatenate(parts)


def _thinned(rows: NDArray[np.int64], share: float) -> NDArray[np.int64]:
    """A share of the rows, in evenly spaced stretches."""
    stretch = np.arange(len(rows)) // STRETCH
    return np.asarray(rows[np.ceil((stretch + 1) * share) > np.ceil(stretch * share)])


def _white(lagged: Array, noise: Noise) -> Array:
    """Whitened rows over the noise's standard deviation."""
    white: Array = noise.whitening @ lagged.reshape(len(noise.whitening), -1)
    return white.reshape(lagged.shape[1:])


def coloured(white: Array, noise: Noise, rng: np.random.Generator) -> Array:
    """Coloured noise from innovations, starting in steady state."""
    lead = rng.choice(white[white != 0.0], 500) if np.any(white) else np.zeros(500)
    return autoregression(np.concatenate((lead, white)), noise.phi)[500:]


def _bounded(x: Array, e: Array, low: Array, high: Array) -> Array:
    normal, right = x.T @ x, x.T @ e
    free = solved(normal, right, 1e-9 / len(normal))
    if np.all((free >= low) & (free <= high)):
        return free
    factor = np.linalg.cholesky(normal)
    return np.asarray(lsq_linear(factor.T, np.linalg.solve(factor, right), (low, high), method="bvls").x)
