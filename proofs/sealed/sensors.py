# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes the truth as imperfect sensors show it, as a table."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from proofs.sealed.drives import Array, OnStreet, SealedDrive
from proofs.sealed.truth import TruthRun

POSITION = ("latitude_deg", "longitude_deg")
RESTING_MPS = 1e-3  # a standing encoder gives no counts
HEAVY_TAILS = 5.0  # degrees of freedom of the torque's white noise
EARTH_M, LATITUDE_DEG, LONGITUDE_DEG = 6_371_000.0, 48.0, 9.0  # radius, and where the towns are
SECOND_S, MINUTE_S = 1.0, 60.0  # between positions; correlation length of their error
# Errors of any instrument, which are no finding: less than a hidden `delay`, `torque_offset` or `torque_gain` adds.
SPEED_STEPS_MPS = (0.02, 0.05)
MOST_LAG_S, MOST_OFFSET_NM, MOST_GAIN = 0.1, 15.0, 0.005
LOST_S, SEEN_S = (20.0, 60.0), 900.0  # how long narrow streets hide the satellites, and for how long they are seen in the mean


@dataclass(frozen=True)
class Sensors:
    """Quality of the instruments, recorded channels, and roughness of the road."""

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
    ambient_off_k: float = 0.0  # of the air's temperature: sun, exhaust
    belt_measured: bool = True
    load_measured: bool = True
    every_s: float = 0.0  # between rows; as often as is simulated where it is less than that
    position_m: float = 5.0  # standard deviation of the slowly varying error; in towns
    position_white_m: float = 1.0
    altitude_m: float = 4.0
    altitude_white_m: float = 0.5


def drawn_sensors(rng: np.random.Generator, belt_measured: bool = False) -> Sensors:
    """Good instruments, each with a lag, an offset and a gain of its own."""
    return Sensors(
        belt_measured=belt_measured,
        speed_step_mps=float(rng.uniform(*SPEED_STEPS_MPS)),
        torque_lag_s=float(rng.uniform(0.0, MOST_LAG_S)),
        torque_offset_nm=float(rng.uniform(-MOST_OFFSET_NM, MOST_OFFSET_NM)),
        torque_gain=float(1.0 + rng.uniform(-MOST_GAIN, MOST_GAIN)),
    )


def record(
    path: Path, drive: SealedDrive, truth: TruthRun, sensors: Sensors, radius: float, start_s: float, rng: np.random.Generator
) -> None:
    """Write one recording."""
    n = len(drive)
    white = rng.standard_t(HEAVY_TAILS, n) * np.sqrt((HEAVY_TAILS - 2.0) / HEAVY_TAILS)
    torque = truth.shown + road_slopes(drive, sensors, rng) * drive.weight * radius
    torque = sensors.torque_gain * lagging(torque, sensors.torque_lag_s, drive.step) + sensors.torque_offset_nm
    torque = torque + white * (sensors.torque_nm + sensors.torque_share * np.abs(truth.shown) + 20.0 * np.abs(drive.accel))
    torque = np.round(torque / sensors.torque_step_nm) * sensors.torque_step_nm
    speed = drive.speed + rng.normal(0.0, sensors.speed_mps, n)
    speed = np.round(speed / sensors.speed_step_mps) * sensors.speed_step_mps
    speed = np.where(np.abs(drive.speed) < RESTING_MPS, 0.0, speed)
    columns: dict[str, Array] = {
        "time_s": np.asarray(start_s + np.arange(n) * drive.step),
        "speed_mps": speed,
        "weight_n": drive.weight,
        "ambient_degc": np.round(drive.ambient + sensors.ambient_off_k, 1),
        "yaw_rate_radps": drive.yaw_rate + rng.normal(0.0, 0.003, n),
        "heading_rad": drive.heading,
        "torque_nm": np.where(_bursts(n, sensors.dropouts, rng), np.nan, torque),
    }
    if drive.slope is not None:
        columns["grade"] = drive.slope
    if sensors.belt_measured:
        columns["belt_degc"] = truth.belt + rng.normal(0.0, 0.4, n)
    if not sensors.load_measured:
        del columns["weight_n"]
    if drive.street is not None:
        del columns["heading_rad"]  # a compass among cars and tracks is useless
        columns |= _in_town(drive.street, drive.step, sensors, rng)
    every = max(1, round(sensors.every_s / drive.step))
    rows = np.column_stack(list(columns.values()))[::every]
    with path.open("w", encoding="utf-8") as file:
        file.write(",".join(columns) + "\n")
        np.savetxt(file, rows, delimiter=",", fmt=["%.8f" if name in POSITION else "%.5f" for name in columns])


def _in_town(street: OnStreet, step: float, sensors: Sensors, rng: np.random.Generator) -> dict[str, Array]:
    """Samples of a satellite receiver, one per second, and of a brake switch."""
    n, per_sample = len(street.x), round(SECOND_S / step)
    known = (np.arange(n) % per_sample == 0) & ~street.covered & ~_lost(n, step, rng)

    def shown(series: Array, drift: float, white: float) -> Array:
        return np.where(known, series + wandering(n, step, drift, rng) + rng.normal(0.0, white, n), np.nan)

    x, y = (shown(series, sensors.position_m, sensors.position_white_m) for series in (street.x, street.y))
    parallel_m = EARTH_M * np.cos(np.radians(LATITUDE_DEG))
    return {
        POSITION[0]: LATITUDE_DEG + np.degrees(y / EARTH_M),
        POSITION[1]: LONGITUDE_DEG + np.degrees(x / parallel_m),
        "altitude_m": shown(400.0 + street.height, sensors.altitude_m, sensors.altitude_white_m),
        "brake_on": (street.brakes > 0.0).astype(float),
    }


def wandering(n: int, step: float, std: float, rng: np.random.Generator) -> Array:
    """An error that varies within a minute."""
    keep = np.exp(-step / MINUTE_S)
    shocks = rng.normal(0.0, std * np.sqrt(1.0 - keep**2), n)
    return np.asarray(lfilter([1.0], [1.0, -keep], shocks, zi=[keep * rng.normal(0.0, std)])[0])


def _lost(n: int, step: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    out, i = np.zeros(n, dtype=bool), int(rng.exponential(SEEN_S) / step)
    while i < n:
        held = int(rng.uniform(*LOST_S) / step)
        out[i : i + held] = True
        i += held + int(rng.exponential(SEEN_S) / step)
    return out


def lagging(series: Array, seconds: float, step: float) -> Array:
    """Output of a first-order filter for a piecewise linear series; it starts settled."""
    if seconds < 1e-3 * step:
        return series
    keep = np.exp(-step / seconds)
    new = 1.0 - seconds / step * (1.0 - keep)  # of the newest sample; the rest is of the one before
    out, _ = lfilter([new, 1.0 - keep - new], [1.0, -keep], series, zi=[(1.0 - new) * series[0]])
    return np.asarray(out)


def road_slopes(drive: SealedDrive, sensors: Sensors, rng: np.random.Generator) -> Array:
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
