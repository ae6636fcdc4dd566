# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Defines the inputs and the state of a step."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Inputs(NamedTuple):
    """What is known at one step; not a number (nan) where it is not. Loads and belt temperatures: one an assembly."""

    speed: float  # m/s
    load: Array  # N, own weight included
    ambient: float  # degC
    ambient_std: float  # K
    belt_measured: Array  # degC, nan where there is no new one
    acceleration: float = math.nan  # m/s^2 along the travel, commanded or measured without gravity's part
    grade: float = math.nan  # rise over run, positive uphill the way the vehicle points
    yaw_rate: float = math.nan  # rad/s
    heading: float = math.nan  # rad
    distance: float = math.nan  # m, driven; without one it is counted from the speed
    measured_torque: float = math.nan  # Nm at the sprockets, whole vehicle
    slope_by_place: float = math.nan  # as `grade`, where none is given: what surroundings say of the place
    torque_by_place: float = math.nan  # Nm against travel, whole vehicle, what they say besides
    torque_by_place_std: float = math.nan  # Nm
    reasons: int = 0  # columns.Reason found before the step
    fed: float = 1.0  # 0 where the feed-forward is to be zero: it is not enabled, or the speed is not to be trusted


class Carried(NamedTuple):
    """What is carried from step to step; all arrays are changed in place."""

    belts: Array  # (assemblies, 2, BELT_COLUMNS); in a fit one of each kind
    motion: Array  # (MOTION_COLUMNS,)
    effects: Array  # see `stepping.new_memory`
    learned: Array  # (LEARNED_COLUMNS,), see columns; zeros where nothing was


class DriveSeries(NamedTuple):
    """A drive, shape (times,); not a number (nan) where something is not known."""

    times: Array  # s
    speeds: Array  # m/s
    weights: Array  # N, shared as nominal loads are
    ambients: Array  # degC
    accelerations: Array  # m/s^2
    grades: Array  # rise over run
    yaw_rates: Array  # rad/s
    headings: Array  # rad
    distances: Array  # m
    slopes_by_place: Array  # as grades, where these are not known
    torques_by_place: Array  # Nm against travel
    torque_stds_by_place: Array  # Nm


class GroundSeries(NamedTuple):
    """What surroundings say of the ground along a drive, shape (times,); nan where they say nothing."""

    slopes: Array  # rise over run the way the vehicle points
    torques: Array  # Nm against travel
    torque_stds: Array  # Nm
