# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Linear least squares within bounds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.prepare.session import Array

TURNS = 4  # of the values that stay at a bound


def bounded(matrix: Array, right: Array, low: Array, high: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Solution of a positive definite system within bounds, and which values are free: one that hits a bound stays there.

    Clipping the free solution instead would leave the others where they fit values outside the bounds.
    """
    free, values = np.ones(len(right), dtype=bool), np.zeros(len(right))
    for _ in range(TURNS):
        values[free] = np.linalg.solve(matrix[np.ix_(free, free)], right[free] - matrix[np.ix_(free, ~free)] @ values[~free])
        outside = (values < low) | (values > high)
        values = np.clip(values, low, high)
        if not outside[free].any():
            break
        free &= ~outside
    return values, free
