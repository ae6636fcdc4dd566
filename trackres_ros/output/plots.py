# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Draws an estimate over time, and holds the look that every picture of the package shares.

Needs matplotlib, an optional extra: it is imported only when a picture is drawn. No window and no pyplot state; the same
input gives the same bytes.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trackres_ros.errors import InputError, MissingExtraError
from trackres_ros.output.learned_plot import draw_coverage, draw_values, is_there
from trackres_ros.units import KMH_PER_MPS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, FigureBase, SubFigure

    from trackres_ros.output.figures import ShownFigure

Array = NDArray[np.float64]

MOST_POINTS = 4000  # of one line; more than a picture has columns of pixels
DOTS_PER_INCH = 110
HOURS_FROM_S = 3 * 3600.0  # a longer time axis is in hours
LEGEND_INCHES = 0.28
TITLE_LETTERS = 95  # that a line across a picture of 9 inches holds
ESTIMATE_INCHES = (9.0, 7.2)
LEARNED_INCHES, MAP_INCHES = 1.8, 2.2  # more of it where something was learned
ALIKE_K = 0.5  # assemblies whose temperatures differ by less are one line
MEASURED = ("torque_nm", "belt_degc")

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
}


@contextmanager
def picture(path: Path, width: float, height: float) -> Iterator[Figure]:
    """An empty figure [inches]; it is written when the block ends, as SVG where the path ends so, else as PNG.

    Raises
    ------
    MissingExtraError
        If matplotlib is not installed.
    """
    with _empty_figure(width, height) as figure:
        yield figure
        write_figure(figure, path)


@contextmanager
def _empty_figure(width: float, height: float) -> Iterator[ShownFigure]:
    """An empty figure [inches], and the look of the package while it is drawn."""
    try:
        import matplotlib  # noqa: F401 - its parts may be there still where it is not
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        from trackres_ros.output.figures import ShownFigure
    except ImportError:
        raise MissingExtraError("pictures", "matplotlib", "plots") from None
    with _look():
        figure = ShownFigure(figsize=(width, height), dpi=DOTS_PER_INCH, layout="constrained")
        FigureCanvasAgg(figure)
        yield figure


@contextmanager
def _look() -> Iterator[None]:
    """The look of the package, whatever other settings of matplotlib the program makes."""
    import matplotlib

    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(LOOK)
        yield


def png_of(figure: Figure) -> bytes:
    """A figure of this module as PNG: the same figure gives the same bytes."""
    drawn = io.BytesIO()
    with _look():
        figure.savefig(drawn, format="png", metadata={"Software": None})
    return drawn.getvalue()


def svg_of(figure: Figure) -> bytes:
    """A figure of this module as SVG: the same figure gives the same bytes.

    Letters stay letters, of matplotlib's font where it is installed; others are narrower, so nothing collides.
    """
    drawn = io.BytesIO()
    with _look():
        figure.savefig(drawn, format="svg", metadata={"Date": None, "Creator": None})
    return drawn.getvalue()


