# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Draws an estimate over time: speed, torque by part and belt temperatures, with their bands."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trackres_ros.errors import InputError
from trackres_ros.output.learned_plot import draw_coverage, draw_values, is_there
from trackres_ros.output.style import (
    BLACK,
    BLUE,
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

Array = NDArray[np.float64]
HOURS_FROM_S = 3 * 3600.0  # a longer time axis is in hours
ESTIMATE_INCHES = (9.0, 7.2)
LEARNED_INCHES, MAP_INCHES = 1.8, 2.2  # taller with learned values
ALIKE_K = 0.5  # assemblies with smaller temperature differences share one line
MEASURED = ("torque_nm", "belt_degc")


def plot_estimate(
    path: Path, time_s: ArrayLike, columns: Mapping[str, Array], title: str, measured: Mapping[str, Array] | None = None
) -> None:
    """`estimate_figure` as a PNG file."""
    with empty_figure(*ESTIMATE_INCHES) as figure:
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

    Raises MissingExtraError if matplotlib is not installed; InputError on an empty series, a measured one of another name, or one
    whose length is not that of the time.

    Parameters
    ----------
    time_s
        [s], shape (times,).
    columns
        Series by name, each of shape (times,), from `simulate.simulate` or a replay: `speed_mps`,
        `resistance_torque_nm` with `resistance_std_nm`, its parts (`resistance.RESISTANCE_PARTS`), `drive_torque_nm`,
        `belt_degc` or `belt_degc/<assembly>` with `belt_std_k/<assembly>`, `ambient_degc`. Missing ones are not drawn.
    title
        Heading of the picture.
    measured
        `torque_nm` [Nm] and `belt_degc` [degC], each of shape (times,), nan without a measurement. A measured torque
        includes the inertia, so the estimated drive torque is drawn with it. By default the column `measured_torque_nm`.
    coverage
        Seconds used for learning, as counted by `learning.buckets`; drawn as a map below the learned values.
    """
    with empty_figure(*ESTIMATE_INCHES) as figure:
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


def _line(axes: Axes, x: Array, y: ArrayLike, label: str, colour: str, **look: Any) -> None:
    """Draw a line; `look` are keywords of `Axes.plot`."""
    axes.plot(*thinned(x, y), label=label, color=colour, **{"linewidth": 1.5, **look})


def _band(axes: Axes, x: Array, middle: Array, std: Array, colour: str) -> None:
    """One standard deviation to either side; a stretch of many samples keeps its outermost edges."""
    starts = np.arange(0, len(x), max(1, -(-len(x) // (MOST_POINTS // 2))))
    low = np.fmin.reduceat(np.asarray(middle) - np.asarray(std), starts)
    high = np.fmax.reduceat(np.asarray(middle) + np.asarray(std), starts)
    axes.fill_between(x[starts], low, high, color=colour, alpha=0.15, linewidth=0.0, label="± 1 std")
