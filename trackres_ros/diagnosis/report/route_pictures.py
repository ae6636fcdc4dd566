# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Draws terms by place: over the matched distance with uncertainty, and on a map of the route."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from trackres_ros.diagnosis.empirical.routes import Route
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.report.picture import WIDTH, Picture
from trackres_ros.output.style import BLUE, GREY, VERMILION, picture_with_legend
from trackres_ros.route.learned import SLOPE
from trackres_ros.route.lookup import SPACING_M
from trackres_ros.text.numbers import figures

INTERVAL = 1.96  # standard deviations, of 95 %
PERCENT = 100.0


def draw_route(route: Route, final: Fit, path: Path) -> Picture:
    """Draw a slope or a torque by place, as learned on the fitted laps."""
    learned = route.learned(final)
    slope = learned.kind == SLOPE
    factor, unit = (PERCENT, "slope [%]") if slope else (1.0, "torque [Nm]")
    way = 0.001 * SPACING_M * np.arange(len(learned.passes))
    x, y = (0.001 * part for part in learned.frame.metres(learned.latitude, learned.longitude))
    with picture_with_legend(path, WIDTH, 5.4) as body:
        along, seen = body.subplots(2, 1, height_ratios=(2.0, 3.0))
        ways = ((0, BLUE, "uphill positive"),) if slope else ((0, BLUE, "one way"), (1, VERMILION, "opposite direction"))
        for column, color, label in ways:
            value, std = factor * learned.value[:, column], factor * learned.std[:, column]
            along.fill_between(way, value - INTERVAL * std, value + INTERVAL * std, color=color, alpha=0.25, linewidth=0.0)
            along.plot(way, value, color=color, linewidth=1.0, label=f"{label}, with its 95 % interval")
        along.axhline(0.0, color=GREY, linewidth=0.8)
        along.set_xlabel("matched distance along the streets, in the order of the first drive [km]")
        along.set_ylabel(unit)
        ways_known = np.isfinite(learned.value).sum(axis=1)
        mean = np.nansum(learned.value, axis=1) / np.where(ways_known > 0, ways_known, np.nan)
        shown = factor * (learned.value[:, 0] if slope else mean)
        most = float(np.nanmax(np.abs(shown)))
        dots = seen.scatter(x, y, c=shown, cmap="coolwarm", vmin=-most, vmax=most, s=8.0, rasterized=True)
        body.colorbar(dots, ax=seen, label=f"{unit}, in the direction of the first drive" if slope else unit)
        seen.set_aspect("equal")
        seen.set_xlabel("east [km]")
        seen.set_ylabel("north [km]")
    unit, what = ("%", "The slope") if slope else ("Nm", "The torque")
    low, high = (figures(float(q), 2) for q in np.nanquantile(factor * learned.value, (0.025, 0.975)))
    sure = figures(factor * float(np.nanmedian(learned.std)), 2)
    return Picture(
        path,
        "By place",
        f"{what} of each place over the matched distance, and a map of the places; most values are between {low} and {high} "
        f"{unit}, with a median standard deviation of {sure} {unit}.",
    )
