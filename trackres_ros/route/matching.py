# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Matches drives to themselves: places along streets, and the position of a drive between them, in either direction."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trackres_ros.route.lookup import (
    JOINED,
    NUMBER,
    PLACE_COLUMNS,
    POSE,
    SPACING_M,
    Array,
    Lookup,
    cell_of,
    lookup_of,
    neighbour_places,
    seen_from,
)
from trackres_ros.route.track import STEP_M, DrivenTrack

Indices = NDArray[np.int64]

AGAIN_M = 150.0  # driven before a place is passed once more


class Places:
    """Places on streets, each with a direction along its street.

    Parameters
    ----------
    table
        East and north of each [m], and its direction, of length 1; shape (places, 4).
    """

    def __init__(self, table: Iterable[Sequence[float]] = ()) -> None:
        self._at: list[tuple[float, float, float, float]] = []
        self._cells: dict[tuple[int, int], list[tuple[float, float, float, float]]] = {}
        for x, y, east, north in table:
            self.add(x, y, east, north)

    def __len__(self) -> int:
        return len(self._at)

    @property
    def table(self) -> Array:
        """East, north and the two parts of the direction of each, shape (places, 4)."""
        return np.array(self._at, dtype=np.float64).reshape(-1, 4)

    @property
    def lookup(self) -> Lookup:
        """The places, for look-up by position, without learned values."""
        places = np.full((len(self), PLACE_COLUMNS), np.nan)
        places[:, POSE], places[:, NUMBER] = self.table, np.arange(len(self))
        return lookup_of([places])

    def add(self, x: float, y: float, east: float, north: float) -> None:
        """One more place: east and north [m], and its direction, of length 1."""
        self._at.append((x, y, east, north))
        self._cells.setdefault((cell_of(x), cell_of(y)), []).append(self._at[-1])

    def is_near(self, x: float, y: float, east: float, north: float) -> bool:
        """Whether there is a place already."""
        column, row = cell_of(x), cell_of(y)
        cells = ((i, j) for i in (column - 1, column, column + 1) for j in (row - 1, row, row + 1))
        return any(
            distance < np.inf and abs(offset) <= JOINED * SPACING_M
            for cell in cells
            for offset, distance, _ in (seen_from(x, y, east, north, *place) for place in self._cells.get(cell, ()))
        )


@dataclass(frozen=True, eq=False)
class Matched:
    """Position of the points of a track between places; arrays of shape (points, 2) or (points,)."""

    place: Indices  # (points, 2), the places behind and ahead, -1 without one
    share: Array  # their weights
    sign: Array  # 1 if the place's direction is that of travel, else -1
    number: Indices  # (points,), index of this pass among all of the nearer place, from 0; -1 without a place
    number_this_way: Indices  # among those in this direction

    @property
    def is_known(self) -> NDArray[np.bool_]:
        """Whether each point is at a place."""
        return np.asarray(self.number >= 0)

    def select(self, points: Indices) -> Matched:
        """Of some points of the track, in their order."""
        number, this_way = self.number[points], self.number_this_way[points]
        return Matched(self.place[points], self.share[points], self.sign[points], number, this_way)

    def middles(self, size: int) -> Matched:
        """The middle point of each group of `size` points. It is at no place unless all points of the group are at one."""
        centre = self.select(np.arange(size // 2, len(self.number), size))
        is_whole = self.is_known.reshape(-1, size).all(axis=1)
        number, this_way = (np.where(is_whole, n, -1) for n in (centre.number, centre.number_this_way))
        return Matched(centre.place, centre.share, centre.sign, number, this_way)


def places_of(tracks: Sequence[DrivenTrack]) -> Places:
    """Places of all driven streets, in the order of their first pass."""
    places = Places()
    for track in tracks:
        for point in _known_points(track):
            if not places.is_near(*point[1:]):
                places.add(*point[1:])
    return places


def match_tracks(places: Places, tracks: Sequence[DrivenTrack]) -> list[Matched]:
    """Position of tracks between places, and the number of earlier passes of each."""
    pass_counts, last_m = np.full((len(places), 3), -1), np.full((len(places), 3), -np.inf)  # one way, the other, and either
    lookup = places.lookup
    numbers = lookup.places[:, NUMBER].astype(np.int64)
    matches, before_m = [], 0.0
    for track in tracks:
        place, share, sign = np.full((len(track), 2), -1), np.zeros((len(track), 2)), np.zeros((len(track), 2))
        number = np.full((len(track), 2), -1)
        for i, *point in _known_points(track):
            back, front, front_share, *signs = neighbour_places(*lookup, 0, *point)
            if back < 0:
                continue
            place[i], share[i], sign[i] = numbers[[back, front]], (1.0 - front_share, front_share), signs
            side, way_m = int(share[i, 1] > 0.5), before_m + i * STEP_M
            nearest, ways = place[i, side], [2, int(sign[i, side] < 0.0)]
            pass_counts[nearest, ways] += way_m - last_m[nearest, ways] > AGAIN_M
            last_m[nearest, ways] = way_m
            number[i] = pass_counts[nearest, ways]
        matches.append(Matched(place, share, sign, number[:, 0], number[:, 1]))
        before_m += len(track) * STEP_M + AGAIN_M
    return matches


def neighbour_pairs(tracks: Sequence[Matched]) -> dict[tuple[int, int], float]:
    """Consecutive places on some track, the lower number first, and whether they have the same direction (1, else -1)."""
    pairs: dict[tuple[int, int], float] = {}
    for track in tracks:
        last_place: tuple[int, float] | None = None
        for places, signs, has_place in zip(track.place.tolist(), track.sign.tolist(), track.is_known.tolist(), strict=True):
            if not has_place:
                last_place = None
                continue
            for place_sign in zip(places, signs, strict=True):
                if last_place is not None and last_place[0] != place_sign[0]:
                    pairs.setdefault(
                        (min(last_place[0], place_sign[0]), max(last_place[0], place_sign[0])), last_place[1] * place_sign[1]
                    )
                last_place = place_sign
    return pairs


def _known_points(track: DrivenTrack) -> list[tuple[int, float, float, float, float]]:
    index = np.flatnonzero(track.is_known)
    rows = zip(*(x[index].tolist() for x in (track.x, track.y, track.east, track.north)), strict=True)
    return [(i, *row) for i, row in zip(index.tolist(), rows, strict=True)]
