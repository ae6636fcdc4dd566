# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Finds lasting level changes of a residual: another ground, a new load, a failed part."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from trackres_ros.diagnosis.empirical.torque import torque_residuals
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.prepare.session import Array

PIECE_S, MOST_PIECES = 30.0, 400  # the search time grows with their number squared; longer recordings have longer pieces
SHORTEST_PIECES = 4
COST_OF_A_CHANGE = 3.0  # times the logarithm of the number of pieces: for position, size, and the possible positions


@dataclass(frozen=True, slots=True)
class Change:
    """A time in a recording [s], and the mean residuals of the segments before and after it [Nm]."""

    recording: str
    time: float
    before: float
    after: float


def changes(found: Fit) -> list[Change]:
    """Change points of the torque residual in each recording, by means of the whitened one over the std of such a mean."""
    listed = []
    sessions, masks = found.problem.sessions, found.problem.masks
    of_torque = found.white[: len(sessions)], torque_residuals(found)
    for session, mask, white, residual in zip(sessions, masks, *of_torque, strict=True):
        valid = np.isfinite(white)
        shortest = PIECE_S * session.pace
        length = shortest * max(1, -(-int(session.time[-1] // shortest + 1) // MOST_PIECES))
        piece = (session.time // length).astype(int)
        count = np.bincount(piece[valid], minlength=piece[-1] + 1)
        there = count > 0
        if there.sum() < 2 * SHORTEST_PIECES:
            continue
        influence = white[valid] * found.noise.weights(white[valid])
        level = np.bincount(piece[valid], weights=influence, minlength=len(count))[there] / np.sqrt(count[there])
        penalty = COST_OF_A_CHANGE * math.log(len(level))
        starts = np.flatnonzero(there)
        edges = [0.0, *(length * starts[first] for first in segments(level, penalty)), np.inf]
        means = [float(residual[mask & (session.time >= a) & (session.time < b)].mean()) for a, b in pairwise(edges)]
        listed += [Change(session.name, float(t), *levels) for t, levels in zip(edges[1:-1], pairwise(means), strict=True)]
    return listed


def segments(level: Array, penalty: float) -> list[int]:
    """First index of each segment after the first one, of the split into constant segments with the least squares.

    A segment has at least `SHORTEST_PIECES` levels and costs `penalty` more. Exact, by dynamic programming (Jackson et al., IEEE
    Signal Processing Letters 12 (2005) 105, "An algorithm for optimal partitioning of data on an interval").
    """
    sums, squares = (np.concatenate(([0.0], np.cumsum(level**power))) for power in (1, 2))
    cost, first = np.full(len(sums), np.inf), np.zeros(len(sums), int)
    cost[0] = 0.0
    for end in range(SHORTEST_PIECES, len(sums)):
        begin = np.arange(end - SHORTEST_PIECES + 1)
        total = cost[begin] + squares[end] - squares[begin] - (sums[end] - sums[begin]) ** 2 / (end - begin) + penalty
        first[end] = int(total.argmin())
        cost[end] = total[first[end]]
    found = [int(first[-1])]
    while found[-1]:
        found.append(int(first[found[-1]]))
    return found[-2::-1]
