# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Simulates torques and belt temperature over a speed profile: the estimator on a computed drive."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from trackres_ros.arrays import Array
from trackres_ros.errors import InputError
from trackres_ros.estimator import columns as layout
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.records import GroundSeries
from trackres_ros.model.resistance import resistance_parts
from trackres_ros.units import KMH_PER_MPS

MOST_SAMPLES = 50_000_000
ROUNDING = 1e-9  # of a time: less is no longer one
LAP_RADIUS_M = 100.0  # section 3.2.2 of the paper
LAP_RAMP_S, LAP_STOP_S, LAP_HZ = 15.0, 20.0, 50


@dataclass(frozen=True, eq=False)
class SimulatedDrive:
    """A drive: times [s], speeds [m/s] and accelerations [m/s^2], each of shape (times,)."""

    time_s: Array
    speed: Array
    acceleration: Array


def ramp_and_hold(speed: float, ramp_s: float, duration_s: float, dt: float) -> SimulatedDrive:
    """From rest to a speed [m/s] in a straight ramp [s], then held; the paper's section 4.2. A ramp of 0 s starts at speed.

    Its last step ends with the duration, or less than a step before.
    """
    if not 0.0 < dt <= duration_s or duration_s / dt > MOST_SAMPLES:
        raise InputError("dt, duration", (dt, duration_s), f"0 < dt <= duration [s] and at most {MOST_SAMPLES} steps")
    steps = round(duration_s / dt)
    if steps * dt > duration_s * (1.0 + ROUNDING):
        steps -= 1
    time: Array = np.arange(steps + 1, dtype=np.float64) * dt
    if ramp_s <= 0.0:
        return SimulatedDrive(time, np.full_like(time, speed), np.zeros_like(time))
    return SimulatedDrive(time, speed * np.minimum(time / ramp_s, 1.0), np.where(time < ramp_s, speed / ramp_s, 0.0))


def through_points(time_s: Array, speed: Array, dt: float) -> SimulatedDrive:
    """A drive along straight lines between given points, sampled every dt [s]."""
    time_s, speed = np.asarray(time_s, float), np.asarray(speed, float)
    if len(time_s) < 2 or (np.diff(time_s) <= 0).any() or not (np.isfinite(time_s).all() and np.isfinite(speed).all()):
        raise InputError("profile", f"{len(time_s)} points", "at least two finite points with rising times")
    span = time_s[-1] - time_s[0]
    if not 0.0 < dt <= span or span / dt > MOST_SAMPLES:
        raise InputError("dt", dt, f"more than 0 and at most the profile's {span:g} s, with at most {MOST_SAMPLES} steps")
    time = time_s[0] + np.arange(int(np.floor(span / dt + 1e-9)) + 1) * dt
    leg = np.clip(np.searchsorted(time_s, time, side="right") - 1, 0, len(time_s) - 2)
    return SimulatedDrive(time, np.interp(time, time_s, speed), (np.diff(speed) / np.diff(time_s))[leg])


def laps(speed: float, lap_m: float, count: int, ramp_s: float, stop_s: float, dt: float) -> SimulatedDrive:
    """Laps with a stop after each, section 3.2.2: ramp up [s], hold, ramp down, stand [s]; `lap_m` [m] a lap."""
    held_s = lap_m / speed - ramp_s
    if held_s < 0.0:
        raise InputError("lap", f"{lap_m:g} m at {speed:g} m/s with ramps of {ramp_s:g} s", "a lap longer than its two ramps")
    corners, speeds, time_s = [0.0], [0.0], 0.0
    for _ in range(count):
        for duration, target in ((ramp_s, speed), (held_s, speed), (ramp_s, 0.0), (stop_s, 0.0)):
            time_s += duration
            corners.append(time_s)
            speeds.append(target)
    return through_points(np.array(corners), np.array(speeds), dt)


def lap_drive(speed_kmh: float, laps_driven: int) -> SimulatedDrive:
    """Laps of a circle of 100 m radius with a stop after each."""
    return laps(speed_kmh / KMH_PER_MPS, 2 * math.pi * LAP_RADIUS_M, laps_driven, LAP_RAMP_S, LAP_STOP_S, 1.0 / LAP_HZ)


def simulate(
    estimator: Estimator,
    drive: SimulatedDrive,
    weight_n: ArrayLike | None = None,
    ambient_degc: ArrayLike | None = None,
    initial_degc: float | None = None,
    grade: ArrayLike = math.nan,
) -> dict[str, Array]:
    """Torques and mean belt temperature along a drive, whole vehicle.

    Parameters
    ----------
    weight_n, ambient_degc
        Whole weight [N] and ambient temperature [degC], numbers or shape (times,); by default those of the vehicle file.
    initial_degc
        Belt temperature at the start [degC], by default the ambient one.
    grade
        Rise over run, a number or shape (times,); nan where it is not known.

    Returns
    -------
    dict
        The series of `series_of`, each of shape (times,).
    """
    return series_of(estimator, drive, run_drive(estimator, drive, weight_n, ambient_degc, initial_degc, grade))


def run_drive(
    estimator: Estimator,
    drive: SimulatedDrive,
    weight_n: ArrayLike | None = None,
    ambient_degc: ArrayLike | None = None,
    initial_degc: float | None = None,
    grade: ArrayLike = math.nan,
    ground: GroundSeries | None = None,
) -> Array:
    """Rows of results along a drive, shape (times, columns); see `simulate`, and `Estimator.along_route` for the ground."""
    weight = estimator.vehicle.weight if weight_n is None else weight_n
    ambient = estimator.vehicle.chassis.ambient if ambient_degc is None else ambient_degc
    speed, first_weight, first_ambient = (float(np.ravel(x)[0]) for x in (drive.speed, weight, ambient))
    first_inputs = estimator.inputs(speed, weight=first_weight, ambient=first_ambient)
    state = estimator.cold_start(first_inputs, belt_degc=initial_degc)
    return estimator.run(state, drive.time_s, drive.speed, weight, ambient, drive.acceleration, grade, ground=ground)[1]


def series_of(estimator: Estimator, drive: SimulatedDrive, rows: Array) -> dict[str, Array]:
    """Columns of a drive, from rows of results; the belt temperature, if there are belts, is the mean of the
    assemblies.
    """
    has_belts = bool(estimator.assemblies)
    torque_names = ("resistance_torque_nm", *resistance_parts(has_belts).values(), "inertia_nm", "drive_torque_nm")
    of_rows = by_column(estimator, rows)
    belts = {"belt_degc": assembly_values(rows, layout.OfAssembly.belt_degc).mean(axis=1)} if has_belts else {}
    drive_columns = {name: of_rows[name] for name in ("speed_mps", "weight_n", "ambient_degc")}
    return {"time_s": drive.time_s, **drive_columns, **belts, **{name: of_rows[name] for name in torque_names}}


def by_column(estimator: Estimator, rows: Array) -> dict[str, Array]:
    """Columns of rows of results by name, each of shape (rows,)."""
    return {name: rows[:, i] for name, i in estimator.column_index.items()}


def assembly_values(rows: Array, column: int) -> Array:
    """One of `columns.ASSEMBLY_COLUMNS` out of rows of results, shape (rows, assemblies)."""
    return rows[:, len(layout.VEHICLE_COLUMNS) + column :: len(layout.ASSEMBLY_COLUMNS)]
