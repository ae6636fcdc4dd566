# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Unnamed candidate forms of a mismatch over a variable, and the thresholds that a scan of the residual finds for them.

Steps, hinges, latches and fades are found by linear algebra on block means of a residual. Each threshold of a grid makes a
column. The best one of each variable and form becomes a candidate; laps and recordings left out judge it like any other.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from trackres_ros.diagnosis.base.patterns import FADE, ClockTerm
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.prepare.session import Array, DriveSession
from trackres_ros.diagnosis.selection.level_errors import FURTHEST, Levels
from trackres_ros.effects import learned
from trackres_ros.effects.effect import Conditions
from trackres_ros.effects.learned import ABOVE, BELOW, LATCHED, STEP, Corner, Curve, EmpiricalEffect, Latch, SidedGain
from trackres_ros.units import STANDSTILL_MPS

Columns = Callable[[Array], list[Array]]
"""Columns of each session for thresholds, shape (n, thresholds)."""

RANGE = (0.02, 0.98)  # quantiles: both ends of the driven range
GRID = 15  # thresholds at first
FINER, PASSES = 5, 3  # then so many between the neighbours of the best
FEWEST_BEYOND = 0.03  # share of the samples on either side of a threshold
LEAST_KEPT = 0.01  # share of the squares of a column that the fit's own parameters do not explain
LONG_STOP_S = 20.0  # a stop after which oil has run off, a belt has set and a brake has been applied


SizedForms = list[tuple[EmpiricalEffect | ClockTerm, Array]]
"""Forms, each with its torque in all sessions per unit of its size, shape (n,)."""


def scanned_forms(fit: Fit, levels: Levels, series: Mapping[int, list[Array]]) -> SizedForms:
    """The best step, hinges and latch of each variable; `series` has its values in each session, by its code."""
    scan, forms = _Scan(fit, levels), SizedForms()
    for code, x in series.items():
        grid, low, high = scan.grid(x)
        if not len(grid):
            continue
        for kind in (STEP, ABOVE, BELOW):
            gain, threshold = scan.best(partial(shapes, kind, x, (low, high)), grid)
            if gain > 0.0:
                forms.append(
                    (Corner(code, kind, low, threshold, high), scan.project(shapes(kind, x, (low, high), np.array([threshold]))))
                )
        if code in LATCHED:
            gain, off_value, on_value = scan.best_latch(x, grid)
            if gain > 0.0:
                states = [latched_states(values, np.array([off_value]), np.array([on_value])) for values in x]
                forms.append((Latch(code, low, off_value, on_value, high), scan.project(states)))
    return forms


def clock_forms(fit: Fit, levels: Levels) -> SizedForms:
    """The best step, hinge and fade over each variable of the clock."""
    scan, forms = _Scan(fit, levels), SizedForms()
    facts, sessions = fit.problem.base.facts, fit.problem.sessions
    ends = np.cumsum([len(s) for s in sessions])[:-1]
    for variable, values_of in CLOCKS.items():
        x = [values_of(s) for s in sessions]
        grid, low, high = scan.grid(x)
        if not len(grid):
            continue
        for kind in (STEP, ABOVE, BELOW, FADE):
            thresholds = grid if kind != FADE else np.geomspace(max(grid[0], 0.01 * high), high, GRID)
            gain, threshold = scan.best(partial(shapes, kind, x, (low, high)), thresholds)
            if gain > 0.0:
                rows = scan.project(shapes(kind, x, (low, high), np.array([threshold])))
                size = facts.weight * facts.radius
                forms.append((ClockTerm(variable, kind, threshold, (low, high), np.split(rows, ends), size), rows))
    return forms


def time_since_long_stop(session: DriveSession) -> Array:
    """Time since the end of the last stop of at least `LONG_STOP_S` [s]; the start of a recording ends one."""
    standstill = np.abs(np.nan_to_num(session.speed)) < STANDSTILL_MPS
    seconds_since, stop_s = np.empty(len(session)), math.inf
    seconds = 0.0
    for i, is_still in enumerate(standstill.tolist()):
        stop_s = stop_s + session.step if is_still else 0.0
        seconds = 0.0 if stop_s >= LONG_STOP_S else seconds + session.step
        seconds_since[i] = seconds
    return seconds_since


