# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Converts scattered, sparse positions to a course in local metres over the driven distance."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackres_ros.arrays import Array, Mask
from trackres_ros.kernels.marks import kernel
from trackres_ros.units import EARTH_M

STEP_M = 10.0  # between points of a track
SMOOTH_M = 10.0  # standard deviation of the mean over distance: satellite positions scatter by 5 to 20 m
LONGEST_GAP_M = 100.0  # between positions: beyond it a straight line may deviate by more than the width of a street
STRAIGHT = (0.5, 1.5)  # way by positions over way driven: outside of it one of them is wrong
TURN = 2.0 * math.pi
FARTHEST_M = 125_000.0  # distance of a place from the map's origin: up to it a map is flat to half a percent


@kernel
def flat(latitude: Any, longitude: Any, of_latitude: Any, of_longitude: Any) -> tuple[Any, Any]:
    """East and north of a place [m] that another one lies, all in rad, on a flat map; numbers, or arrays."""
    east = np.remainder(of_longitude - longitude + math.pi, 2.0 * math.pi) - math.pi
    return EARTH_M * math.cos(latitude) * east, EARTH_M * (of_latitude - latitude)


def on_same_turn(longitude: Array, reference: float) -> Array:
    """Longitudes [rad], moved by whole turns to be next to a reference; those already next to it keep their bits."""
    return longitude - TURN * np.round((longitude - reference) / TURN)


@dataclass(frozen=True, slots=True)
class Frame:
    """Local metres, east and north of a place [rad]."""

    latitude: float
    longitude: float

    @classmethod
    def of_positions(cls, latitude: Array, longitude: Array) -> Frame:
        """The middle of positions [rad], on either side of the date line too; zero without any."""
        has_position = np.isfinite(latitude) & np.isfinite(longitude)
        if not has_position.any():
            return cls(0.0, 0.0)
        return cls(
            float(np.median(latitude[has_position])),
            float(np.median(on_same_turn(longitude[has_position], longitude[has_position][0]))),
        )

    def metres(self, latitude: Array, longitude: Array) -> tuple[Array, Array]:
        """East and north [m] of positions [rad]; nan where these are nan, or too far for a flat map."""
        x, y = flat(self.latitude, self.longitude, latitude, longitude)
        is_near = np.hypot(x, y) < FARTHEST_M
        return np.where(is_near, x, np.nan), np.where(is_near, y, np.nan)

    def position(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Latitude and longitude [rad] of places [m], the latter from -pi to pi."""
        longitude = self.longitude + x / (EARTH_M * math.cos(self.latitude))
        return self.latitude + y / EARTH_M, on_same_turn(longitude, 0.0)


@dataclass(frozen=True, eq=False)
class DrivenTrack:
    """Points every `STEP_M` of a drive; arrays of shape (n,)."""

    x: Array  # east [m]
    y: Array  # north [m]
    east: Array  # direction of travel, of length 1
    north: Array
    is_known: Mask  # where positions and the distance driven agree

    def __len__(self) -> int:
        return len(self.x)

    def nearest_index(self, distance: Array) -> NDArray[np.int64]:
        """The point at each distance driven [m]."""
        return np.clip(np.round(distance / STEP_M).astype(np.int64), 0, len(self) - 1)


def track_of(distance: Array, x: Array, y: Array) -> DrivenTrack:
    """The track of a drive.

    Parameters
    ----------
    distance
        Driven since its start at each sample [m], rising; shape (n,).
    x, y
        East and north at each [m], nan without a position; shape (n,).

    Notes
    -----
    Between positions the path is straight, by the distance driven; between positions further apart than `LONGEST_GAP_M` it is
    unknown. A mean over some metres reduces scatter; a standstill has the weight of one point.
    """
    grid = np.arange(0.0, float(distance[-1]) + 2.0 * STEP_M, STEP_M)
    has_position = np.isfinite(x) & np.isfinite(y)
    if has_position.sum() < 2:
        blank = np.full(len(grid), np.nan)
        return DrivenTrack(blank, blank, blank, blank, np.zeros(len(grid), dtype=bool))
    distances, index = np.unique(np.round(distance[has_position], 1), return_inverse=True)
    count = np.bincount(index.ravel())
    fixes = [np.bincount(index.ravel(), weights=p[has_position]) / count for p in (x, y)]
    next_index = np.clip(np.searchsorted(distances, grid), 1, max(len(distances) - 1, 1))
    is_known = (grid >= distances[0]) & (grid <= distances[-1])
    if len(distances) > 1:
        is_known &= distances[next_index] - distances[next_index - 1] <= LONGEST_GAP_M
    reach = math.ceil(3.0 * SMOOTH_M / STEP_M)
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) * STEP_M / SMOOTH_M) ** 2)
    share = np.convolve(is_known, weights, mode="full")[reach:-reach]
    mean_x, mean_y = (
        np.convolve(np.where(is_known, np.interp(grid, distances, p), 0.0), weights, mode="full")[reach:-reach]
        / np.maximum(share, 1e-9)
        for p in fixes
    )
    east, north = np.gradient(mean_x, STEP_M), np.gradient(mean_y, STEP_M)
    way = np.hypot(east, north)
    is_known &= (way > STRAIGHT[0]) & (way < STRAIGHT[1])
    way = np.where(is_known, way, 1.0)
    return DrivenTrack(mean_x, mean_y, east / way, north / way, is_known)
