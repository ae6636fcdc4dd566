# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Draws drives through a town: a walk on its streets, kept to the right, with stops, bends and friction brakes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from proofs.sealed.drives import STEP_S, Array, OnStreet, SealedDrive
from proofs.sealed.town import BLOCKS_M, Crossing, Town

Indices = NDArray[np.int64]

SPACING_M = 0.5  # of points of a path
RIGHT_M = 1.75  # of the middle of the street
BEND_M = 4.5  # over which the curvature of a bend comes and goes
SIDEWAYS_MPS2 = 1.2
STREET_MPS = (5.0, 13.0)  # in the shortest and in the longest street
CAREFUL = (0.8, 1.0)  # of it, from street to street
UNEVEN, UNEVEN_M = 0.12, 60.0  # of it, along a street
AHEAD_M = 4.0  # of a crossing it stops
RED, RED_S = 0.25, (5.0, 25.0)  # share of the crossings at which it stops, and for how long
CALLED, CALLED_S = 0.4, (12.0, 40.0)  # share of the stops that it stops at
START_S = 10.0  # it stands before it starts
JERK_S = 1.5  # over which an acceleration comes and goes
HARD_MPS2, HARDEST_MPS2, MOST_TAKEN = 0.7, 1.4, 0.8  # friction brakes help from the first on, and take so much at the second
MEAN_MPS = 11.0  # more than it drives in the mean


@dataclass(frozen=True, eq=False)
class Path:
    """A way through a town, by points that are `SPACING_M` apart."""

    x: Array  # to the east [m]
    y: Array  # to the north [m]
    heading: Array  # [rad, from east to north, without jumps]
    fastest: Array  # [m/s]
    halts: tuple[Indices, Array, NDArray[np.bool_]]  # points, for how long [s], and whether at a stop, where loads change


