# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Draws vehicles that differ from their files, and disturbances on some of their drives, all from one seed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from proofs.sealed.drives import Array, SealedDrive

OFF = (0.05, 0.20)  # by which the loss of a file is off
OTHERS_OFF = 0.10  # at most, of bearings, drag, cooling and heat capacity
DRIVES = 3
LOADS, AIRS_DEGC = (1.0, 0.85, 1.15), (5.0, 15.0, 25.0)
AIR_OFF_K = 1.5  # standard deviation, from drive to drive: a thermometer on a vehicle sees sun and exhaust
NONE = ""
ROLLING_SHARE = 0.01  # of weight times radius: about the rolling resistance
# Sensor faults leave the drive unchanged. Faults of the vehicle or the ground change the true torque.
SENSORS = ("gain_step", "stuck", "half_missing", "outliers", "sign_flips")
REAL = ("payload", "mud", "pump", "brake", "hill")
KINDS = (*SENSORS, *REAL)


@dataclass(frozen=True)
class LearningCase:
    """One vehicle."""

    name: str  # uninformative
    build: dict[str, float]  # differences from its file, see `sealed.truth.Build`
    lumped: bool  # the vehicle file has no core temperature of the belt
    hostile: str  # disturbance, one of `KINDS`; empty without one
    size: float  # of the disturbance, relative to its largest: 0 to 1
    seed: int


def draw_cases(seed: int, vehicles: int, hostile: int) -> list[LearningCase]:
    """Draw vehicles, and as many others with a disturbance: every kind equally often."""
    rng = np.random.default_rng([seed, 16])
    names = rng.permutation(10 * (vehicles + hostile))[: vehicles + hostile]
    kinds = [NONE] * vehicles + [KINDS[i % len(KINDS)] for i in range(hostile)]
    found = []
    for number, kind in zip(names, kinds, strict=True):
        build = {part: float(1.0 + rng.uniform(-OTHERS_OFF, OTHERS_OFF)) for part in ("bearing", "drag", "film", "capacity")}
        build["loss"] = float(1.0 / (1.0 + rng.choice((-1.0, 1.0)) * rng.uniform(*OFF)))
        case = LearningCase(
            f"v{number:05d}", build, bool(rng.random() < 0.5), kind, float(rng.random()), int(rng.integers(1 << 31))
        )
        found.append(case)
    return sorted(found, key=lambda case: case.name)


def added_torque(case: LearningCase, one: SealedDrive, nominal: float, radius: float) -> Array:
    """Torque of the ground or the vehicle on a drive [Nm], shape of the speed; the nominal weight is in newtons."""
    speed, distance, rolling = one.speed, np.cumsum(one.speed) * one.step, ROLLING_SHARE * nominal * radius
    time, ahead = np.arange(len(speed)) * one.step, np.tanh(speed / 0.05)
    if case.hostile == "mud":  # stretches of a kilometre that come again
        return np.asarray((0.15 + 0.25 * case.size) * rolling * (np.sin(2.0 * np.pi * distance / 2500.0) > 0.5) * ahead)
    if case.hostile == "pump":
        runs = np.sin(2.0 * np.pi * time / (300.0 + 200.0 * case.size)) > 0.3
        return np.asarray((0.07 + 0.05 * case.size) * rolling * runs * ahead)
    if case.hostile == "brake":  # drags from the middle on, and lets go three quarters of the way
        drags = (time > 0.5 * time[-1]) & (time < 0.75 * time[-1])
        return np.asarray((0.08 + 0.12 * case.size) * rolling * drags * ahead)
    if case.hostile == "hill":
        slope = (0.006 + 0.01 * case.size) * np.sin(2.0 * np.pi * distance / (600.0 + 1500.0 * case.size))
        return np.asarray(one.weight * radius * slope)
    return np.zeros(len(speed))


def weight_shares(case: LearningCase, speed: Array) -> Array:
    """Weight over recorded weight, shape of the speed: another load from the first stop after a third of it on."""
    found = np.ones(len(speed))
    if case.hostile == "payload":
        after = np.flatnonzero((np.arange(len(speed)) > len(speed) // 3) & (speed < 0.05))
        begin = int(after[0]) if len(after) else len(speed) // 2
        found[begin:] = 1.0 + (0.06 + 0.12 * case.size) * (1.0 if round(case.size * 100) % 2 else -1.0)
    return found


def misled(case: LearningCase, torque: Array, step: float, rng: np.random.Generator) -> Array:
    """Torque shown by the sensor [Nm], from a third of the drive on."""
    n = len(torque)
    late = np.arange(n) > n // 3
    if case.hostile == "gain_step":
        return np.where(late, (1.05 if case.size < 0.5 else 0.95) * torque, torque)
    if case.hostile == "stuck":
        held = late & (np.arange(n) * step % 240.0 < 120.0)
        return np.where(held, torque[np.maximum.accumulate(np.where(held, 0, np.arange(n)))], torque)
    if case.hostile == "half_missing":
        return np.where(rng.random(n) < 0.5, np.nan, torque)
    if case.hostile == "outliers":
        return torque + np.where(rng.random(n) < 0.3, rng.normal(1500.0 * (case.size - 0.5), 3000.0, n), 0.0)
    if case.hostile == "sign_flips":
        return np.where(late & (np.arange(n) * step % 120.0 < 40.0), -torque, torque)
    return torque
