# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Answers a case from its recordings and its vehicle file alone: the diagnosis, simpler methods and general learners.

The simpler methods get the same residual of the same re-fitted base and the same shapes of effects. None of them whitens the
residual, knows how similar two effects look, or may leave the choice open. The general learners predict hold-out laps. None of
them knows physics, whitens the residual, or may decide that there is nothing to learn.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import f as f_distribution

from proofs.pipeline import read_json
from trackres_ros.arrays import Array
from trackres_ros.diagnosis import Diagnosis, DiagnosisOptions, diagnose, load_base, read_recordings
from trackres_ros.diagnosis.base.loading import LoadedBase
from trackres_ros.diagnosis.base.variables import varying_series
from trackres_ros.diagnosis.empirical.finders import variable_of
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.prepare.session import Split
from trackres_ros.diagnosis.report.content import report
from trackres_ros.diagnosis.selection.locate import torque_residuals
from trackres_ros.diagnosis.selection.visibility import Separability, base_columns
from trackres_ros.files.resources import find_vehicle
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.recording import Recording

HELD_OUT = "held_out.json"
VEHICLE = "xgd24d"  # of a case without a vehicle file of its own
TOPICS = "topics.yaml"  # of a case whose columns are not the project's
SHOWN = 200  # points of a described term over its variable
DRIVING_MPS = 0.5


def opened(folder: Path) -> tuple[list[Path], list[Recording], LoadedBase]:
    """Paths and recordings in the folder of a case, and its vehicle."""
    own, paths = folder / "vehicle.yaml", sorted(folder.glob("*.csv"))
    base = load_base(own if own.exists() else find_vehicle(VEHICLE))
    if not (folder / TOPICS).exists():
        return paths, read_recordings(paths, None), base
    topics = Topics.load(folder / TOPICS)
    return paths, read_recordings(paths, topics), base.with_topics(topics)


def answer(folder: Path) -> tuple[dict[str, Any], dict[str, Array]]:
    """The diagnosis of the folder of a case, and what simpler methods and general learners find."""
    paths, recordings, base = opened(folder)
    # A drive made to distinguish effects is added to the fit: the hold-out laps are the same as without it.
    kept = folder / HELD_OUT
    held_out = read_json(kept) if kept.exists() else None
    result = diagnose(recordings, base, DiagnosisOptions(holdout=held_out, quick=True))
    simple = simple_answers(result.refitted, result.alone.separability.of_names)
    learned_values = learned_errors(result.refitted, result.split)
    return {"report": report(result, paths), "simple": simple, "learned": learned_values, "over": _over(result)}, {}


def _over(found: Diagnosis) -> dict[str, list[list[float]]]:
    """Of each described term: values of its variable, rising, and its torque there [Nm]; without those that have none."""
    shown = {}
    for term in found.described:
        course = variable_of(term, found.final)
        x, torque = (np.concatenate(list(item)) if item else np.empty(0) for item in (course, term.adds))
        speed = np.concatenate([s.speed for s in found.refitted.problem.sessions])
        if len(x) != len(speed):
            continue
        drives = np.flatnonzero((speed > DRIVING_MPS) & np.isfinite(x))
        rising = drives[np.argsort(x[drives])]
        kept = rising[np.linspace(0, len(rising) - 1, min(SHOWN, len(rising))).astype(int)]
        shown[term.name] = [x[kept].tolist(), torque[kept].tolist()]
    return shown


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
    total, remainder = float(residual @ residual), _left(residual, columns)
    f = (total - remainder) / k / max(remainder / (n - k), 1e-300)
    first = columns[:, 0]
    norm = float(np.linalg.norm(first) * np.sqrt(total))
    return _Regression(
        1.0 - remainder / total, float(first @ residual) / norm if norm else 0.0, f, float(f_distribution.sf(f, k, n - k))
    )


def _left(residual: Array, columns: Array) -> float:
    """Sum of squares after a linear regression."""
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    result = np.linalg.lstsq(scaled, residual, rcond=1e-10)[0]
    return float(((residual - scaled @ result) ** 2).sum())


def _by_aic(residual: Array, own: Array, shapes: dict[str, Array]) -> list[str]:
    """Base and effects in one linear regression; effects are added while Akaike's criterion falls."""
    n, choice, columns = len(residual), list[str](), own
    criterion = n * np.log(_left(residual, own))
    while len(choice) < MOST:
        scores = {
            name: n * np.log(_left(residual, np.hstack((columns, more))))
            + 2.0 * (columns.shape[1] - own.shape[1] + more.shape[1])
            for name, more in shapes.items()
            if name not in choice
        }
        best = min(scores, key=scores.__getitem__, default=None)
        if best is None or scores[best] >= criterion:
            break
        choice, columns, criterion = [*choice, best], np.hstack((columns, shapes[best])), scores[best]
    return choice


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
        result = LassoCV(cv=KFold(FOLDS), alphas=30, eps=1e-3, max_iter=3000).fit(columns, target).coef_
    parts = {name: columns @ np.where([o == name for o in owners], result, 0.0) for name in shapes}
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
    table = np.array([[x for name in names for x in feature.get(name, (0.0, 0.0))] for feature in features])
    known = np.array(labels)
    prediction = np.empty(len(known), dtype=object)
    for train, test in KFold(10, shuffle=True, random_state=1).split(table):
        model = HistGradientBoostingClassifier(max_iter=60, min_samples_leaf=3, random_state=1).fit(table[train], known[train])
        prediction[test] = model.predict(table[test])
    return [str(x) for x in prediction]


