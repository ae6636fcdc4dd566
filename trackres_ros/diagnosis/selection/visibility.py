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
    fast: float = 0.0  # gain in log-likelihood under the noise that best whitens the residual, to first order
    moved: Array = field(default_factory=lambda: np.empty(0))  # the amplitudes of that gain over the typical ones
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
        visible = tuple(s for s in self.visible if is_name(s.effect))
        not_visible = tuple(n for n in self.not_visible if is_name(n.effect))
        return Separability(visible, not_visible, self.names, self.cosines)

    def alike(self, name: str) -> tuple[str, ...]:
        """Effects that look the same as one here, that one first."""
        i = self.names.index(name)
        return (name, *(other for j, other in enumerate(self.names) if j != i and abs(self.cosines[i, j]) > ALIKE_COSINE))


def is_name(effect: Effect) -> bool:
    """Whether an effect is in the catalogue, and no form found in the residual."""
    return not isinstance(effect, EmpiricalEffect | ResidualPattern)


def infeasible(effect: Effect, fit: Fit) -> str:
    """Why an effect cannot be examined with the inputs and the base of a fit; empty if it can."""
    inputs = frozenset.intersection(*(s.given for s in fit.problem.sessions))
    missing = [need for need in effect.needs if need not in ALWAYS_KNOWN and need not in inputs]
    if effect.name in fit.problem.base.includes:
        return "the model already has it"
    if effect.of_belts and not fit.problem.base.has_belt:
        return "the vehicle has no belt"
    if missing:
        return f"needs {', '.join(missing)}, which is not recorded"
    return "grade is recorded, and in the model" if effect.name in SLOPES and "grade" in inputs else ""


def separability(
    effects: Mapping[str, Effect], fit: Fit, own: Array | None = None, columns_of: EffectColumns | None = None
) -> Separability:
    """Linearise all effects about a fit; compare them with its own parameters, with columns `own`, and with each other."""
    columns_of = columns_of or EffectColumns(fit)
    own = base_columns(fit) if own is None else own
    candidates = [effect for effect in effects.values() if effect.name not in fit.effect_names]
    reasons = [infeasible(effect, fit) for effect in candidates]
    not_visible = [NotVisible(effect, reason) for effect, reason in zip(candidates, reasons, strict=True) if reason]
    possible = [effect for effect, reason in zip(candidates, reasons, strict=True) if not reason]
    visibility, quick = _Visibility(fit, own), _FastGains(for_tests(fit), own)
    visible, directions = [], dict[str, Array]()
    for effect in counted(possible, "visibility of each effect", len(possible)):
        columns = [(start, columns_of(effect, start)) for start in starts(effect)]
        proposals, best = visibility.strongest(effect, columns)
        if best is None:
            not_visible.append(NotVisible(effect, "it has no effect here"))
        elif LARGE * best.d_prime < LEAST_D_PRIME:
            size = f"{LARGE:g} times as large as is typical"
            reason = f"even {size}, it would reach only {LARGE * best.d_prime:.1f} standard deviations"
            not_visible.append(NotVisible(effect, reason))
        else:
            # An absorbed effect is hardly visible, but may explain better than base values outside their ranges.
            if best.kept < LEAST_KEPT and LARGE * best.by_priors < LEAST_D_PRIME:
                reason = f"the base's parameters absorb {100.0 * (1 - best.kept):.0f} % of it"
                not_visible.append(NotVisible(effect, reason))
            if is_name(effect):
                directions[effect.name] = best.direction
            visible += [replace(quick.added(s), direction=np.empty(0)) for s in proposals]
    matrix = np.array(list(directions.values())) if directions else np.empty((0, 0))
    return Separability(tuple(visible), tuple(not_visible), tuple(directions), matrix @ matrix.T)


def starts(effect: Effect) -> list[dict[str, float]]:
    """Initial values: the typical ones, and each further start separately."""
    first = effect.values()
    return [first, *({**first, q.name: value} for q in effect.parameters for value in q.more_starts)]


@lru_cache(maxsize=2)  # several ask for the last ones
def base_columns(fit: Fit) -> Array:
    """Change of all predicted segments with each free parameter of the fit, shape (n, parameters)."""
    return jacobian(lambda point: _expected(fit, fit.problem.predict(*fit.model_at(point))), fit.point, fit.free)


