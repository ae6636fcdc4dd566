# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Scores explanations by cross-validation over laps.

Every fourth fitted lap makes a fold. Its prediction comes from a fit without it, to first order about the fit of all laps:
one Newton step, with heavy-tail weights and priors. The hold-out laps were never fitted. The *level score* is the
log-likelihood of all these laps under a noise that is no random walk, so that levels matter.

Source: cross-validation by one Newton step as in Giordano et al., A Swiss army infinitesimal jackknife (2019).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.base.patterns import ResidualPattern
from trackres_ros.diagnosis.inference.fitting import Fit, Problem, solve_bounded
from trackres_ros.diagnosis.inference.noise import SHORT_ROOT, estimate_noise, whitened
from trackres_ros.diagnosis.prepare.session import Array, Mask
from trackres_ros.diagnosis.selection.held_out import FEWEST_LAPS, PIECE_S, RESAMPLES, Improvement, number_pieces
from trackres_ros.diagnosis.selection.visibility import base_columns

FOLDS = 4
FEWEST_OCCASIONS = 5  # of an error: a slow rise over a drive makes four
FEWEST_RECORDINGS = 3  # to leave whole ones out
LEAST_LEVEL = 0.05  # of the mean error of the levels
SURELY = 0.025  # of resampled laps, allowed to show the opposite


@dataclass(frozen=True, eq=False)
class Score:
    """Cross-validated score of a model by piece; shape (pieces,)."""

    density: Array  # log-likelihood of the torque of each piece
    error: Array  # sums of absolute errors [Nm]
    square: Array  # and of squared ones [Nm2]
    occasion: NDArray[np.int64]  # number of the occasion of each piece: pieces with nearly the same error share one
    expected: Array  # torque of each scored sample [Nm], shape (samples,)
    level: Array  # mean error of each piece [Nm]
    unseen: float  # mean absolute error of samples predicted without their recording [Nm]; nan with fewer than three


