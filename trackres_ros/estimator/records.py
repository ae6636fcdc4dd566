# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Defines the inputs and the state of a step."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trackres_ros.effects.stepping import new_memory
from trackres_ros.errors import InputError
from trackres_ros.estimator import columns as at
from trackres_ros.text.numbers import decimals

Array = NDArray[np.float64]

NOT_NUMBERS = "Mmc"  # kinds of dtypes that numpy would convert: dates and durations count in any unit, complex lose a part
IN_SECONDS = 'seconds of dates are (t - t[0]) / numpy.timedelta64(1, "s"), and of durations t / numpy.timedelta64(1, "s")'


class Inputs(NamedTuple):
    """Inputs of one step; nan where unknown. Loads and belt temperatures: one per assembly."""

    speed: float  # m/s
    load: Array  # N, own weight included
    ambient: float  # degC
    ambient_std: float  # K
    belt_measured: Array  # degC, nan without a new one
    acceleration: float = math.nan  # m/s^2 along the travel, commanded or measured without gravity
    grade: float = math.nan  # rise over run, positive uphill the way the vehicle points
    yaw_rate: float = math.nan  # rad/s
    heading: float = math.nan  # rad
    distance: float = math.nan  # m, driven; integrated from the speed if unknown
    measured_torque: float = math.nan  # Nm at the sprockets, whole vehicle
    slope_by_place: float = math.nan  # as `grade`, used where that is unknown: slope from the surroundings
    torque_by_place: float = math.nan  # Nm against travel, whole vehicle, from the surroundings
    torque_by_place_std: float = math.nan  # Nm
    reasons: int = 0  # columns.Reason found before the step
    fed: float = 1.0  # 0 for no feed-forward: it is not enabled, or the speed is not trusted


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class State:
    """State carried from one step to the next; not to be changed. `columns` describes the numbers."""

    belts: Array  # (assemblies, 2, BELT_COLUMNS): temperature [degC] and its departures [K], of the mean and of the surface
    motion: Array  # (MOTION_COLUMNS,): filtered speed and values of the last step
    effects: Array = field(default_factory=lambda: new_memory(0))  # memory of the effects, see `effects.stepping`
    learned: Array = field(default_factory=lambda: np.zeros(at.Learned.columns))  # learned departures of the vehicle

    def __repr__(self) -> str:
        degrees = ", ".join(decimals(float(degc), 1) for degc in self.belts[:, 0, at.Belt.temperature])
        belts = f"belts {degrees} degC, " if degrees else ""
        return f"<State: {belts}speed {decimals(float(self.motion[at.Motion.last_speed]), 2)} m/s>"


class Carried(NamedTuple):
    """State carried from step to step; all arrays are changed in place."""

    belts: Array  # (assemblies, 2, BELT_COLUMNS); in a fit one of each kind
    motion: Array  # (MOTION_COLUMNS,)
    effects: Array  # see `stepping.new_memory`
    learned: Array  # (LEARNED_COLUMNS,), see columns; zeros without learning


class DriveSeries(NamedTuple):
    """A drive, shape (times,); nan where unknown."""

    times: Array  # s
    speeds: Array  # m/s
    weights: Array  # N, shared as nominal loads are
    ambients: Array  # degC
    accelerations: Array  # m/s^2
    grades: Array  # rise over run
    yaw_rates: Array  # rad/s
    headings: Array  # rad
    distances: Array  # m
    slopes_by_place: Array  # as grades, used where these are unknown
    torques_by_place: Array  # Nm against travel
    torque_stds_by_place: Array  # Nm


class GroundSeries(NamedTuple):
    """Ground along a drive from the surroundings, shape (times,); nan where unknown."""

    slopes: Array  # rise over run the way the vehicle points
    torques: Array  # Nm against travel
    torque_stds: Array  # Nm


def floats(given: ArrayLike, where: str, shape: tuple[int, ...] | None = None) -> Array:
    """Convert to an array of floats, of a given shape or any.

    Kernels read arrays without a check of their bounds, so each array from outside passes here.

    Raises
    ------
    InputError
        For another shape, dates, durations, or what is no number.
    """
    try:
        array = np.asarray(given)
        found = None if array.dtype.kind in NOT_NUMBERS else np.asarray(array, dtype=float)
    except (TypeError, ValueError):  # texts, dates as objects, rows of different lengths
        found = None
    if found is None:
        raise InputError(where, given, "numbers", IN_SECONDS)
    if shape is not None and found.shape != shape:
        raise InputError(where, f"an array of shape {found.shape}", f"shape {shape}" if shape else "one number")
    return found


def duration(given: ArrayLike, where: str) -> float:
    """A duration [s]; InputError for a negative or infinite one, or none."""
    found = float(given if isinstance(given, float) else floats(given, where, ()))
    if not 0.0 <= found < math.inf:
        raise InputError(where, found, "a finite number of seconds, at least 0")
    return found


def times(given: ArrayLike, where: str) -> Array:
    """Times of a series [s]; InputError unless they are finite and do not fall."""
    found = np.ascontiguousarray(floats(given, where))
    if found.ndim != 1:
        raise InputError(where, f"an array of shape {found.shape}", "shape (times,)")
    is_wrong = ~np.isfinite(found)
    is_wrong[1:] |= found[1:] < found[:-1]
    if is_wrong.any():
        first = int(np.argmax(is_wrong))
        raise InputError(f"{where}[{first}]", float(found[first]), "finite times that do not fall")
    return found
