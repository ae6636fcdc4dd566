# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Ground slope and torque from the surroundings by position: messages go to the route follower, and each step reads its
result.
"""

from __future__ import annotations

import math
from typing import Annotated

from trackres_ros.arrays import Array, IntArray
from trackres_ros.estimator import columns as at
from trackres_ros.estimator.columns import Times
from trackres_ros.estimator.constants import Constants
from trackres_ros.kernels.arithmetic import length
from trackres_ros.kernels.marks import kernel
from trackres_ros.route.follower import PLACE_KNOWN, SLOPE, TORQUE, TORQUE_STD, drive_on, look, take_position
from trackres_ros.route.track import FARTHEST_M, flat
from trackres_ros.units import NANOSECOND

TOGETHER_NS = 50_000_000  # between the stamps of latitude and longitude: a bus sends them in two messages
PLACE_UNKNOWN = int(at.Reason.PLACE_UNKNOWN)


@kernel
def has_route(k: Constants) -> bool:
    """Whether the surroundings have data by place."""
    return k.number.slopes_by_place or k.number.torques_by_place


@kernel
def position_came(k: Constants, times: IntArray, values: Array, followed: Array) -> None:
    """A latitude or a longitude was accepted: it is a position once both of about one time came. Each serves one position."""
    latitude, longitude = Times(times[at.LATITUDE]), Times(times[at.LONGITUDE])
    if not has_route(k) or latitude.fresh == 0 or longitude.fresh == 0:
        return
    if abs(latitude.last_stamp - longitude.last_stamp) <= TOGETHER_NS:
        latitude.fresh = longitude.fresh = 0
        position_at(k, followed, values[at.LATITUDE], values[at.LONGITUDE])


@kernel
def position_at(k: Constants, followed: Array, latitude: float, longitude: float) -> None:
    """It is at a position [rad]."""
    x, y = flat(k.number.route_latitude, k.number.route_longitude, latitude, longitude)
    if not length(x, y) < FARTHEST_M:
        x = y = math.nan
    take_position(followed, x, y)


@kernel
def ground_now(k: Constants, times: IntArray, followed: Array, speed: float, elapsed: int) -> tuple[float, float, float, bool]:
    """Ground at an accepted speed [m/s], given the time since the last one [ns].

    Returns
    -------
    slope, torque, torque_std, known
        Slope in the vehicle's direction, torque against travel [Nm] and its standard deviation, nan where unknown; and whether
        the position on the route is known.
    """
    if not has_route(k):
        return math.nan, math.nan, math.nan, True
    now, latitude, longitude = Times(times[at.SPEED]), Times(times[at.LATITUDE]), Times(times[at.LONGITUDE])
    # If half of a position was refused, the earlier half is used.
    since_position = now.last_stamp - min(latitude.last_stamp, longitude.last_stamp)
    drive_on(followed, speed, min(elapsed, k.number.position_hold_ns) * NANOSECOND, since_position * NANOSECOND)
    is_old = now.last_arrival - min(latitude.last_arrival, longitude.last_arrival) > k.number.position_hold_ns
    look(k.route_cells, k.route_places, followed, is_old)
    return followed[SLOPE], followed[TORQUE], followed[TORQUE_STD], followed[PLACE_KNOWN] > 0.0


@kernel
def is_missing(k: Constants, grade: float, slope: float, torque: float) -> bool:
    """Whether the surroundings have data by place, but not for this one. A measured slope has priority over theirs."""
    no_slope = k.number.slopes_by_place and math.isnan(grade) and math.isnan(slope)
    return no_slope or (k.number.torques_by_place and math.isnan(torque))


@kernel
def of_place(k: Constants, known: bool, grade: float, slope: float, torque: float) -> int:
    """The reason to report if the surroundings have no data because the place is unknown, else 0."""
    return PLACE_UNKNOWN if not known and is_missing(k, grade, slope, torque) else 0


@kernel
def follow_along(
    k: Constants,
    followed: Array,
    times: Array,
    speeds: Array,
    latitudes: Array,
    longitudes: Array,
    out: Annotated[Array, (None, 4)],
) -> None:
    """Follow a drive; fill one row of `out` per time, as `records.GroundSeries`. A missing position is nan."""
    at_s = -math.inf
    for i in range(times.shape[0]):
        if not (math.isnan(latitudes[i]) or math.isnan(longitudes[i])):
            position_at(k, followed, latitudes[i], longitudes[i])
            at_s = times[i]
        dt, hold_s = times[i] - times[max(i - 1, 0)], k.number.position_hold_ns * NANOSECOND
        drive_on(followed, speeds[i], min(dt, hold_s), times[i] - at_s)
        look(k.route_cells, k.route_places, followed, times[i] - at_s > hold_s)
        out[i, 0], out[i, 1], out[i, 2] = followed[SLOPE], followed[TORQUE], followed[TORQUE_STD]
        out[i, 3] = followed[PLACE_KNOWN]
