# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Sets of terms scored by laps and recordings left out, all to first order about one fit.

Each set then costs one small system of equations instead of a fit, so that pairs which only help together are found too.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.inference.bounded import bounded
from trackres_ros.diagnosis.inference.fitting import Fit, valid_rows
from trackres_ros.diagnosis.prepare.session import Array
from trackres_ros.diagnosis.selection.candidate import same_variable
from trackres_ros.diagnosis.selection.level_errors import PRIOR, RIDGE
from trackres_ros.effects.effect import Effect

Names = tuple[str, ...]

EXPANDED = 8  # best sets of each size that get a further term
FEWEST_RECORDINGS = 3  # to leave whole ones out


class Columns(NamedTuple):
    """Derivatives by a term's amplitudes, shape (n, amplitudes), their typical sizes, and bounds in units of these."""

    effect: Effect
    derivatives: Array
    sizes: Array
    low: Array
    high: Array


class LinearSets:
    """Errors of sets of terms on rows left out.

    Parameters
    ----------
    fit, own
        The fit without the terms, and the derivatives of its own parameters, shape (n, parameters).
    terms
        Columns of each term.
    lap, recording
        Number of the fold and of the recording of each row, shape (n,); a row of fold -1 is never left out.
    """

    def __init__(
        self, fit: Fit, own: Array, terms: Mapping[str, Columns], lap: NDArray[np.int64], recording: NDArray[np.int64]
    ) -> None:
        scale, std, nominal, low, high = (
            np.array([getattr(f, name) for f in fit.free]) for name in ("scale", "std", "nominal", "low", "high")
        )
        self._effects = {name: term.effect for name, term in terms.items()}
        self._own, count = len(scale), len(scale)
        self._at: dict[str, NDArray[np.int64]] = {}
        for name, term in terms.items():
            self._at[name] = np.arange(count, count + len(term.low))
            count += len(term.low)
        used = np.isfinite(weights := fit.weights)
        root = np.sqrt(weights[used])
        x, y = np.empty((len(root), count)), valid_rows(fit.white) * root
        # Term by term: together they would be the largest arrays of a diagnosis.
        for at, derivatives, sizes in [
            (np.arange(self._own), own, scale), *((self._at[name], t.derivatives, t.sizes) for name, t in terms.items()),
        ]:  # fmt: skip
            white = fit.problem.white(fit.problem.split(derivatives * sizes), fit.noises)
            x[:, at] = valid_rows(white) * root[:, np.newaxis]
        prior = np.full(count, PRIOR)
        prior[: self._own] = scale / std
        self._prior = np.diag(prior**2 + RIDGE * len(y))
        self._pull = np.zeros(count)
        self._pull[: self._own] = scale / std * np.nan_to_num((nominal - fit.point) / std)
        self._low = np.concatenate([(low - fit.point) / scale, *(t.low for t in terms.values())])
        self._high = np.concatenate([(high - fit.point) / scale, *(t.high for t in terms.values())])
        pairs, group = np.unique(np.stack([lap[used], recording[used]]), axis=1, return_inverse=True)
        order = np.argsort(group.ravel(), kind="stable")
        parts = np.split(order, np.cumsum(np.bincount(group.ravel()))[:-1])
        self._information = np.stack([x[rows].T @ x[rows] for rows in parts])
        self._right = np.stack([x[rows].T @ y[rows] for rows in parts])
        self._square = np.array([y[rows] @ y[rows] for rows in parts])
        self._rows = np.array([len(rows) for rows in parts])
        laps, recordings = np.unique(pairs[0][pairs[0] >= 0]), np.unique(pairs[1][pairs[0] >= 0])
        self._folds = [np.stack([pairs[0] == number for number in laps])]
        if len(recordings) >= FEWEST_RECORDINGS:
            self._folds.append(np.stack([(pairs[1] == number) & (pairs[0] >= 0) for number in recordings]))
        self._nothing = self._errors(())

    def gain(self, names: Collection[str]) -> float:
        """Gain in log-likelihood on the rows left out, less one for each amplitude beyond the first of a term."""
        more = sum(len(self._at[name]) - 1 for name in names)
        pairs = zip(self._nothing, self._errors(names), self._folds, strict=True)
        return float(np.mean([0.5 * self._left_out(f) * np.log(before / after) for before, after, f in pairs])) - more

    def _left_out(self, folds: NDArray[np.bool_]) -> int:
        return int((folds @ self._rows).sum())

    def _errors(self, names: Collection[str]) -> list[float]:
        """Sum of squares of the rows left out, by laps and by recordings."""
        at = np.concatenate([np.arange(self._own), *(self._at[name] for name in names)]).astype(np.int64)
        square = np.ix_(at, at)
        information, right = self._information[:, at[:, np.newaxis], at], self._right[:, at]
        prior, pull = self._prior[square], self._pull[at]
        whole, all_right = information.sum(axis=0) + prior, right.sum(axis=0) + pull
        values, free = bounded(whole, all_right, self._low[at], self._high[at])
        held = np.where(free, 0.0, values)
        found = []
        for folds in self._folds:
            own, own_right = np.tensordot(folds, information, 1), folds @ right
            rest = whole - own
            fitted = np.tile(held, (len(folds), 1))
            target = all_right - own_right - rest @ held
            fitted[:, free] = np.linalg.solve(rest[:, free][:, :, free], target[:, free, np.newaxis])[..., 0]
            fitted = np.clip(fitted, self._low[at], self._high[at])
            bent = (fitted[:, np.newaxis] @ own)[:, 0]
            found.append(
                float((folds @ self._square + (bent * fitted).sum(axis=1) - 2.0 * (fitted * own_right).sum(axis=1)).sum())
            )
        return found

    def _fits(self, name: str, names: Names) -> bool:
        return name not in names and not any(same_variable(self._effects[name], self._effects[other]) for other in names)

    def best(self, among: Collection[str], count: int, most_terms: int, cost: float) -> list[Names]:
        """The `count` sets of each size of some terms with the highest gain less a `cost` for each term, best first."""
        beam: list[Names] = [()]
        gains: dict[Names, float] = {}
        chosen: list[Names] = []
        for size in range(1, most_terms + 1):
            pairs = ((names, name) for names in beam for name in among if self._fits(name, names))
            sets = dict.fromkeys(tuple(sorted((*names, name))) for names, name in pairs)  # in an order of its own
            gains |= {names: self.gain(names) - cost * size for names in sets}
            beam = sorted(sets, key=lambda names: -gains[names])[:EXPANDED]
            chosen += beam[:count]
        return sorted(chosen, key=lambda names: -gains[names])
