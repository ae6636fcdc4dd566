# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads and writes the slopes of a route as a table: a row for each place."""

from __future__ import annotations

import csv
import io
import math
from pathlib import Path

import numpy as np

from trackres_ros.checks import number
from trackres_ros.errors import InputError
from trackres_ros.files.small_files import read_text
from trackres_ros.route.learned import SLOPE, RouteMap
from trackres_ros.units import DEGREE

MOST_BYTES = 1 << 25  # half a million places, ten thousand kilometres of streets
COLUMNS = {
    "latitude_deg": (-90.0, 90.0),
    "longitude_deg": (-180.0, 180.0),
    "course_deg": (0.0, 360.0),  # clockwise from north: the way in which the slope counts
    "slope": (-0.5, 0.5),  # rise over run
    "std": (0.0, 0.5),
    "passes": (0.0, 1e9),
}


def write_route(path: Path, route: RouteMap) -> None:
    """Write slopes by place."""
    course = np.degrees(0.5 * math.pi - route.course) % 360.0
    rows = zip(
        np.degrees(route.latitude),
        np.degrees(route.longitude),
        course,
        route.value[:, 0],
        route.std[:, 0],
        route.passes,
        strict=True,
    )
    lines = [f"{a:.7f},{b:.7f},{c:.1f},{d:.5f},{e:.5f},{n}" for a, b, c, d, e, n in rows]
    path.write_text("\n".join([",".join(COLUMNS), *lines]) + "\n", encoding="utf-8")


def read_route(path: Path) -> RouteMap:
    """Read slopes by place.

    Raises
    ------
    InputError
        If it is no such table, or a value is beyond all reason.
    """
    rows = list(csv.reader(io.StringIO(read_text(path, "table of a route", MOST_BYTES))))
    if not rows or tuple(rows[0]) != tuple(COLUMNS):
        raise InputError(str(path), ",".join(rows[0])[:80] if rows else "nothing", f"a first line {','.join(COLUMNS)}")
    if len(rows) < 2:
        raise InputError(str(path), "no place", "at least one row")
    table = np.array([_row(row, f"{path}, line {line}") for line, row in enumerate(rows[1:], 2)])
    latitude, longitude, course, slope, std, passes = table.T
    return RouteMap(
        SLOPE,
        DEGREE * latitude,
        DEGREE * longitude,
        0.5 * math.pi - DEGREE * course,
        np.stack([slope, -slope], axis=1),
        np.stack([std, std], axis=1),
        passes.astype(np.int64),
    )


def _row(row: list[str], where: str) -> list[float]:
    if len(row) != len(COLUMNS):
        raise InputError(where, f"{len(row)} values", f"{len(COLUMNS)}: {', '.join(COLUMNS)}")
    return [number(_parsed(x), f"{where}: {name}", *limits) for x, (name, limits) in zip(row, COLUMNS.items(), strict=True)]


def _parsed(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text
