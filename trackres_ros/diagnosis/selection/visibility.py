# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Step 4: finds the visible and the indistinguishable effects of these recordings, before naming any."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from trackres_ros.diagnosis.base.base import Predicted
from trackres_ros.diagnosis.base.patterns import ResidualPattern
from trackres_ros.diagnosis.inference.fitting import LARGE, Fit, for_tests, jacobian, valid_rows
from trackres_ros.diagnosis.prepare.session import ALWAYS_KNOWN, Array
from trackres_ros.effects.effect import Active, Effect
from trackres_ros.effects.learned import EmpiricalEffect
from trackres_ros.progress import counted

LEAST_KEPT, LEAST_D_PRIME = 0.1, 3.0
ALIKE_COSINE = 0.95
FORM_ERROR = 0.1  # of an effect's torque: standard deviation of its function's error
SLOPES = ("grade", "grade_profile")  # effects that a measured slope replaces


@dataclass(frozen=True, eq=False)
class Proposal:
    """An effect to fit, by the first-order change of the residual: its visibility, its gains, and where its fit begins."""

    effect: Effect
    start: Mapping[str, float]  # values of the linearisation, then of the fit's begin
    columns: Array  # change of the prediction per amplitude, of all segments concatenated, shape (n, amplitudes)
    kept: float  # share of it that no re-fit of the base absorbs
    d_prime: float  # visibility of a typical effect in standard deviations
    by_priors: float  # part of it due to base parameters pushed out of the ranges of the vehicle file
    direction: Array  # whitened, orthogonal to the base, of unit length: for the cosine between two effects, empty after that
    fast_gain: float = 0.0  # gain in log-likelihood under the noise that best whitens the residual, to first order
    amplitudes: Array = field(default_factory=lambda: np.empty(0))  # the amplitudes of that gain over the typical ones
    level: float = math.nan  # gain by the level of the torque, in log-likelihood of block means left out

    @property
    def derivatives(self) -> dict[tuple[str, str], Array]:
        """Derivatives of the predictions by the amplitudes, each of shape (n,)."""
        amplitudes = [(self.effect.name, q.name) for q in self.effect.parameters if q.off is not None]
        return dict(zip(amplitudes, self.columns.T, strict=True))


@dataclass(frozen=True, slots=True)
class NotVisible:
    """An effect that is not visible in these recordings."""

    effect: Effect
    why: str

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.effect.name


@dataclass(frozen=True, eq=False)
class Separability:
    """Visible effects, and their similarity."""

    visible: tuple[Proposal, ...]  # one effect may appear several times, from several starts
    not_visible: tuple[NotVisible, ...]  # and visible ones that the base absorbs almost entirely
    names: tuple[str, ...]  # of the visible ones of the catalogue
    cosines: Array  # (names, names), signed

    @property
    def of_names(self) -> Separability:
        """The part for effects of the catalogue."""
        visible_names = tuple(s for s in self.visible if is_name(s.effect))
        not_visible = tuple(n for n in self.not_visible if is_name(n.effect))
        return Separability(visible_names, not_visible, self.names, self.cosines)

    def alike(self, name: str) -> tuple[str, ...]:
        """Effects that look the same as one here, that one first."""
        i = self.names.index(name)
        return (
            name,
            *(other_name for j, other_name in enumerate(self.names) if j != i and abs(self.cosines[i, j]) > ALIKE_COSINE),
        )


def is_name(effect: Effect) -> bool:
    """Whether an effect is in the catalogue, and no form found in the residual."""
    return not isinstance(effect, EmpiricalEffect | ResidualPattern)


def infeasible(effect: Effect, fit: Fit) -> str:
    """Why an effect cannot be examined with the inputs and the base of a fit; empty if it can."""
    inputs = frozenset.intersection(*(s.given for s in fit.problem.sessions))
    missing_inputs = [need for need in effect.needs if need not in ALWAYS_KNOWN and need not in inputs]
    if effect.name in fit.problem.base.includes:
        return "the model already has it"
    if effect.of_belts and not fit.problem.base.has_belt:
        return "the vehicle has no belt"
    if missing_inputs:
        return f"needs {', '.join(missing_inputs)}, which is not recorded"
    return "grade is recorded, and in the model" if effect.name in SLOPES and "grade" in inputs else ""


