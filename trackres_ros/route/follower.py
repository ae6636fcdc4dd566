# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Follows a vehicle on a learned route: takes positions and speeds one by one, and returns the learned ground under the vehicle.
It is compiled, with all its memory in one array.
"""

from __future__ import annotations

import math

from trackres_ros.kernels.marks import kernel, length
from trackres_ros.route.lookup import Array, IntArray, learned_at

COURSE_M = 15.0  # between two positions for a course: their scatter is a part of it
FARTHEST_M = 150.0  # between two positions: beyond, the path between them is unknown
REVERSING_MPS = 0.1  # slower, the sign is noise
LONGEST_M = 100.0  # without a position, that its place is carried on by its speed
EVERY_S = 0.2  # between two looks at the route

SLOPES, TORQUES = range(2)  # kinds of values learned by place, as of `lookup.lookup_of`

# What is remembered: the last position and the one that the course counts from, east and north of a frame [m]; the course, of
# length 1; whether it backs up; distance driven since that position, and along the course since the last one [m]; whether the
# last one came after the last speed; time since the last look [s]; and what that saw: slope the way it points, torque against
# travel and its standard deviation [Nm], whether the place was known.
(
    AT_X, AT_Y, FROM_X, FROM_Y, EAST, NORTH, BACKWARD, SINCE_M, AHEAD_M, IS_NEW, LOOKED_S, SLOPE, TORQUE, TORQUE_STD, PLACE_KNOWN,
) = range(15)  # fmt: skip
FOLLOWED = 15
NOTHING_YET = (*(math.nan,) * 6, 0.0, 0.0, 0.0, 0.0, EVERY_S, *(math.nan,) * 3, 0.0)


@kernel
def forget(followed: Array) -> None:
    """As at the start."""
    for i in range(FOLLOWED):
        followed[i] = NOTHING_YET[i]


@kernel
def take_position(followed: Array, x: float, y: float) -> None:
    """A position came, east and north of the frame [m]; nan of one beyond it. A repeated one is none: receivers repeat their last
    one where they have no reception.
    """
    if x == followed[AT_X] and y == followed[AT_Y]:
        return
    moved = length(x - followed[FROM_X], y - followed[FROM_Y])
    if math.isnan(moved) or moved > FARTHEST_M:
        followed[EAST] = followed[NORTH] = math.nan
        followed[FROM_X], followed[FROM_Y], followed[SINCE_M] = x, y, 0.0
    elif moved >= COURSE_M and followed[SINCE_M] > 0.5 * COURSE_M:
        followed[EAST], followed[NORTH] = (x - followed[FROM_X]) / moved, (y - followed[FROM_Y]) / moved
        followed[FROM_X], followed[FROM_Y], followed[SINCE_M] = x, y, 0.0
    followed[AT_X], followed[AT_Y], followed[AHEAD_M], followed[IS_NEW] = x, y, 0.0, 1.0


@kernel
def drive_on(followed: Array, speed: float, dt: float, since_position: float) -> None:
    """Process a speed [m/s], given the time since the last one and since the last position, by their stamps [s]."""
    followed[SINCE_M] += abs(speed) * dt
    followed[LOOKED_S] += dt
    if abs(speed) > REVERSING_MPS:
        backward = 1.0 if speed < 0.0 else 0.0
        if backward != followed[BACKWARD]:  # it comes back on its way
            followed[EAST], followed[NORTH], followed[AHEAD_M] = -followed[EAST], -followed[NORTH], -followed[AHEAD_M]
        followed[BACKWARD] = backward
    along = -speed if followed[BACKWARD] > 0.0 else speed
    followed[AHEAD_M] += along * (min(max(since_position, 0.0), dt) if followed[IS_NEW] > 0.0 else dt)
    followed[IS_NEW] = 0.0


@kernel
def look(cells: IntArray, places: Array, followed: Array, is_old: bool) -> None:
    """Look up the ground under the vehicle, if the last look-up is old enough; `is_old` means that the last position
    is old.
    """
    if followed[LOOKED_S] < EVERY_S:
        return
    followed[LOOKED_S] = followed[PLACE_KNOWN] = 0.0
    followed[SLOPE] = followed[TORQUE] = followed[TORQUE_STD] = math.nan
    ahead, east, north = followed[AHEAD_M], followed[EAST], followed[NORTH]
    if math.isnan(followed[AT_X]) or math.isnan(east) or (is_old and ahead != 0.0) or abs(ahead) > LONGEST_M:
        return
    followed[PLACE_KNOWN] = 1.0
    x, y = followed[AT_X] + ahead * east, followed[AT_Y] + ahead * north
    for kind in (SLOPES, TORQUES):  # a loop: with constants, each would be compiled by itself
        value, std = learned_at(cells, places, kind, x, y, east, north)
        if kind == SLOPES:
            followed[SLOPE] = -value if followed[BACKWARD] > 0.0 else value
        else:
            followed[TORQUE], followed[TORQUE_STD] = value, std
