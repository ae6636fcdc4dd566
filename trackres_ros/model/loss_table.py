# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Tabulates the loss per metre of travel on a grid, fast enough for every step of a live estimate.

By time-temperature superposition temperature and speed enter only as the reduced speed a_T v: frequencies scale with v, and
every modulus is a function of a_T f. So the axes are x = log10(a_T v) and the load; the torque on the sprocket enters as
the loss it adds forward and backward per torque: it moves the loss by far less than a thousandth (see `drive_share`).
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from trackres_ros.arrays import Array
from trackres_ros.files.cache import cached_arrays
from trackres_ros.kernels.marks import kernel
from trackres_ros.model.hysteresis import METHODS, LossMethod, Spectral
from trackres_ros.model.rubber import RubberModel, cubic_weights, thinned_numbers
from trackres_ros.model.track import LoadRange, TrackModel, load_range
from trackres_ros.vehicle import Vehicle

VERSION = 8  # of the cached form
SOFTEST, STIFFEST = (120.0, 1e-3), (-55.0, 70.0)  # belt [degC] and speed [m/s] at the ends of the axis x
WIDEST = 40.0  # decades of x
DECADES = 0.5  # the ends are multiples of it
EXACT_EACH, FINE_EACH = 20, 100  # exact evaluations for a decade, joined by cubics, and nodes, joined by straight lines
EXACT_LOADS = 12
QUICK_EACH, QUICK_LOADS, QUICK_HARMONICS_EACH = 5, 4, 16  # of a quick table: it differs by less than 0.1 % (test_compare.py)
DRIVE_EVERY = 5  # of the exact evaluations along x has the drive's share too
EVALUATED_DEGC = 20.0  # at any other temperature, the same x has the same loss
FINE_LOADS = 64
TABLE_HARMONICS = 2048
HARMONICS_EACH = 48  # evaluated for a factor e in their number; all of them move the loss by 1e-5 (test_hysteresis.py)
DRIVE_TORQUE_SHARE = 0.15  # of load x sprocket radius: the torque at which the drive's share is computed
CHECKED_BELT_DEGC = (-50.0, 120.0)
SLOWEST_CHECKED = 0.05  # m/s


@dataclass(frozen=True, eq=False)
class LossTable:
    """Loss force [N] of one kind of track over x = log10(a_T v [m/s]) and ln(load [N]); `drive` adds to it per torque."""

    first_x: float
    step_x: float
    first_log_load: float
    step_log_load: float
    loss: Array  # (x, load)
    drive: Array  # (x, 2): N per Nm of sprocket torque, with its sign and of its size

    def loss_at(self, log_reduced_speed: ArrayLike, load: ArrayLike, drive_torque: ArrayLike = 0.0) -> Array:
        """Loss [N] by the same interpolation as the live kernel, any broadcast shape."""
        x, g, m = np.broadcast_arrays(*(np.asarray(a, float) for a in (log_reduced_speed, load, drive_torque)))
        losses = np.empty(x.shape)
        loss, drive = self.loss[np.newaxis], self.drive[np.newaxis]
        for i in np.ndindex(x.shape):
            value, _ = look_up(
                loss, 0, self.first_x, self.step_x, self.first_log_load, self.step_log_load, float(x[i]), float(np.log(g[i]))
            )
            odd_loss, unsigned = look_up_drive(drive, 0, self.first_x, self.step_x, float(x[i]))
            losses[i] = value + m[i] * odd_loss + abs(m[i]) * unsigned
        return losses


@kernel
def look_up(
    loss: Array, table: int, first_x: float, step_x: float, first_log_load: float, step_log_load: float, x: float, log_load: float
) -> tuple[float, float]:
    """Loss [N] and its derivative by x, linear between nodes, held at the edges."""
    rows, columns = loss.shape[1], loss.shape[2]
    u = min(max((x - first_x) / step_x, 0.0), rows - 1.000001)
    w = min(max((log_load - first_log_load) / step_log_load, 0.0), columns - 1.000001)
    i, j = min(int(u), rows - 2), min(int(w), columns - 2)
    u, w = u - i, w - j
    left = loss[table, i, j] + w * (loss[table, i, j + 1] - loss[table, i, j])
    right = loss[table, i + 1, j] + w * (loss[table, i + 1, j + 1] - loss[table, i + 1, j])
    return left + u * (right - left), (right - left) / step_x


