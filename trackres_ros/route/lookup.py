# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Finds the places of streets about a vehicle. It is compiled, and takes no longer than the densest 150 m of streets do, however
many places there are.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackres_ros.kernels.marks import kernel

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

SPACING_M = 20.0  # of places along a street
ASIDE_M = 25.0  # spacing of two drives on one street: the scatter of positions and its lanes
ALIKE = math.cos(math.radians(45.0))  # of directions: less is a street that crosses
REACH = 1.5  # spacings ahead or behind that a place is looked for
JOINED = 0.75  # of a spacing: no new place so near to another
SIDEWAYS = 0.5  # weight of distance aside relative to distance along
CELL_M = 50.0  # of the grid in which places are looked up: more than ASIDE_M and REACH spacings come to

# A place: east and north of a frame [m], its direction, of length 1, its number; and what was learned there of one who travels
# the way it points, and the other way, with standard deviations.
X, Y, EAST, NORTH, NUMBER, ALONG, AGAINST, STD_ALONG, STD_AGAINST = range(9)
PLACE_COLUMNS = 9
POSE, VALUES, STDS = slice(X, NUMBER), slice(ALONG, STD_ALONG), slice(STD_ALONG, PLACE_COLUMNS)
# A cell: its key, and the places in it.
KEY, FIRST, END = range(3)
CELL_COLUMNS = 3
HALF, SPAN = 1 << 15, 1 << 16  # cells about the middle of a frame, and in a row: 1600 km to either side
OF_A_KIND = SPAN * SPAN  # keys: each kind of place has its own cells
NOWHERE = -1, -1, 0.0, 0.0, 0.0


class Lookup(NamedTuple):
    """Places in the order of their cells."""

    cells: IntArray  # (cells, CELL_COLUMNS), keys rising
    places: Array  # (places, PLACE_COLUMNS)


def lookup_of(kinds: list[Array]) -> Lookup:
    """Places ready for look-up.

    Parameters
    ----------
    kinds
        Places of each kind, shape (places, PLACE_COLUMNS); finite except for learned values.
    """
    keys = [kind * OF_A_KIND + _keys(places) for kind, places in enumerate(kinds)]
    key = np.concatenate([np.empty(0, dtype=np.int64), *keys])
    order = np.argsort(key, kind="stable")
    known, first, count = np.unique(key[order], return_index=True, return_counts=True)
    cells = np.stack([known, first, first + count], axis=1).astype(np.int64)
    return Lookup(cells, np.concatenate([np.empty((0, PLACE_COLUMNS)), *kinds])[order])


def _keys(places: Array) -> IntArray:
    column, row = (np.floor(places[:, axis] / CELL_M).astype(np.int64) + HALF for axis in (X, Y))
    return np.asarray(column * SPAN + row)


@kernel
def cell_of(metres: float) -> int:
    """The column or row of a place."""
    return math.floor(metres / CELL_M) + HALF


@kernel
def seen_from(
    x: float, y: float, east: float, north: float, of_x: float, of_y: float, of_east: float, of_north: float
) -> tuple[float, float, float]:
    """A place relative to a vehicle at (x, y) that travels in a direction.

    Returns
    -------
    along, far, sign
        Distance along the travel [m]; weighted distance [m], infinite for a place on another street or out of reach;
        1 if its direction is that of the travel, else -1.
    """
    alike = of_east * east + of_north * north
    along = (of_x - x) * east + (of_y - y) * north
    aside = abs((of_y - y) * east - (of_x - x) * north)
    if abs(alike) < ALIKE or aside > ASIDE_M or abs(along) > REACH * SPACING_M:
        return along, math.inf, 0.0
    return along, abs(along) + SIDEWAYS * aside, math.copysign(1.0, alike)


@kernel
def between(
    cells: IntArray, places: Array, kind: int, x: float, y: float, east: float, north: float
) -> tuple[int, int, float, float, float]:
    """The places behind and ahead of a vehicle at (x, y) [m] that travels in a direction.

    Returns
    -------
    behind, ahead, share, sign_behind, sign_ahead
        Rows of `places`, -1 without a near one; the weight of the one ahead; and whether the direction of each is along the
        travel (1) or against it (-1).
    """
    if not (abs(x) < CELL_M * (HALF - 2) and abs(y) < CELL_M * (HALF - 2)):
        return NOWHERE
    behind = ahead = -1
    nearest_behind = nearest_ahead = math.inf
    along_behind = along_ahead = sign_behind = sign_ahead = 0.0
    column, row = cell_of(x), cell_of(y)
    for step in range(-1, 2):
        last = kind * OF_A_KIND + (column + step) * SPAN + row + 1
        cell = first_at(cells, last - 2)
        while cell < cells.shape[0] and cells[cell, KEY] <= last:
            for place in range(cells[cell, FIRST], cells[cell, END]):
                at = places[place]
                along, far, sign = seen_from(x, y, east, north, at[X], at[Y], at[EAST], at[NORTH])
                if along <= 0.0 and far < nearest_behind:
                    behind, nearest_behind, along_behind, sign_behind = place, far, along, sign
                elif along > 0.0 and far < nearest_ahead:
                    ahead, nearest_ahead, along_ahead, sign_ahead = place, far, along, sign
            cell += 1
    if behind >= 0 and ahead >= 0:
        return behind, ahead, along_behind / (along_behind - along_ahead), sign_behind, sign_ahead
    if behind >= 0 and -along_behind <= JOINED * SPACING_M:
        return behind, behind, 0.0, sign_behind, sign_behind
    if ahead >= 0 and along_ahead <= JOINED * SPACING_M:
        return ahead, ahead, 0.0, sign_ahead, sign_ahead
    return NOWHERE


@kernel
def first_at(cells: IntArray, key: int) -> int:
    """The first cell with a key that is not smaller."""
    low, high = 0, cells.shape[0]
    while low < high:
        middle = (low + high) // 2
        if cells[middle, KEY] < key:
            low = middle + 1
        else:
            high = middle
    return low


@kernel
def learned_at(cells: IntArray, places: Array, kind: int, x: float, y: float, east: float, north: float) -> tuple[float, float]:
    """Learned value of a kind for travel at (x, y) [m] in a direction, and its standard deviation; nan where
    unknown.
    """
    behind, ahead, share, sign_behind, sign_ahead = between(cells, places, kind, x, y, east, north)
    total = spread = weight = 0.0
    if behind >= 0 and share < 1.0:
        against = 1 if sign_behind < 0.0 else 0
        if not math.isnan(places[behind, ALONG + against]):
            total += (1.0 - share) * places[behind, ALONG + against]
            spread += (1.0 - share) * places[behind, STD_ALONG + against]
            weight += 1.0 - share
    if ahead >= 0 and share > 0.0:
        against = 1 if sign_ahead < 0.0 else 0
        if not math.isnan(places[ahead, ALONG + against]):
            total += share * places[ahead, ALONG + against]
            spread += share * places[ahead, STD_ALONG + against]
            weight += share
    return (total / weight, spread / weight) if weight > 0.0 else (math.nan, math.nan)