CLOCKS: Mapping[str, Callable[[DriveSession], Array]] = {
    "time since start": lambda s: s.time,
    "time since a long stop": time_since_long_stop,
    "distance": lambda s: s.distance,
}
"""Variables that no sensor shows, but the clock and the odometer."""


def shapes(kind: int, series: Sequence[Array], ends: tuple[float, float], thresholds: Array) -> list[Array]:
    """Columns of a step, a hinge or a fade for thresholds or scales, shape (n, thresholds) in each session."""
    low, high = ends
    columns = []
    for x in series:
        values = x[:, np.newaxis]
        if kind == STEP:
            column = (values > thresholds).astype(float)
        elif kind == ABOVE:
            column = np.clip((values - thresholds) / (high - thresholds), 0.0, 1.0)
        elif kind == BELOW:
            column = np.clip((thresholds - values) / (thresholds - low), 0.0, 1.0)
        else:
            column = np.exp(-np.maximum(values - low, 0.0) / thresholds)
        columns.append(np.nan_to_num(column))
    return columns


class _Scan:
    """Gains of columns on the block means of a residual, beyond the base's own columns."""

    def __init__(self, fit: Fit, levels: Levels) -> None:
        self._levels, self._masks = levels, fit.problem.masks
        self._rest = np.clip(levels.beyond(levels.residual), -FURTHEST, FURTHEST)
        self._direction = [np.tanh(s.speed / fit.problem.base.facts.standstill) for s in fit.problem.sessions]

    def grid(self, series: Sequence[Array]) -> tuple[Array, float, float]:
        """Thresholds within the driven range with enough samples on either side, and both ends of that."""
        used_values = np.concatenate([x[m] for x, m in zip(series, self._masks, strict=True)])
        if not len(used_values) or not np.isfinite(used_values).all():
            return np.empty(0), math.nan, math.nan
        low, high = (float(q) for q in np.quantile(used_values, RANGE))
        levels = np.unique(used_values)
        if len(levels) > GRID:
            thresholds = np.unique(np.quantile(used_values, np.linspace(FEWEST_BEYOND, 1.0 - FEWEST_BEYOND, GRID)))
        else:
            thresholds = 0.5 * (levels[1:] + levels[:-1])
        share = np.array([np.mean(used_values > t) for t in thresholds])
        is_inside = (share >= FEWEST_BEYOND) & (share <= 1.0 - FEWEST_BEYOND) & (thresholds > low) & (thresholds < high)
        return thresholds[is_inside], low, high

    def project(self, columns: Sequence[Array]) -> Array:
        """A single column as a torque against travel, all sessions concatenated, shape (n,)."""
        return np.concatenate([c[:, 0] * d for c, d in zip(columns, self._direction, strict=True)])

    def gains(self, columns: Sequence[Array]) -> Array:
        """Square of the block scatter that each column explains, shape (columns,)."""
        z = self._levels.means(np.concatenate([c * d[:, np.newaxis] for c, d in zip(columns, self._direction, strict=True)]))
        remainder = self._levels.beyond(z)
        size, remainder_size = (z**2).sum(axis=0), (remainder**2).sum(axis=0)
        return np.where(
            remainder_size > LEAST_KEPT * size, (remainder.T @ self._rest) ** 2 / np.maximum(remainder_size, 1e-12), 0.0
        )

    def best(self, columns: Columns, grid: Array) -> tuple[float, float]:
        """The largest gain, and its threshold."""
        best_pair = (0.0, math.nan)
        for _ in range(PASSES):
            gains = self.gains(columns(grid))
            i = int(np.argmax(gains))
            best_pair = float(gains[i]), float(grid[i])
            grid = _finer(grid, best_pair[1])
        return best_pair

    def best_latch(self, series: Sequence[Array], grid: Array) -> tuple[float, float, float]:
        """The largest gain, the lower threshold (off) and the upper one (on)."""
        best_latch_values, off_values, on_values = (0.0, math.nan, math.nan), grid, grid
        for _ in range(PASSES):
            off_grid, on_grid = np.meshgrid(off_values, on_values)
            pairs = off_grid[off_grid < on_grid], on_grid[off_grid < on_grid]
            if not len(pairs[0]):
                break
            gains = self.gains([latched_states(x, *pairs) for x in series])
            i = int(np.argmax(gains))
            best_latch_values = float(gains[i]), float(pairs[0][i]), float(pairs[1][i])
            off_values, on_values = _finer(off_values, best_latch_values[1]), _finer(on_values, best_latch_values[2])
        return best_latch_values