def separability(
    effects: Mapping[str, Effect], fit: Fit, own_columns: Array | None = None, columns_of: EffectColumns | None = None
) -> Separability:
    """Linearise all effects about a fit; compare them with its own parameters (`own_columns`) and with each other."""
    columns_of = columns_of or EffectColumns(fit)
    own_columns = base_columns(fit) if own_columns is None else own_columns
    candidates = [effect for effect in effects.values() if effect.name not in fit.effect_names]
    reasons = [infeasible(effect, fit) for effect in candidates]
    not_visible = [NotVisible(effect, reason) for effect, reason in zip(candidates, reasons, strict=True) if reason]
    possible_effects = [effect for effect, reason in zip(candidates, reasons, strict=True) if not reason]
    visibility, fast_gains = _Visibility(fit, own_columns), _FastGains(for_tests(fit), own_columns)
    visible_proposals, directions = [], dict[str, Array]()
    for effect in counted(possible_effects, "visibility of each effect", len(possible_effects)):
        columns = [(start, columns_of(effect, start)) for start in starts(effect)]
        proposals, best_visibility = visibility.find_strongest(effect, columns)
        if best_visibility is None:
            not_visible.append(NotVisible(effect, "it has no effect here"))
        elif LARGE * best_visibility.d_prime < LEAST_D_PRIME:
            size = f"{LARGE:g} times as large as is typical"
            reason = f"even {size}, it would reach only {LARGE * best_visibility.d_prime:.1f} standard deviations"
            not_visible.append(NotVisible(effect, reason))
        else:
            # An absorbed effect is hardly visible, but may explain better than base values outside their ranges.
            if best_visibility.kept < LEAST_KEPT and LARGE * best_visibility.by_priors < LEAST_D_PRIME:
                reason = f"the base's parameters absorb {100.0 * (1 - best_visibility.kept):.0f} % of it"
                not_visible.append(NotVisible(effect, reason))
            if is_name(effect):
                directions[effect.name] = best_visibility.direction
            visible_proposals += [replace(fast_gains.add_gain(s), direction=np.empty(0)) for s in proposals]
    matrix = np.array(list(directions.values())) if directions else np.empty((0, 0))
    return Separability(tuple(visible_proposals), tuple(not_visible), tuple(directions), matrix @ matrix.T)


def starts(effect: Effect) -> list[dict[str, float]]:
    """Initial values: the typical ones, and each further start separately."""
    first_values = effect.values()
    return [first_values, *({**first_values, q.name: value} for q in effect.parameters for value in q.more_starts)]


@lru_cache(maxsize=2)  # several ask for the last ones
def base_columns(fit: Fit) -> Array:
    """Change of all predicted segments with each free parameter of the fit, shape (n, parameters)."""
    return jacobian(lambda point: _model_torques(fit, fit.problem.predict(*fit.model_at(point))), fit.point, fit.free)


class EffectColumns:
    """Changes of the prediction per amplitude of effects, to first order about a fit; each is simulated once."""

    def __init__(self, fit: Fit) -> None:
        self._fit = fit
        self._columns_by_values, self._torque_columns = (dict[tuple[Effect, tuple[float, ...]], Array]() for _ in range(2))

    def give(self, effect: Effect, torque: Array) -> None:
        """Columns of an effect that only adds a torque, of all sessions concatenated, shape (n, amplitudes): no simulation."""
        rows = sum(len(g.measured) for g in self._fit.problem.segments)
        if len(torque) < rows:
            torque = np.concatenate((torque, np.zeros((rows - len(torque), torque.shape[1]))))
        self._torque_columns[effect, tuple(effect.values().values())] = torque

    def forget(self) -> None:
        """Forget the columns that were given."""
        self._torque_columns.clear()

    def __call__(self, effect: Effect, start: Mapping[str, float]) -> Array:
        """Columns of one effect about its initial values, shape (n, amplitudes)."""
        key = effect, tuple(start.values())
        if key in self._torque_columns:
            return self._torque_columns[key]
        if key not in self._columns_by_values:
            fit, base_torques = self._fit, _model_torques(self._fit, self._fit.predicted)
            amplitudes = [(q, q.off, q.start - q.off) for q in effect.parameters if q.off is not None]
            off_values = {**start, **{q.name: zero for q, zero, _ in amplitudes}}
            columns = np.empty((len(base_torques), len(amplitudes)))
            for i, (q, zero, step) in enumerate(amplitudes):  # the secant: some effects are far from linear
                active = [*fit.acting, Active(effect, {**off_values, q.name: zero + step})]
                columns[:, i] = (_model_torques(fit, fit.problem.predict(fit.base_values, active)) - base_torques) / step
            self._columns_by_values[key] = columns
        return self._columns_by_values[key]