def street_drive(
    minutes: float, weight: float, ambient: float, town: Town, steepest: float, rng: np.random.Generator
) -> SealedDrive:
    """A drive through a town whose steepest slope is given [rise over run]."""
    path = _path(town, _walk(town, minutes * 60.0 * MEAN_MPS, rng), rng)
    time, speed_at, stretch_at = _timetable(path, rng.uniform(0.4, 0.8), rng.uniform(0.6, 1.3))
    now = np.arange(int(minutes * 60.0 / STEP_S)) * STEP_S
    window = np.hanning(int(JERK_S / STEP_S) + 2)[1:-1]
    sharp = np.pad(np.interp(now, time, speed_at), len(window) // 2, mode="edge")
    speed = np.convolve(sharp, window / window.sum(), mode="valid")
    speed[speed < 1e-9] = 0.0
    distance, way = np.cumsum(speed) * STEP_S, np.arange(len(path.x)) * SPACING_M
    x, y, heading = (np.interp(distance, way, series) for series in (path.x, path.y, path.heading))
    accel = np.gradient(speed, STEP_S)
    street = OnStreet(
        x, y, steepest * town.slope(x, y, heading), steepest * town.height(x, y), town.softness(x, y),
        town.hidden_from_above(x, y),
        stretch_at[np.searchsorted(time, now + 2.0 * JERK_S, side="right") - 1],  # doors are shut before it starts
        _brakes(speed, accel),
    )  # fmt: skip
    air = ambient + rng.normal(0.0, 1.0) * np.sin(now / 1500.0)
    return SealedDrive(STEP_S, speed, accel, np.gradient(heading, STEP_S), heading, np.full(len(now), weight), air, street=street)


def _walk(town: Town, metres: float, rng: np.random.Generator) -> list[Crossing]:
    """Crossings one after the other, never straight back."""
    here: Crossing = (int(rng.integers(len(town.east))), int(rng.integers(len(town.north))))
    walk, way = [here], 0.0
    while way < metres:
        ahead = [c for c in town.neighbours(walk[-1]) if len(walk) < 2 or c != walk[-2]]
        walk.append(ahead[int(rng.integers(len(ahead)))])
        way += float(np.abs(town.at(walk[-1]) - town.at(walk[-2])).sum())
    return walk


def _path(town: Town, walk: list[Crossing], rng: np.random.Generator) -> Path:
    x, y, heading, fastest = (list[Array]() for _ in range(4))
    halts = list[tuple[float, float, bool]]()  # way [m], how long [s], whether at a stop
    way, angle = 0.0, float("nan")

    def add(east: Array, north: Array, towards: Array, limit: float) -> float:
        for kept, series in ((x, east), (y, north), (heading, towards), (fastest, np.full(len(east), limit))):
            kept.append(series)
        return float(np.hypot(np.diff(east), np.diff(north)).sum())

    then: list[Crossing | None] = [*walk[2:], None]
    for before, after, later in zip(walk[:-1], walk[1:], then, strict=True):
        begin, end = town.at(before), town.at(after)
        ahead = (end - begin) / np.abs(end - begin).sum()
        right = np.array([ahead[1], -ahead[0]])
        towards = float(np.arctan2(ahead[1], ahead[0]))
        angle = towards if np.isnan(angle) else angle + float(np.angle(np.exp(1j * (towards - angle))))
        length = float(np.abs(end - begin).sum())
        share = (length - BLOCKS_M[0]) / (BLOCKS_M[1] - BLOCKS_M[0])
        limit = float(np.interp(share, (0.0, 1.0), STREET_MPS) * rng.uniform(*CAREFUL))
        line = np.array([begin + town.radius * ahead, end - town.radius * ahead]) + RIGHT_M * right
        street = (min(before, after), max(before, after))
        if street in town.stops and rng.random() < CALLED:
            at = town.stops[street] if before < after else 1.0 - town.stops[street]
            halts.append((way + at * length - town.radius, float(rng.uniform(*CALLED_S)), True))
        way += add(line[:, 0], line[:, 1], np.full(2, angle), limit)
        if rng.random() < RED:
            halts.append((way - AHEAD_M, float(rng.uniform(*RED_S)), False))
        if later is None:
            break
        onward = (town.at(later) - end) / np.abs(town.at(later) - end).sum()
        turn = float(ahead[0] * onward[1] - ahead[1] * onward[0])  # 1 to the left, -1 to the right
        if turn:
            radius = town.radius + turn * RIGHT_M
            centre = end + town.radius * (onward - ahead)
            bend = angle + turn * np.linspace(0.0, 0.5 * np.pi, 40)
            limit = float(np.sqrt(SIDEWAYS_MPS2 * radius))
            way += add(centre[0] + turn * radius * np.sin(bend), centre[1] - turn * radius * np.cos(bend), bend, limit)
        else:
            line = np.array([end - town.radius * ahead, end + town.radius * ahead]) + RIGHT_M * right
            way += add(line[:, 0], line[:, 1], np.full(2, angle), limit)
    return _evenly(x, y, heading, fastest, halts, rng)


def _evenly(
    x: list[Array], y: list[Array], heading: list[Array], fastest: list[Array], halts: list[tuple[float, float, bool]],
    rng: np.random.Generator,
) -> Path:  # fmt: skip
    """A path of points that are as far apart everywhere, from pieces that follow one another."""
    raw_x, raw_y, raw_heading, raw_fastest = (np.concatenate(pieces) for pieces in (x, y, heading, fastest))
    way = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(raw_x), np.diff(raw_y)))))
    even = np.arange(0.0, way[-1], SPACING_M)
    window = np.full(int(BEND_M / SPACING_M), SPACING_M / BEND_M)
    padded = np.pad(np.interp(even, way, raw_heading), len(window) // 2, mode="edge")
    knots = np.arange(0.0, way[-1] + UNEVEN_M, UNEVEN_M)
    uneven = 1.0 - np.interp(even, knots, rng.uniform(0.0, UNEVEN, len(knots)))
    limit = raw_fastest[np.clip(np.searchsorted(way, even, side="right") - 1, 0, len(way) - 1)]
    at, held, called = (np.array([halt[i] for halt in halts]) for i in (0, 1, 2))
    points = np.round(at / SPACING_M).astype(np.int64)
    return Path(
        np.interp(even, way, raw_x), np.interp(even, way, raw_y), np.convolve(padded, window, mode="valid"), limit * uneven,
        (points, held, called.astype(bool)),
    )  # fmt: skip


def _timetable(path: Path, speeds_up: float, slows_down: float) -> tuple[Array, Array, Indices]:
    """Times at which points are reached and left, the speed there, and how often it halted at stops before."""
    squared = path.fastest**2
    points, held, called = path.halts
    squared[0] = squared[-1] = 0.0
    squared[points] = 0.0
    for ahead, most, order in ((1, slows_down, range(len(squared) - 2, -1, -1)), (-1, speeds_up, range(1, len(squared)))):
        gain, kept = 2.0 * most * SPACING_M, squared.tolist()
        for i in order:
            kept[i] = min(kept[i], kept[i + ahead] + gain)
        squared = np.array(kept)
    speed = np.sqrt(squared)
    waits, stops = np.zeros(len(speed)), np.zeros(len(speed), dtype=np.int64)
    waits[points], waits[0], stops[points] = held, START_S, called
    reached = np.concatenate(([0.0], np.cumsum(waits[:-1] + 2.0 * SPACING_M / (speed[:-1] + speed[1:]))))
    halted = np.flatnonzero(waits)
    time = np.insert(reached, halted + 1, (reached + waits)[halted])
    before = np.cumsum(stops) - stops
    return time, np.insert(speed, halted + 1, speed[halted]), np.insert(before, halted + 1, (before + stops)[halted])


def _brakes(speed: Array, accel: Array) -> Array:
    """Friction brakes' share of a braking torque; they hold a standing vehicle."""
    helped = MOST_TAKEN * np.clip((-accel - HARD_MPS2) / (HARDEST_MPS2 - HARD_MPS2), 0.0, 1.0)
    return np.where(speed > 0.0, helped, 1.0)
