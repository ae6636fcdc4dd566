# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Finds where a series holds nothing that was measured: long gaps, and gaps that were filled with straight lines."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from trackres_ros.diagnosis.prepare.session import Array, Mask

FEWEST_FILLED, SHORTEST_FILLED_S = 5, 3.0
EXACT = 1e-6  # of the largest values: as exact as six digits are written
LONGEST_UNKNOWN_S, UNUSUAL_SPACING = 5.0, 10.0  # of a slope, and times its usual spacing
FEWEST_FOR_SPACING = 100


def straight_spans(at: Array, value: Array) -> list[tuple[float, float]]:
    """Spans [s] in which a series is exactly a straight line that rises or falls: no sensor gives that, a filled gap does."""
    step, rise = np.diff(at), np.diff(value)
    if len(step) < FEWEST_FILLED:
        return []
    slope = rise / step
    exact = EXACT * max(float(np.percentile(np.abs(value), 99.0)), 1e-12)
    bends = np.abs(slope[1:] - slope[:-1]) * np.minimum(step[1:], step[:-1]) > exact
    ends = np.flatnonzero(np.concatenate(([True], bends, [True])))
    return [
        (float(at[a]), float(at[b]))
        for a, b in pairwise(ends.tolist())
        if b - a >= FEWEST_FILLED and at[b] - at[a] >= SHORTEST_FILLED_S and abs(value[b] - value[a]) > 100.0 * exact
    ]


def steps_without_value(at: Array, edges: Array) -> Mask:
    """Steps in a gap of a series that is long beside its usual spacing, or before or after all of it by as much."""
    if len(at) < FEWEST_FOR_SPACING:
        return np.zeros(len(edges) - 1, dtype=bool)
    longest = max(LONGEST_UNKNOWN_S, UNUSUAL_SPACING * float(np.median(np.diff(at))))
    around = np.concatenate(([edges[0] - 0.5 * longest], at, [edges[-1] + 0.5 * longest]))
    gaps = np.flatnonzero(np.diff(around) > longest)
    return steps_within([(float(around[i]), float(around[i + 1])) for i in gaps], edges)


def steps_within(spans: Sequence[tuple[float, float]], edges: Array) -> Mask:
    """Steps that a span reaches into."""
    inside = np.zeros(len(edges) - 1, dtype=bool)
    for begin, end in spans:
        inside |= (edges[:-1] < end) & (edges[1:] > begin)
    return inside
