# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Derives a yaw rate from heading, wheel speeds of both sides or positions, if it was not recorded."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from trackres_ros.diagnosis.prepare.sampling import ordered
from trackres_ros.diagnosis.prepare.session import Array, Cumulative
from trackres_ros.recording.samples import Series
from trackres_ros.units import EARTH_M, MAD_TO_STD

SIDES = ("left", "right")
LONGEST_GAP_S = 2.0
REACHES_S = (1.0, 2.0, 4.0)  # of positions to either side; the shortest precise enough is used
SURE_RADPS = 0.03  # largest acceptable standard deviation of a yaw rate
FEWEST_MOVING = 60  # steps
MAD_OF_SECOND_DIFFERENCE = MAD_TO_STD / 6.0**0.5


class Turning(NamedTuple):
    """Yaw rate [rad/s], positive to the left, mean over each step, nan where unknown; and its source."""

    yaw_rate: Array
    made_of: str


def turning(
    series: Mapping[str, Series], start: int, edges: Array, speed: Array, slowest: float, track_width: float | None
) -> Turning | None:
    """Yaw rate [rad/s] from the heading, else the sides' wheel speeds, else positions; None if none suffices.

    `start` [ns] is that of the `edges` of the steps [s], shape (n + 1,). `speed` is the mean over each step [m/s], shape (n,).
    Positions give a direction above the `slowest` speed [m/s]. `track_width` is the distance of left from right wheels [m].
    """
    if "heading" in series and np.isfinite(series["heading"].value).sum() > 1:
        return Turning(_of_angle(*ordered(series["heading"], start), edges), "heading")
    sides = [_side(series, side, start, edges) for side in SIDES]
    if track_width is not None and sides[0] is not None and sides[1] is not None:
        return Turning((sides[1] - sides[0]) / track_width, f"wheel speeds of both sides, {track_width:g} m apart")
    if "latitude" in series and "longitude" in series:
        found = _of_positions(series, start, edges, speed, slowest)
        return None if found is None else Turning(found, "positions")
    return None


def _of_angle(at: Array, angle: Array, edges: Array) -> Array:
    """Change of an angle over each step."""
    known = (edges[:-1] >= at[0]) & (edges[1:] <= at[-1])
    after = np.clip(np.searchsorted(at, edges[1:]), 1, len(at) - 1)
    known &= at[after] - at[after - 1] <= LONGEST_GAP_S
    return np.where(known, np.diff(np.interp(edges, at, np.unwrap(angle))) / np.diff(edges), np.nan)


def _side(series: Mapping[str, Series], side: str, start: int, edges: Array) -> Array | None:
    """Mean wheel speed of one side over each step; None without any."""
    roles = [role for role in series if role.startswith("wheel_speed/") and side in role.partition("/")[2].split("_")]
    of = [Cumulative.of(*ordered(series[r], start)).means(edges[:-1], edges[1] - edges[0]) for r in roles if _there(series[r])]
    return np.asarray(np.mean(of, axis=0)) if of else None


def _there(series: Series) -> bool:
    return int(np.isfinite(series.value).sum()) > 1


def _of_positions(series: Mapping[str, Series], start: int, edges: Array, speed: Array, slowest: float) -> Array | None:
    """Turn of the path from before a step to after it; nan at near standstill, or between forward and reverse."""
    (at, north), (also_at, east) = (ordered(series[role], start) for role in ("latitude", "longitude"))
    if len(at) < FEWEST_MOVING or len(also_at) < FEWEST_MOVING:
        return None
    middle = 0.5 * (edges[1:] + edges[:-1])
    east = np.interp(at, also_at, np.unwrap(east))
    x, y = EARTH_M * np.cos(np.median(north)) * (east - east[0]), EARTH_M * (north - north[0])
    noise = max(MAD_OF_SECOND_DIFFERENCE * float(np.median(np.abs(np.diff(z, 2)))) for z in (x, y))
    moving = np.abs(speed) > slowest
    if moving.sum() < FEWEST_MOVING:
        return None
    typical = float(np.median(np.abs(speed[moving])))
    spacing = float(np.median(np.diff(at)))
    precise = [r for r in REACHES_S if 6.0**0.5 * noise <= SURE_RADPS * typical * r**2 and r >= spacing]
    if not precise:
        return None
    reach = precise[0]
    before, now, after = (
        np.interp(middle + shift, at, x) + 1j * np.interp(middle + shift, at, y) for shift in (-reach, 0.0, reach)
    )
    turned = np.angle((after - now) * np.conj(now - before))
    one_way = [np.interp(middle + shift, middle, np.sign(speed) * moving) for shift in (-reach, 0.0, reach)]
    known = (np.abs(np.sum(one_way, axis=0)) > 3.0 - 1e-9) & (middle - reach >= at[0]) & (middle + reach <= at[-1])
    return np.where(known, turned / reach, np.nan)
