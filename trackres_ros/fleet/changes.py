# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Finds changes of a vehicle's parameter: steps and trends.

Each recording is compared with the estimate from all recordings of the vehicle and from its type. A change is reported if it
raises the likelihood more than chance does. The rate of false alarms is given, however often one looks.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trackres_ros.fleet.pooling import Pooled, softened
from trackres_ros.fleet.task import FIRST_DAY_S

Array = NDArray[np.float64]

STEP, RAMP = "step", "ramp"
FALSE_ALARMS = 0.2  # per vehicle and year, one in 60 vehicle-months: rate of false alarms
DRAWS = 400
MOST_DRAWN_FOR = 120  # recordings of a vehicle in a draw of chance; more have the same thresholds
FEWEST = 2  # recordings on either side of a change
FEWEST_OF_RAMP = 5  # recordings that rise
MOST_CHANGES = 3
ALIKE = 2.0  # in log-likelihood: parameters that would explain it as well
YEAR_S, DAY_S = 365.25 * 86400.0, 86400.0
SUFFER_CHANGE = (
    "bearing_friction", "loss_modulus_scale", "drag_coefficient", "film_scale", "torque_gain.error", "torque_offset.offset",
)  # fmt: skip
"""Parameters to check for a change, if the base has them."""


@dataclass(frozen=True, slots=True)
class VehicleChange:
    """A change of one parameter of one vehicle."""

    # the changed parameter, and others that would explain it nearly as well
    parameter: str
    alike: tuple[str, ...]
    kind: str  # ``step``, or ``ramp``: a trend
    # begin of the first recording after it, and of the one with which it was first significant [s since 1970]
    since_s: float
    known_s: float
    recordings: int  # number of recordings until then
    # the value before, and its change up to the last recording, in the parameter's unit
    before: float
    size: float
    size_std: float
    relative: float  # its size over the value before; nan for a value of 0 in the vehicle file, such as an error of an instrument
    gain: float  # in log-likelihood


@dataclass(frozen=True, eq=False)
class VehicleHistory:
    """Recordings of one vehicle in the order of time, with their likelihoods, see `Pooled`."""

    # reduced by the scatter of recordings, and without the dependence on the air
    precision: Array
    linear: Array
    # prior of the vehicle from its type: precision and precision times mean
    prior: Array
    right: Array
    time_s: Array  # begin of each
    looked_for: tuple[int, ...]  # indices of the parameters to check for a change


@dataclass(frozen=True, slots=True)
class Best:
    """The best change: its gain, first recording, parameter, kind, size and its standard deviation; gains of all."""

    gain: float
    at: int
    parameter: int
    kind: str
    size: float
    std: float
    by_parameter: Array


def course(pooled: Pooled, vehicle: str) -> VehicleHistory:
    """Of one vehicle of the pool, without the recordings whose day is unknown: they have no place in it."""
    own = (pooled.of.vehicle == vehicle) & (pooled.of.time_s > FIRST_DAY_S)
    of = pooled.of.some(own)
    linear = of.linear - np.einsum("nij,j,n->ni", of.precision, pooled.follows, of.air)
    precision, linear = softened(of.precision, np.asarray(linear), pooled.scatter(own))
    prior = np.asarray(np.linalg.inv(pooled.between + pooled.covariance))
    looked_for = tuple(of.names.index(name) for name in SUFFER_CHANGE if name in of.names)
    return VehicleHistory(precision, linear, prior, prior @ pooled.mean, of.time_s, looked_for)


def shapes(time_s: Array, first: int, kind: str) -> Array:
    """Shape of a change over the recordings: 1 from one on, or days since the one before it."""
    after = np.arange(len(time_s)) >= first
    if kind == STEP:
        return after.astype(float)
    return np.where(after, (time_s - time_s[max(first - 1, 0)]) / DAY_S, 0.0)


@dataclass(frozen=True, eq=False)
class Gains:
    """Gains of changes: candidates (first recording and kind); of each draw, candidate and parameter the score and the
    gain, shapes (draws, candidates, parameters); and the information (candidates, parameters).
    """

    candidates: tuple[tuple[int, str], ...]
    score: Array
    information: Array

    @property
    def gain(self) -> Array:
        """In log-likelihood."""
        return np.asarray(0.5 * self.score**2 / self.information)


