# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Fit a base model, with effects or without: most likely under coloured noise with heavy tails, priors and bounds.

Tests use the best whitening, `for_tests`. On a road its autoregression comes near a unit root, and the whitened residual is
nearly the difference between seconds. Then a small misfit of the acceleration dominates, and a constant of hundreds of Nm
hardly matters. Asymmetric innovations shift the level further, because the whitening magnifies their mean. For predictive
values, `with_levels`, the roots of the autoregression are bounded further inside; docs/decisions/diagnosis.md lists the trials.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, lsq_linear

from trackres_ros.diagnosis.base.base import Base, BaseParameter, Predicted
from trackres_ros.diagnosis.base.instrument import instrument
from trackres_ros.diagnosis.inference.noise import LARGEST_ROOT, SHORT_ROOT, Noise, estimate_noise, whitened_at
from trackres_ros.diagnosis.prepare.session import FEWEST_FITTED, MOST_LAGS, Array, DriveSession, Mask, whole_past
from trackres_ros.effects.effect import Active, Effect

TURNS = 4  # of the values that stay at a bound


def solve_bounded(matrix: Array, right_side: Array, low: Array, high: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Solution of a positive definite system within bounds, and which values are free: one that hits a bound stays there.

    Clipping the free solution instead would leave the others where they fit values outside the bounds.
    """
    is_free, values = np.ones(len(right_side), dtype=bool), np.zeros(len(right_side))
    for _ in range(TURNS):
        values[is_free] = np.linalg.solve(
            matrix[np.ix_(is_free, is_free)], right_side[is_free] - matrix[np.ix_(is_free, ~is_free)] @ values[~is_free]
        )
        is_outside = (values < low) | (values > high)
        values = np.clip(values, low, high)
        if not is_outside[is_free].any():
            break
        is_free &= ~is_outside
    return values, is_free


ROUNDS, MOST_ROUNDS = 3, 10  # of fit and noise
SETTLED = 0.3  # in log-likelihood: a round with a smaller gain is the last
LARGE = 3.0  # times the typical size: prior standard deviation of an effect's amplitude
DIFFERENCE = 1e-4  # of the span between bounds, for derivatives
MOST_STEPS = 60
FIRST_STEPS = 2  # along known derivatives
NEARBY = 1.0  # standard deviations of noise, over all rows: the simulation is linear within this distance
CLOSE = 0.01  # in log-likelihood: a step with a smaller gain is the last of a round
BELT_EVERY = 10  # steps: a belt's temperature is nearly constant from one second to the next


@dataclass(frozen=True, slots=True)
class Free:
    """A parameter of a fit; `key` is (effect or "", parameter)."""

    key: tuple[str, str]
    unit: str
    low: float
    high: float
    nominal: float
    std: float  # of the prior; infinite without one
    scale: float


@dataclass(frozen=True, eq=False)
class Segment:
    """Measurements of one kind in one session; arrays of shape (n,)."""

    kind: str  # `torque` [Nm] or `belt` [degC]
    session: int  # index
    measured: Array
    mask: Mask  # used values
    block: NDArray[np.int64]  # lap of each

    @cached_property
    def valid(self) -> Mask:
        """Used values with a whole past."""
        return whole_past(self.mask, MOST_LAGS)


@dataclass(frozen=True, eq=False)
class Problem:
    """A problem to fit: sessions, masks of their samples, and the base."""

    base: Base
    sessions: tuple[DriveSession, ...]
    masks: tuple[Mask, ...]

    def predict(self, values: Mapping[str, float], effects: Sequence[Active]) -> list[Predicted]:
        """Simulate all sessions."""
        return self.base.predict(self.sessions, values, effects)

    @cached_property
    def segments(self) -> tuple[Segment, ...]:
        """Torques of all sessions, then belt temperatures of those that have them, unless too few have a whole past."""
        torques = [
            Segment("torque", i, s.torque, mask, s.block)
            for i, (s, mask) in enumerate(zip(self.sessions, self.masks, strict=True))
        ]
        belts = []
        for i, (s, mask) in enumerate(zip(self.sessions, self.masks, strict=True)):
            if self.base.has_belt and "belt" in s.given:
                used_steps, rows = np.isfinite(s.belt) & np.isin(s.block, s.block[mask]), slice(None, None, BELT_EVERY)
                belts.append(Segment("belt", i, s.belt[rows], used_steps[rows], s.block[rows]))
        return (*torques, *(belts if sum(int(g.valid.sum()) for g in belts) >= FEWEST_FITTED else ()))

    def expected(self, predictions: Sequence[Predicted]) -> list[Array]:
        """Simulated values of each segment."""
        return [
            predictions[g.session].torque if g.kind == "torque" else self._belt(g.session, predictions[g.session])
            for g in self.segments
        ]

    def _belt(self, session: int, prediction: Predicted) -> Array:
        return (prediction.skin if self.sessions[session].belt_shows_surface else prediction.belt)[::BELT_EVERY]

    def of_torque(self, torques: Sequence[Array]) -> list[Array]:
        """A torque of each session, at each segment; zero for belts."""
        return [torques[g.session] if g.kind == "torque" else np.zeros(len(g.measured)) for g in self.segments]

    def split(self, rows: Array) -> list[Array]:
        """Split concatenated rows into segments."""
        return list(np.split(rows, np.cumsum([len(g.measured) for g in self.segments])[:-1]))

    def residuals(self, predictions: Sequence[Predicted]) -> list[Array]:
        """Measured less simulated, of each segment."""
        return [g.measured - e for g, e in zip(self.segments, self.expected(predictions), strict=True)]

    def white(self, rows: Sequence[Array], noises: Mapping[str, Noise]) -> list[Array]:
        """Whitened rows of each segment over their standard deviation, nan where unused."""
        return [
            whitened_at(r, g.valid, noises[g.kind].phi) / noises[g.kind].std for r, g in zip(rows, self.segments, strict=True)
        ]

    def noises(self, residuals: Sequence[Array], largest_root: float = LARGEST_ROOT) -> dict[str, Noise]:
        """Noise of each kind of segment, with bounded roots of the autoregression."""
        result = {}
        for kind in dict.fromkeys(g.kind for g in self.segments):
            pairs = [(r, g.mask) for r, g in zip(residuals, self.segments, strict=True) if g.kind == kind]
            result[kind] = estimate_noise([r for r, _ in pairs], [m for _, m in pairs], largest_root)
        return result


def valid_rows(parts: Sequence[Array]) -> Array:
    """Used rows of all segments, concatenated."""
    return np.concatenate([p[np.isfinite(p) if p.ndim == 1 else np.isfinite(p).all(axis=1)] for p in parts])


def of_rows(
    problem: Problem, white: Sequence[Array], function: Callable[[Noise, Array], Array], noises: Mapping[str, Noise]
) -> Array:
    """A function of the noise and of whitened residuals, for the used rows."""
    return valid_rows([function(noises[g.kind], w) for w, g in zip(white, problem.segments, strict=True)])


def log_likelihood(problem: Problem, residuals: Sequence[Array], noises: Mapping[str, Noise]) -> float:
    """Log-likelihood of residuals under noise."""
    return float(of_rows(problem, problem.white(residuals, noises), Noise.log_density, noises).sum())


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted model. A search keeps a hundred of them, so what follows from its numbers is computed when it is asked for."""

    problem: Problem
    base_values: dict[str, float]
    effects: tuple[Active, ...]
    instrument: tuple[Active, ...]  # errors of the torque sensor within an instrument's bounds
    free: tuple[Free, ...]  # the fitted parameters, in their order
    point: Array  # their estimates
    covariance: Array  # of these
    noises: dict[str, Noise]  # of each kind of residual
    log_likelihood: float  # including the priors
    samples: int  # number of used residuals
    predicted: tuple[Predicted, ...]  # of each session

    @property
    def residuals(self) -> list[Array]:
        """Measured less expected, of each segment."""
        return self.problem.residuals(self.predicted)

    @property
    def noise(self) -> Noise:
        """Noise of the torque."""
        return self.noises["torque"]

    @property
    def estimates(self) -> dict[tuple[str, str], float]:
        """Estimates of the free parameters."""
        return {f.key: float(x) for f, x in zip(self.free, self.point, strict=True)}

    @property
    def acting(self) -> tuple[Active, ...]:
        """All additions to the base: errors of the instrument, and the effects."""
        return (*self.instrument, *self.effects)

    def model_at(self, point: Array) -> tuple[dict[str, float], tuple[Active, ...]]:
        """Values of the base and all additions, with the free parameters at another point."""
        estimates = {f.key: float(x) for f, x in zip(self.free, point, strict=True)}
        base = {name: estimates.get(("", name), value) for name, value in self.base_values.items()}
        acting_effects = (
            replace(a, values={q: estimates.get((a.effect.name, q), value) for q, value in a.values.items()}) for a in self.acting
        )
        return base, tuple(acting_effects)

    def contribution(self, name: str) -> list[Array]:
        """Contribution of one effect to the expected torque of each session [Nm]."""
        prediction_without = self.problem.predict(self.base_values, [a for a in self.acting if a.effect.name != name])
        return [p.torque - w.torque for p, w in zip(self.predicted, prediction_without, strict=True)]

    @property
    def white(self) -> list[Array]:
        """Whitened residuals of each segment, over their standard deviation."""
        return self.problem.white(self.residuals, self.noises)

    @property
    def weights(self) -> Array:
        """Weights of the residuals of all segments, concatenated; nan where unused."""
        return np.concatenate([self.noises[g.kind].weights(w) for w, g in zip(self.white, self.problem.segments, strict=True)])

    @property
    def effect_names(self) -> tuple[str, ...]:
        """Names of the fitted effects."""
        return tuple(active.effect.name for active in self.effects)

    @cached_property
    def log_evidence(self) -> float:
        """Log-likelihood less the cost of parameters within their priors (Laplace), comparable between fits of one base."""
        prior = np.array([f.std if np.isfinite(f.std) else f.scale for f in self.free])
        eigenvalues = np.linalg.eigvalsh(self.covariance / np.outer(prior, prior))
        return self.log_likelihood + 0.5 * float(np.log(np.maximum(eigenvalues, 1e-12)).sum())

    def std_of(self, effect: str, parameter: str) -> float:
        """Standard deviation of a parameter from the curvature of the likelihood."""
        index = [f.key for f in self.free].index((effect, parameter))
        return float(np.sqrt(self.covariance[index, index]))


def free_parameters(base: Base, effects: Sequence[Effect]) -> tuple[Free, ...]:
    """All parameters of effects and of a base. Those of sensors come first, because they need no new simulation."""

    def base_parameter(q: BaseParameter) -> Free:
        return Free(("", q.name), q.unit, q.low, q.high, q.nominal, q.std, q.std if np.isfinite(q.std) else q.high - q.low)

    parameters = []
    for effect in sorted(effects, key=lambda e: e.acts_on != "sensor"):
        for q in (q for q in effect.parameters if q.fitted):
            width = q.high - q.low
            # The prior of an amplitude scales with its typical size; that of a shape parameter with the width of its bounds.
            std = 0.5 * width if q.off is None else LARGE * abs(q.start - q.off)
            parameters.append(Free((effect.name, q.name), q.unit, q.low, q.high, q.start if q.off is None else q.off, std, width))
    sensor_count = sum(q.fitted for e in effects if e.acts_on == "sensor" for q in e.parameters)
    return (*parameters[:sensor_count], *map(base_parameter, base.parameters), *parameters[sensor_count:])


class _Parameters:
    """The free parameters of a fit as one point, and the model there; `fixed` parameters have a given value."""

    def __init__(self, problem: Problem, acting_effects: Sequence[Effect], fixed_values: Mapping[tuple[str, str], float]) -> None:
        self.problem, self.acting, self.fixed = problem, acting_effects, fixed_values
        self.free = tuple(f for f in free_parameters(problem.base, acting_effects) if f.key not in fixed_values)
        columns = ("low", "high", "nominal", "std", "scale")
        self.low, self.high, self.nominal, self.std, self.scale = (np.array([getattr(f, c) for f in self.free]) for c in columns)

    def start(self, values: Mapping[tuple[str, str], float]) -> Array:
        """Initial point: given, typical or nominal values within bounds."""
        typical_values = {(e.name, q.name): q.start for e in self.acting for q in e.parameters}
        initial = {**typical_values, **values}
        return np.clip(
            [initial.get(f.key, f.nominal) for f in self.free], self.low + 1e-9 * self.scale, self.high - 1e-9 * self.scale
        )

    def off_nominal(self, point: Array) -> Array:
        """Distance from the nominal values, in standard deviations of the priors."""
        return np.asarray((point - self.nominal) / self.std)

    def model(self, point: Array) -> tuple[dict[str, float], tuple[Active, ...]]:
        """Values of the base, and the effects with theirs."""
        shape = {(e.name, q.name): q.start for e in self.acting for q in e.parameters if not q.fitted}
        values = {**shape, **self.fixed, **{f.key: float(x) for f, x in zip(self.free, point, strict=True)}}
        base = {name: value for (effect, name), value in values.items() if not effect}
        return base, tuple(Active(e, {q.name: values[e.name, q.name] for q in e.parameters}) for e in self.acting)

    def expected(self, point: Array) -> Array:
        return np.concatenate(self.problem.expected(self.problem.predict(*self.model(point))))


class _Objective:
    """Least-squares objective, under noise that changes from round to round."""

    def __init__(self, parameters: _Parameters, noises: Mapping[str, Noise] | None, largest_root: float) -> None:
        self._parameters, self._largest_root = parameters, largest_root
        self._last: tuple[Array, list[Array]] | None = None  # a point, and the residuals there
        self._linear: tuple[Array, Array] | None = None  # a point, and the derivatives of the simulation there
        self._white: Array | None = None  # these, whitened
        self.noises = dict(noises or {})

    def settle(self, point: Array) -> list[Array]:
        """Take the noise of the residuals at a point, and return these."""
        residuals = self.residuals(point)
        self.noises, self._white = self._parameters.problem.noises(residuals, self._largest_root), None
        return residuals

    def residuals(self, point: Array) -> list[Array]:
        """Measured less simulated, of each segment; kept for the last point, which several ask for."""
        if self._last is None or not np.array_equal(self._last[0], point):
            problem = self._parameters.problem
            self._last = point.copy(), problem.residuals(problem.predict(*self._parameters.model(point)))
        return self._last[1]

    def value(self, point: Array) -> Array:
        """Signed deviance roots of the whitened residuals and of the priors."""
        return np.concatenate((self._of_residuals(point, Noise.deviance_root), self._parameters.off_nominal(point)))

    def derivatives(self, point: Array) -> Array:
        """Derivatives of the value; the simulation's are reused from a nearby point."""
        p, slope = self._parameters, self._of_residuals(point, Noise.deviance_slope)
        if self._linear is None or np.linalg.norm(self._whitened() @ (point - self._linear[0])) > NEARBY:
            self._linear, self._white = (point.copy(), jacobian(p.expected, point, p.free)), None
        derivatives = self.root_of_information()
        derivatives[: len(slope)] *= -slope[:, np.newaxis]
        return derivatives

    def root_of_information(self) -> Array:
        """Derivatives at the last point, whose square is the Fisher information: 1 for each innovation over its `std`."""
        return np.concatenate((self._whitened(), np.diag(1.0 / self._parameters.std)))

    def _of_residuals(self, point: Array, function: Callable[[Noise, Array], Array]) -> Array:
        problem = self._parameters.problem
        return of_rows(problem, problem.white(self.residuals(point), self.noises), function, self.noises)

    def _whitened(self) -> Array:
        """The derivatives of the simulation, whitened."""
        if self._white is None:
            assert self._linear is not None
            problem = self._parameters.problem
            self._white = valid_rows(problem.white(problem.split(self._linear[1]), self.noises))
        return self._white


def fit(
    problem: Problem,
    effects: Sequence[Effect] = (),
    start: Mapping[tuple[str, str], float] | None = None,
    noises: Mapping[str, Noise] | None = None,
    rounds: int | None = None,
    fixed_values: Mapping[tuple[str, str], float] | None = None,
    largest_root: float = LARGEST_ROOT,
) -> Fit:
    """Fit the base's parameters and those of effects together.

    Parameters
    ----------
    start
        Initial values, by (effect or "", parameter); nominal and typical values elsewhere.
    noises
        Initial noises; by default from the first residuals.
    rounds
        Number of alternations of fit and noise; by default until the likelihood settles.
    fixed_values
        Parameters that are fixed at a value.
    largest_root
        Bound on the roots of the noise's autoregression.
    """
    names = [e.name for e in effects]
    sensors = tuple(e for e in instrument(problem.base) if e.name not in names)
    p = _Parameters(problem, (*sensors, *effects), dict(fixed_values or {}))
    point = p.start(start or {})
    objective = _Objective(p, noises, largest_root)
    if not noises:
        objective.settle(point)
    rows = sum(int(np.count_nonzero(g.valid)) for g in problem.segments)
    likelihood, previous_likelihood = -np.inf, -np.inf
    for turn in range(MOST_ROUNDS if rounds is None else rounds):
        point = least_squares(
            objective.value,
            point,
            jac=objective.derivatives,
            bounds=(p.low, p.high),
            x_scale=p.scale,
            max_nfev=MOST_STEPS,
            ftol=CLOSE / (0.5 * rows),  # relative to the deviance, which is about one per row
            xtol=1e-7,
        ).x
        residuals = objective.settle(point)
        likelihood = log_likelihood(problem, residuals, objective.noises) - 0.5 * float((p.off_nominal(point) ** 2).sum())
        if rounds is None and turn + 1 >= ROUNDS and likelihood - previous_likelihood < SETTLED:
            break
        previous_likelihood = likelihood
    # In units of each parameter's scale: they differ by many orders of magnitude.
    scaled_root = objective.root_of_information() * p.scale
    covariance = np.linalg.pinv(scaled_root.T @ scaled_root, rcond=1e-14, hermitian=True) * np.outer(p.scale, p.scale)
    values, active = p.model(point)
    return Fit(
        problem, values, active[len(sensors) :], active[: len(sensors)], p.free, point, covariance, objective.noises, likelihood,
        rows, tuple(problem.predict(values, active)),
    )  # fmt: skip


def first_look(
    current: Fit,
    effects: Sequence[Effect],
    known_columns: Mapping[tuple[str, str], Array],
    start: Mapping[tuple[str, str], float],
    largest_root: float,
) -> tuple[Fit, Array]:
    """A fit with other effects by a few Gauss-Newton steps along known derivatives, and these, shape (n, parameters).

    Parameters
    ----------
    known_columns
        Derivatives of the predictions by parameter, each of shape (n,). An effect's parameter without them stays as it starts.
    start
        Values, by (effect or "", parameter), where they differ from those of the current fit.
    """
    problem, names = current.problem, [e.name for e in effects]
    sensors = tuple(e for e in instrument(problem.base) if e.name not in names)
    present_values = {(a.effect.name, q): value for a in current.acting for q, value in a.values.items()}
    begin = {**current.estimates, **present_values, **start}
    keys = [(e.name, q.name) for e in effects for q in e.parameters if q.fitted]
    p = _Parameters(problem, (*sensors, *effects), {key: begin[key] for key in keys if key not in known_columns})
    derivatives = np.stack([known_columns[f.key] for f in p.free], axis=1)
    white = valid_rows(problem.white(problem.split(derivatives), current.noises)) * p.scale
    point = p.start(begin)
    rows = sum(int(np.count_nonzero(g.valid)) for g in problem.segments)
    for _ in range(FIRST_STEPS):
        white_residuals = problem.white(problem.residuals(problem.predict(*p.model(point))), current.noises)
        weight = np.sqrt(of_rows(problem, white_residuals, Noise.weights, current.noises))
        x = np.concatenate((white * weight[:, np.newaxis], np.diag(p.scale / p.std)))
        y = np.concatenate((valid_rows(white_residuals) * weight, -p.off_nominal(point)))
        low, high = (p.low - point) / p.scale, (p.high - point) / p.scale
        normal, right_side = x.T @ x + 1e-12 * np.eye(len(point)), x.T @ y
        step = np.linalg.solve(normal, right_side)
        if np.any((step < low) | (step > high)):
            root = np.linalg.cholesky(normal)
            step = lsq_linear(root.T, np.linalg.solve(root, right_side), (low - 1e-12, high + 1e-12), method="bvls").x
        point = np.clip(point + p.scale * step, p.low, p.high)
    predictions = problem.predict(*p.model(point))
    residuals = problem.residuals(predictions)
    noises = problem.noises(residuals, largest_root)
    likelihood = log_likelihood(problem, residuals, noises) - 0.5 * float((p.off_nominal(point) ** 2).sum())
    scaled_rows = np.concatenate((white, np.diag(p.scale / p.std)))
    covariance = np.linalg.pinv(scaled_rows.T @ scaled_rows, rcond=1e-14, hermitian=True) * np.outer(p.scale, p.scale)
    values, active = p.model(point)
    result = Fit(
        problem, values, active[len(sensors) :], active[: len(sensors)], p.free, point, covariance, noises, likelihood, rows,
        tuple(predictions),
    )  # fmt: skip
    return result, derivatives


def jacobian(function: Callable[[Array], Array], point: Array, parameters: Sequence[Free]) -> Array:
    """Derivatives of a function by each free parameter, shape (values, parameters), by differences within the bounds."""
    value = function(point)
    columns = np.empty((len(value), len(point)))
    for i, f in enumerate(parameters):
        step = DIFFERENCE * f.scale
        if point[i] + step > f.high:
            step = -step
        shifted_point = point.copy()
        shifted_point[i] += step
        columns[:, i] = (function(shifted_point) - value) / step
    return columns


def with_levels(
    result: Fit, removed_names: Collection[str] = (), fixed_values: Mapping[tuple[str, str], float] | None = None
) -> Fit:
    """The same model without the effects `removed_names` and with parameters at `fixed_values`, with predictive values."""
    effects = [a.effect for a in result.effects if a.effect.name not in removed_names]
    return fit(result.problem, effects, result.estimates, fixed_values=fixed_values, largest_root=SHORT_ROOT)


def for_tests(result: Fit) -> Fit:
    """The same values, with the noise that best whitens their residuals."""
    return replace(result, noises=result.problem.noises(result.residuals))
