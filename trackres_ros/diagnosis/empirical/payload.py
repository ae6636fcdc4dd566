# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A payload that differs between stretches from stop to stop: passengers get on and off, bulk is loaded and tipped.

Each stretch has an additional mass, correlated with the previous one: a first-order autoregression about a common mean
(random effects, Laird and Ware 1982). Its torque has the signature of a mass: inertia, rolling resistance and grade. Terms
by place are estimated jointly, because a vehicle accelerates at the same places, loaded or not.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from trackres_ros.diagnosis.empirical.by_place import WhitenedRows
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.inference.noise import Noise, estimate_noise, whitened
from trackres_ros.diagnosis.prepare.session import Array, DriveSession, Mask
from trackres_ros.diagnosis.selection.visibility import FORM_ERROR, base_columns
from trackres_ros.recording.slopes import runs_of
from trackres_ros.units import GRAVITY, STANDSTILL_MPS

Indices = NDArray[np.int64]
_Others = Callable[[Array], Array]

PAYLOAD = "payload"
STOP_S = 5.0  # a shorter stop changes no load
FEWEST_STRETCHES = 6
SIZES = tuple(np.geomspace(0.003, 0.3, 9))  # standard deviation of the payload, over the vehicle's mass
MEAN = 0.1  # prior standard deviation of the mean payload, over the vehicle's mass
ALIKE = (0.0, 0.5, 0.8, 0.95)  # correlation of the mass of a stretch with the previous one
LOADED = 0.05  # of the vehicle's mass: standard deviation of the payload while learning other terms
TURNS = 10  # of masses, weights and noise
PROBES = 16  # for a trace (Hutchinson, 1990)
MODEL_ERROR = 0.01  # of the vehicle's mass: the model's own error expressed as a mass, common to all stretches
LEAST_KNOWN = 1e-6  # of a value's scale: a precision for unknown values
LEAST_LEFT = 0.1  # least share of the samples left as degrees of freedom
SURE = 10.0  # in log-likelihood: of a mass by stretch over a torque by stretch
MORE = 0.01  # of the weight, for the derivative


@dataclass(frozen=True, slots=True)
class Stretch:
    """Driving between two stops, and the additional mass [kg] with its standard deviation."""

    recording: str
    begin_s: float
    end_s: float
    mass: float
    std: float


@dataclass(frozen=True, eq=False)
class Payload:
    """A payload by stretch."""

    stretches: tuple[Stretch, ...]  # with fitted samples
    level: float  # root mean square of its torque on the fitted laps [Nm]
    shape: tuple[Array, ...]  # torque over `level` at each sample of each session; off the fitted laps as `ahead`
    ahead: tuple[Array, ...]  # on the fitted laps from the other half of each stretch alone; elsewhere from earlier samples
    cost: float  # of the masses, in log-likelihood


@dataclass(frozen=True, eq=False)
class JointValues:
    """Other values estimated jointly with the masses."""

    adds: tuple[Array, ...]  # torque of each session [Nm]
    columns: tuple[sparse.csr_matrix, ...]  # torque of each session per value
    precision: sparse.csc_matrix  # of the values' prior
    pull: Array  # of the prior towards the values of the file, whatever the last fit found: a scale of all torques is like a mass

    @classmethod
    def values_of(cls, current: Fit) -> JointValues:
        """The values of a fit but its payload, with their priors and the information of other measurements than the torque."""
        own = [i for i, f in enumerate(current.free) if f.key[0] != PAYLOAD]
        free, problem = [current.free[i] for i in own], current.problem
        columns = base_columns(current)[:, own] * [f.scale for f in free]
        parts, torques = problem.split(columns), len(problem.sessions)
        others = problem.white(parts, current.noises)[torques:]
        prior = np.array([(f.scale / f.std) ** 2 for f in free])
        known = np.diag(LEAST_KNOWN + prior) + sum(w.T @ w for w in map(np.nan_to_num, others))
        torque = tuple(sparse.csr_matrix(np.nan_to_num(x)) for x in parts[:torques])
        pull = prior * [(f.nominal - current.at[f.key]) / f.scale for f in free]
        return cls(tuple(np.zeros(x.shape[0]) for x in torque), torque, sparse.csc_matrix(known), pull)

    def together_with(self, other: JointValues | None) -> JointValues:
        """Both sets of values."""
        if other is None:
            return self
        columns = tuple(sparse.hstack(both).tocsr() for both in zip(self.columns, other.columns, strict=True))
        adds = tuple(x + y for x, y in zip(self.adds, other.adds, strict=True))
        precision = sparse.block_diag((self.precision, other.precision)).tocsc()
        return JointValues(adds, columns, precision, np.concatenate([self.pull, other.pull]))


