# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Ranks candidates by how well they predict the *level* of the torque: means over blocks of some seconds, left out in turn.

A likelihood near a unit root takes slow torque for noise. Block means have no such noise model: what counts is the error on
recordings and pieces that were left out. The base stays free within its priors, and outliers weigh less (Huber).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.inference.fitting import BELT_EVERY, Fit
from trackres_ros.diagnosis.prepare.session import Array, Mask
from trackres_ros.units import MAD_TO_STD

BLOCK_S = 15.0  # longer than the changes of a drive torque, shorter than those of temperature and weather
PIECE_S = 150.0  # ten blocks that are left out together
FOLDS = 5
FEWEST_RECORDINGS = 3  # to leave whole ones out
LEAST_FILLED = 0.5  # of a block
HUBER = 1.5  # standard deviations: blocks further off weigh less
FURTHEST = 4.0  # of the scatter of the blocks: limit of a block's influence
TURNS = 3  # of weights and values
PRIOR = 0.2  # of an amplitude over its typical one: the inverse of its standard deviation
RIDGE = 1e-9


class LevelErrors(NamedTuple):
    """Errors of block means predicted without their piece, and without their recording, over the noise; nan where neither."""

    pieces: Array
    recordings: Array


class Amplitudes(NamedTuple):
    """Block means of a candidate's columns for typical amplitudes, and the bounds of the amplitudes over the typical ones."""

    columns: Array  # (blocks, amplitudes)
    low: Array
    high: Array