class CrossValidation:
    """Cross-validation over the fitted laps of a fit, and its final hold-out samples."""

    def __init__(self, base_fit: Fit, held_out: Sequence[Mask], rng: np.random.Generator) -> None:
        sessions, masks = base_fit.problem.sessions, base_fit.problem.masks
        fitted_laps = list(zip(number_pieces(sessions, masks, FOLDS), masks, strict=True))
        laps = np.unique(np.concatenate([lap[m] for lap, m in fitted_laps]))
        self._fold = [np.where(m, np.searchsorted(laps, lap) % FOLDS, -1) for lap, m in fitted_laps]
        self.scored = [m | h for m, h in zip(masks, held_out, strict=True)]
        self.measured = self._samples([s.torque for s in sessions])
        pieces = self._samples(number_pieces(sessions, self.scored, FEWEST_LAPS))
        _, first_rows, self._pieces = np.unique(pieces, return_index=True, return_inverse=True)
        self._count = np.bincount(self._pieces)
        self._begin = self._samples([s.time for s in sessions])[first_rows]
        self._session = self._samples([np.full(len(s), i) for i, s in enumerate(sessions)])[first_rows]
        self._rng = rng
        self._draws: dict[int, Array] = {}

    def score(self, fit: Fit, columns: Array | None = None) -> Score:
        """Score a fit by `fitting.with_levels`; `columns` are its derivatives, where they are known."""
        problem = fit.problem
        columns = base_columns(fit) if columns is None else columns
        white = np.concatenate(problem.white(problem.split(columns), fit.noises))
        weights = np.nan_to_num(fit.weights)  # zero where unused, as the residuals and derivatives
        slopes = weights * np.nan_to_num(np.concatenate(fit.white))
        scale = np.array([f.scale for f in fit.free])
        x = np.nan_to_num(white) * scale
        prior = np.diag([(f.scale / f.std) ** 2 for f in fit.free])
        information = (x * weights[:, np.newaxis]).T @ x + prior
        nominal = np.array([f.nominal for f in fit.free])
        # Zero at an optimum within the bounds; a parameter at a bound is pushed against it.
        push = x.T @ slopes + np.diag(prior) * ((nominal - fit.point) / scale)
        ridge = 1e-9 * max(float(np.trace(information)), 1e-300) / len(information) * np.eye(len(information))
        low, high = ((np.array([getattr(f, side) for f in fit.free]) - fit.point) / scale for side in ("low", "high"))
        lap_folds, session = self.rows(problem)
        torques = np.concatenate([np.full(len(g.measured), g.kind == "torque") for g in problem.segments])
        by_session = problem.split(columns)  # torques come first

        def left_out(folds: Sequence[NDArray[np.int64]], rows_of: Callable[[int], Mask], count: int) -> list[Array]:
            """Expected torque of each session, each fold predicted by one Newton step to the fit without its rows."""
            torques = [p.torque.copy() for p in fit.predicted]
            for fold in range(count):
                rows = rows_of(fold)
                own_information = (x[rows] * weights[rows, np.newaxis]).T @ x[rows]
                shift = (
                    scale * solve_bounded(information - own_information + ridge, push - x[rows].T @ slopes[rows], low, high)[0]
                )
                for i, numbers in enumerate(folds):
                    torques[i][numbers == fold] += by_session[i][numbers == fold] @ shift
            return torques

        torque_series = left_out(self._fold, lambda fold: lap_folds == fold, FOLDS)
        count, unseen_error = len(problem.sessions), math.nan
        if count >= FEWEST_RECORDINGS:
            recordings = [np.full(len(s), i) for i, s in enumerate(problem.sessions)]
            forecasts = left_out(recordings, lambda fold: torques & (session == fold), count)
            unseen_error = float(np.abs(self.measured - self._samples(forecasts)).mean())
        for active in fit.effects:
            if isinstance(active.effect, ResidualPattern):
                self._replace_by_forecast(active.effect, fit, torque_series)
        error = [s.torque - e for s, e in zip(problem.sessions, torque_series, strict=True)]
        # Noise of the forecast: that of the fit is too small for unpredictable events, such as the start of a
        # spell.
        noise = estimate_noise(error, self.scored, SHORT_ROOT)
        density = []
        for residual, mask in zip(error, self.scored, strict=True):
            e = whitened(residual, mask, noise.phi) / noise.std
            density.append(np.where(np.isfinite(e), noise.log_density(np.nan_to_num(e)), 0.0))
        errors = self._samples(error)
        deviations = [np.where(m, e - errors.mean(), 0.0) for e, m in zip(error, self.scored, strict=True)]
        drive = problem.sessions[0]  # all have its step
        correlation_s = correlation_length(deviations) * drive.step
        is_correlated = correlation_s > PIECE_S * drive.pace
        occasion = np.stack([self._session, self._begin // correlation_s if is_correlated else np.arange(len(self._begin))])
        return Score(
            self._sum(self._samples(density)), self._sum(np.abs(errors)), self._sum(errors**2),
            np.unique(occasion, axis=1, return_inverse=True)[1].ravel(), self.measured - errors,
            self._sum(errors) / self._count, unseen_error,
        )  # fmt: skip

    def rows(self, problem: Problem) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Number of the fold of each row, -1 where it is never left out, and of its recording, both of shape (n,)."""
        folds = [self._fold[g.session] if g.kind == "torque" else np.full(len(g.measured), -1) for g in problem.segments]
        recording = [np.full(len(g.measured), g.session) for g in problem.segments]
        return np.concatenate(folds), np.concatenate(recording)

    def _replace_by_forecast(self, effect: ResidualPattern, fit: Fit, torque_series: list[Array]) -> None:
        """Replace a series learned from all laps by its forecast."""
        torques = fit.contribution(effect.name)
        size = sum(float((s * s).sum()) for s in effect.shape)
        per_shape = sum(float((a * s).sum()) for a, s in zip(torques, effect.shape, strict=True)) / max(size, 1e-300)
        for i, (shape, forecast) in enumerate(zip(effect.shape, effect.ahead, strict=True)):
            rows = self._fold[i] >= 0
            torque_series[i][rows] += per_shape * (forecast - shape)[rows]

    def gain(self, score_before: Score, score_after: Score) -> float:
        """Level score of `score_after` over `score_before`."""
        return float((score_after.density - score_before.density).sum())

    def least_gain(self, score_before: Score, score_after: Score) -> float:
        """Lower bound of the level score."""
        return self._lower_bound(score_before, score_after.density - score_before.density)

    def by_recording(self, values: Array) -> Array:
        """Sums of each recording, of values of the pieces."""
        return np.asarray(np.bincount(self._session, weights=values, minlength=len(self.scored)), dtype=np.float64)

    def level_falls(self, score_before: Score, score_after: Score) -> bool:
        """Whether the mean error of the pieces' levels falls by at least `LEAST_LEVEL`."""
        old_error, new_error = (float((np.abs(s.level) * self._count).sum()) for s in (score_before, score_after))
        return new_error <= (1.0 - LEAST_LEVEL) * old_error

    def improvement(self, score_before: Score, score_after: Score) -> Improvement:
        """Change of the mean error, with the lower bound of the level score."""
        count, decrease = self._count.sum(), score_before.error - score_after.error
        return Improvement(
            float(score_before.error.sum() / count), float(score_after.error.sum() / count),
            self._lower_bound(score_before, decrease, self._count), -self._lower_bound(score_before, -decrease, self._count),
            self.least_gain(score_before, score_after),
            self.gain(score_before, score_after),
        )  # fmt: skip

    def _lower_bound(self, score_before: Score, gains: Array, count: NDArray[Any] | None = None) -> float:
        """Lower bound of a sum, or of a mean, over resampled occasions; minus infinity for too few occasions."""
        if score_before.occasion.max() + 1 < FEWEST_OCCASIONS:
            return -np.inf
        draws = self._draw(int(score_before.occasion.max()) + 1)
        sums = draws @ np.bincount(score_before.occasion, weights=gains)
        return float(
            np.quantile(sums if count is None else sums / (draws @ np.bincount(score_before.occasion, weights=count)), SURELY)
        )

    def shares(self, scores: Sequence[Score]) -> Array:
        """Share of resampled laps in which each is the most likely; equal likelihoods share.

        Source: pseudo Bayesian model averaging with a bootstrap, Yao et al. (2018).
        """
        table = self._draw(len(self._count)) @ np.stack([s.density for s in scores], axis=1)
        weight = np.exp(table - table.max(axis=1, keepdims=True))
        return np.asarray((weight / weight.sum(axis=1, keepdims=True)).mean(axis=0))

    def _draw(self, count: int) -> Array:
        """Number of draws of each occasion, in each resample."""
        if count not in self._draws:
            self._draws[count] = self._rng.multinomial(count, np.full(count, 1.0 / count), size=RESAMPLES).astype(np.float64)
        return self._draws[count]

    def beyond(self, base: Fit) -> Callable[[Sequence[Array]], Array]:
        """Function that returns the scored samples of each session's series, orthogonal to the parameters of a base."""
        columns = base_columns(base) * np.array([f.scale for f in base.free])
        own_columns = self._samples(base.problem.split(columns)[: len(self.scored)])  # torques come first
        basis, size, _ = np.linalg.svd(own_columns, full_matrices=False)
        basis = basis[:, size > 1e-9 * size[0]]

        def rest(series: Sequence[Array]) -> Array:
            samples = self._samples(series)
            return np.asarray(samples - basis @ (basis.T @ samples))

        return rest

    def _samples(self, series: Sequence[Any]) -> Any:
        return np.concatenate([x[m] for x, m in zip(series, self.scored, strict=True)])

    def _sum(self, values: Array) -> Array:
        return np.asarray(np.bincount(self._pieces, weights=values, minlength=len(self._count)), dtype=np.float64)


def correlation_length(series: Sequence[Array]) -> float:
    """Correlation length of series in samples: twice the integral of their autocorrelation, up to its end."""
    size = 2 ** int(np.ceil(np.log2(2 * max(map(len, series)))))
    product = np.fft.irfft(sum(np.abs(np.fft.rfft(x, size)) ** 2 for x in series))
    until_end = np.logical_and.accumulate(product > 0.0)[1:]
    return float(1.0 + 2.0 * product[1:][until_end].sum() / max(product[0], 1e-300))
