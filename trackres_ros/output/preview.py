# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Keeps a preview of results that pass by in blocks: the last row, and a thinned series for a picture."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from trackres_ros.arrays import Array
from trackres_ros.estimator.records import Steps
from trackres_ros.units import NANOSECOND

LONGEST_STEP_S, UNUSUAL = 1.0, 5.0  # or that many times the usual: data of a longer step are unknown
HEAD = 1  # columns of a picture row before the results: the time
PICTURE_SAMPLES = 8000  # kept for the picture; twice as many are thinned to half


def longest_step(time_s: NDArray[np.float64]) -> float:
    """Longest time between two rows [s] that is no gap: after a gap the data before it say nothing."""
    return max(LONGEST_STEP_S, UNUSUAL * float(np.median(np.diff(time_s, prepend=time_s[:1]))))


def picture_columns(columns: Sequence[str], picture: Array) -> dict[str, Array]:
    """The series of a picture by column name; its first column is the time."""
    return {name: picture[:, HEAD + i] for i, name in enumerate(columns)}


class ResultPreview:
    """Stored part of passing results: the last row, and every n-th row for the picture.

    n doubles when needed, so a picture of any length costs the same memory.
    """

    def __init__(self, columns: int) -> None:
        self.steps, self.first_ns = 0, 0
        self.last = np.empty(0)
        self.samples = np.empty((0, HEAD + columns))
        self._stride = 1

    def take(self, steps: Steps, write: Callable[[Steps], None] | None) -> None:
        """Take the results of a block, and hand them on."""
        number = len(steps.rows)
        if not number:
            return
        if not self.steps:
            self.first_ns = int(steps.stamp_ns[0])
        rows = np.arange(-self.steps % self._stride, number, self._stride)
        time_s = (steps.stamp_ns[rows] - self.first_ns) * NANOSECOND
        self.samples = np.concatenate([self.samples, np.column_stack([time_s, steps.rows[rows]])])
        while len(self.samples) > 2 * PICTURE_SAMPLES:
            self.samples, self._stride = self.samples[::2], 2 * self._stride
        self.steps += number
        self.last = steps.rows[-1].copy()
        if write:
            write(steps)
