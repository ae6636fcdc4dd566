# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Draws the drives of the proof: drivers and routes that vary."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STEP_S = 0.1
MOST_SIDEWAYS_MPS2 = 2.0
RESTING_MPS, HARDEST_MPS2 = 0.05, 1.6


@dataclass(frozen=True, eq=False)
class OnStreet:
    """Position of a drive in a town, and conditions there, series of shape (n,)."""

    x: Array  # to the east [m]
    y: Array  # to the north [m]
    slope: Array  # of the street in the direction of travel [rise over run]
    height: Array  # of the ground [m]
    softness: Array  # of the ground, 1 at the softest place of the town
    covered: NDArray[np.bool_]  # without satellites
    stretch: NDArray[np.int64]  # number of the stretch between two stops with changes of the load
    brakes: Array  # friction brakes' share of a braking torque; 1 where they hold the vehicle


@dataclass(frozen=True, eq=False)
class SealedDrive:
    """One drive, series of shape (n,)."""

    step: float  # [s]
    speed: Array  # [m/s]
    accel: Array  # [m/s^2]
    yaw_rate: Array  # [rad/s]
    heading: Array  # [rad]
    weight: Array  # [N]
    ambient: Array  # air [degC]
    slope: Array | None = None  # where it was surveyed [rise over run]
    street: OnStreet | None = None

    def __len__(self) -> int:
        return len(self.speed)


def drive(minutes: float, weight: float, ambient: float, fastest: float, rng: np.random.Generator) -> SealedDrive:
    """A drive over a closed course of its own, by a driver of his own."""
    n = int(minutes * 60.0 / STEP_S)
    brisk, restless = rng.uniform(0.2, 0.7), rng.uniform(25.0, 90.0)  # m/s^2, s between changes of mind
    return _on_a_course(_eased(_targets(n, fastest, restless, rng), brisk), weight, ambient, rng)


def trapezoids(minutes: float, weight: float, ambient: float, fastest: float, rng: np.random.Generator) -> SealedDrive:
    """Stop and go: constant accelerations up to speeds that are held, and stops."""
    time, speed = [0.0, rng.uniform(2.0, 10.0)], [0.0, 0.0]
    levels = fastest * np.sort(rng.uniform(0.15, 1.0, int(rng.integers(3, 7))))
    while time[-1] < minutes * 60.0:
        top = float(rng.choice(levels))
        for seconds, then in (
            (top / rng.uniform(0.25, 0.7), top),
            (rng.uniform(20.0, 120.0), top),
            (top / rng.uniform(0.3, 0.9), 0.0),
            (rng.uniform(5.0, 40.0), 0.0),
        ):
            time.append(time[-1] + seconds)
            speed.append(then)
    sharp = np.interp(np.arange(int(minutes * 60.0 / STEP_S)) * STEP_S, time, speed)
    return _on_a_course(sharp, weight, ambient, rng)


def recorded(
    minutes: float, weight: float, ambient: float, fastest: float, profiles: Sequence[Array], rng: np.random.Generator
) -> SealedDrive:
    """Speeds that real vehicles drove, each profile by `STEP_S`, slower where they were faster than this vehicle can be."""
    n, parts = int(minutes * 60.0 / STEP_S), list[Array]()
    while sum(map(len, parts)) < n:
        one = profiles[int(rng.integers(len(profiles)))]
        rests = np.flatnonzero(one < RESTING_MPS)  # it begins and ends at rest, as drives that are joined must
        begin = int(rng.choice(rests[: max(int(np.searchsorted(rests, len(one) - n)), 1)]))
        slower = min(1.0, fastest / float(one.max()), HARDEST_MPS2 / float(np.abs(np.gradient(one, STEP_S)).max()))
        parts.append(one[begin : int(rests[-1]) + 1] * slower)
    return _on_a_course(np.concatenate(parts)[:n], weight, ambient, rng)


def _on_a_course(speed: Array, weight: float, ambient: float, rng: np.random.Generator) -> SealedDrive:
    """A speed driven over a closed course of its own."""
    n, distance = len(speed), np.cumsum(speed) * STEP_S
    curvature = _course(distance, rng)
    sideways = MOST_SIDEWAYS_MPS2 / np.maximum(speed, 0.5)
    yaw_rate = np.clip(curvature * speed, -sideways, sideways)
    air = ambient + rng.normal(0.0, 1.0) * np.sin(np.arange(n) * STEP_S / 1500.0)
    heading = rng.uniform(0.0, 2.0 * np.pi) + np.cumsum(yaw_rate) * STEP_S
    return SealedDrive(STEP_S, speed, np.gradient(speed, STEP_S), yaw_rate, heading, np.full(n, weight), air)


def _targets(n: int, fastest: float, restless: float, rng: np.random.Generator) -> Array:
    out, i = np.empty(n), 0
    while i < n:
        hold = int(rng.gamma(3.0, restless / 3.0) / STEP_S) + 50
        stop = rng.random() < 0.12
        out[i : i + hold] = 0.0 if stop else fastest * rng.beta(1.6, 1.3) * 0.85 + 0.8
        i += hold
    out[:30] = 0.0
    return out


def _eased(target: Array, brisk: float) -> Array:
    """The vehicle's version of it: bounded acceleration, smoothed jerk."""
    speed, now, accel = np.empty(len(target)), 0.0, 0.0
    for i, aim in enumerate(target):
        wanted = np.clip((aim - now) / 1.5, -1.4 * brisk, brisk)
        accel += (wanted - accel) * STEP_S / 0.6
        now = max(0.0, now + accel * STEP_S)
        speed[i] = now
    return speed


def _course(distance: Array, rng: np.random.Generator) -> Array:
    """Curvature over distance: straights and bends of a course that is driven again and again [1/m]."""
    edges, bends = [0.0], []
    while edges[-1] < rng.uniform(900.0, 2500.0):
        edges.append(edges[-1] + rng.uniform(30.0, 160.0))
        bends.append(rng.choice((-1.0, 1.0)) / rng.uniform(18.0, 150.0) if rng.random() < 0.5 else 0.0)
    place = np.searchsorted(edges, distance % edges[-1], side="right") - 1
    raw = np.array(bends)[np.clip(place, 0, len(bends) - 1)]
    return np.convolve(raw, np.ones(15) / 15.0, mode="same")
