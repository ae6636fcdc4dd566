# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Matches drives to themselves: places along streets, and where a drive is between them, whichever way it goes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trackres_ros.route.track import STEP_M, Track

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Between = tuple[tuple[int, int], tuple[float, float], tuple[float, float]]

SPACING_M = 20.0  # of places along a street
ASIDE_M = 25.0  # two drives on one street lie as far apart as the scatter of positions and its lanes make them
ALIKE = math.cos(math.radians(45.0))  # of directions: less is a street that crosses
REACH = 1.5  # spacings ahead or behind that a place is looked for
JOINED = 0.75  # of a spacing: no new place so near to another
SIDEWAYS = 0.5  # how much distance aside counts beside distance along
AGAIN_M = 150.0  # driven before a place is passed once more
CELL_M = 50.0  # of the grid in which places are looked up: more than ASIDE_M and REACH spacings come to


class Places:
    """Places on streets, each with a direction along its street.

    Parameters
    ----------
    x, y, east, north
        East and north of each [m], and its direction, of length 1.
    """

    def __init__(self, x: Sequence[float] = (), y: Sequence[float] = (), east: Sequence[float] = (), north: Sequence[float] = ()):
        self._at: list[tuple[float, float, float, float]] = []
        self._cells: dict[tuple[int, int], list[int]] = {}
        for place in zip(x, y, east, north, strict=True):
            self.add(*place)

    def __len__(self) -> int:
        return len(self._at)

    @property
    def table(self) -> Array:
        """East, north and the two parts of the direction of each, shape (places, 4)."""
        return np.array(self._at, dtype=np.float64).reshape(-1, 4)

    def add(self, x: float, y: float, east: float, north: float) -> None:
        """One more place."""
        self._cells.setdefault((math.floor(x / CELL_M), math.floor(y / CELL_M)), []).append(len(self._at))
        self._at.append((x, y, east, north))

    def is_near(self, x: float, y: float, east: float, north: float) -> bool:
        """Whether there is a place already."""
        return any(abs(along) <= JOINED * SPACING_M for along, _, _, _ in self._around(x, y, east, north))

    def between(self, x: float, y: float, east: float, north: float) -> Between:
        """Where one is who travels in a direction: the places behind and ahead, their shares, and whether they point along (1)
        or against (-1); places of -1 where there is none near.
        """
        behind = ahead = None
        for found in self._around(x, y, east, north):
            if found[0] <= 0.0:
                behind = found if behind is None or found[1] < behind[1] else behind
            else:
                ahead = found if ahead is None or found[1] < ahead[1] else ahead
        if behind is not None and ahead is not None:
            share = behind[0] / (behind[0] - ahead[0])
            return (behind[2], ahead[2]), (1.0 - share, share), (behind[3], ahead[3])
        only = behind or ahead
        if only is None or abs(only[0]) > JOINED * SPACING_M:
            return (-1, -1), (0.0, 0.0), (0.0, 0.0)
        return (only[2], only[2]), (1.0, 0.0), (only[3], only[3])

    def _around(self, x: float, y: float, east: float, north: float) -> list[tuple[float, float, int, float]]:
        """Places on the same street: distance along the travel [m], how far they count as, which, and 1 or -1."""
        column, row = math.floor(x / CELL_M), math.floor(y / CELL_M)
        found = []
        for cell in ((i, j) for i in (column - 1, column, column + 1) for j in (row - 1, row, row + 1)):
            for place in self._cells.get(cell, ()):
                px, py, of_east, of_north = self._at[place]
                alike = of_east * east + of_north * north
                if abs(alike) < ALIKE:
                    continue
                along = (px - x) * east + (py - y) * north
                aside = abs((py - y) * east - (px - x) * north)
                if aside <= ASIDE_M and abs(along) <= REACH * SPACING_M:
                    found.append((along, abs(along) + SIDEWAYS * aside, place, math.copysign(1.0, alike)))
        return found


@dataclass(frozen=True, eq=False)
class Matched:
    """Where the points of a track are between places.

    Attributes
    ----------
    place, share, sign
        The places behind and ahead, -1 where it is at none, how much each counts, and 1 where the place's direction is that of
        travel, -1 where it is the other one; shape (points, 2).
    number, number_this_way
        Which of all passes of the nearer place this is, and which of those in this direction, from 0; -1 where it is at none.
        Shape (points,).
    """

    place: Indices
    share: Array
    sign: Array
    number: Indices
    number_this_way: Indices

    @property
    def known(self) -> NDArray[np.bool_]:
        """Where it is at a place."""
        return np.asarray(self.number >= 0)

    def at(self, points: Indices) -> Matched:
        """Of some points of the track, in their order."""
        number, this_way = self.number[points], self.number_this_way[points]
        return Matched(self.place[points], self.share[points], self.sign[points], number, this_way)

    def middles(self, each: int) -> Matched:
        """The middle one of each so many points; at no place where not all of them are at one."""
        middle = self.at(np.arange(each // 2, len(self.number), each))
        whole = self.known.reshape(-1, each).all(axis=1)
        number, this_way = (np.where(whole, n, -1) for n in (middle.number, middle.number_this_way))
        return Matched(middle.place, middle.share, middle.sign, number, this_way)


def places_of(tracks: Sequence[Track]) -> Places:
    """Places of all streets that were driven, in the order in which they were first."""
    places = Places()
    for track in tracks:
        for at in _known(track):
            if not places.is_near(*at[1:]):
                places.add(*at[1:])
    return places


def matched(places: Places, tracks: Sequence[Track]) -> list[Matched]:
    """Where tracks are between places, and how often each was passed until then."""
    passes, last = np.full((len(places), 3), -1), np.full((len(places), 3), -np.inf)  # one way, the other, and either
    found, before_m = [], 0.0
    for track in tracks:
        place, share, sign = np.full((len(track), 2), -1), np.zeros((len(track), 2)), np.zeros((len(track), 2))
        number = np.full((len(track), 2), -1)
        for i, *at in _known(track):
            place[i], share[i], sign[i] = places.between(*at)
            if place[i, 0] < 0:
                continue
            side, here = int(share[i, 1] > 0.5), before_m + i * STEP_M
            nearer, ways = place[i, side], [2, int(sign[i, side] < 0.0)]
            passes[nearer, ways] += here - last[nearer, ways] > AGAIN_M
            last[nearer, ways] = here
            number[i] = passes[nearer, ways]
        found.append(Matched(place, share, sign, number[:, 0], number[:, 1]))
        before_m += len(track) * STEP_M + AGAIN_M
    return found


def neighbours(tracks: Sequence[Matched]) -> dict[tuple[int, int], float]:
    """Places that follow one another on some track, the lower number first, and whether they point the same way (1, else -1)."""
    found: dict[tuple[int, int], float] = {}
    for track in tracks:
        before: tuple[int, float] | None = None
        for places, signs, known in zip(track.place.tolist(), track.sign.tolist(), track.known.tolist(), strict=True):
            if not known:
                before = None
                continue
            for now in zip(places, signs, strict=True):
                if before is not None and before[0] != now[0]:
                    found.setdefault((min(before[0], now[0]), max(before[0], now[0])), before[1] * now[1])
                before = now
    return found


def _known(track: Track) -> list[tuple[int, float, float, float, float]]:
    at = np.flatnonzero(track.known)
    rows = zip(*(x[at].tolist() for x in (track.x, track.y, track.east, track.north)), strict=True)
    return [(i, *row) for i, row in zip(at.tolist(), rows, strict=True)]
