# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A level that changes once and stays: a replaced part, an unreleased brake, a new sensor zero.

The model of the residual's means over some seconds, in the order of the clocks: an Ornstein-Uhlenbeck drift about a level
of each recording, with white noise. A change is found if one step makes this model significantly more likely, and no second
step is as large.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from trackres_ros.diagnosis.empirical.candidates import FEWEST_SESSIONS
from trackres_ros.diagnosis.empirical.spells import Blocks
from trackres_ros.diagnosis.prepare.session import Array, Mask

PIECE_S, MOST_PIECES = 10.0, 400  # the search takes the cube of their number; longer recordings have longer pieces
SURE = 10.0  # in log-likelihood, beyond the cost of the possible positions
LEAST_SIDE, LEAST_SIDE_S = 0.1, 180.0  # least share and time of compared samples, before a change and after it
WITHIN_S = 120.0  # of its recording on either side of a change: a nearer one is between recordings
AS_LARGE = 0.5  # of a change: a larger second one means that the first did not last
AROUND = 6  # pieces on either side for the levels next to a change
FURTHEST = 2.0  # times the change: limit of a sample's influence on its time
DRIFTS_S = (20.0, 60.0, 180.0, 600.0, 3600.0)
DRIFTS = (0.3, 1.0, 3.0, 10.0)  # drift, in standard deviations of a mean's white noise
APART = (0.0, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0)  # the same: difference between recordings


@dataclass(frozen=True, slots=True)
class LevelChange:
    """A lasting level change."""

    session: int  # index
    row: int  # of the first sample after the change; 0 for a change between two recordings
    size: float  # additional torque after it [Nm]
    cost: float  # log of the number of possible positions

    def shape(self, lengths: Sequence[int]) -> list[Array]:
        """Series of 0 before the change and 1 after it, for sessions with these numbers of samples."""
        where = [self.row if i == self.session else 0 if i > self.session else n for i, n in enumerate(lengths)]
        return [(np.arange(n) >= row).astype(float) for n, row in zip(lengths, where, strict=True)]


def piece_s(seconds: float) -> float:
    """Length of the pieces [s] for recordings of this total duration."""
    return PIECE_S * max(1, math.ceil(seconds / (PIECE_S * MOST_PIECES)))


def find_change(b: Blocks, step: float) -> LevelChange | None:
    """The one lasting level change; None without one, or with several.

    `b` has means of the residual against travel over pieces of `piece_s`, from samples of `step` [s].
    """
    time = np.asarray(b.begin * step, dtype=np.float64)
    allowed = _allowed(b, step)
    if not allowed.any():
        return None
    gains, sizes = _gains(b, time)
    cost = math.log(allowed.sum())
    at = int(np.argmax(np.where(allowed, gains, -np.inf)))
    if gains[at] - cost < SURE:
        return None
    after = (np.arange(len(time)) >= at).astype(float)
    others, other_sizes = _gains(replace(b, mean=b.mean - sizes[at] * after), time)
    near = (b.session == b.session[at]) & (np.abs(time - time[at]) < WITHIN_S)
    again = ~near & (others - cost > SURE) & (np.abs(other_sizes) > AS_LARGE * abs(sizes[at]))
    if again.any():
        return None
    return LevelChange(int(b.session[at]), 0 if b.first[at] else int(b.begin[at]), float(sizes[at]), cost)


def sharpened(change: LevelChange, residual: Array, mask: Mask, length: int) -> LevelChange:
    """Sample of the change that best splits the residual, within a piece to either side.

    `residual` and `mask` are those of the session with the change, against travel; `length` is that of a piece, in samples.
    """
    if change.row == 0:
        return change
    window = slice(max(change.row - length, 1), change.row + length)
    known = np.where(mask, residual, np.nan)
    around = AROUND * length
    sides = [side[np.isfinite(side)] for side in (known[: change.row], known[change.row :])]
    middle = 0.5 * float(np.median(sides[0][-around:]) + np.median(sides[1][:around]))
    above = np.clip(np.nan_to_num((known[window] - middle) / change.size), -FURTHEST, FURTHEST)
    after = np.cumsum(above[::-1])[::-1]
    return replace(change, row=window.start + int(np.argmax(after)))


