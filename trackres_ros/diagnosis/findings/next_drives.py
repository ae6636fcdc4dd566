# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Step 9: what to drive next, so that candidates that look alike here come apart."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.inference.fitting import Fit, jacobian
from trackres_ros.diagnosis.inference.noise import whitened
from trackres_ros.diagnosis.prepare.session import Session
from trackres_ros.diagnosis.prepare.settings import SLOWEST_MPS
from trackres_ros.diagnosis.selection.naming import Candidate

Array = NDArray[np.float64]

STEP_S = 1.0
SEEN_D_PRIME, SURE_D_PRIME = 3.0, 6.0
KNOWN_SLOPE = 0.05


@dataclass(frozen=True, slots=True)
class Advice:
    """A manoeuvre and what it tells apart.

    Attributes
    ----------
    separates
        The effects concerned.
    groups
        The same: what is in one group stays tied.
    manoeuvre, minutes
        What to drive, and for how long.
    expected_d_prime
        Standard deviations between the closest two of different groups.
    """

    separates: tuple[str, ...]
    groups: tuple[tuple[str, ...], ...]
    manoeuvre: str
    expected_d_prime: float
    minutes: float


def advise(candidates: Sequence[Candidate], members: Sequence[str], max_speed: float) -> list[Advice]:
    """Manoeuvres from a small menu, the best first; empty where nothing is tied, or nothing on it tells any two apart."""
    tied = [c for c in candidates if c.name in members]
    if len(tied) < 2:
        return []
    problem = tied[0].fit.problem
    found = []
    for name, drive in menu(problem.base.facts.weight, max_speed).items():
        session = drive(problem.sessions[0])
        apart = {
            frozenset((a.name, b.name)): min(_apart(a.fit, b.fit, session), _apart(b.fit, a.fit, session))
            for a, b in combinations(tied, 2)
        }
        groups = _groups([c.name for c in tied], {pair for pair, d in apart.items() if d < SEEN_D_PRIME})
        if len(groups) > 1:
            between = [d for pair, d in apart.items() if not any(pair <= set(group) for group in groups)]
            found.append(Advice(tuple(c.name for c in tied), groups, name, min(between), len(session) * STEP_S / 60.0))
    # First what leaves the fewest together; of those that surely separate the shortest.
    return sorted(found, key=lambda a: (-len(a.groups), -min(a.expected_d_prime, SURE_D_PRIME), a.minutes))[:3]


def _groups(names: Sequence[str], tied: set[frozenset[str]]) -> tuple[tuple[str, ...], ...]:
    """Names in groups, so that no pair of a tie is in two of them."""
    groups = [{name} for name in names]
    for pair in tied:
        joined = [group for group in groups if group & pair]
        groups = [group for group in groups if not group & pair] + [set().union(*joined)]
    return tuple(sorted((tuple(n for n in names if n in group) for group in groups), key=lambda g: names.index(g[0])))


def menu(weight: float, max_speed: float) -> dict[str, Callable[[Session], Session]]:
    """Manoeuvres by name; each makes a session like one that was recorded."""
    fast, slow = 0.7 * max_speed, 0.25 * max_speed

    def drive(
        points: Sequence[tuple[float, float]], load: Sequence[float] = (1.0,), curvature: float = 0.0, slope: float = 0.0
    ) -> Callable[[Session], Session]:
        def made(like: Session) -> Session:
            time = np.arange(0.0, points[-1][0], STEP_S)
            at, speed_at = np.array([p[0] for p in points]), np.array([p[1] for p in points])
            edges = np.interp(np.append(time, points[-1][0]), at, speed_at)
            speed = 0.5 * (edges[1:] + edges[:-1])
            n = len(time)
            weights = weight * np.repeat(load, -(-n // len(load)))[:n]
            turning = np.where((time // 60.0) % 2 == 1, curvature, 0.0) * speed
            grade = np.where((time // 60.0) % 2 == 1, slope, -slope)
            return replace(
                like, name="manoeuvre", time=time, speed=speed, accel=np.diff(edges) / STEP_S, weight=weights,
                ambient=np.full(n, like.ambient[0]), grade=grade, yaw_rate=turning, heading=np.cumsum(turning) * STEP_S,
                distance=np.cumsum(np.abs(speed)) * STEP_S, torque=np.zeros(n), belt=np.full(n, np.nan),
                used=np.ones(n, dtype=bool), block=np.zeros(n, dtype=np.int64), gap=np.inf,
                given=like.given | {"grade"} if slope else like.given,
            )  # fmt: skip

        return made

    stairs = [(60.0 * i + t, v) for i, v in enumerate(np.linspace(slow, fast, 8)) for t in (15.0, 60.0)]
    launches = [
        (30.0 * i + t, v) for i in range(10) for t, v in ((0.0, 0.0), (6.0, fast / 2), (20.0, fast / 2), (26.0, 0.0), (29.0, 0.0))
    ]
    return {
        "drive forwards and then in reverse, two minutes each": drive(
            [(0, 0), (10, slow), (120, slow), (135, -slow), (250, -slow)]
        ),
        "drive at one speed with three loads, five minutes each": drive([(0, 0), (20, fast), (900, fast)], load=(0.75, 1.0, 1.3)),
        "a staircase of speeds, cold, then again hot": drive([(0, 0), *stairs, *((t + 1500.0, v) for t, v in stairs)]),
        "ten sharp launches with coasting down between them": drive([(0, 0), *((t + 1.0, v) for t, v in launches)]),
        "circles of 30 m radius and straights in turns, five minutes": drive(
            [(0, 0), (10, slow), (300, slow)], curvature=1.0 / 30.0
        ),
        f"up and down a surveyed slope of {KNOWN_SLOPE:.0%} in turns, a minute each, with the grade in the recording": drive(
            [(0, 0), (10, slow), (360, slow)], slope=KNOWN_SLOPE
        ),
        "drive for 20 minutes, stand for an hour, drive for 10 minutes": drive(
            [(0, 0), (20, fast), (1200, fast), (1220, 0), (4820, 0), (4840, fast), (5440, fast)]
        ),
    }


def _apart(truth: Fit, rival: Fit, session: Session) -> float:
    """Standard deviations by which a truth stands out of its rival, after the rival's parameters have moved as they may."""

    def torque(found: Fit, point: Array) -> Array:
        return found.problem.base.predict([session], *found.model_at(point))[0].torque

    shown, expected = torque(truth, truth.point), torque(rival, rival.point)
    columns = jacobian(lambda point: torque(rival, point), rival.point, rival.free)
    moving = np.abs(session.speed) > SLOWEST_MPS  # the gate leaves out the rest

    def white(x: Array) -> Array:
        out = whitened(x, moving, rival.noise.phi) / rival.noise.std
        return np.asarray(out[np.isfinite(out) if out.ndim == 1 else np.isfinite(out).all(axis=1)])

    difference, j = white(shown - expected), white(columns)
    gram = np.linalg.pinv(rival.covariance, rcond=1e-12) + j.T @ j
    left = difference @ difference - (difference @ j) @ np.linalg.solve(gram, j.T @ difference)
    return math.sqrt(max(float(left), 0.0))