class EffectColumns:
    """Changes of the prediction per amplitude of effects, to first order about a fit; each is simulated once."""

    def __init__(self, fit: Fit) -> None:
        self._fit = fit
        self._known, self._torque_columns = (dict[tuple[Effect, tuple[float, ...]], Array]() for _ in range(2))

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
        if key not in self._known:
            fit, before = self._fit, _expected(self._fit, self._fit.predicted)
            amplitudes = [(q, q.off, q.start - q.off) for q in effect.parameters if q.off is not None]
            off = {**start, **{q.name: zero for q, zero, _ in amplitudes}}
            columns = np.empty((len(before), len(amplitudes)))
            for i, (q, zero, step) in enumerate(amplitudes):  # the secant: some effects are far from linear
                active = [*fit.acting, Active(effect, {**off, q.name: zero + step})]
                columns[:, i] = (_expected(fit, fit.problem.predict(fit.base_values, active)) - before) / step
            self._known[key] = columns
        return self._known[key]


class _Visibility:
    """Visibility of effects under the noise of a fit, beyond what the fit's own parameters explain."""

    def __init__(self, fit: Fit, own: Array) -> None:
        self._fit = fit
        self._std, self._scale = (np.array([getattr(f, name) for f in fit.free]) for name in ("std", "scale"))
        self._own = _white(own, fit) * self._scale
        prior, ridge = np.diag((self._scale / self._std) ** 2), 1e-9 * np.eye(len(self._scale))
        self._factor = np.linalg.inv(self._own.T @ self._own + prior + ridge)

    def strongest(
        self, effect: Effect, columns: Sequence[tuple[dict[str, float], Array]]
    ) -> tuple[list[Proposal], Proposal | None]:
        """Sensitivity to an effect from each start with any influence, and the largest one."""
        sensitivities = [s for start, change in columns if (s := self._sensitivity(effect, start, change)) is not None]
        return sensitivities, max(sensitivities, key=lambda s: s.d_prime, default=None)

    def _sensitivity(self, effect: Effect, start: Mapping[str, float], columns: Array) -> Proposal | None:
        """Sensitivity to all amplitudes together, or to the most visible one; None without influence."""
        best = None
        spanned = columns * amplitude_spans(effect)
        for change in (spanned.sum(axis=1), *spanned.T):
            white = _white(change[:, np.newaxis], self._fit)[:, 0]
            whole = float(np.linalg.norm(white))
            if not whole > 1e-9:
                continue
            absorbed = self._factor @ (self._own.T @ white)
            remainder, pushed = white - self._own @ absorbed, absorbed * self._scale / self._std
            data, prior = float(np.linalg.norm(remainder)), float(np.linalg.norm(pushed))
            rest = float(np.hypot(data, prior))
            if best is None or rest > best.d_prime:
                direction = np.concatenate((remainder, pushed)) / max(rest, 1e-300)
                best = Proposal(effect, start, columns, rest / whole, rest, prior, direction)
        return best


class _FastGains:
    """Gains in log-likelihood under the noise that best whitens the residual of a fit, to first order.

    They find what is fast: a delay, a gain, an inertia, judder. Slow torque is noise to them.
    """

    def __init__(self, fit: Fit, own: Array) -> None:
        self._fit = fit
        scale, std, nominal = (np.array([getattr(f, name) for f in fit.free]) for name in ("scale", "std", "nominal"))
        weights = fit.weights
        self._root = np.sqrt(weights[np.isfinite(weights)])
        self._own = _white(own, fit) * scale * self._root[:, np.newaxis]
        self._white = valid_rows(fit.white) * self._root
        information = self._own.T @ self._own + np.diag((scale / std) ** 2) + 1e-9 * np.eye(len(scale))
        self._covariance = np.linalg.inv(information)
        self._pull = self._own.T @ self._white - np.nan_to_num((fit.point - nominal) / std**2) * scale

    def added(self, s: Proposal) -> Proposal:
        """The same sensitivity with its gain."""
        spans = amplitude_spans(s.effect)
        x = _white(s.columns, self._fit) * spans * self._root[:, np.newaxis]
        projection = x.T @ self._own @ self._covariance
        score = x.T @ self._white - projection @ self._pull
        information = x.T @ x - projection @ (self._own.T @ x) + np.eye(len(score)) / LARGE**2
        moved = np.clip(np.linalg.solve(information, score), *amplitude_bounds(s.effect))
        return replace(s, fast=float(score @ moved - 0.5 * moved @ information @ moved), moved=moved)


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


def _expected(fit: Fit, predicted: Sequence[Predicted]) -> Array:
    return np.concatenate(fit.problem.expected(predicted))


def _white(columns: Array, fit: Fit) -> Array:
    """Whitened columns over the noise's standard deviation, used rows only."""
    return valid_rows(fit.problem.white(fit.problem.split(columns), fit.noises))
