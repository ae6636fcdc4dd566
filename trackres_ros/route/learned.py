# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Learned values of a route's places."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trackres_ros.route.follower import SLOPES, TORQUES
from trackres_ros.route.lookup import NUMBER, PLACE_COLUMNS, POSE, STDS, VALUES, Array, Lookup, lookup_of
from trackres_ros.route.matching import Places
from trackres_ros.route.track import Frame

SLOPE, TORQUE = "slope", "torque"
KINDS = {SLOPE: SLOPES, TORQUE: TORQUES}


@dataclass(frozen=True, eq=False)
class RouteMap:
    """A slope or a torque by place; arrays of shape (places,), or (places, 2)."""

    kind: str  # `SLOPE`: rise over run in the direction of a place; `TORQUE`: against travel [Nm]
    latitude: Array  # rad
    longitude: Array
    course: Array  # direction of a place, about the upward axis from east [rad]
    value: Array  # (places, 2), for travel in the direction of a place, and against it; nan where not driven
    std: Array
    passes: NDArray[np.int64]  # number of passes used for learning
    source: Path | None = None  # its table; None for one that is not read from a file

    def __len__(self) -> int:
        return len(self.latitude)

    def times(self, factor: float) -> RouteMap:
        """The same map with its values multiplied."""
        return replace(self, value=factor * self.value, std=abs(factor) * self.std)

    @cached_property
    def frame(self) -> Frame:
        """Local metres about the middle of it."""
        return Frame.of_positions(self.latitude, self.longitude)

    @cached_property
    def places(self) -> Places:
        """The places, to be matched."""
        return Places(self.table(self.frame)[:, POSE].tolist())

    def table(self, frame: Frame) -> Array:
        """Places in a frame, with their learned values, for `lookup.lookup_of`."""
        table = np.empty((len(self), PLACE_COLUMNS))
        table[:, POSE] = np.stack(
            [*frame.metres(self.latitude, self.longitude), np.cos(self.course), np.sin(self.course)], axis=1
        )
        table[:, NUMBER], table[:, VALUES], table[:, STDS] = np.arange(len(self)), self.value, self.std
        return table


def of_kind(route: Sequence[RouteMap], kind: str) -> RouteMap | None:
    """The map of a kind, or None."""
    return next((route_map for route_map in route if route_map.kind == kind), None)


def frame_of(route: Sequence[RouteMap]) -> Frame:
    """Local metres about the middle of all maps."""
    return Frame.of_positions(
        *(np.concatenate([np.empty(0), *(getattr(m, name) for m in route)]) for name in ("latitude", "longitude"))
    )


def followed_in(route: Sequence[RouteMap], frame: Frame) -> Lookup:
    """All maps ready for the follower."""
    tables = {KINDS[m.kind]: m.table(frame) for m in route}
    return lookup_of([tables.get(kind, np.empty((0, PLACE_COLUMNS))) for kind in sorted(KINDS.values())])
