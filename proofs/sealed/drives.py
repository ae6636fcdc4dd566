# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Draws the drives of the proofs: drivers and routes that vary, recorded speeds of real vehicles, and towns."""

from __future__ import annotations

import csv
import gzip
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trackres_ros.arrays import Array
from trackres_ros.errors import InputError

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
        item = profiles[int(rng.integers(len(profiles)))]
        rests = np.flatnonzero(item < RESTING_MPS)  # it begins and ends at rest, as drives that are joined must
        begin = int(rng.choice(rests[: max(int(np.searchsorted(rests, len(item) - n)), 1)]))
        slower = min(1.0, fastest / float(item.max()), HARDEST_MPS2 / float(np.abs(np.gradient(item, STEP_S)).max()))
        parts.append(item[begin : int(rests[-1]) + 1] * slower)
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
    output, i = np.empty(n), 0
    while i < n:
        hold = int(rng.gamma(3.0, restless / 3.0) / STEP_S) + 50
        stop = rng.random() < 0.12
        output[i : i + hold] = 0.0 if stop else fastest * rng.beta(1.6, 1.3) * 0.85 + 0.8
        i += hold
    output[:30] = 0.0
    return output


def _eased(target: Array, brisk: float) -> Array:
    """The vehicle's version of it: bounded acceleration, smoothed jerk."""
    speed, time_now, accel = np.empty(len(target)), 0.0, 0.0
    for i, aim in enumerate(target):
        wanted = np.clip((aim - time_now) / 1.5, -1.4 * brisk, brisk)
        accel += (wanted - accel) * STEP_S / 0.6
        time_now = max(0.0, time_now + accel * STEP_S)
        speed[i] = time_now
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


SPEED_FILES = {
    "bmw_i3/Trip*.csv.gz": (";", "Time [s]", "Velocity [km/h]", 1.0 / 3.6),
    "ztbus/*.csv.gz": (",", "time_unix", "odometry_vehicleSpeed", 1.0),
}  # files, delimiter, columns of time and speed, and the unit of the speed
SMOOTH_S = 1.5  # over which a speed recorded once a second is rounded


def profile_files(data: Path) -> list[tuple[Path, tuple[str, str, str, float]]]:
    """Recordings in the folder that `python -m proofs real --data` takes, each with how it is read."""
    results = [(path, how) for pattern, how in SPEED_FILES.items() for path in sorted(data.glob(pattern))]
    if not results:
        raise InputError("--profiles", str(data), "a folder with bmw_i3/Trip*.csv.gz or ztbus/*.csv.gz")
    return results


def read_profiles(data: Path) -> list[Array]:
    """Speeds [m/s] by `STEP_S`, one series a recording that has a stop in it."""
    results = []
    for path, (delimiter, time_name, speed_name, unit) in profile_files(data):
        with gzip.open(path, "rt", encoding="latin-1", newline="") as lines:
            rows = [(row[time_name] or "nan", row[speed_name] or "nan") for row in csv.DictReader(lines, delimiter=delimiter)]
        table = np.array(rows, dtype=float)
        table = table[np.isfinite(table).all(axis=1)]
        _, first = np.unique(table[:, 0], return_index=True)
        time, speed = table[first].T
        even = np.interp(np.arange(time[0], time[-1], STEP_S), time, np.abs(speed) * unit)
        window = np.hanning(int(SMOOTH_S / STEP_S) + 2)[1:-1]
        smooth = np.convolve(even, window / window.sum(), mode="same")
        if (smooth < RESTING_MPS).any():
            results.append(smooth)
    return results


Crossing = tuple[int, int]

BLOCKS_M = (150.0, 400.0)
COLUMNS, ROWS = 3, (3, 4)  # of crossings
WAVES, WAVES_M = 16, (250.0, 700.0)  # of the ground
STREET_HALF_M = 20.0  # from the middle of a street on, nothing of it is felt or covered any more
EDGE_M = 12.0  # over which soft ground begins
SOFT_STREETS = 0.3  # share of the streets
SOFT_SIZES = (0.4, 1.0)  # of the softest
COVERED_TOWNS = 0.5  # share of the towns in which trees or walls hide the satellites in one street
SOUNDED_M = 5.0  # along streets, to find the steepest place


@dataclass(frozen=True)
class Patch:
    """A part of a street between two places [m], of a size of its own."""

    begin: tuple[float, float]
    end: tuple[float, float]
    size: float = 1.0

    def along(self, x: Array, y: Array) -> tuple[Array, Array]:
        """How far places are along it from its begin, and aside of it [m]."""
        (x0, y0), (x1, y1) = self.begin, self.end
        east, north = (x1 - x0) / self.length, (y1 - y0) / self.length
        return (x - x0) * east + (y - y0) * north, (x - x0) * north - (y - y0) * east

    @property
    def length(self) -> float:
        """From its begin to its end [m]."""
        return float(np.hypot(self.end[0] - self.begin[0], self.end[1] - self.begin[1]))


