# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs simpler methods for comparison, given the same residual of the same re-fitted base and the same shapes of effects.

None of them whitens the residual, knows how similar two effects look, or may leave the choice open.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import f as f_distribution

from proofs.sealed.drives import Array
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.selection.visibility import Separability, base_columns

MOST = 3  # largest number of names, as for the diagnosis
SURE_P = 0.05
LEAST_SHARE = 0.1  # of the variance explained by a sparse regression: smaller terms are not named
FOLDS = 5
FEWEST_TO_LEARN = 30


def simple_answers(refitted: Fit, seen: Separability) -> dict[str, Any]:
    """Names by each method for a recording, and the features by which a classifier is trained.

    `seen` holds the effects linearised about the re-fitted base.
    """
    torque = np.concatenate([np.full(len(g.measured), g.kind == "torque") & g.mask for g in refitted.problem.segments])
    residual = np.concatenate(refitted.residuals)[torque]
    own = base_columns(refitted)[torque]
    shapes = {s.effect.name: s.columns[torque] for s in seen.visible if s.start == s.effect.values()}
    tested = {name: _regression(residual, columns) for name, columns in shapes.items()}
    best = max(tested, key=lambda name: tested[name].explained, default=None)
    return {
        "naive": [best] if best and tested[best].p < SURE_P else [],  # it explains most, and more than chance for white noise
        "aic": _by_aic(residual, own, shapes),
        "sparse": _by_lasso(residual, own, shapes),
        "features": {name: (t.correlation, t.f) for name, t in tested.items()},
    }


@dataclass(frozen=True, slots=True)
class _Regression:
    explained: float  # share of the sum of squares
    correlation: float  # signed, of the first column
    f: float
    p: float  # for white noise


def _regression(residual: Array, columns: Array) -> _Regression:
    n, k = columns.shape
    whole, left = float(residual @ residual), _left(residual, columns)
    f = (whole - left) / k / max(left / (n - k), 1e-300)
    first = columns[:, 0]
    norm = float(np.linalg.norm(first) * np.sqrt(whole))
    return _Regression(
        1.0 - left / whole, float(first @ residual) / norm if norm else 0.0, f, float(f_distribution.sf(f, k, n - k))
    )


def _left(residual: Array, columns: Array) -> float:
    """Sum of squares after a linear regression."""
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    found = np.linalg.lstsq(scaled, residual, rcond=1e-10)[0]
    return float(((residual - scaled @ found) ** 2).sum())


def _by_aic(residual: Array, own: Array, shapes: dict[str, Array]) -> list[str]:
    """Base and effects in one linear regression; effects are added while Akaike's criterion falls."""
    n, chosen, columns = len(residual), list[str](), own
    criterion = n * np.log(_left(residual, own))
    while len(chosen) < MOST:
        scores = {
            name: n * np.log(_left(residual, np.hstack((columns, more))))
            + 2.0 * (columns.shape[1] - own.shape[1] + more.shape[1])
            for name, more in shapes.items()
            if name not in chosen
        }
        best = min(scores, key=scores.__getitem__, default=None)
        if best is None or scores[best] >= criterion:
            break
        chosen, columns, criterion = [*chosen, best], np.hstack((columns, shapes[best])), scores[best]
    return chosen


def _by_lasso(residual: Array, own: Array, shapes: dict[str, Array]) -> list[str]:
    """The effects of a cross-validated lasso on the residual, largest first."""
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.linear_model import LassoCV
    from sklearn.model_selection import KFold

    if not shapes:
        return []
    basis = np.linalg.qr(own / np.maximum(np.linalg.norm(own, axis=0), 1e-300))[0]
    owners = [name for name, columns in shapes.items() for _ in range(columns.shape[1])]
    columns = np.hstack(list(shapes.values()))
    columns = columns - basis @ (basis.T @ columns)
    spread = columns.std(axis=0)
    columns, owners = columns[:, spread > 0.0] / spread[spread > 0.0], [o for o, s in zip(owners, spread, strict=True) if s > 0.0]
    target = residual - basis @ (basis.T @ residual)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # effects that look alike: which of them it takes is its own affair
        found = LassoCV(cv=KFold(FOLDS), alphas=30, eps=1e-3, max_iter=3000).fit(columns, target).coef_
    parts = {name: columns @ np.where([o == name for o in owners], found, 0.0) for name in shapes}
    sizes = {name: float(part.std()) for name, part in parts.items()}
    least = LEAST_SHARE * float(np.sum(list(parts.values()), axis=0).std())
    named = [name for name, size in sizes.items() if size > max(least, 1e-9)]
    return sorted(named, key=lambda name: -sizes[name])[:MOST]


def by_trees(features: Sequence[dict[str, tuple[float, float]]], labels: Sequence[str], names: Sequence[str]) -> list[str]:
    """The effect that boosted trees predict for each case, trained on the other parts of a ten-fold split.

    Features and label of each case, the first of several effects, and the names of all effects come in. The result is empty
    where there are too few cases to learn from.
    """
    from sklearn.ensemble import HistGradientBoostingClassifier
    from sklearn.model_selection import KFold

    if len(labels) < FEWEST_TO_LEARN:
        return []
    table = np.array([[x for name in names for x in of.get(name, (0.0, 0.0))] for of in features])
    known = np.array(labels)
    predicted = np.empty(len(known), dtype=object)
    for train, test in KFold(10, shuffle=True, random_state=1).split(table):
        model = HistGradientBoostingClassifier(max_iter=60, min_samples_leaf=3, random_state=1).fit(table[train], known[train])
        predicted[test] = model.predict(table[test])
    return [str(x) for x in predicted]