@dataclass(frozen=True, eq=False)
class _Normal:
    """Normal equations of the masses of all stretches, with the other values eliminated; and the session of each."""

    matrix: Array  # (stretches, stretches)
    right: Array  # (stretches,)
    session: Indices  # (stretches,)

    def solved(self, std: float, alike: float, mean: float) -> _Solution:
        """Most likely masses, given the standard deviations of payload and mean [kg], and the correlation."""
        count = np.arange(len(self.right))
        together = np.equal.outer(self.session, self.session)
        prior = mean**2 + std**2 * together * alike ** np.abs(np.subtract.outer(count, count))
        grown = np.eye(len(count)) + prior @ self.matrix
        covariance = np.linalg.solve(grown, prior)
        masses = covariance @ self.right
        pulls = self.right - self.matrix @ masses  # of the samples, against those of the prior
        cost = 0.5 * float(np.linalg.slogdet(grown)[1])
        evidence = 0.5 * float(self.right @ masses) - cost
        stds = np.sqrt(np.diag(covariance))
        settled = float((self.matrix * covariance).sum())
        of_mean, taken = mean**2 * float(pulls.sum()), cost + 0.5 * float(masses @ pulls)
        return _Solution(std, alike, evidence, taken, of_mean, settled, self._split(masses), self._split(stds))

    def _split(self, series: Array) -> list[Array]:
        return np.split(series, np.flatnonzero(np.diff(self.session)) + 1)


@dataclass(frozen=True, eq=False)
class _Solution:
    """Masses of the stretches of each session with their standard deviations [kg], and their mean, for a standard deviation
    of the payload [kg] and a correlation; with the log-evidence, the cost, and the number of masses that the
    samples determine.
    """

    std: float
    alike: float
    evidence: float
    cost: float
    mean: float
    settled: float
    masses: list[Array]
    stds: list[Array]


def may_differ(current: Fit) -> bool:
    """Whether masses may differ by stretch: no load is recorded, and there are enough stops."""
    sessions = current.problem.sessions
    if any({"load", "passengers"} & s.given for s in sessions):
        return False
    return sum(int(stretch_numbers(s).max()) + 1 for s in sessions) >= FEWEST_STRETCHES


def find_payload(current: Fit, residuals: Sequence[Array], joint: JointValues | None = None) -> Payload | None:
    """The mass of each stretch; None with recorded loads or passengers, or too few stretches.

    `residuals` are those of the torque of each session in the fit [Nm], without a payload and the terms in `joint`.
    """
    if not may_differ(current):
        return None
    sessions, masks = current.problem.sessions, current.problem.masks
    numbers = [stretch_numbers(s) for s in sessions]
    mass = mass_of(current)
    per_kg = torque_of_a_kilogram(current, mass)
    typical = float(np.sqrt(np.mean(np.concatenate([m[use] for m, use in zip(per_kg, masks, strict=True)]) ** 2)))
    against, joint_values = [typical * np.sign(s.speed) for s in sessions], JointValues.values_of(current).together_with(joint)
    samples = _Samples(per_kg, numbers, residuals, joint_values, mass)
    best, noise, left = samples.most_likely(masks, current.noise)
    of_level = _Samples(against, numbers, residuals, joint_values, mass).most_likely(masks, current.noise)[0]
    if best.evidence < of_level.evidence + SURE:
        return None  # the difference does not have the signature of a mass
    later = [halves(number, mask) for number, mask in zip(numbers, masks, strict=True)]
    of_half = [samples.masses([m & (x == half) for m, x in zip(masks, later, strict=True)], best, noise, left) for half in (0, 1)]
    torques, known, stretches = [], [], list[Stretch]()
    for i, (session, number, by_mass, residual, masses, stds) in enumerate(
        zip(sessions, numbers, per_kg, residuals, best.masses, best.stds, strict=True)
    ):
        smoothed = by_mass * masses[number]
        live = np.where(session.used, by_mass * _followed(by_mass, residual, number, session.used, noise, best), 0.0)
        torques.append(np.where(masks[i], smoothed, live))
        of_other_half = np.where(later[i] == 0, of_half[1][i][number], of_half[0][i][number])
        known.append(np.where(masks[i], by_mass * of_other_half, live))
        for k in np.unique(number[masks[i]]).tolist():
            rows = np.flatnonzero(number == k)
            begin, end = float(session.time[rows[0]]), float(session.time[rows[-1]] + session.step)
            std = math.hypot(stds[k], FORM_ERROR * masses[k], MODEL_ERROR * mass)
            stretches.append(Stretch(session.name, begin, end, float(masses[k]), std))
    acting = np.concatenate([t[m] for t, m in zip(torques, masks, strict=True)])
    level = float(np.sqrt(np.mean(acting**2)))
    if not level > 0.0:
        return None
    cost = best.cost + math.log(len(SIZES) * len(ALIKE))
    shape, ahead = (tuple(t / level for t in of) for of in (torques, known))
    return Payload(tuple(stretches), level, shape, ahead, cost)