def gains(of: VehicleHistory, known: Sequence[tuple[int, Array]], draws: Array) -> Gains:
    """Gain of each possible change in addition to the known ones.

    `known`: parameter and shape of each; `draws`: of `VehicleHistory.linear`, shape (draws, n, p).
    """
    n = len(of.linear)
    design, whole, right = _model(of, known, draws)
    weighted = of.precision @ design
    mean = np.linalg.solve(whole, right.T).T
    left = draws - np.einsum("nij,dj->dni", weighted, mean)  # the slope of each log-likelihood at the present parameters
    looked = list(of.looked_for)
    candidates = [(first, STEP) for first in range(FEWEST, n - FEWEST + 1)]
    candidates += [(first, RAMP) for first in range(1, n - FEWEST_OF_RAMP + 1)]
    form = np.array([shapes(of.time_s, first, kind) for first, kind in candidates])  # (candidates, n)
    score = np.einsum("cn,dnq->dcq", form, left[:, :, looked], optimize=True)
    own = form**2 @ np.stack([of.precision[:, q, q] for q in looked], axis=1)
    cross = np.einsum("cn,nqj->cqj", form, weighted[:, looked], optimize=True)
    solved = np.linalg.solve(whole, cross.reshape(-1, cross.shape[-1]).T).T.reshape(cross.shape)
    return Gains(tuple(candidates), score, np.maximum(own - np.einsum("cqj,cqj->cq", cross, solved), 1e-12))


def _model(of: VehicleHistory, known: Sequence[tuple[int, Array]], draws: Array) -> tuple[Array, Array, Array]:
    """Design of a vehicle with known changes, shape (n, p, parameters), its information, and right hand sides of the draws."""
    n, p = of.linear.shape
    design = np.zeros((n, p, p + len(known)))
    design[:, :, :p] = np.eye(p)
    for j, (parameter, shape) in enumerate(known):
        design[:, parameter, p + j] = shape
    whole = np.einsum("nij,nik->jk", design, of.precision @ design)
    whole[:p, :p] += of.prior
    whole[p:, p:] += 1e-9 * np.eye(len(known))
    right = np.einsum("nij,dni->dj", design, draws, optimize=True)
    right[:, :p] += of.right
    return design, whole, right


def best_change(of: VehicleHistory, known: Sequence[tuple[int, Array]] = ()) -> Best | None:
    """The change with the greatest likelihood in addition to the known ones; None with too few recordings."""
    if len(of.linear) < 2 * FEWEST:
        return None
    found = gains(of, known, of.linear[np.newaxis])
    gain = found.gain[0]
    c, q = (int(i) for i in np.unravel_index(int(gain.argmax()), gain.shape))
    first, kind = found.candidates[c]
    size, std = float(found.score[0, c, q] / found.information[c, q]), float(found.information[c, q] ** -0.5)
    return Best(float(gain[c, q]), first, of.looked_for[q], kind, size, std, gain.max(axis=0))


def threshold(of: VehicleHistory, rate: float = FALSE_ALARMS, seed: int = 1) -> float:
    """Threshold of the gain that chance alone exceeds, after any recording, at a rate per year [log-likelihood].

    Recordings are drawn with the scatter of the pool, without a change.
    """
    rng, n = np.random.default_rng(seed), min(len(of.linear), MOST_DRAWN_FOR)
    if n < 2 * FEWEST:
        return np.inf
    precision = of.precision[:n]
    values, vectors = np.linalg.eigh(precision)
    root = vectors * np.sqrt(np.maximum(values, 0.0))[:, np.newaxis, :]
    mean = (
        np.linalg.solve(of.prior, of.right)
        + rng.standard_normal((DRAWS, len(of.right))) @ np.linalg.cholesky(np.linalg.inv(of.prior)).T
    )
    drawn = np.einsum("nij,dj->dni", precision, mean) + np.einsum(
        "nij,dnj->dni", root, rng.standard_normal((DRAWS, *of.linear[:n].shape))
    )
    highest = np.zeros(DRAWS)
    for count in range(2 * FEWEST, n + 1):
        part = VehicleHistory(precision[:count], of.linear[:count], of.prior, of.right, of.time_s[:count], of.looked_for)
        highest = np.maximum(highest, gains(part, (), drawn[:, :count]).gain.max(axis=(1, 2)))
    years = max((of.time_s[n - 1] - of.time_s[0]) / YEAR_S, 1e-3)
    share = min(0.5, rate * years)  # of draws that may pass
    return exceeded(highest, share)


