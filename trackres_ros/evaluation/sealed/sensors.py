# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes the truth as imperfect sensors show it, as a table."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from trackres_ros.evaluation.sealed.drives import Drive
from trackres_ros.evaluation.sealed.truth import TruthRun

Array = NDArray[np.float64]

COLUMNS = ("time_s", "speed_mps", "weight_n", "ambient_degc", "yaw_rate_radps", "heading_rad", "torque_nm")
RESTING_MPS = 1e-3  # an encoder that does not turn counts nothing
HEAVY_TAILS = 5.0  # degrees of freedom of the torque's white noise


@dataclass(frozen=True)
class Sensors:
    """How good the instruments are, and how rough the road is."""

    torque_nm: float = 30.0
    torque_share: float = 0.01  # of the torque
    torque_step_nm: float = 5.0
    road: float = 0.0005  # slope that no one measured, standard deviation
    road_m: float = 30.0  # over which it changes
    torque_lag_s: float = 0.0  # of first order, as of a filter
    torque_offset_nm: float = 0.0
    torque_gain: float = 1.0
    speed_mps: float = 0.01
    speed_step_mps: float = 0.02
    dropouts: float = 0.002  # share of samples, in bursts
    belt_measured: bool = True


def record(
    path: Path, drive: Drive, truth: TruthRun, sensors: Sensors, radius: float, start_s: float, rng: np.random.Generator
) -> None:
    """Write one recording."""
    n = len(drive)
    white = rng.standard_t(HEAVY_TAILS, n) * np.sqrt((HEAVY_TAILS - 2.0) / HEAVY_TAILS)
    torque = truth.shown + _road(drive, sensors, rng) * drive.weight * radius
    torque = sensors.torque_gain * lagging(torque, sensors.torque_lag_s, drive.step) + sensors.torque_offset_nm
    torque = torque + white * (sensors.torque_nm + sensors.torque_share * np.abs(truth.shown) + 20.0 * np.abs(drive.accel))
    torque = np.round(torque / sensors.torque_step_nm) * sensors.torque_step_nm
    speed = drive.speed + rng.normal(0.0, sensors.speed_mps, n)
    speed = np.round(speed / sensors.speed_step_mps) * sensors.speed_step_mps
    speed = np.where(np.abs(drive.speed) < RESTING_MPS, 0.0, speed)
    columns = [
        start_s + np.arange(n) * drive.step,
        speed,
        drive.weight,
        np.round(drive.ambient, 1),
        drive.yaw_rate + rng.normal(0.0, 0.003, n),
        drive.heading,
        np.where(_bursts(n, sensors.dropouts, rng), np.nan, torque),
    ]
    names = list(COLUMNS)
    if drive.slope is not None:
        columns.append(drive.slope)
        names.append("grade")
    if sensors.belt_measured:
        columns.append(truth.belt + rng.normal(0.0, 0.4, n))
        names.append("belt_degc")
    rows = np.column_stack(columns)
    with path.open("w", encoding="utf-8") as file:
        file.write(",".join(names) + "\n")
        np.savetxt(file, rows, delimiter=",", fmt="%.5f")


def lagging(series: Array, seconds: float, step: float) -> Array:
    """What a filter of first order makes of a series that runs straight between its samples; it starts settled."""
    if seconds < 1e-3 * step:
        return series
    keep = np.exp(-step / seconds)
    new = 1.0 - seconds / step * (1.0 - keep)  # of the newest sample; the rest is of the one before
    out, _ = lfilter([new, 1.0 - keep - new], [1.0, -keep], series, zi=[(1.0 - new) * series[0]])
    return np.asarray(out)


def _road(drive: Drive, sensors: Sensors, rng: np.random.Generator) -> Array:
    """Slope over distance that comes and goes."""
    keep = np.exp(-np.abs(drive.speed) * drive.step / sensors.road_m)
    shocks = rng.normal(0.0, 1.0, len(drive)) * np.sqrt(1.0 - keep**2)
    out, now = np.empty(len(drive)), rng.normal()
    for i in range(len(drive)):
        now = keep[i] * now + shocks[i]
        out[i] = now
    return sensors.road * out


def _bursts(n: int, share: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    out = np.zeros(n, dtype=bool)
    for begin in rng.integers(0, n, rng.poisson(share * n / 10.0)):
        out[begin : begin + rng.integers(3, 18)] = True
    return out
