# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Step 9: proposes drives that separate similar candidates from each other and from no effect."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np

from trackres_ros.diagnosis.base.patterns import ResidualPattern
from trackres_ros.diagnosis.empirical.term import MODEL_ERROR, Term
from trackres_ros.diagnosis.inference.fitting import Fit, jacobian
from trackres_ros.diagnosis.inference.noise import whitened
from trackres_ros.diagnosis.prepare.session import SLOWEST_MPS, Array, DriveSession, Mask

Points = Sequence[tuple[float, float]]

STEP_S = 1.0
SEEN_D_PRIME = 4.0  # at this distance, the likelihood differs by more than within a class with 90 % probability
NEARLY = 0.9  # of the most information: the shortest such manoeuvre comes first
MOST_ADVICE = 3
KNOWN_SLOPE = 0.05
LOADS = 0.75, 1.0, 1.3  # of the weight in the vehicle file


@dataclass(frozen=True, slots=True)
class Advice:
    """A manoeuvre and the explanations that it separates."""

    separates: tuple[str, ...]  # the tied effects
    groups: tuple[tuple[str, ...], ...]  # the same in groups; effects of one group stay tied
    manoeuvre: str
    expected_d_prime: float  # standard deviations between the closest two of different groups
    minutes: float
    information_bit: float  # expected lower bound for the group, or for none but the model's own error


def advise(term: Term, max_speed: float) -> list[Advice]:
    """Manoeuvres from a menu, the best first; empty without ties, or if no manoeuvre separates any two."""
    if term.rivals is None or len(term.members) < 2:
        return []
    terms = [term, *(c for c in term.rivals.candidates if c.name in term.members)]
    names, rival_fits = [c.name for c in terms], [*(c.fit for c in terms), term.rivals.before]
    probabilities = [term.weights[name] for name in names]
    probabilities.append(max(probabilities))  # for none of them: that of the most likely one
    weights = np.array([x / sum(probabilities) for x in probabilities])
    present_distances = recorded_distances([c.level - term.rivals.cost for c in terms])
    information_before = information(weights, present_distances)
    problem, advice = term.rivals.before.problem, []
    for manoeuvre, drive in menu(problem.base.facts.weight, max_speed).items():
        session = drive(problem.sessions[0])
        squares = squared_distances(rival_fits, session)
        smallest_distances = np.sqrt(np.maximum(np.minimum(squares, squares.T), 0.0))
        pair_distances = {
            frozenset((names[i], names[j])): float(smallest_distances[i, j]) for i, j in combinations(range(len(names)), 2)
        }
        groups = _groups(names, {pair for pair, d in pair_distances.items() if d < SEEN_D_PRIME})
        is_tied = np.array([[any({a, b} <= set(group) for group in groups) for b in names] for a in names])
        squares[:-1, :-1][is_tied] = 0.0  # tied effects add no information
        bits = information(weights, np.maximum(present_distances + squares, 0.0)) - information_before
        if len(groups) > 1 and bits > 0.0:
            distances = [d for pair, d in pair_distances.items() if not any(pair <= set(group) for group in groups)]
            advice.append(Advice(tuple(names), groups, manoeuvre, min(distances), len(session) * STEP_S / 60.0, bits))
    return _best_first(advice)


def _best_first(advice: Sequence[Advice]) -> list[Advice]:
    """The shortest of the nearly most informative ones, then the others by information."""
    most_bits = max((a.information_bit for a in advice), default=0.0)
    ranking = sorted(advice, key=lambda a: -a.information_bit)
    first_advice = min((a for a in ranking if a.information_bit >= NEARLY * most_bits), key=lambda a: a.minutes, default=None)
    return ([] if first_advice is None else [first_advice, *(a for a in ranking if a is not first_advice)])[:MOST_ADVICE]


def recorded_distances(gains: Sequence[float]) -> Array:
    """Squared distances from the recordings so far, of the tied effects and last of none: zero between effects, and
    twice the `gains` beyond the threshold from none, shape (n + 1, n + 1).
    """
    squares = np.zeros((len(gains) + 1, len(gains) + 1))
    squares[-1, :-1] = squares[:-1, -1] = [max(0.0, 2.0 * gain) for gain in gains]
    return squares