def exceeded(highest: Array, share: float) -> float:
    """Quantile of the largest values for a share above it, by a fitted Gumbel distribution. It covers shares too small for the
    number of draws.
    """
    scale = float(np.std(highest)) * np.sqrt(6.0) / np.pi
    by_gumbel = float(np.mean(highest)) - 0.5772156649 * scale - scale * float(np.log(-np.log1p(-share)))
    return float(max(by_gumbel, np.quantile(highest, 1.0 - share)))


def vehicle_changes(pooled: Pooled, vehicle: str, rate: float = FALSE_ALARMS) -> tuple[list[VehicleChange], float]:
    """Changes of a vehicle, by significance; and the threshold of the gain."""
    of, names, std, nominal = course(pooled, vehicle), pooled.of.names, pooled.of.std, pooled.of.nominal
    least = threshold(of, rate)
    known: list[tuple[int, Array]] = []
    found: list[VehicleChange] = []
    while len(found) < MOST_CHANGES:
        best = best_change(of, known)
        if best is None or best.gain < least:
            break
        alike = [i for i, gain in zip(of.looked_for, best.by_parameter, strict=True) if gain > best.gain - ALIKE]
        seen = _first_seen(of, known, best, least)
        shape = shapes(of.time_s, best.at, best.kind)
        known.append((best.parameter, shape))
        before = nominal[best.parameter] + std[best.parameter] * _before(of, known)[best.parameter]
        reach = shape[-1] * std[best.parameter]
        found.append(
            VehicleChange(
                parameter=names[best.parameter],
                alike=tuple(names[i] for i in alike if i != best.parameter),
                kind=best.kind,
                since_s=float(of.time_s[best.at]),
                known_s=float(of.time_s[seen]),
                recordings=seen - best.at + 1,
                before=float(before),
                size=float(best.size * reach),
                size_std=float(best.std * reach),
                relative=float(best.size * reach / before) if nominal[best.parameter] and before else float("nan"),
                gain=best.gain,
            )
        )
    return found, least


def _first_seen(of: VehicleHistory, known: Sequence[tuple[int, Array]], best: Best, least: float) -> int:
    """The recording with which a change was first sure, had one looked after each."""
    for count in range(max(best.at + FEWEST, 2 * FEWEST), len(of.linear)):
        part = VehicleHistory(of.precision[:count], of.linear[:count], of.prior, of.right, of.time_s[:count], of.looked_for)
        early = best_change(part, [(parameter, shape[:count]) for parameter, shape in known])
        if early is not None and early.gain >= least and early.parameter in (best.parameter, *of.looked_for):
            return count - 1
    return len(of.linear) - 1


def _before(of: VehicleHistory, known: Sequence[tuple[int, Array]]) -> Array:
    """Parameters of the vehicle before all changes, in standard deviations."""
    _, whole, right = _model(of, known, of.linear[np.newaxis])
    return np.asarray(np.linalg.solve(whole, right[0])[: of.linear.shape[1]])


def levels(pooled: Pooled, vehicle: str, name: str) -> tuple[Array, Array, Array]:
    """For each recording of a vehicle: time, and a parameter's value with its standard deviation, all others as pooled."""
    of, mean = course(pooled, vehicle), pooled.by_vehicle[vehicle][0]
    i = pooled.of.names.index(name)
    own = np.maximum(of.precision[:, i, i], 1e-12)
    value = mean[i] + (of.linear[:, i] - of.precision[:, i] @ mean) / own
    return of.time_s, pooled.of.nominal[i] + pooled.of.std[i] * value, pooled.of.std[i] * own**-0.5
