# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A source whose positions become slopes of a route, as if they had been recorded."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from trackres_ros.recording.roles import POSITION
from trackres_ros.recording.samples import Block, Finding, Source
from trackres_ros.route.follower import Follower
from trackres_ros.route.learned import RouteMap

GRADE = "grade"


def on_route(source: Source, route: RouteMap | None) -> Source:
    """The source with slopes of the route; as it is where there is no route, no position, or a slope that was recorded."""
    needed = {*POSITION, "speed"} <= set(source.roles)
    return source if route is None or not needed or GRADE in source.roles else _OnRoute(source, route)


class _OnRoute:
    """See `on_route`; a `Source`."""

    def __init__(self, source: Source, route: RouteMap) -> None:
        self._source, self._route = source, route

    @property
    def name(self) -> str:
        return self._source.name

    @property
    def roles(self) -> tuple[str, ...]:
        return (*self._source.roles, GRADE)

    @property
    def notes(self) -> tuple[str, ...]:
        return (*self._source.notes, "slopes are those of the route in the surroundings, by position")

    @property
    def findings(self) -> tuple[Finding, ...]:
        return self._source.findings

    @property
    def zero_is_unset(self) -> bool:
        return self._source.zero_is_unset

    def blocks(self, max_rows: int = 65536) -> Iterator[Block]:
        follower, roles = Follower(self._route), self._source.roles
        latitude_role, longitude_role = (roles.index(role) for role in POSITION)
        speed_role, latitude, latitude_ns = roles.index("speed"), np.nan, -1
        for block in self._source.blocks(max_rows):
            before, slopes = [], []
            of_use = np.flatnonzero(np.isin(block.role, (latitude_role, longitude_role, speed_role)))
            rows = zip(of_use.tolist(), *(x[of_use].tolist() for x in (block.role, block.stamp_ns, block.value)), strict=True)
            for row, role, stamp_ns, value in rows:
                if role == latitude_role:
                    latitude, latitude_ns = value, stamp_ns
                elif role == longitude_role:
                    if stamp_ns == latitude_ns:
                        follower.position(stamp_ns, latitude, value)
                else:
                    slope = follower.speed(stamp_ns, value)
                    if slope is not None and np.isfinite(slope):
                        before.append(row)
                        slopes.append(slope)
            yield Block(
                np.insert(block.role, before, len(roles)),
                np.insert(block.stamp_ns, before, block.stamp_ns[before]),
                np.insert(block.arrival_ns, before, block.arrival_ns[before]),
                np.insert(block.value, before, slopes),
            )
