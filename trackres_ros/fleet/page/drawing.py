# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Draws a parameter of a vehicle over the months, as inline SVG: no script, no separate file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from trackres_ros.fleet.trends import day_of
from trackres_ros.text.numbers import alike, figures

WIDTH, HEIGHT = 720.0, 220.0
LEFT, RIGHT, TOP, BOTTOM = 105.0, 12.0, 12.0, 28.0
TICKS = 4


def drawn(levels: Sequence[Sequence[float]], name: str, unit: str, changes: Sequence[Mapping[str, Any]]) -> str:
    """Values with their standard deviations over time, and the begin of changes.

    `levels`: times [s since 1970], values and standard deviations; `changes`: of this parameter.
    """
    time, value, std = (np.array(series) for series in levels)
    if not len(time):
        return ""
    low, high = _range(value, std)
    begin, end = float(time.min()), float(max(time.max(), time.min() + 86400.0))

    def x(at: float) -> float:
        return LEFT + (WIDTH - LEFT - RIGHT) * (at - begin) / (end - begin)

    def y(at: float) -> float:
        return TOP + (HEIGHT - TOP - BOTTOM) * (high - min(max(at, low), high)) / (high - low)

    parts = []
    ticks = np.linspace(low, high, TICKS)
    for at, text in zip(ticks, alike([float(t) for t in ticks], (high - low) / TICKS), strict=True):
        parts.append(f'<line class="grid" x1="{LEFT:g}" x2="{WIDTH - RIGHT:g}" y1="{y(at):.1f}" y2="{y(at):.1f}"/>')
        parts.append(f'<text x="{LEFT - 6:g}" y="{y(at) + 4:.1f}" text-anchor="end">{text}</text>')
    for at, anchor in ((begin, "start"), (0.5 * (begin + end), "middle"), (end, "end")):
        parts.append(f'<text x="{x(at):.1f}" y="{HEIGHT - 8:g}" text-anchor="{anchor}">{day_of(at)}</text>')
    for t, v, s in zip(time, value, std, strict=True):
        title = f"{day_of(t)}: {figures(v, 4)} +- {figures(s, 2)} {unit if unit != '1' else ''}"
        parts.append(f'<line class="bar" x1="{x(t):.1f}" x2="{x(t):.1f}" y1="{y(v - s):.1f}" y2="{y(v + s):.1f}"/>')
        parts.append(f'<circle cx="{x(t):.1f}" cy="{y(v):.1f}" r="3"><title>{escape(title.strip())}</title></circle>')
    for change in changes:
        at = x(max(change["since_s"], begin))
        parts.append(f'<line class="change" x1="{at:.1f}" x2="{at:.1f}" y1="{TOP:g}" y2="{HEIGHT - BOTTOM:g}"/>')
    label = f"{name} over time, from {day_of(begin)} to {day_of(end)}: {figures(float(value[0]))} to {figures(float(value[-1]))}"
    return f'<svg viewBox="0 0 {WIDTH:g} {HEIGHT:g}" role="img" aria-label="{escape(label)}">{"".join(parts)}</svg>'


def _range(value: np.ndarray, std: np.ndarray) -> tuple[float, float]:
    """Range of the axis: all values except outliers."""
    low, high = (float(np.quantile(ends, q)) for ends, q in ((value - std, 0.02), (value + std, 0.98)))
    margin = 0.15 * max(high - low, 1e-9 + 0.02 * abs(high))
    return low - margin, high + margin
