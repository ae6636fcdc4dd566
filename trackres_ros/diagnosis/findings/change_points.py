# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Finds lasting level changes of a residual: another ground, a new load, a failed part."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.empirical.torque import torque_residuals
from trackres_ros.diagnosis.inference.fitting import Fit

Array = NDArray[np.float64]

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


def changes(found: Fit) -> list[Change] | None:
    """Change points of the torque residual in each recording; None where `ruptures` is not installed.

    Notes
    -----
    Pruned exact linear time (PELT) on the means of the whitened residual, in standard deviations of such a mean.
    """
    try:
        from ruptures import Pelt
    except ImportError:
        return None
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
        ends = Pelt(model="l2", min_size=SHORTEST_PIECES, jump=1).fit(level).predict(pen=penalty)
        starts = np.flatnonzero(there)
        edges = [0.0, *(length * starts[end] for end in ends[:-1]), np.inf]
        means = [float(residual[mask & (session.time >= a) & (session.time < b)].mean()) for a, b in pairwise(edges)]
        listed += [Change(session.name, float(t), *levels) for t, levels in zip(edges[1:-1], pairwise(means), strict=True)]
    return listed
