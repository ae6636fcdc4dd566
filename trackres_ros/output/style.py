# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The common style of all pictures of the package: palette, fonts, figures and their files.

Needs matplotlib, an optional extra: it is imported only when a picture is drawn. No window and no pyplot state; the same
input gives the same bytes.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from trackres_ros.arrays import Array
from trackres_ros.errors import MissingExtraError
from trackres_ros.files.file_sets import file_set
from trackres_ros.files.interpreter import leave_unread
from trackres_ros.files.own_files import write

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure


MOST_POINTS = 4000  # of one line; more than a picture has columns of pixels
DOTS_PER_INCH = 110
LEGEND_INCHES = 0.28
TITLE_LETTERS = 95  # that a line across a picture of 9 inches holds

# Okabe and Ito's palette, distinguishable with any kind of colour vision; the order keeps neighbours different in lightness.
BLACK, BLUE, VERMILION, GREEN, ORANGE, PURPLE, SKY = ("#000000", "#0072B2", "#D55E00", "#009E73", "#E69F00", "#CC79A7", "#56B4E9")
PALETTE = (BLUE, ORANGE, GREEN, PURPLE, SKY, BLACK, VERMILION)
GREY = "#8C8C8C"
# For an ordered quantity such as the speed: from light to dark, readable in grey.
STEPS = ("#FDB863", "#E08214", "#B2577A", "#6A4C9C", "#1F2F6B")

LOOK: dict[Any, Any] = {
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.titlelocation": "left",
    "axes.labelsize": 9.0,
    "legend.fontsize": 8.0,
    "legend.frameon": False,
    "axes.grid": True,
    "grid.color": "#E3E3E3",
    "grid.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "lines.linewidth": 1.5,
    "figure.constrained_layout.hspace": 0.03,
    "svg.hashsalt": "trackres",
    "svg.fonttype": "none",
    "text.parse_math": False,  # names of files and vehicles may have a $
}


@contextmanager
def picture(path: Path, width: float, height: float) -> Iterator[Figure]:
    """An empty figure [inches], written when the block ends: SVG by the suffix of the path, else PNG.

    Raises MissingExtraError if matplotlib is not installed.
    """
    with empty_figure(width, height) as figure:
        yield figure
        write_figure(figure, path)


@contextmanager
def empty_figure(width: float, height: float) -> Iterator[Figure]:
    """An empty figure [inches], and the look of the package while it is drawn."""
    try:
        with leave_unread("matplotlibrc"):
            import matplotlib  # noqa: F401 - its parts may be there still where it is not
        from matplotlib.backends.backend_agg import FigureCanvasAgg
    except ImportError:
        raise MissingExtraError("pictures", "matplotlib", "plots") from None
    with _look():
        figure = _notebook_figure()(figsize=(width, height), dpi=DOTS_PER_INCH, layout="constrained")
        FigureCanvasAgg(figure)
        yield figure


@cache
def _notebook_figure() -> type[Figure]:
    """The class of figures outside of pyplot, so that nothing has to be closed; a notebook shows them as PNG."""
    from matplotlib.figure import Figure

    class NotebookFigure(Figure):
        def _repr_png_(self) -> bytes:
            return png_of(self)

    return NotebookFigure


@contextmanager
def _look() -> Iterator[None]:
    """The style of the package, independent of other settings of matplotlib in the program."""
    import matplotlib

    with matplotlib.rc_context(), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph", UserWarning)  # a letter without a glyph is drawn as a box
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(LOOK)
        yield


def png_of(figure: Figure) -> bytes:
    """A figure of this module as PNG: the same figure gives the same bytes."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    buffer = io.BytesIO()
    with _look():  # `savefig` would draw it twice
        FigureCanvasAgg(figure).print_png(buffer, metadata={"Software": None})  # type: ignore[no-untyped-call]
    return buffer.getvalue()


def svg_of(figure: Figure) -> bytes:
    """A figure of this module as SVG: the same figure gives the same bytes.

    Text stays text, in matplotlib's font if it is installed; fallback fonts are narrower, so nothing overlaps.
    """
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    buffer = io.BytesIO()
    with _look():
        FigureCanvasSVG(figure).print_svg(  # type: ignore[no-untyped-call]
            buffer, metadata={"Date": None, "Creator": None}
        )
    return buffer.getvalue()


def write_figure(figure: Figure, path: Path) -> None:
    """Write a figure as SVG or PNG, by the suffix of the path; create its folder if needed."""
    _without_maths(figure)
    with file_set():
        write(path, svg_of(figure) if path.suffix.lower() == ".svg" else png_of(figure))


def _without_maths(figure: Figure) -> None:
    """Label logarithmic axes in plain text: the look of the package reads no maths."""
    from matplotlib.ticker import LogFormatter, LogFormatterMathtext

    for axis in (axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)):
        if isinstance(axis.get_major_formatter(), LogFormatterMathtext):
            axis.set_major_formatter("{x:g}")
            axis.set_minor_formatter(LogFormatter())


@contextmanager
def picture_with_legend(path: Path, width: float, height: float, rows: int = 1) -> Iterator[SubFigure]:
    """As `picture`, with space above all axes for one legend of all their labels, where it covers nothing."""
    head_inches = LEGEND_INCHES + 0.6 * LEGEND_INCHES * (rows - 1)
    with picture(path, width, height + head_inches) as figure:
        head, body = np.ravel(np.asarray(figure.subfigures(2, 1, height_ratios=(head_inches, height))))
        yield body
        entries = {label: line for axes in body.axes for line, label in zip(*axes.get_legend_handles_labels(), strict=True)}
        if entries:
            head.legend(
                list(entries.values()), list(entries), loc="center left", ncols=-(-len(entries) // rows), borderaxespad=0.0
            )


def shorten(text: str, length: int) -> str:
    """Shorten a text to so many characters, in its middle."""
    if len(text) <= length:
        return text
    letters = length - 3
    return f"{text[: letters - letters // 2]}...{text[len(text) - letters // 2 :]}"


def thin_out(x: ArrayLike, y: ArrayLike, point_count: int = MOST_POINTS) -> tuple[Array, Array]:
    """At most `point_count` points of a line that keep its least and greatest values.

    `x`, `y`: the line, each of shape (points,); nan in `y` is a gap; `point_count`: longest line that stays unchanged. Returns
    the line itself if it is short enough; else, for each stretch of equal count, the points with the least and the greatest
    value, in their order. A stretch without values stays a gap.
    """
    x, y = np.asarray(x, float), np.asarray(y, float)
    if len(y) <= point_count:
        return x, y
    count = -(-len(y) // (point_count // 2))
    stretches = np.pad(y, (0, -len(y) % count), constant_values=np.nan).reshape(-1, count)
    is_empty = np.isnan(stretches)
    starts = count * np.arange(len(stretches))
    lowest_rows = starts + np.where(is_empty, np.inf, stretches).argmin(axis=1)
    highest_rows = starts + np.where(is_empty, -np.inf, stretches).argmax(axis=1)
    rows = np.unique(np.concatenate([lowest_rows, highest_rows]))
    return x[rows], y[rows]


def legend_beside(axes: Axes, title: str | None = None) -> None:
    """Legend to the right of the axes, where it hides no line."""
    axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0, title=title, alignment="left")
