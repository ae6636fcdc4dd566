# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Step 7: intervals of a chosen effect's parameters: profile likelihood, widened by the scatter over laps and by the error of
the functional form.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from trackres_ros.diagnosis.inference.fitting import Fit, Free, fit, free_parameters
from trackres_ros.diagnosis.inference.noise import SHORT_ROOT
from trackres_ros.diagnosis.selection.candidate import FORM_ERROR
from trackres_ros.diagnosis.selection.grade import ON_BOUND
from trackres_ros.diagnosis.selection.visibility import base_columns
from trackres_ros.progress import counted
from trackres_ros.vehicle.writing.changes import Interval

DROP = 0.5 * float(chdtri(1, 0.05))  # half of the 95 % quantile of chi-squared
NORMAL_95 = 1.96
MOST_TRIES = 8
GROWTH = 2.0


def intervals(found: Fit) -> dict[tuple[str, str], Interval]:
    """Intervals of all parameters of a fit by `levels.with_levels`: the base's from the curvature, those of effects from their
    profile; both from laps and sessions where wider. A value at the end of its range is only bounded. One fixed at a
    typical value may lie anywhere within its bounds.

    The size of an effect also depends on its function, which is accurate to `FORM_ERROR`.
    """
    session_of_row = np.concatenate([np.full(len(g.measured), g.session) for g in found.problem.segments])
    laps, sessions = lap_std(found), _jackknife_std(found, session_of_row)  # unmodelled conditions differ between sessions
    by_laps = {key: max(std, sessions.get(key, 0.0)) for key, std in laps.items()}
    offs = {(a.effect.name, q.name): q.off for a in found.effects for q in a.effect.parameters if q.off is not None}

    def interval(f: Free) -> Interval:
        if f.key not in found.at:
            return Interval(f.low, f.high, True)
        at = found.at[f.key]
        std = max(by_laps.get(f.key, 0.0), found.std_of(*f.key))
        if not f.key[0]:
            at_end = min(at - f.low, f.high - at) <= ON_BOUND * (f.high - f.low)
            return Interval(max(f.low, at - NORMAL_95 * std), min(f.high, at + NORMAL_95 * std), at_end)
        low, low_open = _edge(found, f.key, -1.0, f.low)
        high, high_open = _edge(found, f.key, 1.0, f.high)
        lap = NORMAL_95 * by_laps.get(f.key, 0.0)
        form = NORMAL_95 * FORM_ERROR * abs(at - offs.get(f.key, at))
        below, above = (float(np.hypot(max(reach, lap), form)) for reach in (at - low, high - at))
        return Interval(max(f.low, at - below), min(f.high, at + above), low_open or high_open)

    of = free_parameters(found.problem.base, [a.effect for a in found.effects])
    return {f.key: interval(f) for f in counted(of, "intervals", len(of))}


def lap_std(found: Fit, together: int = 1) -> dict[tuple[str, str], float]:
    """Standard deviations from leaving out one lap at a time, or `together` consecutive ones, to first order."""
    return _jackknife_std(found, np.concatenate([g.block for g in found.problem.segments]) // together)


def _jackknife_std(found: Fit, blocks: NDArray[np.int64]) -> dict[tuple[str, str], float]:
    """Standard deviations from leaving out one block of rows at a time."""
    scale = np.array([f.scale for f in found.free])
    prior = np.array([f.scale / f.std for f in found.free])
    columns = found.problem.white(found.problem.split(base_columns(found) * scale), found.noises)
    x, e = np.concatenate(columns), np.concatenate(found.white)
    valid = np.isfinite(e) & np.isfinite(x).all(axis=1)
    x, e, blocks = x[valid], (e * found.weights)[valid], blocks[valid]
    inverse = np.linalg.pinv(x.T @ x + np.diag(prior**2), rcond=1e-13)
    shifts = np.array([inverse @ (x[blocks == b].T @ e[blocks == b]) for b in np.unique(blocks)])
    count = len(shifts)
    if count < 3:
        return {}
    std = np.sqrt(count / (count - 1) * ((shifts - shifts.mean(axis=0)) ** 2).sum(axis=0)) * scale
    return {f.key: float(s) for f, s in zip(found.free, std, strict=True)}


def _edge(found: Fit, key: tuple[str, str], side: float, bound: float) -> tuple[float, bool]:
    """Point where the profile has fallen by `DROP`, or the bound with True if it does not."""
    at, effects = found.at[key], [a.effect for a in found.effects]
    reach = abs(bound - at)
    if reach <= 1e-6 * max(abs(bound), abs(at), 1e-12):
        return bound, True
    step = min(max(NORMAL_95 * found.std_of(*key), 1e-4 * reach), reach)
    inside, outside = (0.0, 0.0), None
    for _ in range(MOST_TRIES):
        fixed = {key: at + side * step}
        held = fit(found.problem, effects, found.at, found.noises, rounds=1, fixed=fixed, largest_root=SHORT_ROOT)
        fallen = found.log_likelihood - held.log_likelihood
        if fallen >= DROP:
            outside = (step, fallen)
            break
        inside = (step, max(fallen, 0.0))
        if step >= reach * (1.0 - 1e-9):
            return bound, True
        step = min(reach, GROWTH * step)
    if outside is None:
        return bound, True
    # Between them the square root of the fall is nearly linear.
    a, b = np.sqrt(inside[1]), np.sqrt(outside[1])
    share = (np.sqrt(DROP) - a) / (b - a) if b > a else 1.0
    return at + side * float(inside[0] + share * (outside[0] - inside[0])), False
