# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Joins values by cubics without scipy, which takes longer to load than a loss table takes to build."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from trackres_ros.arrays import Array

STEEPEST_END = 3.0  # of a monotone cubic's slope at its end, over that of the line to the next value


def thinned(count: int, each: int) -> Array:
    """Whole numbers 1 to `count`, of large ones so many that there are `each` for a factor e."""
    found = [1]
    while found[-1] < count:
        found.append(min(count, found[-1] + max(1, found[-1] // each)))
    return np.array(found, float)


def cubic_weights(nodes: Array, at: Array) -> Array:
    """Weights of values at rising nodes, four or more, in the values at others, shape (at, nodes).

    Each is joined by Lagrange's cubic through the four nodes about it.
    """
    places = np.clip(np.searchsorted(nodes, at, side="right") - 2, 0, len(nodes) - 4)[:, np.newaxis] + np.arange(4)
    four = nodes[places]
    weights = np.ones(four.shape)
    for one in range(4):
        for other in set(range(4)) - {one}:
            weights[:, one] *= (at - four[:, other]) / (four[:, one] - four[:, other])
    found = np.zeros((len(at), len(nodes)))
    np.put_along_axis(found, places, weights, axis=1)
    return found


class MonotoneCubic:
    """Values joined by cubics that rise and fall only where the values do: at least three values at rising nodes.

    Notes
    -----
    The slope in a node is the harmonic mean of the slopes on its two sides, weighted by their lengths; 0 at an extreme. At an
    end it is that of the parabola through three values, as long as it keeps to the sense of the outer line.

    References
    ----------
    F. N. Fritsch and J. Butland, A method for constructing local monotone piecewise cubic interpolants, SIAM J. Sci. Stat.
    Comput. 5 (1984) 300-304; as scipy's PchipInterpolator.
    """

    def __init__(self, nodes: Array, values: Array) -> None:
        length = np.diff(nodes)
        line = np.diff(values) / length
        slope = np.concatenate([[_end(length, line)], _inner(length, line), [_end(length[::-1], line[::-1])]])
        third = (slope[:-1] + slope[1:] - 2.0 * line) / length
        self._nodes = nodes
        self._coefficients = values[:-1], slope[:-1], (line - slope[:-1]) / length - third, third / length

    def __call__(self, at: ArrayLike) -> Array:
        """Values at others, same shape; beyond the ends by the outer cubics."""
        given = np.asarray(at, float)
        piece = np.searchsorted(self._nodes[1:-1], given, side="right")
        along = given - self._nodes[piece]
        first, second, third, fourth = (coefficient[piece] for coefficient in self._coefficients)
        return np.asarray(first + along * (second + along * (third + along * fourth)))


def _inner(length: Array, line: Array) -> Array:
    """Slopes in the inner nodes."""
    weight, other = 2.0 * length[1:] + length[:-1], length[1:] + 2.0 * length[:-1]
    turns = line[:-1] * line[1:] <= 0.0
    before, after = (np.where(turns, 1.0, side) for side in (line[:-1], line[1:]))
    return np.where(turns, 0.0, (weight + other) / (weight / before + other / after))


def _end(length: Array, line: Array) -> float:
    """Slope in the first node."""
    slope = float(((2.0 * length[0] + length[1]) * line[0] - length[0] * line[1]) / (length[0] + length[1]))
    if slope * line[0] <= 0.0:
        return 0.0
    steepest = STEEPEST_END * float(line[0])
    return steepest if line[0] * line[1] < 0.0 and abs(slope) > abs(steepest) else slope
