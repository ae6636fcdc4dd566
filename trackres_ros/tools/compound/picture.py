# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Draws a fitted compound: data coverage, master curve, shift and residuals."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from trackres_ros.output.style import BLACK, BLUE, GREEN, GREY, PURPLE, VERMILION, picture_with_legend, shorten
from trackres_ros.text import decimals
from trackres_ros.tools.compound.coverage import Need, is_covered
from trackres_ros.tools.compound.fitting import KEPT, CompoundFit

if TYPE_CHECKING:
    from matplotlib.axes import Axes

INCHES = 10.0, 8.0
GRID = 300
MARGIN_K, MARGIN_DECADES = 8.0, 0.5
PALE = "#DCE9F5"
DOTS: dict[str, Any] = {"linestyle": "none", "marker": ".", "markersize": 4.0, "markeredgewidth": 0.0}


def draw_compound(fit: CompoundFit, need: Need, path: Path) -> Path:
    """The picture of a fit."""
    with picture_with_legend(path, *INCHES) as figure:
        (cover, curve), (shift, residual_axes) = figure.subplots(2, 2)
        _coverage(cover, fit, need)
        _master(curve, fit)
        _shift(shift, fit)
        _residuals(residual_axes, fit)
    return path


def _coverage(axes: Axes, fit: CompoundFit, need: Need) -> None:
    sweep = fit.sweep
    temps = np.linspace(
        min(sweep.temp_degc.min(), need.coldest) - MARGIN_K, max(sweep.temp_degc.max(), need.hottest) + MARGIN_K, GRID
    )
    low = np.log10(min(sweep.frequency.min(), need.slowest)) - MARGIN_DECADES
    high = np.log10(max(sweep.frequency.max(), need.fastest)) + MARGIN_DECADES
    log_f = np.linspace(low, high, GRID)
    grid_t, grid_f = np.meshgrid(temps, log_f)
    is_inside = is_covered(fit, 10.0**grid_f, grid_t)
    axes.contourf(temps, 10.0**log_f, is_inside.astype(float), levels=[0.5, 1.5], colors=[PALE], zorder=0)
    axes.plot(sweep.temp_degc, sweep.frequency, color=BLACK, label="measured", **DOTS)
    axes.fill([], [], color=PALE, label="covered by superposition")
    box_t = [need.coldest, need.hottest, need.hottest, need.coldest, need.coldest]
    box_f = [need.slowest, need.slowest, need.fastest, need.fastest, need.slowest]
    axes.plot(box_t, box_f, color=PURPLE, label="required by the belts")
    axes.set_yscale("log")
    axes.set_ylim(10.0**low, 10.0**high)
    axes.set_xlim(temps[0], temps[-1])
    axes.set_title(f"coverage of {shorten(sweep.path.name, 30)}; white is extrapolated")
    axes.set_xlabel("temperature [°C]")
    axes.set_ylabel("frequency [Hz]")


def _master(axes: Axes, fit: CompoundFit) -> None:
    sweep, prony, shift = fit.sweep, fit.prony, fit.shift
    reference = prony.reference_degc
    moved_hz = sweep.frequency * 10.0 ** (shift.log_shift(sweep.temp_degc) - shift.log_shift(reference))
    degc = np.linspace(fit.master.low_degc, fit.master.high_degc, 400)
    master_hz = fit.master.at_frequency * 10.0 ** (shift.log_shift(degc) - shift.log_shift(reference))
    for measured, curve, series, colour, label in zip(
        (sweep.storage, sweep.loss),
        fit.master.moduli(degc),
        prony.moduli(master_hz),
        (BLUE, VERMILION),
        ("storage E′", "loss E″"),
        strict=True,
    ):
        axes.plot(moved_hz, measured / 1e6, color=colour, alpha=0.6, **DOTS)
        axes.plot(master_hz, curve / 1e6, color=colour, label=label)
        axes.plot(
            master_hz,
            series / 1e6,
            color=BLACK,
            linewidth=0.9,
            linestyle=":",
            label="Prony series" if colour == VERMILION else None,
        )
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_title(f"master curve at {reference:.0f} °C")
    axes.set_xlabel("reduced frequency [Hz]")
    axes.set_ylabel("modulus [MPa]")


def _shift(axes: Axes, fit: CompoundFit) -> None:
    shift, reference = fit.shift, fit.prony.reference_degc
    degc = np.linspace(fit.sweep.temp_degc.min(), fit.sweep.temp_degc.max(), 300)
    axes.plot(degc, shift.log_shift(degc) - shift.log_shift(reference), color=GREEN)
    if fit.glass_is_seen:
        axes.axvline(shift.glass_transition, color=GREY, linewidth=0.9, linestyle="--")
        axes.annotate(
            "Tg", (shift.glass_transition, 0.95), xycoords=("data", "axes fraction"), xytext=(3, 0), textcoords="offset points"
        )
    axes.set_title("shift of the vehicle file" if fit.law == KEPT else f"shift: {fit.law}")
    axes.set_xlabel("temperature [°C]")
    axes.set_ylabel(f"log10 of a_T about {reference:.0f} °C")


def _residuals(axes: Axes, fit: CompoundFit) -> None:
    percent = 100.0 * np.expm1(fit.master.residuals)
    for k, colour in enumerate((BLUE, VERMILION)):
        axes.plot(fit.sweep.temp_degc, percent[:, k], color=colour, **DOTS)
    axes.axhline(0.0, color=GREY, linewidth=0.9)
    storage, loss = (decimals(100.0 * x, 2) for x in fit.rms)
    axes.set_title(f"measured over master curve: rms {storage} % of E′, {loss} % of E″")
    axes.set_xlabel("temperature [°C]")
    axes.set_ylabel("difference [%]")
