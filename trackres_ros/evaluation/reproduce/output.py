# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes the files of a reproduction: tables as CSV, and lines of one family in one panel."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DIGITS = 6
INK = "#404040"


def write_csv(path: Path, columns: Mapping[str, ArrayLike]) -> None:
    """Columns of one length, numbers with six significant digits, nan as an empty cell; names end in the unit."""
    arrays = [np.asarray(values) for values in columns.values()]
    lines = [",".join(columns)]
    lines += [",".join(_cell(value) for value in row) for row in zip(*(a.tolist() for a in arrays), strict=True)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _cell(value: float | str) -> str:
    if isinstance(value, str):
        return value
    return "" if math.isnan(value) else f"{value:.{DIGITS}g}"


def mark_time(axes: Axes, time_s: float, text: str) -> None:
    """A dotted line at a time with a remark at its top."""
    axes.axvline(time_s, color=INK, linewidth=0.8, linestyle=":")
    axes.annotate(
        text,
        (time_s, 0.98),
        xycoords=("data", "axes fraction"),
        xytext=(4, 0),
        textcoords="offset points",
        ha="left",
        va="top",
        fontsize=8,
        color=INK,
    )
