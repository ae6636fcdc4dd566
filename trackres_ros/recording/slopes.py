# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Computes the slope of the road from the altitude: only where the vehicle moves, as sure as the altitude is, and no steeper
than roads are.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SLOWEST_MPS = 0.5
STAND_S = 10.0  # of standing: long enough to tell whether the altitude runs away by itself
DRIFT, LEAST_DRIFT_M = 3.0, 5.0  # times what scatters about it, and at least: a run while standing that is none of noise
HARMLESS_SLOPE = 0.01  # what such a run would make of a drive at the usual speed
REACH_S = 120.0  # by which it may have begun before a stand, or end after it
STEEPEST = 0.2  # rise over run; a few streets are steeper, no road that recordings are made on
GRID_M = 5.0
SHORTEST_M, LONGEST_M = 200.0, 3000.0  # over which a slope is taken
SURE_SLOPE = 0.005  # standard deviation of a slope that is good enough
OF_A_LINE = 12.0**0.5  # standard deviation of the slope of a line over that of its points, and its length
MAD_TO_STD = 1.4826


class Slopes(NamedTuple):
    """Slopes along a drive.

    Attributes
    ----------
    value
        Rise over run, shape (n,); nan where it is not known.
    std
        Their standard deviation, by the error of the altitude.
    length_m
        Over how much of the way each is taken.
    """

    value: Array
    std: float
    length_m: float


def slopes(time_s: Array, speed: Array, altitude: Array, error_m: float = 0.0) -> Slopes:
    """Slope of the road along a drive.

    Parameters
    ----------
    time_s, speed, altitude
        Rising times [s], speeds [m/s] and altitudes [m] that may be nan, each of shape (n,).
    error_m
        Standard deviation of an error of the altitude that lasts longer than the way a slope is taken over, and does not show
        as scatter [m].

    Notes
    -----
    What the altitude does while the vehicle stands is no slope, and is taken out. Where it runs away while the vehicle stands,
    as that of a receiver or a pressure that still settles, it is not trusted for minutes before and after, either, or up to a
    stand in which it is still. The rest is fitted by straight lines over as much of the way as its noise and its steps ask for.
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
    return Slopes(found, noise * OF_A_LINE / length, length)


def _step(altitude: Array) -> float:
    """The step in which an altitude comes [m]."""
    steps = np.diff(np.unique(altitude))
    return float(steps.min()) if len(steps) else 0.0


def _lines(profile: Array, length: float) -> tuple[Array, Array]:
    """Level and slope of the straight line through what lies within half a length of each point of a profile."""
    half = max(1, min(round(0.5 * length / GRID_M), len(profile) // 2))
    place = np.arange(len(profile), dtype=float)
    sums = [np.concatenate(([0.0], np.cumsum(x))) for x in (np.ones(len(profile)), place, place**2, profile, place * profile)]
    begin, end = np.maximum(place - half, 0).astype(int), np.minimum(place + half + 1, len(profile)).astype(int)
    n, x, xx, y, xy = (s[end] - s[begin] for s in sums)
    slope = (n * xy - x * y) / np.maximum(n * xx - x**2, 1e-9)
    return (y - slope * x) / n + slope * place, slope / GRID_M


def _untrusted(time_s: Array, height: Array, speed: Array, moving: Mask) -> Mask:
    """Around each stand in which the altitude runs away, at most up to the stands before and after."""
    stands = [(a, b) for a, b in _runs(~moving) if time_s[b - 1] - time_s[a] >= STAND_S]
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


def _runs(mask: Mask) -> Iterator[tuple[int, int]]:
    """Begin and end of each run of true values."""
    edges = np.flatnonzero(np.diff(mask.astype(int), prepend=0, append=0))
    return zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
