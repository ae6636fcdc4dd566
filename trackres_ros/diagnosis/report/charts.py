# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Describes the pictures of a report: panels with series, spans and rules. `static` and `interactive` draw them alike."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackres_ros.output.style import GREY

Values = NDArray[np.floating[Any]]

DARK = "#333333"
MARK = "#777777"  # of times that are marked at the foot
SHADE = f"{GREY}2E"  # of times that are marked by their background
RIM = 0.15  # of the height of the values, above and below them
FOOT = 0.045  # of the height of a panel
TITLE_LETTERS = 88  # characters of a title over the whole width of a page


class Picture(NamedTuple):
    """A picture in a file, and its description."""

    path: Path
    title: str
    alternative: str


class Line(NamedTuple):
    """A line in pieces that are not connected; nan in `y` is a gap."""

    text: str
    colour: str
    pieces: Sequence[tuple[Values, Values]]  # x and y
    width: float = 1.5
    is_dashed: bool = False


class Area(NamedTuple):
    """The area between two lines."""

    text: str
    colour: str
    x: Values
    low: Values
    high: Values


class Bars(NamedTuple):
    """Bars with their intervals."""

    text: str
    colour: str
    x: Values
    height: Values
    half_width: Values  # of the interval; nan without one
    width: float
    has_star: Sequence[bool] = ()
    details: Sequence[str] = ()  # at the pointer
    keys: Sequence[str] = ()  # of the times that a press highlights


class Points(NamedTuple):
    """Points with their intervals."""

    text: str
    colour: str
    x: Values
    y: Values
    half_width: Values
    x_half: Values | None = None


class Span(NamedTuple):
    """A marked time."""

    text: str
    begin: float
    end: float
    colour: str = SHADE
    top: float = 1.0  # share of the panel's height


class Rule(NamedTuple):
    """A line across the panel; an upright one is dashed, and has a label at its top."""

    place: float
    is_upright: bool = False
    text: str = ""
    label: str = ""
    colour: str = GREY


class Map(NamedTuple):
    """Values of places, in the same scale to either side."""

    x: Values
    y: Values
    values: Values
    label: str


class Matrix(NamedTuple):
    """Values of pairs, from -1 to 1."""

    names: Sequence[str]
    values: Values
    label: str


Element = Line | Area | Bars | Points | Span | Rule | Map | Matrix
ZERO = Rule(0.0)


class Panel(NamedTuple):
    """Elements over one pair of axes. Its lines have the same `x`."""

    elements: Sequence[Element]
    title: str = ""
    x_label: str = ""
    y_label: str = ""
    height: int = 240  # pixels of the interactive page
    ticks: tuple[Sequence[float], Sequence[str]] | None = None  # their places and labels
    highlight: tuple[int, float] | None = None  # session whose highlighted steps it shows, and seconds per unit of the x-axis

    @property
    def lines(self) -> list[Line]:
        """The lines of the panel."""
        return [element for element in self.elements if isinstance(element, Line)]

    @property
    def x_range(self) -> tuple[float, float]:
        """Where its lines begin and end."""
        pieces = self.lines[0].pieces
        return float(pieces[0][0][0]), float(pieces[-1][0][-1])


class Chart(NamedTuple):
    """A picture: its panels, which fill one column after the other, and its description."""

    title: str
    alternative: str
    panels: Sequence[Panel]
    x_label: str = ""  # of all panels; their lines then reach from end to end, and zoom together
    y_label: str = ""  # of all panels, which then have the same scale
    columns: int = 1

    def legend(self) -> list[tuple[str, str, bool]]:
        """Colour and text of each series, and whether it is solid."""
        series = [e for panel in self.panels for e in panel.elements if not isinstance(e, Map | Matrix)]
        dashed_texts = {e.text for e in series if isinstance(e, Rule) or (isinstance(e, Line) and e.is_dashed)}
        return list({e.text: (e.colour, e.text, e.text not in dashed_texts) for e in series if e.text}.values())


def unit(label: str) -> str:
    """The unit of the label of an axis, in its brackets."""
    return label.partition("[")[2].partition("]")[0]
