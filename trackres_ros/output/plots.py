# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Draws an estimate over time: speed, torque by part and belt temperatures, with their bands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trackres_ros.arrays import Array
from trackres_ros.errors import InputError
from trackres_ros.learning.buckets import BELT_DEGC, FILLED_S, SPEED_SHARES
from trackres_ros.output.preview import longest_step
from trackres_ros.output.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    MOST_POINTS,
    ORANGE,
    PALETTE,
    PURPLE,
    SKY,
    TITLE_LETTERS,
    VERMILION,
    empty_figure,
    legend_beside,
    shortened,
    thinned,
    write_figure,
)
from trackres_ros.units import KMH_PER_MPS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, FigureBase

HOURS_FROM_S = 3 * 3600.0  # a longer time axis is in hours
ESTIMATE_INCHES = (9.0, 7.2)
LEARNED_INCHES, MAP_INCHES = 1.8, 2.2  # taller with learned values
ALIKE_K = 0.5  # assemblies with smaller temperature differences share one line
LEARNED = {
    "loss_modulus_scale": "loss of the belts", "bearing_friction": "bearings", "drag_coefficient": "drag",
    "rotating_mass_factor": "mass",
}  # fmt: skip
COLOURS = (BLUE, ORANGE, SKY, GREEN)
LINES = "-", "--", ":"  # of assemblies beyond the palette
LETTERS_FROM = 0.6  # of the darkest: letters on it are white


@dataclass(frozen=True, eq=False)
class TimeAxis:
    """Times as they are drawn, shape (times,), and the numbers of the first rows after a gap, or a step back."""

    values: Array
    gaps: NDArray[np.intp]

    def broken(self, rows: NDArray[np.intp], *series: Array) -> list[Array]:
        """Times and values of some rows, in their order, with nan where a gap is, so that no line crosses it."""
        place = np.searchsorted(rows, self.gaps)
        return [np.insert(values, place, np.nan) for values in (self.values[rows], *series)]


def estimate_figure(
    time_s: ArrayLike, columns: Mapping[str, Array], title: str, coverage: Array | None = None, path: Path | None = None
) -> Figure:
    """Speed, torques and belt temperature over one time axis.

    Raises MissingExtraError if matplotlib is not installed; InputError on an empty series, or one whose length is not that of the
    time.

    Parameters
    ----------
    time_s
        [s], shape (times,).
    columns
        Series by name, each of shape (times,), from `simulate.simulate` or a replay: `speed_mps`,
        `resistance_torque_nm` with `resistance_std_nm`, its parts (`resistance.RESISTANCE_PARTS`), `drive_torque_nm`,
        `belt_degc` or `belt_degc/<assembly>` with `belt_std_k/<assembly>`, `ambient_degc`, `measured_torque_nm` (nan
        without a measurement; it includes the inertia, so `drive_torque_nm` is drawn with it). Missing ones are not drawn.
    title
        Heading of the picture.
    coverage
        Seconds used for learning, as counted by `learning.buckets`; drawn as a map below the learned values.
    path
        PNG file to write too.
    """
    with empty_figure(*ESTIMATE_INCHES) as figure:
        _draw_estimate(figure, time_s, columns, title, coverage)
        if path is None:
            figure.draw_without_rendering()  # ticks and text are made now, in this look
        else:
            write_figure(figure, path)
        figure.set_layout_engine("none")  # a second layout would move them
    return figure


def _draw_estimate(
    figure: Figure, time_s: ArrayLike, columns: Mapping[str, Array], title: str, coverage: Array | None = None
) -> None:
    time = np.asarray(time_s, float)
    if len(time) == 0:
        raise InputError("estimate", "no rows", "at least one row to draw")
    for name, values in columns.items():
        if np.shape(values) != time.shape:
            raise InputError(f"column {name}", np.shape(values), f"the shape of the time, {time.shape}")
    in_hours = float(np.ptp(time)) > HOURS_FROM_S
    step = np.diff(time)
    gaps = np.flatnonzero((step > longest_step(time)) | (step < 0.0)) + 1
    x = TimeAxis(time / 3600.0 if in_hours else time, gaps)
    drawn: FigureBase = figure
    if learned := _is_there(columns):
        figure.set_size_inches(
            ESTIMATE_INCHES[0], ESTIMATE_INCHES[1] + LEARNED_INCHES + (0.0 if coverage is None else MAP_INCHES)
        )
        if coverage is not None:
            heights = (ESTIMATE_INCHES[1] + LEARNED_INCHES, MAP_INCHES)
            drawn, below = np.ravel(np.asarray(figure.subfigures(2, 1, height_ratios=heights)))
            _draw_coverage(below.subplots(), coverage)
    parts = drawn.subplots(3 + learned, 1, sharex=True, height_ratios=(1.0, 1.8, 1.4, 1.2)[: 3 + learned])
    speed, torque, belt = parts[:3]
    figure.suptitle(shortened(title, TITLE_LETTERS), x=0.01, ha="left", fontsize=11)
    _line(speed, x, np.asarray(columns["speed_mps"], float) * KMH_PER_MPS, "speed", BLACK)
    speed.set_ylabel("speed [km/h]")
    _draw_torque(torque, x, columns)
    _draw_belt(belt, x, columns)
    if learned:
        _draw_values(parts[3], x, columns)
    parts[-1].set_xlabel("time [h]" if in_hours else "time [s]")
    for axes in parts:
        axes.margins(x=0.01)
        legend_beside(axes)
    drawn.align_ylabels()


