# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Fits general learners to the same residual of the same re-fitted base, and predicts hold-out laps.

None of them knows physics, whitens the residual, or may decide that there is nothing to learn.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np

from proofs.sealed.drives import Array
from trackres_ros.diagnosis.base.variables import varying
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.prepare.session import Split
from trackres_ros.diagnosis.selection.locate import torque_residuals

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
    known, new, target, left = rows[training], rows[held_out], residual[training], residual[held_out]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of fits that do not converge: a matter of the learner
        adds = {name: learn(known, target, new) for name, learn in LEARN.items()}
    return {BASE: float(np.abs(left).mean()), **{name: float(np.abs(left - x).mean()) for name, x in adds.items()}}


def _rows(refitted: Fit) -> Array:
    """Features for a residual, including the drive torque, each over its standard deviation."""
    series = varying(refitted.problem.sessions, refitted.predicted)
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
        found = fitted(table[:cut], target[:cut], threshold)
        return float(np.abs(target[cut:] - table[cut:] @ found).mean())

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


def _by_trees(known: Array, target: Array, new: Array) -> Array:
    """Boosted trees that stop early, on a tenth of the rows."""
    from sklearn.ensemble import HistGradientBoostingRegressor

    model = HistGradientBoostingRegressor(learning_rate=0.05, min_samples_leaf=40, early_stopping=True, random_state=SEED)
    return np.asarray(model.fit(known, target).predict(new))


LEARN: dict[str, Learn] = {
    "sparse regression (pysindy)": _by_sparse_regression,
    "Gaussian process": _by_process,
    "boosted trees": _by_trees,
}