@dataclass(frozen=True, eq=False)
class Town:
    """Streets on a grid, and the ground below them.

    `waves` are those of the height: wave numbers to the east and to the north [rad/m], phases [rad] and amplitudes [m], shape
    (4, waves); the steepest place of all streets has a slope of 1.
    """

    east: Array  # of the streets that run north [m], shape (columns,)
    north: Array  # of those that run east [m], shape (rows,)
    waves: Array
    soft: tuple[Patch, ...]  # parts of streets on which driving is harder
    covered: Patch | None  # part of a street where no satellite is seen
    radius: float  # of the bends at crossings, in the middle of the street [m]
    stops: dict[tuple[Crossing, Crossing], float]  # by street its place as a share, from the crossing that comes first in order

    def at(self, crossing: Crossing) -> Array:
        """Where a crossing is [m], shape (2,)."""
        return np.array([self.east[crossing[0]], self.north[crossing[1]]])

    def neighbours(self, crossing: Crossing) -> list[Crossing]:
        """Crossings a block away."""
        i, j = crossing
        near = ((i + 1, j), (i, j + 1), (i - 1, j), (i, j - 1))
        return [(k, m) for k, m in near if 0 <= k < len(self.east) and 0 <= m < len(self.north)]

    @property
    def streets(self) -> list[tuple[Crossing, Crossing]]:
        """Blocks between two crossings, the first in order first."""
        crossings = [(i, j) for i in range(len(self.east)) for j in range(len(self.north))]
        return [
            (crossing, other_neighbour)
            for crossing in crossings
            for other_neighbour in self.neighbours(crossing)
            if crossing < other_neighbour
        ]

    def height(self, x: Array, y: Array) -> Array:
        """Height of the ground [m] for a steepest slope of 1."""
        kx, ky, phase, size = self.waves
        return np.asarray(np.sin(np.multiply.outer(x, kx) + np.multiply.outer(y, ky) + phase) @ size)

    def slope(self, x: Array, y: Array, heading: Array) -> Array:
        """Rise over run in a direction [rad, from east to north], for a steepest slope of 1."""
        kx, ky, phase, size = self.waves
        swing = np.cos(np.multiply.outer(x, kx) + np.multiply.outer(y, ky) + phase) * size
        return np.asarray((swing @ kx) * np.cos(heading) + (swing @ ky) * np.sin(heading))

    def softness(self, x: Array, y: Array) -> Array:
        """How soft or rough the ground is: of the softest street nearly 1, else less, mostly 0."""
        output = np.zeros(len(x))
        for patch in self.soft:
            along, aside = patch.along(x, y)
            is_inside = np.tanh(along / EDGE_M) - np.tanh((along - patch.length) / EDGE_M)
            output += 0.5 * patch.size * is_inside * (np.abs(aside) < STREET_HALF_M)
        return output

    def hidden_from_above(self, x: Array, y: Array) -> NDArray[np.bool_]:
        """Where no satellite is seen."""
        if self.covered is None:
            return np.zeros(len(x), dtype=bool)
        along, aside = self.covered.along(x, y)
        return np.asarray((along > 0.0) & (along < self.covered.length) & (np.abs(aside) < STREET_HALF_M))


def draw_town(rng: np.random.Generator) -> Town:
    """A town of its own."""
    east, north = (_grid(count, rng) for count in (COLUMNS, int(rng.choice(ROWS))))
    length, towards = rng.uniform(*WAVES_M, WAVES), rng.uniform(0.0, 2.0 * np.pi, WAVES)
    number = 2.0 * np.pi / length
    phase, size = rng.uniform(0.0, 2.0 * np.pi, WAVES), rng.normal(size=WAVES) / number
    waves = np.array([number * np.cos(towards), number * np.sin(towards), phase, size])
    bare = Town(east, north, waves, (), None, float(rng.uniform(10.0, 18.0)), {})
    waves[3] /= _steepest(bare)
    streets = bare.streets
    order = rng.permutation(len(streets))
    soft_ones = max(2, round(SOFT_STREETS * len(streets)))
    sizes = rng.uniform(*SOFT_SIZES, soft_ones)
    soft = tuple(
        _part(bare, streets[k], rng, float(size)) for k, size in zip(order[:soft_ones], sizes / sizes.max(), strict=True)
    )
    covered = _part(bare, streets[order[-1]], rng) if rng.random() < COVERED_TOWNS else None
    stops = {street: float(rng.uniform(0.35, 0.65)) for street in streets if rng.random() < 0.4}
    return Town(east, north, waves, soft, covered, bare.radius, stops)


