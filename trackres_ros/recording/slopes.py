# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Computes the slope of the road from the altitude: only in motion, as accurate as the altitude, and no steeper
than roads are.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from trackres_ros.arrays import Array, Mask
from trackres_ros.units import MAD_TO_STD

SLOWEST_MPS = 0.5
STAND_S = 10.0  # of standing: long enough to detect a drifting altitude
DRIFT, LEAST_DRIFT_M = 3.0, 5.0  # times the scatter, and a minimum: a drift at standstill that is not noise
HARMLESS_SLOPE = 0.01  # slope error due to such a drift at the usual speed
REACH_S = 120.0  # time by which the drift may precede or outlast a standstill
STEEPEST = 0.2  # rise over run; a few streets are steeper, no road that recordings are made on
GRID_M = 5.0
SHORTEST_M, LONGEST_M = 200.0, 3000.0  # distance over which a slope is fitted
SURE_SLOPE = 0.005  # sufficient standard deviation of a slope
OF_A_LINE = 12.0**0.5  # standard deviation of the slope of a line over that of its points, and its length


class Slopes(NamedTuple):
    """Slopes along a drive."""

    value: Array  # rise over run the way the vehicle points, shape (n,); nan where unknown
    std: float  # their standard deviation, due to the error of the altitude
    length_m: float  # distance over which each is fitted


def slopes(time_s: Array, speed: Array, altitude: Array, error_m: float = 0.0) -> Slopes:
    """Slope of the road along a drive.

    `time_s`, `speed`, `altitude`: rising times [s], speeds [m/s] and altitudes [m] that may be nan, each of shape (n,);
    `error_m`: standard deviation of a slow error of the altitude, which lasts longer than the fitted distance and does not show
    as scatter [m].

    Notes
    -----
    Changes of the altitude at standstill are no slope, and are removed. If it drifts at standstill, such as that of a
    receiver or a pressure that still settles, it is ignored for minutes before and after, or up to a standstill without drift.
    The rest is fitted by straight lines over a distance that depends on its noise and its steps.
    """
    known = np.isfinite(altitude)
    unknown = Slopes(np.full(len(time_s), np.nan), np.nan, np.nan)
    if known.sum() < 2:
        return unknown
    height = np.interp(time_s, time_s[known], altitude[known])
    moving = np.abs(speed) > SLOWEST_MPS
    steps = np.abs(0.5 * (speed[1:] + speed[:-1])) * np.diff(time_s)
    distance = np.concatenate(([0.0], np.cumsum(np.nan_to_num(steps))))
    rises = np.where(moving[1:] & moving[:-1], np.diff(height), 0.0)
    along = np.concatenate(([0.0], np.cumsum(rises)))
    if distance[-1] < SHORTEST_M:
        return unknown
    at = np.arange(0.0, distance[-1] + GRID_M, GRID_M)
    unique, first = np.unique(distance, return_index=True)
    profile = np.interp(at, unique, along[first])
    step = _step(altitude[known])
    rough = profile - _lines(profile, SHORTEST_M)[0]
    noise = max(MAD_TO_STD * float(np.median(np.abs(rough - np.median(rough)))), step / OF_A_LINE, error_m)
    length = min(max(noise * OF_A_LINE / SURE_SLOPE, SHORTEST_M), LONGEST_M)
    found = np.interp(distance, at, _lines(profile, length)[1])
    found[~(np.abs(found) <= STEEPEST) | _untrusted(time_s, height, speed, moving)] = np.nan
    found[speed < 0.0] *= -1.0  # a vehicle that reverses downhill points uphill
    return Slopes(found, noise * OF_A_LINE / length, length)


def _step(altitude: Array) -> float:
    """The step in which an altitude comes [m]."""
    steps = np.diff(np.unique(altitude))
    return float(steps.min()) if len(steps) else 0.0


def _lines(profile: Array, length: float) -> tuple[Array, Array]:
    """Level and slope of the straight line through the points within half a length of each point of a profile."""
    half = max(1, min(round(0.5 * length / GRID_M), len(profile) // 2))
    place = np.arange(len(profile), dtype=float)
    sums = [np.concatenate(([0.0], np.cumsum(x))) for x in (np.ones(len(profile)), place, place**2, profile, place * profile)]
    begin, end = np.maximum(place - half, 0).astype(int), np.minimum(place + half + 1, len(profile)).astype(int)
    n, x, xx, y, xy = (s[end] - s[begin] for s in sums)
    slope = (n * xy - x * y) / np.maximum(n * xx - x**2, 1e-9)
    return (y - slope * x) / n + slope * place, slope / GRID_M


def _untrusted(time_s: Array, height: Array, speed: Array, moving: Mask) -> Mask:
    """Around each standstill with a drifting altitude, at most up to the standstills before and after."""
    stands = [(a, b) for a, b in runs_of(~moving) if time_s[b - 1] - time_s[a] >= STAND_S]
    usual = float(np.median(np.abs(speed[moving])))
    bad = np.zeros(len(time_s), dtype=bool)
    for i, (a, b) in enumerate(stands):
        t = time_s[a:b] - time_s[a]
        rate, level = np.polyfit(t, height[a:b], 1)
        scatter = float(np.std(height[a:b] - level - rate * t))
        if abs(rate) > HARMLESS_SLOPE * usual and abs(rate) * t[-1] > max(DRIFT * scatter, LEAST_DRIFT_M):
            begin, end = np.searchsorted(time_s, (time_s[a] - REACH_S, time_s[b - 1] + REACH_S))
            before = stands[i - 1][1] if i else 0
            after = stands[i + 1][0] if i + 1 < len(stands) else len(time_s)
            bad[max(begin, before) : min(end, after)] = True
    return bad


def runs_of(mask: Mask) -> Iterator[tuple[int, int]]:
    """Begin and end of each run of true values."""
    edges = np.flatnonzero(np.diff(mask.astype(int), prepend=0, append=0))
    return zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
