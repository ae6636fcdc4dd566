# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Makes recordings that were never driven: the base model with an effect switched on, and sensors that are not perfect.

They share the model with the diagnosis, so they show that it works as built, not that it is right.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from trackres_ros.arrays import Array
from trackres_ros.diagnosis.base.base import Base, Predicted
from trackres_ros.diagnosis.prepare.session import DriveSession
from trackres_ros.effects.effect import Active

STEP_S = 0.2
TORQUE_NOISE_NM, SLOW_NOISE_NM, SLOW_NOISE_S = 40.0, 20.0, 3.0
SPEED_NOISE_MPS = 0.01
BELT_NOISE_K = 0.5
AMBIENTS_DEGC = (5.0, 15.0, 25.0, -5.0)
LOADS = (1.0, 0.85, 1.2, 1.05)  # of the nominal weight
COLUMNS = "time_s,speed_mps,accel_mps2,weight_n,ambient_degc,yaw_rate_radps,heading_rad,torque_nm,belt_degc"
START_S = 1_760_000_000
APART_S = 172_800.0 * 7


def drives(
    base: Base, max_speed: float, count: int, minutes: float, rng: np.random.Generator, step: float = STEP_S
) -> list[DriveSession]:
    """Drives over plain, turns and stops, with load and weather changing from one to the next; the belt starts soaked."""
    sessions: list[DriveSession] = []
    for i in range(count):
        steps = int(minutes * 60.0 / step)
        speed, accel = _speeds(steps, step, max_speed, rng)
        yaw_rate = _turns(steps, step, speed, rng)
        nan = np.full(steps, np.nan)
        sessions.append(
            DriveSession(
                f"drive_{i + 1}",
                step,
                np.arange(steps, dtype=float) * step,
                speed,
                accel,
                np.full(steps, base.facts.weight * LOADS[i % len(LOADS)]),
                np.full(steps, AMBIENTS_DEGC[i % len(AMBIENTS_DEGC)]),
                nan,
                yaw_rate,
                np.cumsum(yaw_rate) * step,
                np.cumsum(np.abs(speed)) * step + (sessions[-1].distance[-1] if sessions else 0.0),
                nan,
                nan,
                np.ones(steps, dtype=bool),
                np.zeros(steps, dtype=np.int64),
                given=frozenset({"load"}),
            )
        )
    return sessions


def write_recordings(
    base: Base, folder: Path, sessions: Sequence[DriveSession], effects: Sequence[Active], rng: np.random.Generator
) -> list[Path]:
    """Simulate drives and write them as tables; the paths."""
    predictions = base.predict(sessions, base.nominal, effects)
    paths = []
    for i, (session, prediction) in enumerate(zip(sessions, predictions, strict=True)):
        paths.append(folder / f"{session.name}.csv")
        write_recording(paths[-1], session, prediction, base.torque_scale, START_S + i * APART_S, rng)
    return paths


def write_recording(
    path: Path, session: DriveSession, prediction: Predicted, torque_scale: float, begin_s: float, rng: np.random.Generator
) -> None:
    """Write a simulated drive as a table, with the noise of its sensors.

    Parameters
    ----------
    torque_scale
        Shown over true torque.
    begin_s
        Time of its start, since 1970 [s].
    """
    n = len(session)
    memory = np.exp(-session.step / SLOW_NOISE_S)
    drift = np.empty(n)
    noise_level = 0.0
    for k, shock in enumerate(rng.normal(0.0, SLOW_NOISE_NM * np.sqrt(1.0 - memory**2), n)):
        noise_level = memory * noise_level + shock
        drift[k] = noise_level
    torque = torque_scale * prediction.torque + drift + rng.normal(0.0, TORQUE_NOISE_NM, n)
    time = begin_s + session.time + 0.5 * session.step
    columns = (session.speed + rng.normal(0.0, SPEED_NOISE_MPS, n), session.accel, session.weight, session.ambient)
    belt = prediction.belt + rng.normal(0.0, BELT_NOISE_K, n)
    rows = np.column_stack([time, *columns, session.yaw_rate, session.heading, torque, belt])
    np.savetxt(path, rows, delimiter=",", header=COLUMNS, comments="", fmt="%.6f")


def _speeds(steps: int, step: float, max_speed: float, rng: np.random.Generator) -> tuple[Array, Array]:
    corners, speeds, time_s = [0.0], [0.0], 0.0
    while time_s < steps * step:
        target = 0.0 if rng.random() < 0.15 else rng.uniform(0.12, 0.85) * max_speed
        ramp = max(abs(target - speeds[-1]) / rng.uniform(0.2, 0.5), 1.0)
        hold = rng.uniform(10.0, 25.0) if target == 0.0 else rng.uniform(20.0, 120.0)
        corners += [time_s + ramp, time_s + ramp + hold]
        speeds += [target, target]
        time_s += ramp + hold
    time = (np.arange(steps) + 0.5) * step
    edges = np.interp(np.arange(steps + 1) * step, corners, speeds)
    return np.interp(time, corners, speeds), np.diff(edges) / step


def _turns(steps: int, step: float, speed: Array, rng: np.random.Generator) -> Array:
    curvature, row = np.zeros(steps), 0
    while row < steps:
        length = int(rng.uniform(10.0, 60.0) / step)
        if rng.random() < 0.5:
            curvature[row : row + length] = rng.choice((-1.0, 1.0)) / rng.uniform(20.0, 120.0)
        row += length
    sideways = 2.0  # m/s^2 at most
    return np.clip(curvature * speed, -sideways / np.maximum(np.abs(speed), 0.5), sideways / np.maximum(np.abs(speed), 0.5))
