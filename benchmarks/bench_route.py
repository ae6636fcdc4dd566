# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What following a vehicle on a route adds to a step, in a town of 400 km of streets and where they lie as dense as they may."""

from __future__ import annotations

import statistics
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from measuring import START_NS, at_most
from numpy.typing import NDArray

from trackres_ros.estimator import columns as at
from trackres_ros.estimator.entry_points import COMPILED, INTERPRETED, Entries
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.route.learned import SLOPE, TORQUE, RouteMap
from trackres_ros.route.lookup import CELL_M, SPACING_M
from trackres_ros.route.table import MOST_IN_A_CELL
from trackres_ros.route.track import Frame
from trackres_ros.vehicle import load

STEPS, SPEEDS_A_POSITION = 20_000, 100  # a position a second, a speed each 10 ms
STREETS, STREET_M = 200, 2000.0
STEP_NS = 10_000_000
FRAME = Frame(0.83, 0.15)
WITHOUT, TOWN, DENSE = "no route", "a town", "as dense as may be"
TARGETS = {
    f"compiled: a speed in {TOWN} over one with {WITHOUT}, mean": at_most(1.2),
    f"compiled: a speed, {DENSE}, 99.9 % [us]": at_most(200.0),
    f"interpreted: a speed in {TOWN} over one with {WITHOUT}, mean": at_most(1.2),
}

Array = NDArray[np.float64]


def route(x: Array, y: Array, course: Array) -> tuple[RouteMap, RouteMap]:
    """A slope and a torque of each place."""
    n = len(x)
    pose, passes = (*FRAME.position(x, y), course), np.full(n, 3)
    value = np.random.default_rng(1).normal(0.0, 0.02, (n, 2))
    slope, spread = np.stack([value[:, 0], -value[:, 0]], axis=1), np.full((n, 2), 0.002)
    return RouteMap(SLOPE, *pose, slope, spread, passes), RouteMap(TORQUE, *pose, 1e4 * value, 1e4 * spread, passes)


def routes() -> dict[str, Sequence[RouteMap]]:
    """None, a town with a street each way every 10 m, and one spot."""
    along = np.arange(0.0, STREET_M, SPACING_M)
    across = np.repeat(np.arange(STREETS // 2) * 10.0, len(along))
    along = np.tile(along, STREETS // 2)
    level = np.zeros(len(along))
    town = (np.concatenate(pair) for pair in ((along, across), (across, along), (level, level + 0.5 * np.pi)))
    corners = CELL_M * np.stack(np.meshgrid(np.arange(-2, 22), np.arange(-2, 2)), axis=-1).reshape(-1, 1, 2)
    spots = (corners + np.random.default_rng(2).uniform(0.0, CELL_M, (len(corners), MOST_IN_A_CELL, 2))).reshape(-1, 2)
    return {WITHOUT: (), TOWN: route(*town), DENSE: route(spots[:, 0], spots[:, 1], np.zeros(len(spots)))}


def times(steps: int, entries: Entries) -> dict[str, list[float]]:
    """Wall time of each speed [s] by route; all meet the same machine."""
    vehicle = load("xgd24d")
    latitude, longitude = FRAME.position(0.08 * np.arange(steps) % 1000.0, np.full(steps, 2.0))
    sessions = {name: Estimator(replace(vehicle, route=tuple(r)), entries=entries).session() for name, r in routes().items()}
    found: dict[str, list[float]] = {name: [] for name in sessions}
    for n in range(steps):
        now = START_NS + n * STEP_NS
        for name, session in sessions.items():
            if n % SPEEDS_A_POSITION == 0:
                session.handle(at.LATITUDE, now, now, float(latitude[n]))
                session.handle(at.LONGITUDE, now, now, float(longitude[n]))
            before = time.perf_counter()
            session.handle(at.SPEED, now, now, 8.0 + 0.01 * (n % 7))
            found[name].append(time.perf_counter() - before)
    return found


def run(steps: int = STEPS) -> dict[str, float]:
    """Measure so many speeds; a twentieth as many in plain Python."""
    result = {}
    for kind, entries, count in (("compiled", COMPILED, steps), ("interpreted", INTERPRETED, max(steps // 20, 20))):
        found = times(count, entries)
        for name, of in found.items():
            result[f"{kind}: a speed, {name}, median [us]"] = 1e6 * statistics.median(of)
            result[f"{kind}: a speed, {name}, 99.9 % [us]"] = 1e6 * float(np.quantile(of, 0.999))
        mean = {name: statistics.mean(sorted(of)[: int(0.999 * len(of))]) for name, of in found.items()}
        result[f"{kind}: a speed in {TOWN} over one with {WITHOUT}, mean"] = mean[TOWN] / mean[WITHOUT]
    return result