def _allowed(b: Blocks, step: float) -> Mask:
    """Pieces that may start another level: with enough on either side, of its own recording or of many others."""
    time, before, total = b.begin * step, np.cumsum(b.count) - b.count, b.count.sum()
    least = max(LEAST_SIDE * total, LEAST_SIDE_S / step)
    begins, ends = (np.array([limit(time[b.session == s]) for s in b.session]) for limit in (np.min, np.max))
    within = (time - begins >= WITHIN_S) & (ends - time >= WITHIN_S)
    between = b.first & (len(np.unique(b.session)) >= FEWEST_SESSIONS)
    return np.asarray((before >= least) & (total - before >= least) & (within | between))


def _gains(b: Blocks, time: Array) -> tuple[Array, Array]:
    """Gain in log-likelihood of a step at each piece over none, each with its best noise; and the steps [Nm].

    Sessions are independent; a separate level adds a rank of one to the covariance of each.
    """
    n = len(time)
    sessions = [np.flatnonzero(b.session == s) for s in np.unique(b.session)]
    white = np.mean(b.count) / b.count
    y = b.mean - np.average(b.mean, weights=b.count)
    without, with_step, sizes = -np.inf, np.full(n, -np.inf), np.zeros(n)
    apart = APART if len(sessions) > 1 else (0.0,)
    for size, seconds in [(0.0, DRIFTS_S[0]), *((w, s) for w in DRIFTS for s in DRIFTS_S)]:
        sums = [_sums(y[rows], time[rows], white[rows], size, seconds) for rows in sessions]
        for between in apart:
            parts = [_with_own_level(s, between**2) for s in sums]
            yy, y1, ones, logdet = (math.fsum(p[i] for p in parts) for i in range(4))
            like = -0.5 * (n * math.log(max(yy - y1**2 / ones, 1e-12)) + logdet)
            without = max(without, like)
            later = [[math.fsum(p[k] for p in parts[i + 1 :]) for k in (1, 2, 2)] for i in range(len(parts))]
            a, one, c = (np.concatenate([p[4 + k] + rest[k] for p, rest in zip(parts, later, strict=True)]) for k in range(3))
            across, own = a - one * y1 / ones, np.maximum(c - one**2 / ones, 1e-12)
            left = np.maximum(yy - y1**2 / ones - across**2 / own, 1e-12)
            likes = -0.5 * (n * np.log(left) + logdet)
            better = likes > with_step
            with_step, sizes = np.where(better, likes, with_step), np.where(better, across / own, sizes)
    return with_step - without, sizes


class _Sums(NamedTuple):
    """Of one session, with the inverse covariance C: of its means y, of ones, and of steps s from each piece on."""

    yy: float
    y1: float
    ones: float
    logdet: float  # of the covariance
    sy: Array
    s1: Array
    ss: Array


def _sums(y: Array, time: Array, white: Array, size: float, seconds: float) -> _Sums:
    """From the tridiagonal inverse covariance of the drift."""
    after = np.tril(np.ones((len(y), len(y)))) / white[:, np.newaxis]
    weighted, of_steps, logdet = y / white, after, float(np.log(white).sum())
    if size > 0.0:
        keep = np.exp(-np.diff(time) / seconds)
        fresh = size**2 * np.concatenate(([1.0], 1.0 - keep**2))
        diagonal = 1.0 / fresh + 1.0 / white
        diagonal[:-1] += keep**2 / fresh[1:]
        factor = cholesky_banded(np.stack([np.concatenate(([0.0], -keep / fresh[1:])), diagonal]))
        logdet += float(np.log(fresh).sum()) + 2.0 * float(np.log(factor[1]).sum())
        solved = cho_solve_banded((factor, False), np.column_stack([weighted, after])) / white[:, np.newaxis]
        weighted, of_steps = weighted - solved[:, 0], after - solved[:, 1:]
    s1, ss = of_steps.sum(axis=0), (of_steps * after * white[:, np.newaxis]).sum(axis=0)
    return _Sums(float(y @ weighted), float(weighted.sum()), float(s1[0]), logdet, np.cumsum(weighted[::-1])[::-1], s1, ss)


def _with_own_level(s: _Sums, variance: float) -> _Sums:
    """The same for a session level of the given variance."""
    grown = 1.0 + variance * s.ones
    share = variance / grown
    return _Sums(
        s.yy - share * s.y1**2, s.y1 / grown, s.ones / grown, s.logdet + math.log(grown),
        s.sy - share * s.s1 * s.y1, s.s1 / grown, s.ss - share * s.s1**2,
    )  # fmt: skip
