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
    has_altitude = np.isfinite(altitude)
    no_slopes = Slopes(np.full(len(time_s), np.nan), np.nan, np.nan)
    if has_altitude.sum() < 2:
        return no_slopes
    height = np.interp(time_s, time_s[has_altitude], altitude[has_altitude])
    is_moving = np.abs(speed) > SLOWEST_MPS
    steps = np.nan_to_num(0.5 * (speed[1:] + speed[:-1])) * np.diff(time_s)
    distance, place = (np.concatenate(([0.0], np.cumsum(increments))) for increments in (np.abs(steps), steps))
    climb = np.where(is_moving[1:] & is_moving[:-1], np.diff(height), 0.0)
    height_along = np.concatenate(([0.0], np.cumsum(climb)))
    if distance[-1] < SHORTEST_M:
        return no_slopes
    grid = np.arange(0.0, distance[-1] + GRID_M, GRID_M)
    unique_distance, first_rows = np.unique(distance, return_index=True)
    profile, place_on_grid = (np.interp(grid, unique_distance, increments[first_rows]) for increments in (height_along, place))
    step = _step(altitude[has_altitude])
    roughness = profile - _lines(place_on_grid, profile, SHORTEST_M)[0]
    roughness = roughness[np.isfinite(roughness)]
    if not len(roughness):
        return no_slopes
    noise = max(MAD_TO_STD * float(np.median(np.abs(roughness - np.median(roughness)))), step / OF_A_LINE, error_m)
    length = min(max(noise * OF_A_LINE / SURE_SLOPE, SHORTEST_M), LONGEST_M)
    slope_values = np.interp(distance, grid, _lines(place_on_grid, profile, length)[1])
    slope_values[~(np.abs(slope_values) <= STEEPEST) | _untrusted(time_s, height, speed, is_moving)] = np.nan
    return Slopes(slope_values, noise * OF_A_LINE / length, length)


def _step(altitude: Array) -> float:
    """The step in which an altitude comes [m]."""
    steps = np.diff(np.unique(altitude))
    return float(steps.min()) if len(steps) else 0.0


def _lines(positions: Array, profile: Array, length: float) -> tuple[Array, Array]:
    """Level and slope of the straight line, by the `positions` along the way [m], through the points of a profile within half a
    length of each, which are `GRID_M` apart along the drive; nan where these hardly come ahead.
    """
    half_width = max(1, min(round(0.5 * length / GRID_M), len(profile) // 2))
    sums = [
        np.concatenate(([0.0], np.cumsum(x)))
        for x in (np.ones(len(profile)), positions, positions**2, profile, positions * profile)
    ]
    rows = np.arange(len(profile))
    begin, end = np.maximum(rows - half_width, 0), np.minimum(rows + half_width + 1, len(profile))
    n, x, xx, y, xy = (s[end] - s[begin] for s in sums)
    spread = n * xx - x**2
    variance_scale = GRID_M**2 * n**2 * (n**2 - 1.0) / OF_A_LINE**2
    slope = (n * xy - x * y) / np.where(spread > LEAST_AHEAD**2 * variance_scale, spread, np.nan)
    return (y - slope * x) / n + slope * positions, slope


def _untrusted(time_s: Array, height: Array, speed: Array, is_moving: Mask) -> Mask:
    """Around each standstill with a drifting altitude, at most up to the standstills before and after."""
    stands = [
        (stand_begin, stand_end)
        for stand_begin, stand_end in runs_of(~is_moving)
        if time_s[stand_end - 1] - time_s[stand_begin] >= STAND_S
    ]
    usual_speed = float(np.median(np.abs(speed[is_moving])))
    is_untrusted = np.zeros(len(time_s), dtype=bool)
    for i, (stand_begin, stand_end) in enumerate(stands):
        t = time_s[stand_begin:stand_end] - time_s[stand_begin]
        rate, level = np.polyfit(t, height[stand_begin:stand_end], 1)
        scatter = float(np.std(height[stand_begin:stand_end] - level - rate * t))
        if abs(rate) > HARMLESS_SLOPE * usual_speed and abs(rate) * t[-1] > max(DRIFT * scatter, LEAST_DRIFT_M):
            begin, end = np.searchsorted(time_s, (time_s[stand_begin] - REACH_S, time_s[stand_end - 1] + REACH_S))
            previous_end = stands[i - 1][1] if i else 0
            next_begin = stands[i + 1][0] if i + 1 < len(stands) else len(time_s)
            is_untrusted[max(begin, previous_end) : min(end, next_begin)] = True
    return is_untrusted


def runs_of(mask: Mask) -> Iterator[tuple[int, int]]:
    """Begin and end of each run of true values."""
    edges = np.flatnonzero(np.diff(mask.astype(int), prepend=0, append=0))
    return zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
