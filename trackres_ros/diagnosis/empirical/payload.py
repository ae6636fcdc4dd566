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
_OtherValues = Callable[[Array], Array]

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
        own_indices = [i for i, f in enumerate(current.free) if f.key[0] != PAYLOAD]
        free_parameters, problem = [current.free[i] for i in own_indices], current.problem
        columns = base_columns(current)[:, own_indices] * [f.scale for f in free_parameters]
        parts, torques = problem.split(columns), len(problem.sessions)
        other_columns = problem.white(parts, current.noises)[torques:]
        prior = np.array([(f.scale / f.std) ** 2 for f in free_parameters])
        information = np.diag(LEAST_KNOWN + prior) + sum(w.T @ w for w in map(np.nan_to_num, other_columns))
        torque = tuple(sparse.csr_matrix(np.nan_to_num(x)) for x in parts[:torques])
        pull = prior * [(f.nominal - current.estimates[f.key]) / f.scale for f in free_parameters]
        return cls(tuple(np.zeros(x.shape[0]) for x in torque), torque, sparse.csc_matrix(information), pull)

    def together_with(self, other_values: JointValues | None) -> JointValues:
        """Both sets of values."""
        if other_values is None:
            return self
        columns = tuple(sparse.hstack(pair).tocsr() for pair in zip(self.columns, other_values.columns, strict=True))
        adds = tuple(x + y for x, y in zip(self.adds, other_values.adds, strict=True))
        precision = sparse.block_diag((self.precision, other_values.precision)).tocsc()
        return JointValues(adds, columns, precision, np.concatenate([self.pull, other_values.pull]))


@dataclass(frozen=True, eq=False)
class _Normal:
    """Normal equations of the masses of all stretches, with the other values eliminated; and the session of each."""

    matrix: Array  # (stretches, stretches)
    right_side: Array  # (stretches,)
    session: Indices  # (stretches,)

    def solve(self, std: float, correlation: float, mean: float) -> _Solution:
        """Most likely masses, given the standard deviations of payload and mean [kg], and the correlation."""
        count = np.arange(len(self.right_side))
        is_same = np.equal.outer(self.session, self.session)
        prior = mean**2 + std**2 * is_same * correlation ** np.abs(np.subtract.outer(count, count))
        growth = np.eye(len(count)) + prior @ self.matrix
        covariance = np.linalg.solve(growth, prior)
        masses = covariance @ self.right_side
        pulls = self.right_side - self.matrix @ masses  # of the samples, against those of the prior
        cost = 0.5 * float(np.linalg.slogdet(growth)[1])
        evidence = 0.5 * float(self.right_side @ masses) - cost
        stds = np.sqrt(np.diag(covariance))
        determined_count = float((self.matrix * covariance).sum())
        mean_payload, total_cost = mean**2 * float(pulls.sum()), cost + 0.5 * float(masses @ pulls)
        return _Solution(
            std,
            correlation,
            evidence,
            total_cost,
            mean_payload,
            determined_count,
            self._split_rows(masses),
            self._split_rows(stds),
        )

    def _split_rows(self, series: Array) -> list[Array]:
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
    settled_sum: float
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
    per_kg = torque_per_kilogram(current, mass)
    typical_torque = float(np.sqrt(np.mean(np.concatenate([m[use] for m, use in zip(per_kg, masks, strict=True)]) ** 2)))
    directions, joint_values = (
        [typical_torque * np.sign(s.speed) for s in sessions],
        JointValues.values_of(current).together_with(joint),
    )
    samples = _Samples(per_kg, numbers, residuals, joint_values, mass)
    best_solution, noise, remainder = samples.most_likely(masks, current.noise)
    level_solution = _Samples(directions, numbers, residuals, joint_values, mass).most_likely(masks, current.noise)[0]
    if best_solution.evidence < level_solution.evidence + SURE:
        return None  # the difference does not have the signature of a mass
    half_numbers = [halves(number, mask) for number, mask in zip(numbers, masks, strict=True)]
    half_masses = [
        samples.masses(
            [m & (x == number_of_half) for m, x in zip(masks, half_numbers, strict=True)], best_solution, noise, remainder
        )
        for number_of_half in (0, 1)
    ]
    torques, forecasts, stretches = [], [], list[Stretch]()
    for i, (session, number, per_mass, residual, masses, stds) in enumerate(
        zip(sessions, numbers, per_kg, residuals, best_solution.masses, best_solution.stds, strict=True)
    ):
        smooth_series = per_mass * masses[number]
        forecast = np.where(
            session.used, per_mass * _forecast(per_mass, residual, number, session.used, noise, best_solution), 0.0
        )
        torques.append(np.where(masks[i], smooth_series, forecast))
        other_half = np.where(half_numbers[i] == 0, half_masses[1][i][number], half_masses[0][i][number])
        forecasts.append(np.where(masks[i], per_mass * other_half, forecast))
        for k in np.unique(number[masks[i]]).tolist():
            rows = np.flatnonzero(number == k)
            begin, end = float(session.time[rows[0]]), float(session.time[rows[-1]] + session.step)
            std = math.hypot(stds[k], FORM_ERROR * masses[k], MODEL_ERROR * mass)
            stretches.append(Stretch(session.name, begin, end, float(masses[k]), std))
    acting_torque = np.concatenate([t[m] for t, m in zip(torques, masks, strict=True)])
    level = float(np.sqrt(np.mean(acting_torque**2)))
    if not level > 0.0:
        return None
    cost = best_solution.cost + math.log(len(SIZES) * len(ALIKE))
    shape, forecast_shape = (tuple(t / level for t in series) for series in (torques, forecasts))
    return Payload(tuple(stretches), level, shape, forecast_shape, cost)