@kernel
def look_up_drive(drive: Array, table: int, first_x: float, step_x: float, x: float) -> tuple[float, float]:
    """Loss per sprocket torque with its sign, and per its size [N/Nm]."""
    u = min(max((x - first_x) / step_x, 0.0), drive.shape[1] - 1.000001)
    i = min(int(u), drive.shape[1] - 2)
    u -= i
    return drive[table, i, 0] + u * (drive[table, i + 1, 0] - drive[table, i, 0]), drive[table, i, 1] + u * (
        drive[table, i + 1, 1] - drive[table, i, 1]
    )


def loss_table(vehicle: Vehicle, track_name: str, cache: Path | None = None) -> LossTable:
    """Table of one kind of track, from the cache if the description is identical, else built and cached.

    Parameters
    ----------
    cache
        Folder of the cache, see `trackres_ros.files.cache`.
    """

    def compute() -> dict[str, Array]:
        return build(_method(vehicle, track_name, HARMONICS_EACH), load_range(vehicle, track_name))

    low, high = log_speeds(RubberModel(vehicle.rubber))
    nodes = round((high - low) * FINE_EACH) + 1
    shapes = {"axes": (4,), "loss": (nodes, FINE_LOADS), "drive": (nodes, 2)}
    arrays = cached_arrays(f"loss-{fingerprint(vehicle, track_name)}", shapes, compute, cache)
    return _table(arrays)


def quick_table(vehicle: Vehicle, track_name: str, _cache: Path | None = None) -> LossTable:
    """Table of a vehicle that is used only once: with fewer exact evaluations, and not cached."""
    method = _method(vehicle, track_name, QUICK_HARMONICS_EACH)
    return _table(build(method, load_range(vehicle, track_name), QUICK_EACH, QUICK_LOADS))


def _method(vehicle: Vehicle, track_name: str, harmonics_each: int) -> LossMethod:
    track, rubber = vehicle.tracks[track_name], RubberModel(vehicle.rubber)
    if vehicle.hysteresis != Spectral.name:
        return METHODS[vehicle.hysteresis](track, rubber)
    return Spectral(track, rubber, TABLE_HARMONICS, thinned_numbers(TABLE_HARMONICS, harmonics_each))


def _table(arrays: Mapping[str, Array]) -> LossTable:
    first_x, step_x, first_log_load, step_log_load = (float(value) for value in arrays["axes"])
    return LossTable(first_x, step_x, first_log_load, step_log_load, arrays["loss"], arrays["drive"])


def log_speeds(rubber: RubberModel) -> tuple[float, float]:
    """Ends of the axis x = log10(a_T v [m/s]), by the rubber's own a_T, whose reference may be any temperature.

    Slower and hotter, rubber hardly changes with frequency. A rubber whose a_T spans more than `WIDEST` decades has none of its
    cold end in the table, and `coverage` says so.
    """
    low_log, high_log = (float(rubber.log_shift(belt)) + math.log10(speed) for belt, speed in (SOFTEST, STIFFEST))
    low = DECADES * math.floor(low_log / DECADES)
    return low, min(DECADES * math.ceil(high_log / DECADES), low + WIDEST)


