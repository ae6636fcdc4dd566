# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Draws tests of whether the residual of the last fit is white noise."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.inference.levels import for_tests
from trackres_ros.diagnosis.pipeline import Diagnosis
from trackres_ros.diagnosis.report.picture import WIDTH, Picture
from trackres_ros.diagnosis.report.series import INTERVAL
from trackres_ros.output.style import BLUE, GREY, VERMILION, picture_with_legend
from trackres_ros.text.numbers import figures

Array = NDArray[np.float64]

LAGS = 30
SHOWN_FREQUENCIES = 400
BARTLETT = 1.358  # over the root of the number of frequencies: 95 % of white noise stays within (Kolmogorov and Smirnov)


def autocorrelation(rows: Sequence[Array], lags: int = LAGS) -> tuple[Array, Array]:
    """Autocorrelation at lags 1 and up of series with gaps (nan), and the number of pairs of each."""
    rows = [row - np.nanmean(np.concatenate(list(rows))) for row in rows]
    square = np.nanmean(np.concatenate(rows) ** 2)
    found, pairs = np.zeros(lags), np.zeros(lags)
    for lag in range(1, lags + 1):
        products = np.concatenate([row[lag:] * row[:-lag] for row in rows if len(row) > lag] or [np.full(1, np.nan)])
        pairs[lag - 1] = np.isfinite(products).sum()
        found[lag - 1] = np.nanmean(products) / square if pairs[lag - 1] else np.nan
    return found, pairs


def cumulative_power(rows: Sequence[Array]) -> Array:
    """Cumulative share of the power over the frequency of concatenated series without gaps; shape (frequencies,)."""
    joined = np.concatenate([row[np.isfinite(row)] for row in rows])
    power = np.abs(np.fft.rfft(joined - joined.mean())[1:-1]) ** 2
    return np.asarray(np.cumsum(power) / power.sum())


def draw_noise(d: Diagnosis, path: Path) -> Picture:
    """Autocorrelation and cumulative periodogram of the plain and whitened residual, with bounds of white noise."""
    fit = for_tests(d.final)
    torque = [g.kind == "torque" for g in fit.problem.segments]
    plain = [np.where(g.mask, r, np.nan) for r, g, used in zip(fit.residuals, fit.problem.segments, torque, strict=True) if used]
    white = [w for w, used in zip(fit.white, torque, strict=True) if used]
    step = d.sessions[0].step
    beyond = 0
    with picture_with_legend(path, WIDTH, 2.3) as body:
        left, right = body.subplots(1, 2)
        for rows, colour, label, shift in ((plain, GREY, "residual", -0.2), (white, BLUE, "whitened", 0.2)):
            found, pairs = autocorrelation(rows)
            lags = np.arange(1, LAGS + 1)
            left.bar((lags + shift) * step, found, 0.4 * step, color=colour, label=label)
            power = cumulative_power(rows)
            every = max(1, len(power) // SHOWN_FREQUENCIES)
            frequency = np.linspace(0.0, 0.5 / step, len(power))
            right.plot(frequency[::every], power[::every], color=colour, label=label)
        bound = INTERVAL / np.sqrt(np.maximum(pairs, 1.0))
        beyond = int((np.abs(found) > bound).sum())
        left.plot(lags * step, bound, color=VERMILION, linestyle="--", linewidth=1.0, label="95 % bounds of white noise")
        left.plot(lags * step, -bound, color=VERMILION, linestyle="--", linewidth=1.0)
        rim = BARTLETT / np.sqrt(max(len(power), 1))
        for side in (-rim, rim):
            right.plot([0.0, 0.5 / step], [side, 1.0 + side], color=VERMILION, linestyle="--", linewidth=1.0)
        right.set_ylim(0.0, 1.0)
        left.set_xlabel("lag [s]")
        left.set_ylabel("autocorrelation")
        right.set_xlabel("frequency [Hz]")
        right.set_ylabel("cumulative share of power")
    return Picture(
        path,
        "Is the residual white noise?",
        f"Autocorrelation and cumulative periodogram of the residual after the last fit, raw and whitened. Of "
        f"{LAGS} lags of the whitened residual, {beyond} exceed the bounds of white noise, "
        f"where {figures(0.05 * LAGS, 2)} would by chance.",
    )