class _Samples:
    """The samples of all sessions as equations for the masses of their stretches and the other values.

    `by` has the torque of each sample per kilogram, `numbers` the stretch of each sample, `residuals` the torque [Nm].
    """

    def __init__(
        self,
        torques_per_mass: Sequence[Array],
        numbers: Sequence[Indices],
        residuals: Sequence[Array],
        joint: JointValues,
        mass: float,
    ) -> None:
        self.residuals, self._joint, self._mass = residuals, joint, mass
        self._session = np.repeat(np.arange(len(numbers)), [int(n.max()) + 1 for n in numbers])
        self._columns = [
            sparse.hstack([x, z]).tocsr() for x, z in zip(by_stretch(torques_per_mass, numbers), joint.columns, strict=True)
        ]
        self._full_residuals = [r + x for r, x in zip(residuals, joint.adds, strict=True)]

    def _equations(
        self, masks: Sequence[Mask], remainder: Sequence[Array], noise: Noise
    ) -> tuple[_Normal, _OtherValues, float, int]:
        rows = WhitenedRows.of(self._columns, self._full_residuals, masks, noise)
        weights = noise.weights(WhitenedRows.of(self._columns, remainder, masks, noise).white)
        return *_normal(rows, weights, self._session, self._joint), len(rows.white)

    def most_likely(self, masks: Sequence[Mask], noise: Noise) -> tuple[_Solution, Noise, list[Array]]:
        """Most likely sizes by stretch from some samples, the remaining noise, and the residual of all samples [Nm]."""
        remainder = list(self.residuals)
        for _ in range(TURNS):  # with the payload in it, the noise would be as large and hide the payload
            normal, other_sum, settled_sum, count = self._equations(masks, remainder, noise)
            solutions = (
                normal.solve(size * self._mass, correlation, MEAN * self._mass) for size in SIZES for correlation in ALIKE
            )
            best_solution = max(solutions, key=lambda solution: solution.evidence)
            values = np.concatenate(best_solution.masses)
            values = np.concatenate([values, other_sum(values)])
            remainder = [r - x @ values for r, x in zip(self._full_residuals, self._columns, strict=True)]
            noise = estimate_noise(remainder, masks)
            # Fitting so many values makes the residual smaller than the noise.
            shrinks = math.sqrt(max(1.0 - (best_solution.settled_sum + settled_sum) / count, LEAST_LEFT))
            noise = replace(noise, scale=noise.scale / shrinks)
        return best_solution, noise, remainder

    def masses(self, masks: Sequence[Mask], solution: _Solution, noise: Noise, remainder: Sequence[Array]) -> list[Array]:
        """Masses of the stretches of each session from fewer samples, their scatter and the noise known [kg]."""
        return self._equations(masks, remainder, noise)[0].solve(solution.std, solution.alike, MEAN * self._mass).masses