class Levels:
    """Block means of the residual of a fit and of the columns of its free parameters.

    Torques and measured belt temperatures are each in units of the scatter of their own residual.
    """

    def __init__(self, fit: Fit, own_columns: Array, used_masks: Sequence[Mask]) -> None:
        self._index(fit, used_masks)
        residual = self._raw(np.concatenate(fit.residuals))
        scatter = np.array([MAD_TO_STD * float(np.median(np.abs(residual[self._kind == k]))) for k in range(len(self._kinds))])
        self._unit = np.maximum(scatter, 1e-9)[self._kind]
        self.residual = residual / self._unit
        scale, std, nominal = (np.array([getattr(f, name) for f in fit.free]) for name in ("scale", "std", "nominal"))
        self._own_means = self.means(own_columns) * scale
        self._prior = scale / std
        self._pull = np.nan_to_num((nominal - fit.point) / std)
        self.base_errors = self.errors(None)
        prior = np.eye(len(self._prior)) * (self._prior**2 + RIDGE)
        self._projector = np.linalg.solve(self._own_means.T @ self._own_means + prior, self._own_means.T)

    def _index(self, fit: Fit, used_masks: Sequence[Mask]) -> None:
        """Block of each row, and the folds of the blocks."""
        problem = fit.problem
        self._kinds = list(dict.fromkeys(g.kind for g in problem.segments))
        keys, masks, length = [], [], BLOCK_S * problem.sessions[0].pace
        for number, segment in enumerate(problem.segments):
            session = problem.sessions[segment.session]
            torque = segment.kind == "torque"
            time = session.time if torque else session.time[::BELT_EVERY]
            is_known = used_masks[segment.session] if torque else segment.mask
            block = (time // length).astype(np.int64)
            keys.append(np.stack([np.full(len(block), number), block]))
            masks.append(is_known)
        self._used_rows = np.concatenate(masks)
        unique_keys, self._block = np.unique(np.concatenate(keys, axis=1), axis=1, return_inverse=True)
        self._block = self._block.ravel()
        self._count = np.bincount(self._block[self._used_rows], minlength=unique_keys.shape[1])
        self._is_full = self._count >= LEAST_FILLED * np.bincount(self._block)
        segments = [problem.segments[i] for i in unique_keys[0, self._is_full]]
        self._kind = np.array([self._kinds.index(g.kind) for g in segments])
        self.recording = np.array([g.session for g in segments])
        self.time = unique_keys[1, self._is_full] * length
        pieces = np.unique(
            np.stack([self.recording, self.time // (PIECE_S * problem.sessions[0].pace)]), axis=1, return_inverse=True
        )[1]
        folds = np.arange(FOLDS)[:, np.newaxis] == pieces.ravel() % FOLDS
        recordings = np.arange(len(problem.sessions))[:, np.newaxis] == self.recording
        recordings = recordings[recordings.any(axis=1)]
        has_several = len(recordings) >= FEWEST_RECORDINGS
        self._pieces = folds[folds.any(axis=1) & ~folds.all(axis=1)]
        self._recordings = recordings if has_several else recordings[:0]

    def _raw(self, rows: Array) -> Array:
        """Block means of rows of all segments, shape (n,) or (n, k)."""
        if rows.ndim == 2:
            return np.stack([self._raw(column) for column in rows.T], axis=1) if rows.shape[1] else np.empty((self.blocks, 0))
        total = np.bincount(self._block, np.where(self._used_rows, np.nan_to_num(rows), 0.0), len(self._count))
        return np.asarray(total[self._is_full] / self._count[self._is_full])

    def means(self, rows: Array) -> Array:
        """Block means over the scatter of the residual; of all segments, or of all torques."""
        missing_rows = len(self._block) - len(rows)
        rows = np.concatenate((rows, np.zeros((missing_rows, *rows.shape[1:])))) if missing_rows else rows
        means = self._raw(rows)
        return np.asarray(means / (self._unit if rows.ndim == 1 else self._unit[:, np.newaxis]))

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return len(self._kind)

    @property
    def of_torque(self) -> NDArray[np.bool_]:
        """Blocks of torque, the others are of belt temperatures."""
        return np.asarray(self._kind == 0)

    @property
    def scatter_nm(self) -> float:
        """Scatter of the torque's block means [Nm]."""
        return float(self._unit[0])

    def errors(self, candidate: Amplitudes | None) -> LevelErrors:
        """Errors of the blocks with the base, and a candidate, fitted to the others."""
        errors = []
        for folds in (self._pieces, self._recordings):
            error = np.full(self.blocks, np.nan)
            if len(folds):
                prediction = self._solve(candidate, ~folds)[0]
                error[:] = np.where(folds, self.residual - prediction, 0.0).sum(axis=0)
            errors.append(error)
        return LevelErrors(*errors)

    def start(self, candidate: Amplitudes) -> Array:
        """The amplitudes over their typical ones that fit all blocks best."""
        _, amplitudes = self._solve(candidate, np.ones((1, self.blocks), dtype=bool))
        return np.asarray(amplitudes[0])

    def _solve(self, candidate: Amplitudes | None, used_folds: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Prediction of all blocks by each fold's fit, shape (folds, blocks), and its amplitudes."""
        extra_columns = np.empty((self.blocks, 0)) if candidate is None else candidate.columns
        count = extra_columns.shape[1]
        x = np.column_stack([self._own_means, extra_columns])
        prior = np.diag(np.append(self._prior**2, np.full(count, PRIOR**2)) + RIDGE)
        pull = np.append(self._prior * self._pull, np.zeros(count))
        weight = used_folds.astype(float)
        for _ in range(TURNS):
            values = _least_squares(x, self.residual[np.newaxis], weight, prior, pull)
            if candidate is not None:
                amplitudes = np.clip(values[:, -count:], candidate.low, candidate.high)
                if not np.array_equal(amplitudes, values[:, -count:]):
                    rest = self.residual - amplitudes @ extra_columns.T
                    base = slice(0, len(self._prior))
                    own_solution = _least_squares(self._own_means, rest, weight, prior[base, base], pull[base])
                    values = np.column_stack([own_solution, amplitudes])
            error = np.abs(self.residual - values @ x.T)
            weight = used_folds / np.maximum(1.0, error / HUBER)
        return values @ x.T, values[:, x.shape[1] - count :]

    def gain(self, candidate: Amplitudes) -> float:
        """Gain in log-likelihood of the blocks left out: mean of that by pieces and by recordings, less one for each amplitude
        beyond the first.
        """
        pairs = zip(self.base_errors, self.errors(candidate), strict=True)
        gains = [
            log_likelihood(candidate_errors) - log_likelihood(base_errors)
            for base_errors, candidate_errors in pairs
            if np.isfinite(base_errors).any()
        ]
        return float(np.mean(gains) - (candidate.columns.shape[1] - 1))

    def falls(self, torque: Array) -> float:
        """Share by which a column of all torques lowers the mean error of the blocks that are predicted without their piece."""
        column = self.means(torque)[:, np.newaxis]
        new_errors = self.errors(Amplitudes(column, np.array([-np.inf]), np.array([np.inf])))
        return 1.0 - float(np.nanmean(np.abs(new_errors.pieces)) / np.nanmean(np.abs(self.base_errors.pieces)))

    def change_of(self, torque: Array, changing_torque: Array, cluster_s: float) -> tuple[float, float]:
        """Fit the coefficient of a column `changing_torque`, with the base and the `torque` of a term; and its standard
        deviation.

        The deviation is that of clusters of `cluster_s` [s] whose errors may be alike.
        """
        x = np.column_stack([self._own_means, self.means(torque), self.means(changing_torque)])
        prior = np.diag(np.append(self._prior**2, [0.0, 0.0]) + RIDGE)
        pull = np.append(self._prior * self._pull, [0.0, 0.0])
        weight = np.ones((1, self.blocks))
        for _ in range(TURNS):
            values = _least_squares(x, self.residual[np.newaxis], weight, prior, pull)
            weight = 1.0 / np.maximum(1.0, np.abs(self.residual - values @ x.T) / HUBER)
        error = np.clip(self.residual - values[0] @ x.T, -FURTHEST, FURTHEST)
        inverse = np.linalg.inv(x.T @ x + prior)
        cluster = np.unique(np.stack([self.recording, self.time // cluster_s]), axis=1, return_inverse=True)[1].ravel()
        scores = np.stack([np.bincount(cluster, column * error) for column in x.T], axis=1)
        variance = float((inverse @ (scores.T @ scores) @ inverse)[-1, -1])
        return float(values[0, -1]), math.sqrt(max(variance, 0.0))

    def beyond(self, columns: Array) -> Array:
        """Part of block means that the base's own columns do not explain, within their priors."""
        return np.asarray(columns - self._own_means @ (self._projector @ columns))


def log_likelihood(error: Array) -> float:
    """Log-likelihood of errors under Student's t with four degrees of freedom and their own scale."""
    scale = max(float(np.mean(np.abs(error))), 1e-12)
    return -len(error) * math.log(scale) - 2.5 * float(np.log1p((error / scale) ** 2 / 4.0).sum())


def _least_squares(x: Array, y: Array, weight: Array, prior: Array, pull: Array) -> Array:
    """Weighted least squares of each fold; x (blocks, k), y and weight (folds, blocks), the result (folds, k)."""
    weighted_columns = weight[:, np.newaxis, :] * x.T
    right_side = (weighted_columns @ y[..., np.newaxis])[..., 0] + pull
    return np.asarray(np.linalg.solve(weighted_columns @ x + prior, right_side[..., np.newaxis])[..., 0])
