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
LEAST_AHEAD = 0.4  # of the way of a line, ahead; half where the vehicle turns back once
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
    The rest is fitted by straight lines over a distance that depends on its noise and its steps. A vehicle that turns back is
    taken to retrace its way: such a line is over the way it points. Where it only moves to and fro, the slope is unknown.
    """
    known = np.isfinite(altitude)
    unknown = Slopes(np.full(len(time_s), np.nan), np.nan, np.nan)
    if known.sum() < 2:
        return unknown
    height = np.interp(time_s, time_s[known], altitude[known])
    moving = np.abs(speed) > SLOWEST_MPS
    steps = np.nan_to_num(0.5 * (speed[1:] + speed[:-1])) * np.diff(time_s)
    distance, place = (np.concatenate(([0.0], np.cumsum(of))) for of in (np.abs(steps), steps))
    rises = np.where(moving[1:] & moving[:-1], np.diff(height), 0.0)
    along = np.concatenate(([0.0], np.cumsum(rises)))
    if distance[-1] < SHORTEST_M:
        return unknown
    at = np.arange(0.0, distance[-1] + GRID_M, GRID_M)
    unique, first = np.unique(distance, return_index=True)
    profile, ahead = (np.interp(at, unique, of[first]) for of in (along, place))
    step = _step(altitude[known])
    rough = profile - _lines(ahead, profile, SHORTEST_M)[0]
    rough = rough[np.isfinite(rough)]
    if not len(rough):
        return unknown
    noise = max(MAD_TO_STD * float(np.median(np.abs(rough - np.median(rough)))), step / OF_A_LINE, error_m)
    length = min(max(noise * OF_A_LINE / SURE_SLOPE, SHORTEST_M), LONGEST_M)
    found = np.interp(distance, at, _lines(ahead, profile, length)[1])
    found[~(np.abs(found) <= STEEPEST) | _untrusted(time_s, height, speed, moving)] = np.nan
    return Slopes(found, noise * OF_A_LINE / length, length)


def _step(altitude: Array) -> float:
    """The step in which an altitude comes [m]."""
    steps = np.diff(np.unique(altitude))
    return float(steps.min()) if len(steps) else 0.0


def _lines(ahead: Array, profile: Array, length: float) -> tuple[Array, Array]:
    """Level and slope of the straight line, by the place `ahead` [m], through the points of a profile within half a length of
    each, which are `GRID_M` apart along the drive; nan where these hardly come ahead.
    """
    half = max(1, min(round(0.5 * length / GRID_M), len(profile) // 2))
    sums = [np.concatenate(([0.0], np.cumsum(x))) for x in (np.ones(len(profile)), ahead, ahead**2, profile, ahead * profile)]
    rows = np.arange(len(profile))
    begin, end = np.maximum(rows - half, 0), np.minimum(rows + half + 1, len(profile))
    n, x, xx, y, xy = (s[end] - s[begin] for s in sums)
    spread = n * xx - x**2
    straight = GRID_M**2 * n**2 * (n**2 - 1.0) / OF_A_LINE**2
    slope = (n * xy - x * y) / np.where(spread > LEAST_AHEAD**2 * straight, spread, np.nan)
    return (y - slope * x) / n + slope * ahead, slope


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