def _draw_torque(axes: Axes, x: TimeAxis, columns: Mapping[str, Array]) -> None:
    if np.isfinite(columns.get("measured_torque_nm", np.nan)).any():
        _line(axes, x, columns["measured_torque_nm"], "measured", VERMILION, linewidth=0.9)
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


def _draw_belt(axes: Axes, x: TimeAxis, columns: Mapping[str, Array]) -> None:
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
                _line(
                    axes,
                    x,
                    values,
                    name.replace("_", " "),
                    PALETTE[i % len(PALETTE)],
                    linestyle=LINES[i // len(PALETTE) % len(LINES)],
                )
    elif "belt_degc" in columns:
        _line(axes, x, columns["belt_degc"], "belt, mean", BLACK)
    if "ambient_degc" in columns:
        _line(axes, x, columns["ambient_degc"], "ambient", GREY, linestyle="--")
    axes.set_ylabel("temperature [°C]")


def _line(axes: Axes, x: TimeAxis, y: ArrayLike, label: str, colour: str, **look: Any) -> None:
    """Draw a line; `look` are keywords of `Axes.plot`."""
    rows, shown = thinned(np.arange(len(x.values)), y)
    axes.plot(*x.broken(rows.astype(int), shown), label=label, color=colour, **{"linewidth": 1.5, **look})


def _band(axes: Axes, x: TimeAxis, middle: Array, std: Array, colour: str) -> None:
    """One standard deviation to either side; a stretch of many samples keeps its outermost edges."""
    count = len(x.values)
    starts = np.union1d(np.arange(0, count, max(1, -(-count // (MOST_POINTS // 2)))), x.gaps)
    low = np.fmin.reduceat(np.asarray(middle) - np.asarray(std), starts)
    high = np.fmax.reduceat(np.asarray(middle) + np.asarray(std), starts)
    at, low, high = x.broken(starts, low, high)
    axes.fill_between(at, low, high, color=colour, alpha=0.15, linewidth=0.0, label="± 1 std")


def _is_there(columns: Mapping[str, Array]) -> bool:
    """Whether anything was learned from."""
    return any(f"learned_{name}" in columns for name in LEARNED)


def _draw_values(axes: Axes, x: TimeAxis, columns: Mapping[str, Array]) -> None:
    """Values relative to the first, with one standard deviation to either side."""
    for (name, label), colour in zip(LEARNED.items(), COLOURS, strict=True):
        if f"learned_{name}" not in columns:
            continue
        value, std = np.asarray(columns[f"learned_{name}"], float), np.asarray(columns[f"learned_{name}_std"], float)
        first = value[0] if value[0] else 1.0
        every = np.arange(len(value))
        axes.plot(*x.broken(every, value / first), color=colour, label=label)
        at, low, high = x.broken(every, (value - std) / first, (value + std) / first)
        axes.fill_between(at, low, high, color=colour, alpha=0.12, linewidth=0.0)
    axes.set_ylabel("learned, over the first")


def _draw_coverage(axes: Axes, seconds: Array) -> None:
    """Seconds that were learned from, by belt temperature and speed; loads are summed up.

    `seconds`: shape (speeds, belt temperatures, loads), as `learning.buckets` counts them.
    """
    shown = np.asarray(seconds.sum(axis=2))
    most = max(float(shown.max()), FILLED_S)
    axes.imshow(shown, cmap="Blues", vmin=0.0, vmax=most, aspect="auto", origin="lower")
    for i, row in enumerate(shown.tolist()):
        for j, count in enumerate(row):
            colour = "white" if count > LETTERS_FROM * most else "black"
            axes.text(j, i, f"{count:.0f} s", ha="center", va="center", fontsize=7.0, color=colour)
    axes.set_xticks(range(shown.shape[1]), _between(BELT_DEGC, "{:.0f}"))
    axes.set_yticks(range(shown.shape[0]), _between(tuple(100.0 * share for share in SPEED_SHARES), "{:.0f}"))
    axes.set_xlabel("learned from: belt [°C]")
    axes.set_ylabel("speed [% of greatest]")
    axes.grid(visible=False)


def _between(edges: tuple[float, ...], form: str) -> list[str]:
    inner = [f"{form.format(a)}-{form.format(b)}" for a, b in pairwise(edges)]
    return [f"< {form.format(edges[0])}", *inner, f"> {form.format(edges[-1])}"]