class _Samples:
    """The samples of all sessions as equations for the masses of their stretches and the other values.

    `by` has the torque of each sample per kilogram, `numbers` the stretch of each sample, `residuals` the torque [Nm].
    """

    def __init__(
        self, by: Sequence[Array], numbers: Sequence[Indices], residuals: Sequence[Array], joint: JointValues, mass: float
    ) -> None:
        self.residuals, self._joint, self._mass = residuals, joint, mass
        self._session = np.repeat(np.arange(len(numbers)), [int(n.max()) + 1 for n in numbers])
        self._columns = [sparse.hstack([x, z]).tocsr() for x, z in zip(by_stretch(by, numbers), joint.columns, strict=True)]
        self._whole = [r + x for r, x in zip(residuals, joint.adds, strict=True)]

    def _equations(self, masks: Sequence[Mask], left: Sequence[Array], noise: Noise) -> tuple[_Normal, _Others, float, int]:
        rows = WhitenedRows.of(self._columns, self._whole, masks, noise)
        weights = noise.weights(WhitenedRows.of(self._columns, left, masks, noise).white)
        return *_normal(rows, weights, self._session, self._joint), len(rows.white)

    def most_likely(self, masks: Sequence[Mask], noise: Noise) -> tuple[_Solution, Noise, list[Array]]:
        """Most likely sizes by stretch from some samples, the remaining noise, and the residual of all samples [Nm]."""
        left = list(self.residuals)
        for _ in range(TURNS):  # with the payload in it, the noise would be as large and hide the payload
            normal, others, settled, count = self._equations(masks, left, noise)
            tried = (normal.solved(size * self._mass, alike, MEAN * self._mass) for size in SIZES for alike in ALIKE)
            best = max(tried, key=lambda one: one.evidence)
            values = np.concatenate(best.masses)
            values = np.concatenate([values, others(values)])
            left = [r - x @ values for r, x in zip(self._whole, self._columns, strict=True)]
            noise = estimate_noise(left, masks)
            # Fitting so many values makes the residual smaller than the noise.
            shrinks = math.sqrt(max(1.0 - (best.settled + settled) / count, LEAST_LEFT))
            noise = replace(noise, scale=noise.scale / shrinks)
        return best, noise, left

    def masses(self, masks: Sequence[Mask], like: _Solution, noise: Noise, left: Sequence[Array]) -> list[Array]:
        """Masses of the stretches of each session from fewer samples, their scatter and the noise known [kg]."""
        return self._equations(masks, left, noise)[0].solved(like.std, like.alike, MEAN * self._mass).masses