def _finer(grid: Array, threshold: float) -> Array:
    """Thresholds around one of a grid, up to but excluding its neighbours."""
    i = int(np.searchsorted(grid, threshold))
    begin, end = grid[max(i - 1, 0)], grid[min(i + 1, len(grid) - 1)]
    return np.unique(np.append(np.linspace(begin, end, FINER + 2)[1:-1], threshold))


def latched_states(x: Array, off_values: Array, on_values: Array) -> Array:
    """State of latches along a series, initially off, shape (n, latches); see `effects.learned.latch_state`."""
    set_, reset = x[:, np.newaxis] > on_values, ~(x[:, np.newaxis] >= off_values)
    row = np.arange(1, len(x) + 1)[:, np.newaxis]
    last_set, last_reset = (np.maximum.accumulate(np.where(event, row, 0), axis=0) for event in (set_, reset))
    return (last_set > last_reset).astype(float)


def most_on_side(x: Array, side: int) -> float:
    """The largest value of a sign, as a quantile of those of that sign; 0 with hardly any."""
    values = side * x[side * x > 0.0]
    return float(np.quantile(values, RANGE[1])) if len(values) > FEWEST_BEYOND * len(x) else 0.0


DRIVEN = (0.02, 0.98)  # quantiles that bound the knots
KNOTS = {
    learned.SPEED: 5, learned.LOAD: 3, learned.AMBIENT: 2, learned.TURNING: 3, learned.CURVATURE: 3, learned.ACCELERATION: 4,
    learned.TURN: 4, learned.DRIVING_TORQUE: 4, learned.BELT: 3,
}  # fmt: skip
SIGNED = (learned.ACCELERATION, learned.TURN, learned.DRIVING_TORQUE)
BOTH_SIDES = 0.05  # least share of a signed variable on its rarer side to use both
NEAR_ZERO = 0.1  # of the range on a side: between these knots a signed curve may step
RESOLVED = 6.0  # times its noise: nearer zero a smoothed acceleration reflects the smoothing more than the drive
LEAST_RANGE = 0.02  # of its size: a smaller variation is constant
FEWEST_REVERSE = 60  # samples in reverse


def series(code: int, fit: Fit) -> list[Array]:
    """A variable of learned effects in each session of a fit, as in the live step."""
    facts, values = fit.problem.base.facts, []
    for s, p in zip(fit.problem.sessions, fit.predicted, strict=True):
        turn_rate = np.abs(s.yaw_rate)
        curvature = turn_rate / np.hypot(s.speed, facts.contact_length * turn_rate + STANDSTILL_MPS)
        recorded_series: Any = s.speed, s.accel, s.weight, s.ambient, s.yaw_rate, s.heading, s.distance
        simulated_series: Any = p.at_sprockets, np.tanh(s.speed / facts.standstill), curvature, p.belt
        conditions = Conditions(facts, *recorded_series, *simulated_series)
        values.append(np.asarray(np.broadcast_to(learned.variable(conditions, code), len(s)), dtype=float))
    return values


