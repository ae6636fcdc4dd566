# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Finds the thresholds of a step, a hinge or a latch, by linear algebra on the residual of a fit.

Each threshold of a grid makes a column. Its gain in log-likelihood follows from the whitened residual, given the free
parameters of the fit. Only the best column of each variable and form becomes a candidate, if it gains enough.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from trackres_ros.diagnosis.inference.fitting import Fit, valid_rows
from trackres_ros.diagnosis.inference.noise import shortened, whitened
from trackres_ros.diagnosis.prepare.session import Array
from trackres_ros.diagnosis.selection.visibility import base_columns
from trackres_ros.effects.learned import ABOVE, BELOW, LATCHED, STEP, Corner, EmpiricalEffect, Latch

Columns = Callable[[Array], list[Array]]
"""Columns of each session for thresholds, shape (n, thresholds)."""

RANGE = (0.02, 0.98)  # quantiles: both ends of the driven range
GRID = 15  # thresholds at first
FINER, PASSES = 5, 3  # then so many between the neighbours of the best
FEWEST_BEYOND = 0.03  # share of the samples on either side of a threshold
LEAST_GAIN = 8.0  # in log-likelihood: a smaller gain is not worth a fit
LATCH_GAIN = 3.0  # in log-likelihood: gain of a latch over a step for its second threshold
WORTH = 0.25  # of the largest gain: smaller ones are no rivals
LEAST_KEPT = 0.01  # share of the squares of a column that the fit's own parameters do not explain


@dataclass(frozen=True, eq=False)
class _Scores:
    """The residual of a fit under one noise, and the projection of a column on the fit's free parameters."""

    fit: Fit
    white: Array  # (n,), of the torque
    weight: Array
    own: Array  # (n, parameters), scaled
    solve: Array  # (parameters, parameters)
    pull: Array  # (parameters,)

    @classmethod
    def of(cls, fit: Fit, own: Array) -> _Scores:
        """Under the noises of a fit; `own` are the columns of its free parameters."""
        problem, noises = fit.problem, fit.noises
        scale, std = (np.array([getattr(f, name) for f in fit.free]) for name in ("scale", "std"))
        nominal = np.array([f.nominal for f in fit.free])
        rows = problem.white(fit.residuals, noises)
        columns = problem.white([x * scale for x in problem.split(own)], noises)
        weights = [noises[g.kind].weights(r) for r, g in zip(rows, problem.segments, strict=True)]
        y, x, w = valid_rows(rows), valid_rows(columns), valid_rows(weights)
        information = (x.T * w) @ x + np.diag((scale / std) ** 2) + 1e-9 * np.eye(len(scale))
        pull = x.T @ (w * y) - (fit.point - nominal) / std**2 * scale
        count = len(valid_rows([r for r, g in zip(rows, problem.segments, strict=True) if g.kind == "torque"]))
        return cls(fit, y[:count], w[:count], x[:count], np.asarray(np.linalg.inv(information), dtype=np.float64), pull)

    def gains(self, columns: Sequence[Array]) -> Array:
        """Gain of each column in log-likelihood, shape (columns,)."""
        noise, sessions, facts = self.fit.noise, self.fit.problem.sessions, self.fit.problem.base.facts
        direction = [np.tanh(s.speed / facts.standstill)[:, np.newaxis] for s in sessions]
        parts = [whitened(x * d, m, noise.phi) for x, d, m in zip(columns, direction, self.fit.problem.masks, strict=True)]
        x = valid_rows(parts) / noise.std
        weighted = x * self.weight[:, np.newaxis]
        taken = weighted.T @ self.own @ self.solve
        score = weighted.T @ self.white - taken @ self.pull
        whole = (weighted * x).sum(axis=0)
        left = whole - (taken * (weighted.T @ self.own)).sum(axis=1)
        return np.where(left > LEAST_KEPT * whole, 0.5 * score**2 / np.maximum(left, 1e-12), 0.0)