def fingerprint(vehicle: Vehicle, track_name: str) -> str:
    """Hash of all inputs of the table: the values of the vehicle file and of its rubber file, not their comments."""
    content = {
        "version": VERSION,
        "method": vehicle.hysteresis,
        "track": asdict(vehicle.tracks[track_name]),
        "rubber": asdict(vehicle.rubber),
        "loads": load_range(vehicle, track_name),
    }
    text = json.dumps(content, sort_keys=True, default=lambda array: array.tolist())
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def build(method: LossMethod, loads: LoadRange, exact_each: int = EXACT_EACH, exact_loads: int = EXACT_LOADS) -> dict[str, Array]:
    """Evaluate the exact method on a coarse grid and refine it by cubics in the logarithm: the arrays of a `LossTable`.

    `exact_each`, `exact_loads`: exact evaluations for a decade of x, and over the loads. Bending does not depend on the load, and
    the logarithm of the indentation hardly bends over that of the load.
    """
    low, high = log_speeds(method.rubber)
    x, fine_x = (np.linspace(low, high, round((high - low) * density) + 1) for density in (exact_each, FINE_EACH))
    log_load, fine_load = (np.linspace(np.log(loads.low), np.log(loads.high), count) for count in (exact_loads, FINE_LOADS))
    speed = 10.0 ** (x - method.rubber.log_shift(EVALUATED_DEGC))
    exact_loss = method.by_torque(speed[:, np.newaxis], EVALUATED_DEGC, np.exp(log_load))
    over_x, over_load = cubic_weights(x, fine_x), cubic_weights(log_load, fine_load)
    indentation = np.exp(over_x @ np.log(exact_loss.indentation) @ over_load.T)
    loss = indentation + np.exp(over_x @ np.log(exact_loss.bending[:, :1]))
    by_torque = method.by_torque(speed[::DRIVE_EVERY], EVALUATED_DEGC, loads.nominal)
    torque = DRIVE_TORQUE_SHARE * loads.nominal * method.track.sprocket_radius
    forward_loss, reverse_loss = by_torque.drive(torque), by_torque.drive(-torque)
    parts = np.stack([forward_loss - reverse_loss, forward_loss + reverse_loss], axis=1) / (2.0 * torque)
    drive = cubic_weights(x[::DRIVE_EVERY], fine_x) @ parts
    axes = np.array([fine_x[0], fine_x[1] - fine_x[0], fine_load[0], fine_load[1] - fine_load[0]])
    return {"axes": axes, "loss": loss, "drive": drive}


def interpolation_error(
    model: TrackModel, table: LossTable, loads: LoadRange, max_speed: float, points: int = 400, seed: int = 1
) -> Array:
    """Relative errors of the table against the exact method at random points of the whole range, shape (points,)."""
    random = np.random.default_rng(seed)
    speed = np.exp(random.uniform(np.log(SLOWEST_CHECKED), np.log(max_speed), points))
    belt_degc = random.uniform(*CHECKED_BELT_DEGC, points)
    load = np.exp(random.uniform(np.log(loads.low), np.log(loads.high), points))
    torque = random.uniform(-1.0, 1.0, points) * DRIVE_TORQUE_SHARE * load * model.track.sprocket_radius
    exact_loss = model.loss.loss_force(speed, belt_degc, load, torque).total
    return table.loss_at(np.log10(speed) + model.rubber.log_shift(belt_degc), load, torque) / exact_loss - 1.0


def drive_share(table: LossTable, loads: LoadRange, sprocket_radius: float) -> float:
    """Largest share of the loss that the drive torque adds or removes, over all reduced speeds at nominal load."""
    return _largest_share(table, loads, sprocket_radius, np.abs(table.drive[:, 0]) + np.abs(table.drive[:, 1]))


def reverse_share(table: LossTable, loads: LoadRange, sprocket_radius: float) -> float:
    """Largest relative difference of the loss between forward and reverse.

    Notes
    -----
    In reverse a sprocket slackens the run of the belt that it tightens forward. So where the drive's strain meets the
    bending over a wheel, it adds to the bending or reduces it. The torque's sign matters, not that of the
    travel: without the torque, reverse equals forward.
    """
    return _largest_share(table, loads, sprocket_radius, 2.0 * np.abs(table.drive[:, 0]))


def _largest_share(table: LossTable, loads: LoadRange, sprocket_radius: float, per_torque: Array) -> float:
    torque = DRIVE_TORQUE_SHARE * loads.nominal * sprocket_radius
    column = int(round((np.log(loads.nominal) - table.first_log_load) / table.step_log_load))
    return float(np.max(per_torque * torque / table.loss[:, column]))
