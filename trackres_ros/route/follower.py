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
def forget_position(follower: Array) -> None:
    """As at the start."""
    for i in range(FOLLOWED):
        follower[i] = NOTHING_YET[i]


@kernel
def take_position(follower: Array, x: float, y: float) -> None:
    """A position came, east and north of the frame [m]; nan of one beyond it. A repeated one is none: receivers repeat their last
    one where they have no reception.
    """
    if x == follower[AT_X] and y == follower[AT_Y]:
        return
    step_m = length(x - follower[FROM_X], y - follower[FROM_Y])
    if math.isnan(step_m) or step_m > FARTHEST_M:
        follower[EAST] = follower[NORTH] = math.nan
        follower[FROM_X], follower[FROM_Y], follower[SINCE_M] = x, y, 0.0
    elif step_m >= COURSE_M and follower[SINCE_M] > 0.5 * COURSE_M:
        follower[EAST], follower[NORTH] = (x - follower[FROM_X]) / step_m, (y - follower[FROM_Y]) / step_m
        follower[FROM_X], follower[FROM_Y], follower[SINCE_M] = x, y, 0.0
    follower[AT_X], follower[AT_Y], follower[AHEAD_M], follower[IS_NEW] = x, y, 0.0, 1.0


@kernel
def drive_on(follower: Array, speed: float, dt: float, since_position: float) -> None:
    """Process a speed [m/s], given the time since the last one and since the last position, by their stamps [s]."""
    follower[SINCE_M] += abs(speed) * dt
    follower[LOOKED_S] += dt
    if abs(speed) > REVERSING_MPS:
        is_backward = 1.0 if speed < 0.0 else 0.0
        if is_backward != follower[BACKWARD]:  # it comes back on its way
            follower[EAST], follower[NORTH], follower[AHEAD_M] = -follower[EAST], -follower[NORTH], -follower[AHEAD_M]
        follower[BACKWARD] = is_backward
    way_speed = -speed if follower[BACKWARD] > 0.0 else speed
    follower[AHEAD_M] += way_speed * (min(max(since_position, 0.0), dt) if follower[IS_NEW] > 0.0 else dt)
    follower[IS_NEW] = 0.0


@kernel
def look_up_ground(cells: IntArray, places: Array, follower: Array, is_old: bool) -> None:
    """Look up the ground under the vehicle, if the last look-up is old enough; `is_old` means that the last position
    is old.
    """
    if follower[LOOKED_S] < EVERY_S:
        return
    follower[LOOKED_S] = follower[PLACE_KNOWN] = 0.0
    follower[SLOPE] = follower[TORQUE] = follower[TORQUE_STD] = math.nan
    ahead, east, north = follower[AHEAD_M], follower[EAST], follower[NORTH]
    if math.isnan(follower[AT_X]) or math.isnan(east) or (is_old and ahead != 0.0) or abs(ahead) > LONGEST_M:
        return
    follower[PLACE_KNOWN] = 1.0
    x, y = follower[AT_X] + ahead * east, follower[AT_Y] + ahead * north
    for kind in (SLOPES, TORQUES):  # a loop: with constants, each would be compiled by itself
        value, std = learned_at(cells, places, kind, x, y, east, north)
        if kind == SLOPES:
            follower[SLOPE] = -value if follower[BACKWARD] > 0.0 else value
        else:
            follower[TORQUE], follower[TORQUE_STD] = value, std
