# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Made drives round a block of streets, with positions as a satellite receiver gives them and a slope that is known."""

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from trackres_ros.route.lookup import learned_at, lookup_of

LATITUDE, LONGITUDE = 0.827, 0.1486  # rad
HALF_AXES_M = 420.0, 260.0
_TURN = np.linspace(0.0, 2.0 * np.pi, 4001)
_ROUND = np.stack([HALF_AXES_M[0] * np.cos(_TURN), HALF_AXES_M[1] * np.sin(_TURN)])
_WAY = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(_ROUND)))])
LAP_M = float(_WAY[-1])


def slope_at(way):
    """Rise over run of the street, so far round the block [m]."""
    angle = 2.0 * np.pi * way / LAP_M
    return 0.03 * np.sin(2.0 * angle) + 0.02 * np.cos(3.0 * angle + 1.0) + 0.012 * np.sin(7.0 * angle)


def place_at(way):
    """East and north [m]."""
    return tuple(np.interp(way % LAP_M, _WAY, part) for part in _ROUND)


def autoregression(n, rng, seconds, size, lead=2000):
    share = np.exp(-1.0 / seconds)
    return lfilter([1.0], [1.0, -share], rng.normal(0.0, size * np.sqrt(1.0 - share**2), n + lead))[lead:]


@dataclass(frozen=True)
class Drive:
    """One sample a second: speed [m/s], distance driven, way round the block [m], direction round it, positions [m] as shown."""

    speed: np.ndarray
    distance: np.ndarray
    way: np.ndarray
    direction: np.ndarray
    x: np.ndarray
    y: np.ndarray


def drive(seed, rounds=(1, 1, 1, 1), scatter_m=5.0, aside_m=2.0, hidden=()):
    """Round the block, each time one way (1) or the other (-1), with stops; on the right side of the street. Between the `hidden`
    ways no position comes.
    """
    rng = np.random.default_rng(seed)
    n = int(len(rounds) * LAP_M / 5.0) + 200
    corners = np.arange(0, n + 1, 40)
    speed = np.interp(np.arange(n), corners, rng.uniform(3.0, 11.0, len(corners)))
    for place in rng.integers(0, n, 2 * len(rounds)):
        speed[place : place + 25] = 0.0
    for _ in range(2):  # no vehicle stops within a second
        speed = np.convolve(speed, np.full(9, 1.0 / 9.0), mode="same")
    distance = np.cumsum(speed)
    end = int(np.searchsorted(distance, len(rounds) * LAP_M))
    speed, distance = speed[:end], distance[:end]
    direction = np.array(rounds, dtype=float)[np.minimum((distance // LAP_M).astype(int), len(rounds) - 1)]
    way = np.where(direction > 0.0, distance % LAP_M, LAP_M - distance % LAP_M)
    x, y = place_at(way)
    ahead = place_at(way + direction)
    east, north = ahead[0] - x, ahead[1] - y
    x, y = x + aside_m * north, y - aside_m * east
    x, y = (p + autoregression(end, rng, 40.0, scatter_m) + rng.normal(0.0, 1.5, end) for p in (x, y))
    for begin, stop in hidden:
        x = np.where((way > begin) & (way < stop), np.nan, x)
    return Drive(speed, distance, way, direction, x, y)


def learned_by(route):
    """A function of a place [m] and a direction of travel: value and std there; a slope is the rise along the travel."""
    lookup = lookup_of([route.table(route.frame)])
    return lambda x, y, east, north: learned_at(*lookup, 0, x, y, east, north)


def position_of(lap_drive):
    """Latitude and longitude of a drive as shown [rad]."""
    metres = 6371008.8
    return LATITUDE + lap_drive.y / metres, LONGITUDE + lap_drive.x / (metres * np.cos(LATITUDE))
