# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Draws two compared results in one picture."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from trackres_ros.output.style import write_figure

COLOURS = "#0072B2", "#D55E00"
TWO_SIDED_95 = 1.96


def draw_overlay(found: Mapping[str, Any], path: Path) -> Path:
    """Each parameter of both with its 95 % interval, over how sure the difference is."""
    from matplotlib.figure import Figure

    listed = found["parameters"]
    figure = Figure(figsize=(8.0, 1.4 + 0.45 * len(listed)), layout="constrained")
    axes = figure.subplots()
    for row, q in enumerate(listed):
        unit = q["difference_std"] or abs(q["difference"]) or 1.0
        middle = 0.5 * (q["one"] + q["other"])
        for side, (which, colour) in enumerate(zip(("one", "other"), COLOURS, strict=True)):
            label = found[which] if row == 0 else None
            spread = TWO_SIDED_95 * q[f"{which}_std"] / unit
            axes.errorbar(
                [(q[which] - middle) / unit], [row + 0.15 * (2 * side - 1)], xerr=[spread], fmt="o", color=colour, label=label
            )
    axes.set_yticks(range(len(listed)), [f"{q['parameter']}{' *' if q['differs'] else ''}" for q in listed])
    axes.invert_yaxis()
    axes.axvline(0.0, color="0.8", zorder=0)
    axes.set_xlabel("distance from the mean of both, in standard deviations of the difference (* differs)")
    figure.legend(loc="outside upper center", ncols=1)
    write_figure(figure, path)
    return path