def _grid(count: int, rng: np.random.Generator) -> Array:
    return np.concatenate(([0.0], np.cumsum(rng.uniform(*BLOCKS_M, count - 1))))


def _part(town: Town, street: tuple[Crossing, Crossing], rng: np.random.Generator, size: float = 1.0) -> Patch:
    """Most of a street, without its crossings."""
    begin, end = (town.at(crossing) for crossing in street)
    first, last = rng.uniform(0.15, 0.25), rng.uniform(0.75, 0.85)
    (x0, y0), (x1, y1) = (begin + share * (end - begin) for share in (first, last))
    return Patch((float(x0), float(y0)), (float(x1), float(y1)), size)


def _steepest(town: Town) -> float:
    results = []
    for street in town.streets:
        begin, end = (town.at(crossing) for crossing in street)
        share = np.linspace(0.0, 1.0, int(np.abs(end - begin).sum() / SOUNDED_M) + 2)
        x, y = (begin[i] + share * (end[i] - begin[i]) for i in (0, 1))
        heading = np.full(len(x), np.arctan2(end[1] - begin[1], end[0] - begin[0]))
        results.append(float(np.abs(town.slope(x, y, heading)).max()))
    return max(results)


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
BRAKING_MPS2, MOST_BRAKING_MPS2, MOST_TAKEN = (
    0.7,
    1.4,
    0.8,
)  # friction brakes help from the first on, and take so much at the second
MEAN_MPS = 11.0  # more than it drives in the mean