def found_by_scan(fit: Fit, series: dict[int, list[Array]]) -> list[EmpiricalEffect]:
    """The best step, hinge and latch of each variable, if it gains enough.

    `series` has the values of each variable in each session, by its code.
    """
    own = base_columns(fit)
    short = shortened(fit.noise)
    fits = [fit, *([] if short is None else [replace(fit, noises={**fit.noises, "torque": short})])]
    scores = [_Scores.of(one, own) for one in fits]

    def gains(columns: Sequence[Array]) -> Array:
        """Random-walk noise hides slow effects: the larger gain of both noises."""
        return np.asarray(np.max([one.gains(columns) for one in scores], axis=0))

    found: list[tuple[float, EmpiricalEffect]] = []
    for code, x in series.items():
        known = np.concatenate([one[m] for one, m in zip(x, fit.problem.masks, strict=True)])
        low, high = (float(q) for q in np.quantile(known, RANGE))
        grid = _grid(known, low, high)
        if not len(grid):
            continue
        step_gain, step_at = _best(partial(_steps, x), grid, gains)
        least = LEAST_GAIN + math.log(len(grid))
        if step_gain > least:
            found.append((step_gain, Corner(code, STEP, low, step_at, high)))
        hinges = {kind: _best(partial(_hinges, x, end), grid, gains) for kind, end in ((ABOVE, high), (BELOW, low))}
        kind = max(hinges, key=lambda one: hinges[one][0])
        if hinges[kind][0] > least:
            found.append((hinges[kind][0], Corner(code, kind, low, hinges[kind][1], high)))
        if code in LATCHED:
            latch_gain, off, on = _best_latch(x, grid, gains)
            if latch_gain > max(least, step_gain) + LATCH_GAIN:
                found.append((latch_gain, Latch(code, low, off, on, high)))
    most = max((gain for gain, _ in found), default=0.0)
    return [form for gain, form in found if gain > WORTH * most]


def _grid(known: Array, low: float, high: float) -> Array:
    """Thresholds within the driven range, with enough samples on either side."""
    levels = np.unique(known)
    if len(levels) > GRID:
        at = np.unique(np.quantile(known, np.linspace(FEWEST_BEYOND, 1.0 - FEWEST_BEYOND, GRID)))
    else:
        at = 0.5 * (levels[1:] + levels[:-1])
    share = np.array([np.mean(known > t) for t in at])
    return at[(share >= FEWEST_BEYOND) & (share <= 1.0 - FEWEST_BEYOND) & (at > low) & (at < high)]


def _finer(grid: Array, at: float) -> Array:
    """Thresholds around one of a grid, up to but excluding its neighbours."""
    i = int(np.searchsorted(grid, at))
    begin, end = grid[max(i - 1, 0)], grid[min(i + 1, len(grid) - 1)]
    return np.unique(np.append(np.linspace(begin, end, FINER + 2)[1:-1], at))


def _best(columns: Columns, grid: Array, gains: Callable[[Sequence[Array]], Array]) -> tuple[float, float]:
    """The largest gain, and its threshold."""
    best = (0.0, math.nan)
    for _ in range(PASSES):
        found = gains(columns(grid))
        i = int(np.argmax(found))
        best = float(found[i]), float(grid[i])
        grid = _finer(grid, best[1])
    return best


def _best_latch(x: Sequence[Array], grid: Array, gains: Callable[[Sequence[Array]], Array]) -> tuple[float, float, float]:
    """The largest gain, the lower threshold (off) and the upper one (on)."""
    best, offs, ons = (0.0, math.nan, math.nan), grid, grid
    for _ in range(PASSES):
        off, on = np.meshgrid(offs, ons)
        pairs = off[off < on], on[off < on]
        if not len(pairs[0]):
            break
        found = gains([latched_states(one, *pairs) for one in x])
        i = int(np.argmax(found))
        best = float(found[i]), float(pairs[0][i]), float(pairs[1][i])
        offs, ons = _finer(offs, best[1]), _finer(ons, best[2])
    return best


def _steps(series: Sequence[Array], thresholds: Array) -> list[Array]:
    return [(x[:, np.newaxis] > thresholds).astype(float) for x in series]


def _hinges(series: Sequence[Array], end: float, thresholds: Array) -> list[Array]:
    return [np.nan_to_num(np.clip((x[:, np.newaxis] - thresholds) / (end - thresholds), 0.0, 1.0)) for x in series]


def latched_states(x: Array, off: Array, on: Array) -> Array:
    """State of latches along a series, initially off, shape (n, latches); see `effects.learned.latched`."""
    set_, reset = x[:, np.newaxis] > on, ~(x[:, np.newaxis] >= off)
    row = np.arange(1, len(x) + 1)[:, np.newaxis]
    last_set, last_reset = (np.maximum.accumulate(np.where(at, row, 0), axis=0) for at in (set_, reset))
    return (last_set > last_reset).astype(float)


def most_on_side(x: Array, side: int) -> float:
    """The largest value of a sign, as a quantile of those of that sign; 0 with hardly any."""
    there = side * x[side * x > 0.0]
    return float(np.quantile(there, RANGE[1])) if len(there) > FEWEST_BEYOND * len(x) else 0.0
