# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Counts cycles after ASTM E1049-85, 5.4.4, and fills the strain rainflow matrix of equation (25)."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple


class Cycle(NamedTuple):
    """One row of the matrix: range (not amplitude), mean, number (1 or 1/2), and position in the series."""

    range: float
    mean: float
    number: float
    start: int
    end: int


def turning_points(series: Sequence[float]) -> list[int]:
    """Indices of the reversals of a series, its ends included; of a flat stretch the first sample counts."""
    points = [0] if len(series) else []
    for i in range(1, len(series)):
        step = series[i] - series[points[-1]]
        if step == 0.0:
            continue
        if len(points) > 1 and step * (series[points[-1]] - series[points[-2]]) > 0.0:
            points[-1] = i
        else:
            points.append(i)
    return points


def count_cycles(series: Sequence[float]) -> list[Cycle]:
    """Count the cycles of a series of strains; the residue at the end gives half cycles.

    Parameters
    ----------
    series
        Strains [1] in order, at least the turning points.

    References
    ----------
    ASTM E1049-85 (2017), Standard Practices for Cycle Counting in Fatigue Analysis, 5.4.4.
    """
    cycles: list[Cycle] = []

    def add(start: int, end: int, count: float) -> None:
        a, b = series[start], series[end]
        cycles.append(Cycle(abs(b - a), (a + b) / 2.0, count, start, end))

    stack: list[int] = []
    for point in turning_points(series):
        stack.append(point)
        while len(stack) >= 3:
            newest = abs(series[stack[-1]] - series[stack[-2]])
            previous = abs(series[stack[-2]] - series[stack[-3]])
            if newest < previous:
                break
            if len(stack) == 3:  # the range holds the start of the series: half a cycle
                add(stack[0], stack[1], 0.5)
                stack.pop(0)
            else:
                add(stack[-3], stack[-2], 1.0)
                del stack[-3:-1]
    for start, end in pairwise(stack):
        add(start, end, 0.5)
    return cycles


def count_loop(series: Sequence[float]) -> list[Cycle]:
    """Count the cycles of one loop of a periodic series: begun at its maximum, every cycle closes.

    The cycles' indices refer to `series`; the first sample follows again after the last.
    """
    if len(series) < 2:
        return []
    top = max(range(len(series)), key=lambda i: series[i])
    order = [(top + i) % len(series) for i in range(len(series))] + [top]
    return [cycle._replace(start=order[cycle.start], end=order[cycle.end]) for cycle in count_cycles([series[i] for i in order])]