class _Visibility:
    """Visibility of effects under the noise of a fit, beyond what the fit's own parameters explain."""

    def __init__(self, fit: Fit, own_columns: Array) -> None:
        self._fit = fit
        self._std, self._scale = (np.array([getattr(f, name) for f in fit.free]) for name in ("std", "scale"))
        self._own_columns = _white(own_columns, fit) * self._scale
        prior, ridge = np.diag((self._scale / self._std) ** 2), 1e-9 * np.eye(len(self._scale))
        self._factor = np.linalg.inv(self._own_columns.T @ self._own_columns + prior + ridge)

    def find_strongest(
        self, effect: Effect, columns: Sequence[tuple[dict[str, float], Array]]
    ) -> tuple[list[Proposal], Proposal | None]:
        """Sensitivity to an effect from each start with any influence, and the largest one."""
        sensitivities = [s for start, change in columns if (s := self._sensitivity(effect, start, change)) is not None]
        return sensitivities, max(sensitivities, key=lambda s: s.d_prime, default=None)

    def _sensitivity(self, effect: Effect, start: Mapping[str, float], columns: Array) -> Proposal | None:
        """Sensitivity to all amplitudes together, or to the most visible one; None without influence."""
        best_proposal = None
        spanned = columns * amplitude_spans(effect)
        for change in (spanned.sum(axis=1), *spanned.T):
            white = _white(change[:, np.newaxis], self._fit)[:, 0]
            full_norm = float(np.linalg.norm(white))
            if not full_norm > 1e-9:
                continue
            absorption = self._factor @ (self._own_columns.T @ white)
            remainder, shift = white - self._own_columns @ absorption, absorption * self._scale / self._std
            data, prior = float(np.linalg.norm(remainder)), float(np.linalg.norm(shift))
            rest = float(np.hypot(data, prior))
            if best_proposal is None or rest > best_proposal.d_prime:
                direction = np.concatenate((remainder, shift)) / max(rest, 1e-300)
                best_proposal = Proposal(effect, start, columns, rest / full_norm, rest, prior, direction)
        return best_proposal


class _FastGains:
    """Gains in log-likelihood under the noise that best whitens the residual of a fit, to first order.

    They find what is fast: a delay, a gain, an inertia, judder. Slow torque is noise to them.
    """

    def __init__(self, fit: Fit, own_columns: Array) -> None:
        self._fit = fit
        scale, std, nominal = (np.array([getattr(f, name) for f in fit.free]) for name in ("scale", "std", "nominal"))
        weights = fit.weights
        self._root = np.sqrt(weights[np.isfinite(weights)])
        self._own_columns = _white(own_columns, fit) * scale * self._root[:, np.newaxis]
        self._white = valid_rows(fit.white) * self._root
        information = self._own_columns.T @ self._own_columns + np.diag((scale / std) ** 2) + 1e-9 * np.eye(len(scale))
        self._covariance = np.linalg.inv(information)
        self._pull = self._own_columns.T @ self._white - np.nan_to_num((fit.point - nominal) / std**2) * scale

    def add_gain(self, s: Proposal) -> Proposal:
        """The same sensitivity with its gain."""
        spans = amplitude_spans(s.effect)
        x = _white(s.columns, self._fit) * spans * self._root[:, np.newaxis]
        projection = x.T @ self._own_columns @ self._covariance
        score = x.T @ self._white - projection @ self._pull
        information = x.T @ x - projection @ (self._own_columns.T @ x) + np.eye(len(score)) / LARGE**2
        amplitudes = np.clip(np.linalg.solve(information, score), *amplitude_bounds(s.effect))
        return replace(
            s, fast_gain=float(score @ amplitudes - 0.5 * amplitudes @ information @ amplitudes), amplitudes=amplitudes
        )


def amplitude_spans(effect: Effect) -> Array:
    """Typical amplitudes of an effect, beyond its values without effect."""
    return np.array([q.start - q.off for q in effect.parameters if q.off is not None])


def amplitude_bounds(effect: Effect) -> tuple[Array, Array]:
    """Bounds of the amplitudes over the typical ones."""
    ends = [
        ((q.low - q.off) / (q.start - q.off), (q.high - q.off) / (q.start - q.off))
        for q in effect.parameters
        if q.off is not None
    ]
    low, high = np.array([sorted(pair) for pair in ends]).reshape(-1, 2).T
    return low, high


def _model_torques(fit: Fit, predictions: Sequence[Predicted]) -> Array:
    return np.concatenate(fit.problem.expected(predictions))


def _white(columns: Array, fit: Fit) -> Array:
    """Whitened columns over the noise's standard deviation, used rows only."""
    return valid_rows(fit.problem.white(fit.problem.split(columns), fit.noises))