Learn = Callable[[Array, Array, Array], Array]
"""Features and targets for training, features for prediction; returns the predictions."""

BASE = "base"
THRESHOLDS_NM = (3.0, 10.0, 30.0, 100.0)  # of a coefficient of a function of scaled variables
RIDGE = 0.05
CHECKED_SHARE = 0.25  # of the rows, the last: they choose the threshold
KERNEL_ROWS, PROCESS_ROWS = 300, 1200  # evenly over the recordings: a Gaussian process grows with the cube
SEED = 1


def learned_errors(refitted: Fit, split: Split) -> dict[str, float]:
    """Mean absolute error on hold-out laps of the re-fitted base, and with each learner added [Nm]."""
    sessions = refitted.problem.sessions
    residual = np.concatenate(torque_residuals(refitted))
    training = np.concatenate([split.training_mask(s) for s in sessions])
    held_out = np.concatenate([split.held_out_mask(s) for s in sessions])
    rows = _rows(refitted)
    known, new, target, remainder = rows[training], rows[held_out], residual[training], residual[held_out]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of fits that do not converge: a matter of the learner
        adds = {name: learn(known, target, new) for name, learn in LEARN.items()}
    return {BASE: float(np.abs(remainder).mean()), **{name: float(np.abs(remainder - x).mean()) for name, x in adds.items()}}


def _rows(refitted: Fit) -> Array:
    """Features for a residual, including the drive torque, each over its standard deviation."""
    series = varying_series(refitted.problem.sessions, refitted.predicted)
    series["driving torque"] = np.concatenate([p.at_sprockets for p in refitted.predicted])
    if "heading" in series:
        heading = series.pop("heading")
        series |= {"north": np.cos(heading), "east": np.sin(heading)}
    table = np.column_stack(list(series.values()))
    return np.asarray(table / table.std(axis=0))


def _by_sparse_regression(known: Array, target: Array, new: Array) -> Array:
    """Sequentially thresholded least squares over products of two variables, their sizes and their signs."""
    from pysindy import STLSQ, PolynomialLibrary

    middle, products = known.mean(axis=0), PolynomialLibrary(degree=2)

    def functions(rows: Array) -> Array:
        smooth = np.asarray(products.fit_transform(rows - middle))
        return np.hstack((smooth, np.abs(rows - middle), np.sign(rows)))

    def fitted(rows: Array, of: Array, threshold: float) -> Array:
        return np.asarray(STLSQ(threshold=threshold, alpha=RIDGE * len(of), max_iter=20).fit(rows, of[:, np.newaxis]).coef_[0])

    table, cut = functions(known), int(len(known) * (1.0 - CHECKED_SHARE))

    def error(threshold: float) -> float:
        result = fitted(table[:cut], target[:cut], threshold)
        return float(np.abs(target[cut:] - table[cut:] @ result).mean())

    return functions(new) @ fitted(table, target, min(THRESHOLDS_NM, key=error))


def _by_process(known: Array, target: Array, new: Array) -> Array:
    """A Gaussian process with a length of its own along each variable, and white noise."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    kernel = ConstantKernel(1.0) * RBF(np.full(known.shape[1], 2.0), (0.2, 100.0)) + WhiteKernel(1.0)
    few, more = (np.linspace(0, len(known) - 1, min(n, len(known))).astype(int) for n in (KERNEL_ROWS, PROCESS_ROWS))
    settled = GaussianProcessRegressor(kernel, normalize_y=True, random_state=SEED).fit(known[few], target[few]).kernel_
    model = GaussianProcessRegressor(settled, optimizer=None, normalize_y=True).fit(known[more], target[more])
    return np.asarray(model.predict(new))


def _boosted_trees(known: Array, target: Array, new: Array) -> Array:
    """Boosted trees that stop early, on a tenth of the rows."""
    from sklearn.ensemble import HistGradientBoostingRegressor

    model = HistGradientBoostingRegressor(learning_rate=0.05, min_samples_leaf=40, early_stopping=True, random_state=SEED)
    return np.asarray(model.fit(known, target).predict(new))


LEARN: dict[str, Learn] = {
    "sparse regression (pysindy)": _by_sparse_regression,
    "Gaussian process": _by_process,
    "boosted trees": _boosted_trees,
}