@dataclass(frozen=True, eq=False)
class Way:
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
    time_now = np.arange(int(minutes * 60.0 / STEP_S)) * STEP_S
    window = np.hanning(int(JERK_S / STEP_S) + 2)[1:-1]
    sharp = np.pad(np.interp(time_now, time, speed_at), len(window) // 2, mode="edge")
    speed = np.convolve(sharp, window / window.sum(), mode="valid")
    speed[speed < 1e-9] = 0.0
    distance, way = np.cumsum(speed) * STEP_S, np.arange(len(path.x)) * SPACING_M
    x, y, heading = (np.interp(distance, way, series) for series in (path.x, path.y, path.heading))
    accel = np.gradient(speed, STEP_S)
    street = OnStreet(
        x, y, steepest * town.slope(x, y, heading), steepest * town.height(x, y), town.softness(x, y),
        town.hidden_from_above(x, y),
        stretch_at[np.searchsorted(time, time_now + 2.0 * JERK_S, side="right") - 1],  # doors are shut before it starts
        _brakes(speed, accel),
    )  # fmt: skip
    air = ambient + rng.normal(0.0, 1.0) * np.sin(time_now / 1500.0)
    return SealedDrive(
        STEP_S, speed, accel, np.gradient(heading, STEP_S), heading, np.full(len(time_now), weight), air, street=street
    )


def _walk(town: Town, metres: float, rng: np.random.Generator) -> list[Crossing]:
    """Crossings one after the other, never straight back."""
    here: Crossing = (int(rng.integers(len(town.east))), int(rng.integers(len(town.north))))
    walk, way = [here], 0.0
    while way < metres:
        forecasts = [c for c in town.neighbours(walk[-1]) if len(walk) < 2 or c != walk[-2]]
        walk.append(forecasts[int(rng.integers(len(forecasts)))])
        way += float(np.abs(town.at(walk[-1]) - town.at(walk[-2])).sum())
    return walk


def _path(town: Town, walk: list[Crossing], rng: np.random.Generator) -> Way:
    x, y, heading, fastest = (list[Array]() for _ in range(4))
    halts = list[tuple[float, float, bool]]()  # way [m], how long [s], whether at a stop
    way, angle = 0.0, float("nan")

    def add(east: Array, north: Array, towards: Array, limit: float) -> float:
        for kept, series in ((x, east), (y, north), (heading, towards), (fastest, np.full(len(east), limit))):
            kept.append(series)
        return float(np.hypot(np.diff(east), np.diff(north)).sum())

    then: list[Crossing | None] = [*walk[2:], None]
    for node_before, node_after, later in zip(walk[:-1], walk[1:], then, strict=True):
        begin, end = town.at(node_before), town.at(node_after)
        forecast = (end - begin) / np.abs(end - begin).sum()
        right = np.array([forecast[1], -forecast[0]])
        towards = float(np.arctan2(forecast[1], forecast[0]))
        angle = towards if np.isnan(angle) else angle + float(np.angle(np.exp(1j * (towards - angle))))
        length = float(np.abs(end - begin).sum())
        share = (length - BLOCKS_M[0]) / (BLOCKS_M[1] - BLOCKS_M[0])
        limit = float(np.interp(share, (0.0, 1.0), STREET_MPS) * rng.uniform(*CAREFUL))
        line = np.array([begin + town.radius * forecast, end - town.radius * forecast]) + RIGHT_M * right
        street = (min(node_before, node_after), max(node_before, node_after))
        if street in town.stops and rng.random() < CALLED:
            place = town.stops[street] if node_before < node_after else 1.0 - town.stops[street]
            halts.append((way + place * length - town.radius, float(rng.uniform(*CALLED_S)), True))
        way += add(line[:, 0], line[:, 1], np.full(2, angle), limit)
        if rng.random() < RED:
            halts.append((way - AHEAD_M, float(rng.uniform(*RED_S)), False))
        if later is None:
            break
        onward = (town.at(later) - end) / np.abs(town.at(later) - end).sum()
        turn = float(forecast[0] * onward[1] - forecast[1] * onward[0])  # 1 to the left, -1 to the right
        if turn:
            radius = town.radius + turn * RIGHT_M
            centre = end + town.radius * (onward - forecast)
            bend = angle + turn * np.linspace(0.0, 0.5 * np.pi, 40)
            limit = float(np.sqrt(SIDEWAYS_MPS2 * radius))
            way += add(centre[0] + turn * radius * np.sin(bend), centre[1] - turn * radius * np.cos(bend), bend, limit)
        else:
            line = np.array([end - town.radius * forecast, end + town.radius * forecast]) + RIGHT_M * right
            way += add(line[:, 0], line[:, 1], np.full(2, angle), limit)
    return _evenly(x, y, heading, fastest, halts, rng)


def _evenly(
    x: list[Array], y: list[Array], heading: list[Array], fastest: list[Array], halts: list[tuple[float, float, bool]],
    rng: np.random.Generator,
) -> Way:  # fmt: skip
    """A path of points that are as far apart everywhere, from pieces that follow one another."""
    raw_x, raw_y, raw_heading, raw_fastest = (np.concatenate(pieces) for pieces in (x, y, heading, fastest))
    way = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(raw_x), np.diff(raw_y)))))
    even = np.arange(0.0, way[-1], SPACING_M)
    window = np.full(int(BEND_M / SPACING_M), SPACING_M / BEND_M)
    padded = np.pad(np.interp(even, way, raw_heading), len(window) // 2, mode="edge")
    knots = np.arange(0.0, way[-1] + UNEVEN_M, UNEVEN_M)
    uneven = 1.0 - np.interp(even, knots, rng.uniform(0.0, UNEVEN, len(knots)))
    limit = raw_fastest[np.clip(np.searchsorted(way, even, side="right") - 1, 0, len(way) - 1)]
    place, held, called = (np.array([halt[i] for halt in halts]) for i in (0, 1, 2))
    points = np.round(place / SPACING_M).astype(np.int64)
    return Way(
        np.interp(even, way, raw_x), np.interp(even, way, raw_y), np.convolve(padded, window, mode="valid"), limit * uneven,
        (points, held, called.astype(bool)),
    )  # fmt: skip


def _timetable(path: Way, speeds_up: float, slows_down: float) -> tuple[Array, Array, Indices]:
    """Times at which points are reached and left, the speed there, and how often it halted at stops before."""
    squared = path.fastest**2
    points, held, called = path.halts
    squared[0] = squared[-1] = 0.0
    squared[points] = 0.0
    for forecast, most, order in ((1, slows_down, range(len(squared) - 2, -1, -1)), (-1, speeds_up, range(1, len(squared)))):
        gain, kept = 2.0 * most * SPACING_M, squared.tolist()
        for i in order:
            kept[i] = min(kept[i], kept[i + forecast] + gain)
        squared = np.array(kept)
    speed = np.sqrt(squared)
    waits, stops = np.zeros(len(speed)), np.zeros(len(speed), dtype=np.int64)
    waits[points], waits[0], stops[points] = held, START_S, called
    reached = np.concatenate(([0.0], np.cumsum(waits[:-1] + 2.0 * SPACING_M / (speed[:-1] + speed[1:]))))
    halted = np.flatnonzero(waits)
    time = np.insert(reached, halted + 1, (reached + waits)[halted])
    stop_sums = np.cumsum(stops) - stops
    return (
        time,
        np.insert(speed, halted + 1, speed[halted]),
        np.insert(stop_sums, halted + 1, (stop_sums + stops)[halted]),
    )


def _brakes(speed: Array, accel: Array) -> Array:
    """Friction brakes' share of a braking torque; they hold a standing vehicle."""
    helped = MOST_TAKEN * np.clip((-accel - BRAKING_MPS2) / (MOST_BRAKING_MPS2 - BRAKING_MPS2), 0.0, 1.0)
    return np.where(speed > 0.0, helped, 1.0)