def information(weights: Array, squares: Array) -> float:
    """Lower bound of the information about the true hypothesis [bit].

    Parameters
    ----------
    weights
        Probabilities, shape (n,), sum 1.
    squares
        Squared distances of the first's prediction from the second, in standard deviations, shape (n, n).

    Notes
    -----
    The entropy of a mixture of normal distributions of equal width from their Bhattacharyya distances, which are an eighth of
    the squares: Kolchinsky and Tracey (2017), Estimating mixture entropy with pairwise distances, Entropy 19, 361.
    """
    return max(0.0, float(-weights @ np.log2(np.exp(-squares / 8.0) @ weights)))


def _groups(names: Sequence[str], tied_pairs: set[frozenset[str]]) -> tuple[tuple[str, ...], ...]:
    """Names in groups, so that no pair of a tie is in two of them."""
    groups = [{name} for name in names]
    for pair in tied_pairs:
        joined_groups = [group for group in groups if group & pair]
        groups = [group for group in groups if not group & pair] + [set().union(*joined_groups)]
    return tuple(sorted((tuple(n for n in names if n in group) for group in groups), key=lambda g: names.index(g[0])))


def _manoeuvre(
    recording: DriveSession,
    weight: float,
    points: Points,
    load: Sequence[float] = (1.0,),
    curvature: float = 0.0,
    slope: float = 0.0,
) -> DriveSession:
    """A session like a recorded one, with shares of the weight [N] in sequence.

    Speeds [m/s] are linear between `points` in time [s]. Each minute the curvature [1/m] is off or on, and the slope changes
    its sign.
    """
    times, speeds = np.array(points).T
    time = np.arange(0.0, times[-1], STEP_S)
    edges = np.interp(np.append(time, times[-1]), times, speeds)
    speed = 0.5 * (edges[1:] + edges[:-1])
    n = len(time)
    odd_minute = (time // 60.0) % 2 == 1
    turn_rate = np.where(odd_minute, curvature, 0.0) * speed
    return replace(
        recording,
        name="manoeuvre",
        time=time,
        speed=speed,
        accel=np.diff(edges) / STEP_S,
        weight=weight * np.repeat(load, -(-n // len(load)))[:n],
        ambient=np.full(n, recording.ambient[0]),
        grade=np.where(odd_minute, slope, -slope),
        yaw_rate=turn_rate,
        heading=np.cumsum(turn_rate) * STEP_S,
        distance=np.cumsum(np.abs(speed)) * STEP_S,
        torque=np.zeros(n),
        belt=np.full(n, np.nan),
        used=np.ones(n, dtype=bool),
        block=np.zeros(n, dtype=np.int64),
        gap=np.inf,
        given=recording.given | {"grade"} if slope else recording.given,
    )


def menu(weight: float, max_speed: float) -> dict[str, Callable[[DriveSession], DriveSession]]:
    """Manoeuvres by name; each makes a session like a recorded one."""
    fast_mps, slow_mps = 0.7 * max_speed, 0.25 * max_speed

    def drive(points: Points, **series: Any) -> Callable[[DriveSession], DriveSession]:
        return partial(_manoeuvre, weight=weight, points=points, **series)

    def times(count: int, points: Points) -> list[tuple[float, float]]:
        """The same repeatedly, from standstill to standstill."""
        return [(i * (points[-1][0] + 1.0) + t, v) for i in range(count) for t, v in points]

    launch = [(0.0, 0.0), (6.0, fast_mps / 2), (20.0, fast_mps / 2), (26.0, 0.0), (29.0, 0.0)]
    launch_back = [(t, -v / 2) for t, v in launch]
    both_ways = [*times(10, launch), *((300.0 + t, v) for t, v in times(10, launch_back))]
    to_and_fro = [(0.0, 0.0), (10.0, slow_mps), (120.0, slow_mps), (135.0, -slow_mps), (250.0, -slow_mps), (260.0, 0.0)]
    stairs = [(0.0, 0.0), *((60.0 * i + t, v) for i, v in enumerate(np.linspace(slow_mps, fast_mps, 8)) for t in (15.0, 60.0))]
    circles = [
        (0.0, 0.0),
        *((300.0 * i + t, v) for i, v in enumerate((0.6 * slow_mps, slow_mps, 1.4 * slow_mps)) for t in (10.0, 300.0)),
    ]
    slope = f"alternate up and down a surveyed slope of {100.0 * KNOWN_SLOPE:.0f} %, a minute each, and record the grade"
    light_and_heavy = LOADS[0], LOADS[-1]
    return {
        "drive forwards and then in reverse, two minutes each": drive(to_and_fro),
        "drive forwards and then in reverse, two minutes each, with each of three loads": drive(times(3, to_and_fro), load=LOADS),
        "drive at one speed with three loads, five minutes each": drive([(0, 0), (20, fast_mps), (900, fast_mps)], load=LOADS),
        "a staircase of speeds, cold, then again hot": drive([*stairs, *((t + 1500.0, v) for t, v in stairs[1:])]),
        "a staircase of speeds with a light load, then with a heavy one": drive(
            [*stairs, (495.0, 0.0), *((t + 495.0, v) for t, v in stairs)], load=light_and_heavy
        ),
        "ten sharp launches with coasting down between them": drive(times(10, launch)),
        "ten sharp launches with a light load, then ten with a heavy one": drive(times(20, launch), load=light_and_heavy),
        "ten sharp launches forwards, then ten in reverse": drive(both_ways),
        "ten sharp launches forwards and ten in reverse with a light load, then again with a heavy one": drive(
            times(2, both_ways), load=light_and_heavy
        ),
        "alternate circles of 30 m radius and straights, five minutes": drive(
            [(0, 0), (10, slow_mps), (300, slow_mps)], curvature=1.0 / 30.0
        ),
        "alternate circles of 30 m radius and straights, five minutes at each of three speeds": drive(
            circles, curvature=1.0 / 30.0
        ),
        slope: drive([(0, 0), (10, slow_mps), (360, slow_mps)], slope=KNOWN_SLOPE),
        f"sharp launches {slope}": drive(times(20, launch), slope=KNOWN_SLOPE),
        "drive for 20 minutes, stand for an hour, drive for 10 minutes": drive(
            [(0, 0), (20, fast_mps), (1200, fast_mps), (1220, 0), (4820, 0), (4840, fast_mps), (5440, fast_mps)]
        ),
    }


def squared_distances(rival_fits: Sequence[Fit], session: DriveSession) -> Array:
    """Squared distances of each fit's prediction from each other fit, in standard deviations, after re-fitting the latter's
    parameters within their uncertainty, shape (n, n).

    The last fit has none of the effects. Distances from it are smaller by the gain allowed for the model's own error, see
    `term.spurious_gain`. A manoeuvre that shows none of them therefore reduces the known distance.
    """
    is_moving = np.abs(session.speed) > SLOWEST_MPS  # the gate excludes standstill
    predictions = [_torque(fit, fit.point, session) for fit in rival_fits]
    columns = [
        _refit_distances(rival, predictions, torque, session, is_moving)
        for rival, torque in zip(rival_fits, predictions, strict=True)
    ]
    squares = np.stack(columns, axis=1)
    noise, torque = rival_fits[-1].noise, float(np.sqrt(np.mean(predictions[-1][is_moving] ** 2)))
    own_variance = int(is_moving.sum()) * (MODEL_ERROR * torque * noise.dc_gain / noise.std) ** 2
    squares[-1] = squares[:, -1] = squares[:, -1] - own_variance
    squares[-1, -1] = 0.0
    return squares


def _refit_distances(
    rival: Fit, predictions: Sequence[Array], prediction: Array, session: DriveSession, is_moving: Mask
) -> Array:
    """Squared distances of predictions from one fit with free parameters, shape (predictions,)."""

    def white(x: Array) -> Array:
        white_values = whitened(x, is_moving, rival.noise.phi) / rival.noise.std
        return np.asarray(white_values[np.isfinite(white_values).all(axis=1)])

    scale = np.array([f.scale for f in rival.free])  # parameters differ by many orders of magnitude
    columns = white(jacobian(lambda point: _torque(rival, point, session), rival.point, rival.free) * scale)
    precision = np.linalg.pinv(rival.covariance / np.outer(scale, scale), rcond=1e-12, hermitian=True)
    differences = white(np.stack([torque - prediction for torque in predictions], axis=1))
    projection = columns.T @ differences
    explained_distance = np.einsum("ij,ij->j", projection, np.linalg.solve(precision + columns.T @ columns, projection))
    return np.asarray(np.maximum(np.einsum("ij,ij->j", differences, differences) - explained_distance, 0.0))


def _torque(fit: Fit, point: Array, session: DriveSession) -> Array:
    """Predicted torque of a drive, without terms that depend on a series of the recordings."""
    values, acting_effects = fit.model_at(point)
    predictable_effects = [a for a in acting_effects if not isinstance(a.effect, ResidualPattern)]
    return np.asarray(fit.problem.base.predict([session], values, predictable_effects)[0].torque)
