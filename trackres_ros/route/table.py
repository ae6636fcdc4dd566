# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads and writes the learned values of a route's places as a table, one row per place."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from trackres_ros.checks import number
from trackres_ros.errors import InputError
from trackres_ros.files.documents import read_text
from trackres_ros.files.own_files import write
from trackres_ros.route.learned import SLOPE, TORQUE, RouteMap, followed_in, frame_of, of_kind
from trackres_ros.route.lookup import CELL_M, END, FIRST, Array
from trackres_ros.route.track import FARTHEST_M
from trackres_ros.units import DEGREE

MOST_BYTES = 1 << 26  # half a million places, ten thousand kilometres of streets
MOST_IN_A_CELL = 200  # places: crossing streets have some tens, and each takes computing time in the vehicle
MOST_NM = 1e7
PLACE = {
    "latitude_deg": (-90.0, 90.0),
    "longitude_deg": (-180.0, 180.0),
    "course_deg": (0.0, 360.0),  # clockwise from north: the way in which the slope counts
}
LEARNED = {
    SLOPE: {"slope": (-0.5, 0.5), "std": (0.0, 0.5)},  # rise over run
    TORQUE: {  # against travel, of one who travels along the course, and the other way
        "torque_nm": (-MOST_NM, MOST_NM),
        "torque_std_nm": (0.0, MOST_NM),
        "torque_back_nm": (-MOST_NM, MOST_NM),
        "torque_back_std_nm": (0.0, MOST_NM),
    },
}
PASSES = {"passes": (0.0, 1e9)}
HEADERS = [
    {name: limits for group in (PLACE, *(LEARNED[kind] for kind in kinds), PASSES) for name, limits in group.items()}
    for kinds in ((SLOPE,), (TORQUE,), (SLOPE, TORQUE))
]


def write_route(path: Path, route: Sequence[RouteMap]) -> None:
    """Write learned values by place: a row for each place with any, and an empty cell for a missing one."""
    rows: dict[str, dict[str, str]] = {}
    for route_map in route:
        for place, values, count in zip(_places(route_map), _learned_values(route_map), route_map.passes.tolist(), strict=True):
            if any(values.values()):
                rows.setdefault(place, {}).update({**values, "passes": str(count)})
    kinds = [kind for kind in LEARNED if of_kind(route, kind) is not None]
    columns = [*(name for kind in kinds for name in LEARNED[kind]), *PASSES]
    lines = [",".join([place, *(row.get(name, "") for name in columns)]) for place, row in rows.items()]
    write(path, ("\n".join([",".join([*PLACE, *columns]), *lines]) + "\n").encode())


def _places(route: RouteMap) -> list[str]:
    course = np.degrees(0.5 * math.pi - route.course) % 360.0
    rows = zip(np.degrees(route.latitude), np.degrees(route.longitude), course, strict=True)
    return [f"{a:.7f},{b:.7f},{c:.1f}" for a, b, c in rows]


def _learned_values(route: RouteMap) -> list[dict[str, str]]:
    digits = 5 if route.kind == SLOPE else 1
    std = np.where(np.isfinite(route.value), route.std, np.nan)
    values = np.stack([route.value, std], axis=2).reshape(len(route), -1)
    rows = ([f"{x:.{digits}f}" if math.isfinite(x) else "" for x in row] for row in values.tolist())
    return [dict(zip(LEARNED[route.kind], row, strict=False)) for row in rows]  # a slope holds for both directions


def read_route(path: Path) -> tuple[RouteMap, ...]:
    """Read learned values by place: a slope, a torque, or both.

    Raises
    ------
    InputError
        If it is no such table, a value is implausible, or its places are too far from or too close to one another.
    """
    reader = csv.reader(io.StringIO(read_text(path, "table of a route", MOST_BYTES)))
    try:
        lines = [(reader.line_num, row) for row in reader if row]
    except csv.Error as error:
        raise InputError(f"{path}, line {reader.line_num}", str(error), "a row of numbers between commas") from None
    rows = [row for _, row in lines]
    limits_by_name = next((header for header in HEADERS if rows and rows[0] == list(header)), None)
    if limits_by_name is None:
        expected = f"a first line {' or '.join(','.join(header) for header in HEADERS)}"
        raise InputError(str(path), "a different first line" if rows else "nothing", expected)
    if len(rows) < 2:
        raise InputError(str(path), "no place", "at least one row")
    table = np.array([_row(row, limits_by_name, f"{path}, line {line}") for line, row in lines[1:]])
    columns = dict(zip(limits_by_name, table.T, strict=True))
    route = tuple(_map(kind, columns, path) for kind in LEARNED if set(LEARNED[kind]) <= set(limits_by_name))
    route = tuple(route_map for route_map in route if len(route_map))
    if not route:
        raise InputError(str(path), "no learned value", "at least one row with a slope or a torque")
    _check_places(path, route)
    return route


def _row(row: list[str], limits_by_name: Mapping[str, tuple[float, float]], line: str) -> list[float]:
    if len(row) != len(limits_by_name):
        raise InputError(line, f"{len(row)} values", f"{len(limits_by_name)}: {', '.join(limits_by_name)}")
    may_be_empty = limits_by_name.keys() - PLACE.keys() - PASSES.keys()
    numbers = [
        math.nan if name in may_be_empty and not text.strip() else number(_parse_number(text), f"{line}: {name}", *limits)
        for text, (name, limits) in zip(row, limits_by_name.items(), strict=True)
    ]
    values = dict(zip(limits_by_name, numbers, strict=True))
    for name, std in (("slope", "std"), ("torque_nm", "torque_std_nm"), ("torque_back_nm", "torque_back_std_nm")):
        if name in values and math.isnan(values[name]) != math.isnan(values[std]):
            raise InputError(line, f"one of {name} and {std}", "both, or neither")
    return numbers


def _parse_number(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def _map(kind: str, columns: Mapping[str, Array], source: Path) -> RouteMap:
    """The places of a kind with a learned value."""
    values = np.stack([columns[name] for name in LEARNED[kind]], axis=1)
    value, std = values[:, ::2], values[:, 1::2]
    if kind == SLOPE:
        value, std = np.concatenate([value, -value], axis=1), np.concatenate([std, std], axis=1)
    has_value = np.isfinite(value).any(axis=1)
    latitude, longitude, course = (DEGREE * columns[name][has_value] for name in PLACE)
    counts = columns["passes"][has_value].astype(np.int64)
    return RouteMap(kind, latitude, longitude, 0.5 * math.pi - course, value[has_value], std[has_value], counts, source)


def _check_places(path: Path, route: Sequence[RouteMap]) -> None:
    """Refuse places beyond a flat map, and too many at one spot, where a look-up would take long."""
    frame = frame_of(route)
    if not all(np.isfinite(route_map.table(frame)[:, 0]).all() for route_map in route):
        span_text = f"places more than {0.001 * FARTHEST_M:.0f} km from their middle"
        raise InputError(str(path), span_text, "places of one region", "make a table for each region")
    cells = followed_in(route, frame).cells
    densest = int((cells[:, END] - cells[:, FIRST]).max())
    if densest > MOST_IN_A_CELL:
        raise InputError(str(path), f"{densest} places within {CELL_M:.0f} m", f"at most {MOST_IN_A_CELL}")