def write_figure(figure: Figure, path: Path) -> None:
    """Write a figure as a PNG file, or as SVG where the path ends so; the folder is made if need be."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(svg_of(figure) if path.suffix == ".svg" else png_of(figure))


@contextmanager
def picture_with_legend(path: Path, width: float, height: float, rows: int = 1) -> Iterator[SubFigure]:
    """As `picture`, of which rows above all axes are kept for one legend of all their labels, where it covers nothing."""
    head_inches = LEGEND_INCHES + 0.6 * LEGEND_INCHES * (rows - 1)
    with picture(path, width, height + head_inches) as figure:
        head, body = np.ravel(np.asarray(figure.subfigures(2, 1, height_ratios=(head_inches, height))))
        yield body
        entries = {label: line for axes in body.axes for line, label in zip(*axes.get_legend_handles_labels(), strict=True)}
        if entries:
            head.legend(
                list(entries.values()), list(entries), loc="center left", ncols=-(-len(entries) // rows), borderaxespad=0.0
            )


def shortened(text: str, most: int) -> str:
    """A text of at most so many characters; its middle gives way."""
    if len(text) <= most:
        return text
    kept = most - 3
    return f"{text[: kept - kept // 2]}...{text[len(text) - kept // 2 :]}"


def thinned(x: ArrayLike, y: ArrayLike, most: int = MOST_POINTS) -> tuple[Array, Array]:
    """At most `most` points of a line that keep its least and greatest values.

    Parameters
    ----------
    x, y
        The line, each of shape (points,); nan in `y` is a gap.
    most
        Points of a line that is left as it is.

    Returns
    -------
    x, y
        The line itself where it is short enough, else of each stretch of equal count the points with the least
        and the greatest value, in their order; a stretch without values stays a gap.
    """
    x, y = np.asarray(x, float), np.asarray(y, float)
    if len(y) <= most:
        return x, y
    count = -(-len(y) // (most // 2))
    stretches = np.pad(y, (0, -len(y) % count), constant_values=np.nan).reshape(-1, count)
    empty = np.isnan(stretches)
    starts = count * np.arange(len(stretches))
    least = starts + np.where(empty, np.inf, stretches).argmin(axis=1)
    greatest = starts + np.where(empty, -np.inf, stretches).argmax(axis=1)
    kept = np.unique(np.concatenate([least, greatest]))
    return x[kept], y[kept]


def legend_beside(axes: Axes, title: str | None = None) -> None:
    """Legend to the right of the axes, where it hides no line."""
    axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0, title=title, alignment="left")


def plot_estimate(
    path: Path, time_s: ArrayLike, columns: Mapping[str, Array], title: str, measured: Mapping[str, Array] | None = None
) -> None:
    """`estimate_figure` as a PNG file."""
    with _empty_figure(*ESTIMATE_INCHES) as figure:
        _draw_estimate(figure, time_s, columns, title, measured)
        write_figure(figure, path)


def estimate_figure(
    time_s: ArrayLike,
    columns: Mapping[str, Array],
    title: str,
    measured: Mapping[str, Array] | None = None,
    coverage: Array | None = None,
) -> Figure:
    """Speed, torques and belt temperature over one time axis.

    Parameters
    ----------
    time_s
        [s], shape (times,).
    columns
        Series by name, each of shape (times,), as `simulate.simulate` or a replay gives them: `speed_mps`,
        `resistance_torque_nm` with `resistance_std_nm`, its parts (`resistance.RESISTANCE_PARTS`), `drive_torque_nm`,
        `belt_degc` or `belt_degc/<assembly>` with `belt_std_k/<assembly>`, `ambient_degc`. What is not there is not drawn.
    title
        Heading of the picture.
    measured
        `torque_nm` [Nm] and `belt_degc` [degC], each of shape (times,), nan where there is no measurement. A measured torque
        holds the inertia too, so the estimated drive torque is drawn beside it. By default the column `measured_torque_nm`.
    coverage
        Seconds that were learned from, as `learning.buckets` counts them; drawn as a map below what was learned.

    Raises
    ------
    MissingExtraError
        If matplotlib is not installed.
    InputError
        On an empty series, a measured one of another name, or one whose length is not that of the time.
    """
    with _empty_figure(*ESTIMATE_INCHES) as figure:
        _draw_estimate(figure, time_s, columns, title, measured, coverage)
        figure.draw_without_rendering()  # ticks and text are made now, in this look
    return figure


def _draw_estimate(
    figure: Figure,
    time_s: ArrayLike,
    columns: Mapping[str, Array],
    title: str,
    measured: Mapping[str, Array] | None,
    coverage: Array | None = None,
) -> None:
    time = np.asarray(time_s, float)
    if len(time) == 0:
        raise InputError("estimate", "no rows", "at least one row to draw")
    given = dict(measured or {})
    if unknown := sorted(set(given) - set(MEASURED)):
        raise InputError("measured", unknown[0], f"one of {', '.join(MEASURED)}")
    if "torque_nm" not in given and "measured_torque_nm" in columns:
        given["torque_nm"] = columns["measured_torque_nm"]
    given = {name: values for name, values in given.items() if np.isfinite(values).any()}
    for name, values in (*columns.items(), *given.items()):
        if np.shape(values) != time.shape:
            raise InputError(f"column {name}", np.shape(values), f"the shape of the time, {time.shape}")
    in_hours = float(time[-1] - time[0]) > HOURS_FROM_S
    x = time / 3600.0 if in_hours else time
    drawn: FigureBase = figure
    if learned := is_there(columns):
        figure.set_size_inches(
            ESTIMATE_INCHES[0], ESTIMATE_INCHES[1] + LEARNED_INCHES + (0.0 if coverage is None else MAP_INCHES)
        )
        if coverage is not None:
            heights = (ESTIMATE_INCHES[1] + LEARNED_INCHES, MAP_INCHES)
            drawn, below = np.ravel(np.asarray(figure.subfigures(2, 1, height_ratios=heights)))
            draw_coverage(below.subplots(), coverage)
    parts = drawn.subplots(3 + learned, 1, sharex=True, height_ratios=(1.0, 1.8, 1.4, 1.2)[: 3 + learned])
    speed, torque, belt = parts[:3]
    figure.suptitle(shortened(title, TITLE_LETTERS), x=0.01, ha="left", fontsize=11)
    _line(speed, x, np.asarray(columns["speed_mps"], float) * KMH_PER_MPS, "speed", BLACK)
    speed.set_ylabel("speed [km/h]")
    _draw_torque(torque, x, columns, given.get("torque_nm"))
    _draw_belt(belt, x, columns, given.get("belt_degc"))
    if learned:
        draw_values(parts[3], x, columns)
    parts[-1].set_xlabel("time [h]" if in_hours else "time [s]")
    for axes in parts:
        axes.margins(x=0.01)
        legend_beside(axes)
    drawn.align_ylabels()


def _draw_torque(axes: Axes, x: Array, columns: Mapping[str, Array], measured: Array | None) -> None:
    if measured is not None:
        _line(axes, x, measured, "measured", VERMILION, linewidth=0.9)
        if "drive_torque_nm" in columns:
            _line(axes, x, columns["drive_torque_nm"], "drive torque", GREY, linewidth=0.9)
    has_belts = any(name.startswith("belt_degc") for name in columns)
    if "resistance_std_nm" in columns:
        _band(axes, x, columns["resistance_torque_nm"], columns["resistance_std_nm"], BLACK)
    for name, label, colour in (
        ("resistance_torque_nm", "resistance", BLACK),
        ("hysteresis_nm", "hysteresis", BLUE),
        ("bearing_nm", "bearings" if has_belts else "rolling", ORANGE),
        ("wind_nm", "wind", SKY),
        ("effects_nm", "effects", PURPLE),
    ):
        if name in columns and (name not in ("hysteresis_nm", "effects_nm") or np.any(columns[name])):  # of a vehicle with some
            _line(axes, x, columns[name], label, colour)
    axes.set_ylabel(f"torque at {'sprockets' if has_belts else 'wheels'} [Nm]")


def _draw_belt(axes: Axes, x: Array, columns: Mapping[str, Array], measured: Array | None) -> None:
    if measured is not None:
        _line(axes, x, measured, "measured", VERMILION, linestyle="none", marker=".", markersize=5)
    by_assembly = {
        name.partition("/")[2]: np.asarray(values, float) for name, values in columns.items() if name.startswith("belt_degc/")
    }
    if by_assembly:
        stacked = np.stack(list(by_assembly.values()))
        mean = stacked.mean(axis=0)
        if np.nanmax(np.abs(stacked - mean), initial=0.0) < ALIKE_K:
            stds = [columns[f"belt_std_k/{name}"] for name in by_assembly if f"belt_std_k/{name}" in columns]
            if stds:
                _band(axes, x, mean, np.mean(stds, axis=0), BLACK)
            _line(axes, x, mean, "belt, mean", BLACK)
        else:
            for i, (name, values) in enumerate(by_assembly.items()):
                _line(axes, x, values, name.replace("_", " "), PALETTE[i % len(PALETTE)])
    elif "belt_degc" in columns:
        _line(axes, x, columns["belt_degc"], "belt, mean", BLACK)
    if "ambient_degc" in columns:
        _line(axes, x, columns["ambient_degc"], "ambient", GREY, linestyle="--")
    axes.set_ylabel("temperature [°C]")


def _line(
    axes: Axes,
    x: Array,
    y: ArrayLike,
    label: str,
    colour: str,
    linewidth: float = 1.5,
    linestyle: str = "-",
    marker: str = "",
    markersize: float = 0.0,
) -> None:
    axes.plot(
        *thinned(x, y), label=label, color=colour, linewidth=linewidth, linestyle=linestyle, marker=marker, markersize=markersize
    )


def _band(axes: Axes, x: Array, middle: Array, std: Array, colour: str) -> None:
    """One standard deviation to either side; a stretch of many samples keeps its outermost edges."""
    starts = np.arange(0, len(x), max(1, -(-len(x) // (MOST_POINTS // 2))))
    low = np.fmin.reduceat(np.asarray(middle) - np.asarray(std), starts)
    high = np.fmax.reduceat(np.asarray(middle) + np.asarray(std), starts)
    axes.fill_between(x[starts], low, high, color=colour, alpha=0.15, linewidth=0.0, label="± 1 std")
