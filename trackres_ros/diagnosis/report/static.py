# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Draws the pictures of a report with matplotlib, for paper and for pages without a script."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from trackres_ros.diagnosis.report.charts import (
    DARK,
    RIM,
    Area,
    Bars,
    Chart,
    Element,
    Line,
    Map,
    Matrix,
    Panel,
    Picture,
    Points,
    Rule,
    Span,
)
from trackres_ros.output.style import picture, picture_with_legend, thin_out

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WIDTH = 7.2  # inches: that of a printed A4 page, so that type keeps its size
PIXELS_PER_INCH, REST_INCHES = 140, 0.5  # of panels; of the labels of their axes
MOST_POINTS, FEWEST_POINTS = 3000, 60  # of a line: the resolution of paper; of a piece of one
LEGEND_LETTERS = 115  # over the whole width


def draw(chart: Chart, path: Path) -> Picture:
    """Draw a chart into a file."""
    rows = -(-len(chart.panels) // chart.columns)
    heights = [panel.height for panel in chart.panels[:rows]]
    size = WIDTH, sum(heights) / PIXELS_PER_INCH + REST_INCHES
    entries = [text for _, text, _ in chart.legend()]
    with picture_with_legend(path, *size, _rows_of_legend(entries)) if entries else picture(path, *size) as body:
        grid = body.subplots(rows, chart.columns, squeeze=False, sharey=bool(chart.y_label), height_ratios=heights)
        for axis, panel in zip_longest(grid.T.ravel(), chart.panels):
            if panel is None:
                axis.set_visible(False)
                continue
            _draw_panel(axis, panel)
            if chart.x_label:
                axis.set_xlim(*panel.x_range)
        for label, place in ((chart.x_label, body.supxlabel), (chart.y_label, body.supylabel)):
            if label:
                place(label, fontsize=9)
    return Picture(path, chart.title, chart.alternative)


def _rows_of_legend(entries: Sequence[str]) -> int:
    """The fewest rows that hold a legend."""
    for rows in range(1, len(entries)):
        columns = (entries[begin : begin + rows] for begin in range(0, len(entries), rows))
        if sum(6 + max(map(len, column)) for column in columns) <= LEGEND_LETTERS:
            return rows
    return len(entries)


def _draw_panel(axis: Axes, panel: Panel) -> None:
    for element in panel.elements:
        _draw_element(axis, element)
    axis.margins(y=RIM)
    axis.set_title(panel.title, fontsize=8.5)
    axis.set(xlabel=panel.x_label, ylabel=panel.y_label)
    if panel.ticks:
        axis.set_xticks(*panel.ticks, fontsize=7)


def _draw_element(axis: Axes, element: Element) -> None:
    match element:
        case Line(text, colour, pieces, width, is_dashed):
            for piece in pieces:
                course = thin_out(*piece, max(FEWEST_POINTS, MOST_POINTS // len(pieces)))
                axis.plot(*course, color=colour, label=text, linewidth=width, linestyle=(0, (3, 1.5)) if is_dashed else "-")
        case Area(text, colour, x, low, high):
            axis.fill_between(x, low, high, color=colour, linewidth=0.0, label=text)
        case Bars():
            _draw_bars(axis, element)
        case Points(text, colour, x, y, half_width, x_half):
            axis.errorbar(x, y, half_width, x_half, fmt="o", color=colour, markersize=4, linewidth=1.0, label=text)
        case Span(text, begin, end, colour, top):
            axis.axvspan(begin, end, ymax=top, color=colour, linewidth=0, label=text)
        case Rule(place, is_upright, text, label, colour):
            draw_line, style = (axis.axvline, "--") if is_upright else (axis.axhline, "-")
            draw_line(place, color=colour, linewidth=0.8, linestyle=style, label=text or None)
            corner: dict[str, Any] = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points", "va": "top"}
            axis.annotate(label, (place, 1.0), (2, -2), color=DARK, fontsize=7, **corner)
        case Map(x, y, values, label):
            largest_value = float(np.nanmax(np.abs(values)))
            dots = axis.scatter(x, y, c=values, cmap="coolwarm", vmin=-largest_value, vmax=largest_value, s=8.0, rasterized=True)
            axis.figure.colorbar(dots, ax=axis, label=label)
            axis.set_aspect("equal")
        case Matrix(names, values, label):
            image = axis.imshow(values, vmin=-1.0, vmax=1.0, cmap="PuOr_r")
            axis.set_xticks(range(len(names)), names, rotation=90, fontsize=7.5)
            axis.set_yticks(range(len(names)), names, fontsize=7.5)
            axis.grid(False)
            axis.figure.colorbar(image, ax=axis, label=label, shrink=0.5, aspect=12)


def _draw_bars(axis: Axes, bars: Bars) -> None:
    axis.bar(bars.x, bars.height, bars.width, color=bars.colour, label=bars.text)
    axis.errorbar(bars.x, bars.height, bars.half_width, fmt="none", ecolor=DARK, elinewidth=0.8, capsize=1.5)
    for x, height, has_star in zip(bars.x, bars.height, bars.has_star, strict=False):
        if has_star:
            direction, side = (-1, "top") if height > 0 else (1, "bottom")
            axis.annotate("*", (x, 0.0), (0, direction), textcoords="offset points", ha="center", va=side, color=bars.colour)