def halves(number: Indices, mask: Mask) -> Indices:
    """Half of its stretch in which each sample lies, by the fitted samples: 0 or 1."""
    half_number = np.zeros(len(number), dtype=np.int64)
    for k in np.unique(number[mask]).tolist():
        rows = np.flatnonzero((number == k) & mask)
        half_number[rows[len(rows) // 2 :]] = 1
    return half_number


def _normal(rows: WhitenedRows, weights: Array, session: Indices, joint: JointValues) -> tuple[_Normal, _OtherValues, float]:
    """Normal equations of the masses, a function for the other values, and the number of those that the samples determine."""
    count = len(session)
    weighted_columns = rows.columns.multiply(weights[:, np.newaxis]).tocsr()
    matrix, right_side = (rows.columns.T @ weighted_columns).tocsc(), np.asarray(weighted_columns.T @ rows.white)
    mass_block, coupling = matrix[:count, :count].toarray(), matrix[count:, :count].toarray()
    solve = splu((matrix[count:, count:] + joint.precision).tocsc()).solve
    elimination, other_values = solve(coupling), solve(right_side[count:] + joint.pull)
    normal = _Normal(mass_block - coupling.T @ elimination, right_side[:count] - coupling.T @ other_values, session)
    probes = np.random.default_rng(0).choice((-1.0, 1.0), (len(coupling), PROBES))
    determined_count = float(np.mean((probes * solve(matrix[count:, count:] @ probes)).sum(axis=0)))
    return normal, lambda masses: other_values - elimination @ masses, determined_count


def by_stretch(torques_per_mass: Sequence[Array], numbers: Sequence[Indices]) -> list[sparse.csr_matrix]:
    """Columns of a series of each session, one for each stretch of all sessions: shape (samples, stretches)."""
    counts = [int(n.max()) + 1 for n in numbers]
    first_columns = np.cumsum([0, *counts[:-1]])
    return [
        sparse.csr_matrix((x, (np.arange(len(x)), begin + n)), (len(x), sum(counts)))
        for x, n, begin in zip(torques_per_mass, numbers, first_columns, strict=True)
    ]


def loads(current: Fit) -> list[Array]:
    """Torque of each session for a mass change of one standard deviation on each stretch, shape (samples, stretches)."""
    mass = mass_of(current)
    columns = by_stretch(torque_per_kilogram(current, mass), [stretch_numbers(s) for s in current.problem.sessions])
    return [LOADED * mass * x.toarray() for x in columns]


def mass_of(current: Fit) -> float:
    """Mass of the vehicle in a fit [kg]."""
    return current.base_values.get("mass", current.problem.base.facts.weight / GRAVITY)


def stretch_numbers(session: DriveSession) -> Indices:
    """Number of the stretch of each sample; a stop belongs to the stretch before it."""
    starts = np.zeros(len(session), dtype=np.int64)
    for begin, end in runs_of(np.abs(np.nan_to_num(session.speed)) < STANDSTILL_MPS):
        if (end - begin) * session.step >= STOP_S and begin > 0 and end < len(session):
            starts[end] = 1
    return np.cumsum(starts)


def torque_per_kilogram(current: Fit, mass: float) -> list[Array]:
    """Torque of an additional kilogram, of each session [Nm]; unlike the model's mass it has no rotating part."""
    problem, facts = current.problem, current.problem.base.facts
    model_torques = []
    for step in (0.0, MORE):
        weight = (1.0 + step) * mass * GRAVITY
        sessions_with_load = [replace(s, weight=np.full(len(s), weight), given=s.given | {"load"}) for s in problem.sessions]
        model_torques.append([p.torque for p in problem.base.predict(sessions_with_load, *current.model_at(current.point))])
    rotating_share = current.base_values.get("rotating_mass_factor", problem.base.rotating_mass_factor) - 1.0
    return [
        np.where(
            np.abs(s.speed) > STANDSTILL_MPS,
            (torque_loaded - torque) / (MORE * mass) - rotating_share * s.accel * facts.radius,
            0.0,
        )
        for s, torque, torque_loaded in zip(problem.sessions, *model_torques, strict=True)
    ]


def _forecast(per_mass: Array, residual: Array, number: Indices, used_steps: Mask, noise: Noise, solution: _Solution) -> Array:
    """Live estimate of the mass at each sample of a session from earlier ones: a Kalman filter [kg].

    `number` is the stretch of each sample, and `noise` that of the residual without the payload.
    """
    white = whitened(np.column_stack([per_mass, residual]), used_steps, noise.phi) / noise.std
    is_begin = np.diff(number, prepend=-1) > 0
    masses = np.empty(len(number))
    mean, variance = solution.mean, solution.std**2
    for t, ((slope, residual_white), is_first) in enumerate(zip(white.tolist(), is_begin.tolist(), strict=True)):
        if is_first and t:
            mean = solution.mean + solution.alike * (mean - solution.mean)
            variance = solution.alike**2 * variance + (1.0 - solution.alike**2) * solution.std**2
        masses[t] = mean
        if math.isnan(residual_white):
            continue
        innovation, variance_ahead = residual_white - slope * mean, slope**2 * variance
        weight = float(noise.weights(np.array(innovation / math.sqrt(1.0 + variance_ahead))))
        gain = variance * slope / (variance_ahead + 1.0 / weight)
        mean, variance = mean + gain * innovation, variance * (1.0 - gain * slope)
    return masses
