# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Draws an estimate over time: speed, torque by part and belt temperatures, with their bands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trackres_ros.arrays import Array
from trackres_ros.errors import InputError
from trackres_ros.learning.gate import BELT_DEGC, FILLED_S, LOAD_SHARES, SPEED_SHARES
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
    shorten,
    thin_out,
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
    "loss_modulus_scale": ("loss of the belts", BLUE), "film_scale": ("cooling of the belts", PURPLE),
    "capacity_scale": ("heat capacity", VERMILION), "bearing_friction": ("bearings", ORANGE),
    "rolling_coefficient": ("rolling", ORANGE), "drag_coefficient": ("drag", SKY), "drag_area": ("drag", SKY),
    "rotating_mass_factor": ("mass", GREEN),
}  # fmt: skip
"""Labels and colours of the learned values of a vehicle, with belts or without."""
LINES = "-", "--", ":"  # of assemblies beyond the palette
LETTERS_FROM = 0.6  # of the darkest: letters on it are white


@dataclass(frozen=True, eq=False)
class TimeAxis:
    """Times as they are drawn, shape (times,), and the numbers of the first rows after a gap, or a step back."""

    values: Array
    gaps: NDArray[np.intp]

    def with_gaps(self, rows: NDArray[np.intp], *series: Array) -> list[Array]:
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
        Seconds used for learning, as counted by `learning.gate`; drawn as a map below the learned values, by speed and
        belt temperature, or load if there are no belts.
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
    estimate_figure: FigureBase = figure
    has_belts, learned_series = any(name.startswith("belt_degc") for name in columns), _learned_series(columns)
    if learned_series:
        figure.set_size_inches(
            ESTIMATE_INCHES[0], ESTIMATE_INCHES[1] + LEARNED_INCHES + (0.0 if coverage is None else MAP_INCHES)
        )
        if coverage is not None:
            heights = (ESTIMATE_INCHES[1] + LEARNED_INCHES, MAP_INCHES)
            estimate_figure, learned_figure = np.ravel(np.asarray(figure.subfigures(2, 1, height_ratios=heights)))
            _draw_coverage(learned_figure.subplots(), coverage, has_belts)
    count = 3 + bool(learned_series)
    parts = estimate_figure.subplots(count, 1, sharex=True, height_ratios=(1.0, 1.8, 1.4, 1.2)[:count])
    speed, torque, belt = parts[:3]
    figure.suptitle(shorten(title, TITLE_LETTERS), x=0.01, ha="left", fontsize=11)
    _line(speed, x, np.asarray(columns["speed_mps"], float) * KMH_PER_MPS, "speed", BLACK)
    speed.set_ylabel("speed [km/h]")
    _draw_torque(torque, x, columns, has_belts)
    _draw_belt(belt, x, columns)
    if learned_series:
        _draw_values(parts[3], x, learned_series)
    parts[-1].set_xlabel("time [h]" if in_hours else "time [s]")
    for axes in parts:
        axes.margins(x=0.01)
        legend_beside(axes)
    estimate_figure.align_ylabels()


def _draw_torque(axes: Axes, x: TimeAxis, columns: Mapping[str, Array], has_belts: bool) -> None:
    if np.isfinite(columns.get("measured_torque_nm", np.nan)).any():
        _line(axes, x, columns["measured_torque_nm"], "measured", VERMILION, linewidth=0.9)
        if "drive_torque_nm" in columns:
            _line(axes, x, columns["drive_torque_nm"], "drive torque", GREY, linewidth=0.9)
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
        belt_rows = np.stack(list(by_assembly.values()))
        mean = belt_rows.mean(axis=0)
        if np.nanmax(np.abs(belt_rows - mean), initial=0.0) < ALIKE_K:
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
    rows, values = thin_out(np.arange(len(x.values)), y)
    axes.plot(*x.with_gaps(rows.astype(int), values), label=label, color=colour, **{"linewidth": 1.5, **look})


def _band(axes: Axes, x: TimeAxis, middle: Array, std: Array, colour: str) -> None:
    """One standard deviation to either side; a stretch of many samples keeps its outermost edges."""
    count = len(x.values)
    starts = np.union1d(np.arange(0, count, max(1, -(-count // (MOST_POINTS // 2)))), x.gaps)
    low = np.fmin.reduceat(np.asarray(middle) - np.asarray(std), starts)
    high = np.fmax.reduceat(np.asarray(middle) + np.asarray(std), starts)
    times, low, high = x.with_gaps(starts, low, high)
    axes.fill_between(times, low, high, color=colour, alpha=0.15, linewidth=0.0, label="± 1 std")


def _learned_series(columns: Mapping[str, Array]) -> list[tuple[Array, Array, str, str]]:
    """Value, standard deviation, label and colour of each learned value of the vehicle; a unit ends the names of its columns."""
    return [
        (np.asarray(columns[f"learned_{name}{unit}"], float), np.asarray(columns[f"learned_{name}_std{unit}"], float), *look)
        for name, look in LEARNED.items()
        for unit in ("", "_m^2")
        if f"learned_{name}{unit}" in columns
    ]


def _draw_values(axes: Axes, x: TimeAxis, learned_series: Sequence[tuple[Array, Array, str, str]]) -> None:
    """Values relative to the first, with one standard deviation to either side."""
    for value, std, label, colour in learned_series:
        first_value = value[0] if value[0] else 1.0
        rows = np.arange(len(value))
        axes.plot(*x.with_gaps(rows, value / first_value), color=colour, label=label)
        times, low, high = x.with_gaps(rows, (value - std) / first_value, (value + std) / first_value)
        axes.fill_between(times, low, high, color=colour, alpha=0.12, linewidth=0.0)
    axes.set_ylabel("learned, over the first")


def _draw_coverage(axes: Axes, seconds: Array, has_belts: bool) -> None:
    """Seconds that were learned from, by speed, and by belt temperature or load; those of all others are added.

    `seconds`: shape (speeds, belt temperatures, loads), as `learning.gate` counts them.
    """
    cells = np.asarray(seconds.sum(axis=2 if has_belts else 1))
    edges, label = (BELT_DEGC, "belt [°C]") if has_belts else (_percent(LOAD_SHARES), "load [% of nominal]")
    longest_s = max(float(cells.max()), FILLED_S)
    axes.imshow(cells, cmap="Blues", vmin=0.0, vmax=longest_s, aspect="auto", origin="lower")
    for i, row in enumerate(cells.tolist()):
        for j, count in enumerate(row):
            colour = "white" if count > LETTERS_FROM * longest_s else "black"
            axes.text(j, i, f"{count:.0f} s", ha="center", va="center", fontsize=7.0, color=colour)
    axes.set_xticks(range(cells.shape[1]), _interval_labels(edges))
    axes.set_yticks(range(cells.shape[0]), _interval_labels(_percent(SPEED_SHARES)))
    axes.set_xlabel(f"learned from: {label}")
    axes.set_ylabel("speed [% of greatest]")
    axes.grid(visible=False)


def _percent(shares: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(100.0 * share for share in shares)


def _interval_labels(edges: tuple[float, ...]) -> list[str]:
    labels = [f"{begin:.0f}-{end:.0f}" for begin, end in pairwise(edges)]
    return [f"< {edges[0]:.0f}", *labels, f"> {edges[-1]:.0f}"]
