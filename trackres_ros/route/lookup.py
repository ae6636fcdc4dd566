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
    cell_keys, start, count = np.unique(key[order], return_index=True, return_counts=True)
    cells = np.stack([cell_keys, start, start + count], axis=1).astype(np.int64)
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
    offset, far, sign
        Distance along the travel [m]; weighted distance [m], infinite for a place on another street or out of reach;
        1 if its direction is that of the travel, else -1.
    """
    cosine = of_east * east + of_north * north
    offset = (of_x - x) * east + (of_y - y) * north
    lateral = abs((of_y - y) * east - (of_x - x) * north)
    if abs(cosine) < ALIKE or lateral > ASIDE_M or abs(offset) > REACH * SPACING_M:
        return offset, math.inf, 0.0
    return offset, abs(offset) + SIDEWAYS * lateral, math.copysign(1.0, cosine)


@kernel
def neighbour_places(
    cells: IntArray, places: Array, kind: int, x: float, y: float, east: float, north: float
) -> tuple[int, int, float, float, float]:
    """The places behind and ahead of a vehicle at (x, y) [m] that travels in a direction.

    Returns
    -------
    back, front, share, back_sign, front_sign
        Rows of `places`, -1 without a near one; the weight of the one ahead; and whether the direction of each is along the
        travel (1) or against it (-1).
    """
    if not (abs(x) < CELL_M * (HALF - 2) and abs(y) < CELL_M * (HALF - 2)):
        return NOWHERE
    back = front = -1
    back_distance = front_distance = math.inf
    back_offset = front_offset = back_sign = front_sign = 0.0
    column, row = cell_of(x), cell_of(y)
    for step in range(-1, 2):
        last_key = kind * OF_A_KIND + (column + step) * SPAN + row + 1
        cell = first_at(cells, last_key - 2)
        while cell < cells.shape[0] and cells[cell, KEY] <= last_key:
            for place in range(cells[cell, FIRST], cells[cell, END]):
                row_values = places[place]
                offset, distance, sign = seen_from(
                    x, y, east, north, row_values[X], row_values[Y], row_values[EAST], row_values[NORTH]
                )
                if offset <= 0.0 and distance < back_distance:
                    back, back_distance, back_offset, back_sign = place, distance, offset, sign
                elif offset > 0.0 and distance < front_distance:
                    front, front_distance, front_offset, front_sign = place, distance, offset, sign
            cell += 1
    if back >= 0 and front >= 0:
        return back, front, back_offset / (back_offset - front_offset), back_sign, front_sign
    if back >= 0 and -back_offset <= JOINED * SPACING_M:
        return back, back, 0.0, back_sign, back_sign
    if front >= 0 and front_offset <= JOINED * SPACING_M:
        return front, front, 0.0, front_sign, front_sign
    return NOWHERE


@kernel
def first_at(cells: IntArray, key: int) -> int:
    """The first cell with a key that is not smaller."""
    low, high = 0, cells.shape[0]
    while low < high:
        centre = (low + high) // 2
        if cells[centre, KEY] < key:
            low = centre + 1
        else:
            high = centre
    return low


@kernel
def learned_at(cells: IntArray, places: Array, kind: int, x: float, y: float, east: float, north: float) -> tuple[float, float]:
    """Learned value of a kind for travel at (x, y) [m] in a direction, and its standard deviation; nan where
    unknown.
    """
    back, front, share, back_sign, front_sign = neighbour_places(cells, places, kind, x, y, east, north)
    total = spread = weight = 0.0
    if back >= 0 and share < 1.0:
        side = 1 if back_sign < 0.0 else 0
        if not math.isnan(places[back, ALONG + side]):
            total += (1.0 - share) * places[back, ALONG + side]
            spread += (1.0 - share) * places[back, STD_ALONG + side]
            weight += 1.0 - share
    if front >= 0 and share > 0.0:
        side = 1 if front_sign < 0.0 else 0
        if not math.isnan(places[front, ALONG + side]):
            total += share * places[front, ALONG + side]
            spread += share * places[front, STD_ALONG + side]
            weight += share
    return (total / weight, spread / weight) if weight > 0.0 else (math.nan, math.nan)