def halves(number: Indices, mask: Mask) -> Indices:
    """Half of its stretch in which each sample lies, by the fitted samples: 0 or 1."""
    later = np.zeros(len(number), dtype=np.int64)
    for k in np.unique(number[mask]).tolist():
        rows = np.flatnonzero((number == k) & mask)
        later[rows[len(rows) // 2 :]] = 1
    return later


def _normal(rows: WhitenedRows, weights: Array, session: Indices, joint: JointValues) -> tuple[_Normal, _Others, float]:
    """Normal equations of the masses, a function for the other values, and the number of those that the samples determine."""
    count = len(session)
    weighted = rows.columns.multiply(weights[:, np.newaxis]).tocsr()
    matrix, right = (rows.columns.T @ weighted).tocsc(), np.asarray(weighted.T @ rows.white)
    of_masses, across = matrix[:count, :count].toarray(), matrix[count:, :count].toarray()
    solve = splu((matrix[count:, count:] + joint.precision).tocsc()).solve
    taken, of_others = solve(across), solve(right[count:] + joint.pull)
    normal = _Normal(of_masses - across.T @ taken, right[:count] - across.T @ of_others, session)
    probes = np.random.default_rng(0).choice((-1.0, 1.0), (len(across), PROBES))
    settled = float(np.mean((probes * solve(matrix[count:, count:] @ probes)).sum(axis=0)))
    return normal, lambda masses: of_others - taken @ masses, settled


def by_stretch(by: Sequence[Array], numbers: Sequence[Indices]) -> list[sparse.csr_matrix]:
    """Columns of a series of each session, one for each stretch of all sessions: shape (samples, stretches)."""
    counts = [int(n.max()) + 1 for n in numbers]
    first = np.cumsum([0, *counts[:-1]])
    return [
        sparse.csr_matrix((x, (np.arange(len(x)), begin + n)), (len(x), sum(counts)))
        for x, n, begin in zip(by, numbers, first, strict=True)
    ]


def loads(current: Fit) -> list[Array]:
    """Torque of each session for a mass change of one standard deviation on each stretch, shape (samples, stretches)."""
    mass = mass_of(current)
    columns = by_stretch(torque_of_a_kilogram(current, mass), [stretch_numbers(s) for s in current.problem.sessions])
    return [LOADED * mass * x.toarray() for x in columns]


def mass_of(current: Fit) -> float:
    """Mass of the vehicle in a fit [kg]."""
    return current.base_values.get("mass", current.problem.base.facts.weight / GRAVITY)


def stretch_numbers(session: DriveSession) -> Indices:
    """Number of the stretch of each sample; a stop belongs to the stretch before it."""
    next_one = np.zeros(len(session), dtype=np.int64)
    for begin, end in runs_of(np.abs(np.nan_to_num(session.speed)) < STANDSTILL_MPS):
        if (end - begin) * session.step >= STOP_S and begin > 0 and end < len(session):
            next_one[end] = 1
    return np.cumsum(next_one)


def torque_of_a_kilogram(current: Fit, mass: float) -> list[Array]:
    """Torque of an additional kilogram, of each session [Nm]; unlike the model's mass it has no rotating part."""
    problem, facts = current.problem, current.problem.base.facts
    expected = []
    for more in (0.0, MORE):
        weight = (1.0 + more) * mass * GRAVITY
        loaded = [replace(s, weight=np.full(len(s), weight), given=s.given | {"load"}) for s in problem.sessions]
        expected.append([p.torque for p in problem.base.predict(loaded, *current.model_at(current.point))])
    rotating = current.base_values.get("rotating_mass_factor", problem.base.rotating_mass_factor) - 1.0
    return [
        np.where(np.abs(s.speed) > STANDSTILL_MPS, (with_more - without) / (MORE * mass) - rotating * s.accel * facts.radius, 0.0)
        for s, without, with_more in zip(problem.sessions, *expected, strict=True)
    ]


def _followed(by_mass: Array, residual: Array, number: Indices, used: Mask, noise: Noise, like: _Solution) -> Array:
    """Live estimate of the mass at each sample of a session from earlier ones: a Kalman filter [kg].

    `number` is the stretch of each sample, and `noise` that of the residual without the payload.
    """
    white = whitened(np.column_stack([by_mass, residual]), used, noise.phi) / noise.std
    begins = np.diff(number, prepend=-1) > 0
    known = np.empty(len(number))
    mean, variance = like.mean, like.std**2
    for t, ((slope, shown), first) in enumerate(zip(white.tolist(), begins.tolist(), strict=True)):
        if first and t:
            mean = like.mean + like.alike * (mean - like.mean)
            variance = like.alike**2 * variance + (1.0 - like.alike**2) * like.std**2
        known[t] = mean
        if math.isnan(shown):
            continue
        off, by_payload = shown - slope * mean, slope**2 * variance
        weight = float(noise.weights(np.array(off / math.sqrt(1.0 + by_payload))))
        gain = variance * slope / (by_payload + 1.0 / weight)
        mean, variance = mean + gain * off, variance * (1.0 - gain * slope)
    return known