def driving_series(code: int, fit: Fit) -> Array:
    """Values of the variable at compared samples; empty if it is not always known, or too imprecise."""
    values = np.concatenate([x[m] for x, m in zip(series(code, fit), fit.problem.masks, strict=True)])
    is_known = np.isfinite(values).all() and (code not in (learned.ACCELERATION, learned.DRIVING_TORQUE) or _resolved(fit))
    return values if is_known else np.empty(0)


def _resolved(fit: Fit) -> bool:
    """Whether the acceleration is precise where its curve may step: smoothing errors look like such a curve."""
    noise = max(s.accel_noise for s in fit.problem.sessions)
    largest_accel = max(float(np.quantile(np.abs(s.accel), DRIVEN[1])) for s in fit.problem.sessions)
    return RESOLVED * noise <= NEAR_ZERO * largest_accel


def varies(x: Array) -> bool:
    """Whether a variable varies enough for a curve."""
    if len(x) == 0:
        return False
    low, high = np.quantile(x, DRIVEN)
    return bool(high - low > LEAST_RANGE * max(abs(low), abs(high)))


def knots(code: int, x: Array, count: int) -> list[float]:
    """Knots of a curve: equally filled between, or close on either side of zero for a signed variable."""
    low, high = (float(q) for q in np.quantile(x, DRIVEN))
    if code in SIGNED and min(np.mean(x < 0.0), np.mean(x > 0.0)) > BOTH_SIDES:
        inner_edge = NEAR_ZERO * min(-low, high)
        extra_count = max(0, (count - 4) // 2)
        lower_knots = np.linspace(low, -inner_edge, extra_count + 2)
        above = np.linspace(inner_edge, high, extra_count + 2)
        return [*lower_knots.tolist(), *above.tolist()]
    even_knots = np.quantile(x, np.linspace(*DRIVEN, count))
    if code == learned.SPEED:  # for rarely driven speeds: half by frequency, half by distance
        even_knots = 0.5 * (even_knots + np.linspace(low, high, count))
    kept_knots = [float(even_knots[0])]
    for knot in even_knots[1:].tolist():
        if knot - kept_knots[-1] > LEAST_RANGE * (high - low):
            kept_knots.append(knot)
    return kept_knots


def variable_codes(fit: Fit) -> list[int]:
    """Codes of the variables that a form may follow here.

    Notes
    -----
    A curve over an acceleration derived from speeds shows their error: at a steady speed, the apparent acceleration
    is error, and its inertia is not in the torque. So such a curve needs a measured acceleration. A curve over the driving
    torque, which includes that inertia, needs a small error.
    """
    measured = all("accel" in s.given for s in fit.problem.sessions)
    return [code for code in KNOTS if varies(driving_series(code, fit)) and (code != learned.ACCELERATION or measured)]


def candidates(fit: Fit) -> dict[str, EmpiricalEffect]:
    """All forms with knots of their own here, by their names."""
    facts = fit.problem.base.facts
    forms: list[EmpiricalEffect] = []
    x = {code: driving_series(code, fit) for code in learned.VARIABLES}
    codes = variable_codes(fit)
    forms += [Curve(code, knots(code, x[code], KNOTS[code])) for code in codes]
    if learned.DRIVING_TORQUE in codes:
        limits = {side: most_on_side(x[learned.DRIVING_TORQUE], side) for side in (learned.DRIVES, learned.BRAKES)}
        reverse = np.concatenate([s.speed[m] < 0.0 for s, m in zip(fit.problem.sessions, fit.problem.masks, strict=True)])
        if reverse.sum() >= FEWEST_REVERSE:  # forwards, a negative torque brakes
            limits[learned.NEGATIVE] = most_on_side(np.where(reverse, 1.0, -1.0) * x[learned.DRIVING_TORQUE], 1)
        forms += [SidedGain(side, largest_torque) for side, largest_torque in limits.items() if min(limits.values()) > 0.0]
    size = facts.weight * facts.radius
    return {effect.name: learned.sized_effect(effect, size) for effect in forms}
