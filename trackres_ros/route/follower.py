# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Follows a vehicle on a route that was learned: positions and speeds come in, one by one, and the slope under it goes out."""

from __future__ import annotations

import math

import numpy as np

from trackres_ros.route.learned import RouteMap
from trackres_ros.units import NANOSECOND

COURSE_M = 15.0  # between two positions that say where it is heading: their scatter is a part of it
FARTHEST_M = 150.0  # between two positions: the way between them is not known
MOVING_MPS = 0.5  # slower, positions say nothing of where it is heading
LONGEST_S, LONGEST_M = 10.0, 100.0  # without a position, that its place is carried on by its speed
EVERY_S = 0.2  # of the slopes that go out


class Follower:
    """Where a vehicle is on a route.

    Parameters
    ----------
    route
        Slopes by place.
    """

    def __init__(self, route: RouteMap) -> None:
        self._route = route
        self._anchor: tuple[float, float] | None = None  # the position that the course counts from
        self._at: tuple[float, float] | None = None
        self._course: tuple[float, float] | None = None
        self._backward = False
        self._since_m = 0.0
        self._ahead_m = 0.0  # driven since the last position
        self._fixed_ns = self._now_ns = self._told_ns = 0

    def position(self, stamp_ns: int, latitude: float, longitude: float) -> None:
        """A position came [rad]."""
        x, y = (float(p[0]) for p in self._route.frame.metres(np.array([latitude]), np.array([longitude])))
        if not (math.isfinite(x) and math.isfinite(y)):
            return
        if self._anchor is not None:
            east, north = x - self._anchor[0], y - self._anchor[1]
            moved = math.hypot(east, north)
            if moved > FARTHEST_M:
                self._course = self._anchor = None
            elif moved >= COURSE_M and self._since_m > 0.5 * COURSE_M:
                self._course = east / moved, north / moved
                self._anchor, self._since_m = (x, y), 0.0
        if self._anchor is None:
            self._anchor, self._since_m = (x, y), 0.0
        self._at, self._fixed_ns = (x, y), stamp_ns
        self._ahead_m = 0.0

    def speed(self, stamp_ns: int, speed: float) -> float | None:
        """A speed came [m/s]: the slope under the vehicle, rise over run the way it points; nan beside the route, None where it
        was told a moment ago.
        """
        if not math.isfinite(speed):
            return None
        self._since_m += abs(speed) * _seconds(self._now_ns, stamp_ns)
        self._ahead_m += abs(speed) * _seconds(max(self._now_ns, self._fixed_ns), stamp_ns)
        self._now_ns = max(stamp_ns, self._now_ns)
        if abs(speed) > MOVING_MPS:
            if self._backward != (speed < 0.0):  # it comes back on its way
                self._course = None if self._course is None else (-self._course[0], -self._course[1])
            self._backward = speed < 0.0
        if 0.0 <= (stamp_ns - self._told_ns) * NANOSECOND < EVERY_S:
            return None
        self._told_ns = stamp_ns
        return self._slope(stamp_ns)

    def _slope(self, stamp_ns: int) -> float:
        late = (stamp_ns - self._fixed_ns) * NANOSECOND > LONGEST_S and self._ahead_m > 0.0
        if self._at is None or self._course is None or late or self._ahead_m > LONGEST_M:
            return math.nan
        (x, y), (east, north) = self._at, self._course
        rise, _ = self._route.at(x + self._ahead_m * east, y + self._ahead_m * north, east, north)
        return -rise if self._backward else rise


def _seconds(before_ns: int, now_ns: int) -> float:
    """Time since a stamp, at most `LONGEST_S`; none where there was no stamp yet."""
    return min(max((now_ns - before_ns) * NANOSECOND, 0.0), LONGEST_S) if before_ns else 0.0
