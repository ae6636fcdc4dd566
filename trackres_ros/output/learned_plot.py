# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Draws learned parameters over time with bands, and a map of the driving conditions."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trackres_ros.learning.buckets import BELT_DEGC, FILLED_S, SPEED_SHARES

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]

SHOWN = {
    "loss_modulus_scale": "loss of the belts",
    "bearing_friction": "bearings",
    "drag_coefficient": "drag",
    "rotating_mass_factor": "mass",
}
COLOURS = ("#0072B2", "#E69F00", "#56B4E9", "#009E73")
LETTERS_FROM = 0.6  # of the darkest: letters on it are white


def is_there(columns: Mapping[str, Array]) -> bool:
    """Whether anything was learned from."""
    return any(f"learned_{name}" in columns for name in SHOWN)


def draw_values(axes: Axes, x: Array, columns: Mapping[str, Array]) -> None:
    """Values relative to the first, with one standard deviation to either side."""
    for (name, label), colour in zip(SHOWN.items(), COLOURS, strict=True):
        if f"learned_{name}" not in columns:
            continue
        value, std = np.asarray(columns[f"learned_{name}"], float), np.asarray(columns[f"learned_{name}_std"], float)
        first = value[0] if value[0] else 1.0
        axes.plot(x, value / first, color=colour, label=label)
        axes.fill_between(x, (value - std) / first, (value + std) / first, color=colour, alpha=0.12, linewidth=0.0)
    axes.set_ylabel("learned, over the first")


def draw_coverage(axes: Axes, seconds: Array) -> None:
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
