# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Step 4: finds the visible and the indistinguishable effects of these recordings, before naming any."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.base.base import Predicted
from trackres_ros.diagnosis.inference.fitting import LARGE, Fit, jacobian, valid_rows
from trackres_ros.diagnosis.inference.noise import shortened
from trackres_ros.effects.effect import Active, Effect
from trackres_ros.effects.learned import EmpiricalEffect
from trackres_ros.progress import counted

Array = NDArray[np.float64]
Projector = Callable[[Array], tuple[Array, Array]]
ColumnsOf = Callable[[Effect, Mapping[str, float]], Array]

LEAST_KEPT, LEAST_D_PRIME = 0.1, 3.0
ALIKE_COSINE = 0.95
ALWAYS_KNOWN = ("speed", "accel", "weight", "distance", "drive_torque", "ambient", "belt")
REPLACED_BY = {"grade": ("grade", "grade_profile")}
"""Effects that a measured channel replaces."""


@dataclass(frozen=True, eq=False)
class EffectSensitivity:
    """First-order change of the residual by an effect.

    Attributes
    ----------
    effect, start
        The effect, and the values of its linearisation.
    amplitudes
        Names of the parameters of `columns`.
    columns
        Change of the prediction per amplitude, of all segments concatenated, shape (n, amplitudes).
    kept
        Share of it that no re-fit of the base absorbs.
    d_prime
        Visibility of a typical effect in standard deviations.
    by_priors
        Part of it due to base parameters pushed out of the ranges of the vehicle file.
    direction
        Whitened, orthogonal to the base, of unit length: for the cosine between two effects.
    """

    effect: Effect
    start: Mapping[str, float]
    amplitudes: tuple[str, ...]
    columns: Array
    kept: float
    d_prime: float
    by_priors: float
    direction: Array


class Shown(NamedTuple):
    """Visibility of a change of the predicted torque, see `EffectSensitivity`."""

    kept: float
    d_prime: float
    by_priors: float
    direction: Array


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
    """Visible effects, and their similarity.

    Attributes
    ----------
    visible
        Sensitivities of visible effects; one may appear several times, from several starts.
    not_visible
        The others with the reason; and visible ones that the base could absorb almost entirely.
    names, cosines
        Names of the visible ones, and the cosines between them, shape (names, names), signed.
    """

    visible: tuple[EffectSensitivity, ...]
    not_visible: tuple[NotVisible, ...]
    names: tuple[str, ...]
    cosines: Array  # (names, names), signed

    @property
    def of_names(self) -> Separability:
        """The part for effects of the catalogue."""
        visible = tuple(s for s in self.visible if not isinstance(s.effect, EmpiricalEffect))
        not_visible = tuple(n for n in self.not_visible if not isinstance(n.effect, EmpiricalEffect))
        names = {s.effect.name for s in visible}
        at = [i for i, name in enumerate(self.names) if name in names]
        return Separability(visible, not_visible, tuple(self.names[i] for i in at), self.cosines[np.ix_(at, at)])

    def alike(self, name: str) -> tuple[str, ...]:
        """Effects that look the same as one here, that one first."""
        i = self.names.index(name)
        return (name, *(other for j, other in enumerate(self.names) if j != i and abs(self.cosines[i, j]) > ALIKE_COSINE))


def feasible(effects: Mapping[str, Effect], fit: Fit) -> tuple[list[Effect], list[NotVisible]]:
    """Effects with all inputs available, and the others with the reason."""
    sessions = fit.problem.sessions
    given = frozenset.intersection(*(s.given for s in sessions))
    possible, not_visible = [], []
    for effect in effects.values():
        name = effect.name
        missing = [need for need in effect.needs if need not in ALWAYS_KNOWN and need not in given]
        measured = [channel for channel, names in REPLACED_BY.items() if name in names and channel in given]
        if name in fit.effect_names:
            continue
        if name in fit.problem.base.includes:
            not_visible.append(NotVisible(effect, "the model already has it"))
            continue
        if effect.belt_only and not fit.problem.base.has_belt:
            not_visible.append(NotVisible(effect, "the vehicle has no belt"))
        elif missing:
            not_visible.append(NotVisible(effect, f"needs {', '.join(missing)}, which is not recorded"))
        elif measured:
            not_visible.append(NotVisible(effect, f"{measured[0]} is recorded, and in the model"))
        else:
            possible.append(effect)
    return possible, not_visible


def separability(effects: Mapping[str, Effect], fit: Fit, columns_of: ColumnsOf | None = None) -> Separability:
    """Linearise all effects about a fit, unless given, and compare them with the fit's own parameters and with
    each other.
    """
    columns_of = columns_of or EffectColumns(fit)
    possible, not_visible = feasible(effects, fit)
    own = base_columns(fit)
    own_white = _white(own, fit)
    project = _projector(own_white, fit)
    short = shortened(fit.noise)
    beside_short = None if short is None else replace(fit, noises={**fit.noises, "torque": short})
    project_short = None if beside_short is None else _projector(_white(own, beside_short), beside_short)
    visible = []
    for effect in counted(possible, "visibility of each effect", len(possible)):
        columns = [(start, columns_of(effect, start)) for start in starts(effect)]
        found, best = _strongest(effect, columns, fit, project)
        if best and LARGE * best.d_prime < LEAST_D_PRIME and beside_short and project_short:
            # A random-walk noise hides a slow effect, which may even be its cause.
            found, best = _strongest(effect, columns, beside_short, project_short)
        if best is None:
            not_visible.append(NotVisible(effect, "it has no effect here"))
        elif LARGE * best.d_prime < LEAST_D_PRIME:
            size = f"{LARGE:g} times as large as is typical"
            why = f"even {size}, it would reach only {LARGE * best.d_prime:.1f} standard deviations"
            not_visible.append(NotVisible(effect, why))
        else:
            # An absorbed effect is hardly visible, but may explain better than base values outside their ranges.
            if best.kept < LEAST_KEPT and LARGE * best.by_priors < LEAST_D_PRIME:
                why = f"the base's parameters absorb {1 - best.kept:.0%} of it"
                not_visible.append(NotVisible(effect, why))
            visible += found
    names = tuple(dict.fromkeys(s.effect.name for s in visible))
    strongest = {name: max((s for s in visible if s.effect.name == name), key=lambda s: s.d_prime) for name in names}
    directions = np.array([strongest[name].direction for name in names]) if names else np.empty((0, 0))
    return Separability(tuple(visible), tuple(not_visible), names, directions @ directions.T)


def starts(effect: Effect) -> list[dict[str, float]]:
    """Initial values: the typical ones, and each further start separately."""
    first = effect.values()
    return [first, *({**first, q.name: value} for q in effect.parameters for value in q.more_starts)]


def base_columns(fit: Fit) -> Array:
    """Change of all predicted segments with each free parameter of the fit, shape (n, parameters)."""
    return jacobian(lambda point: _expected(fit, fit.problem.predict(*fit.model_at(point))), fit.point, fit.free)


class EffectColumns:
    """Changes of the prediction per amplitude of effects, to first order about a fit; each is simulated once."""

    def __init__(self, fit: Fit) -> None:
        self._fit = fit
        self._known = dict[tuple[int, tuple[float, ...]], Array]()

    def __call__(self, effect: Effect, start: Mapping[str, float]) -> Array:
        """Columns of one effect about its initial values."""
        key = id(effect), tuple(start.values())
        if key not in self._known:
            self._known[key] = _columns(effect, start, self._fit)
        return self._known[key]


def _columns(effect: Effect, start: Mapping[str, float], fit: Fit) -> Array:
    """Change of the prediction per amplitude of an effect, shape (n, amplitudes)."""
    before = _expected(fit, fit.predicted)
    off = {**start, **{q.name: q.off for q in effect.parameters if q.off is not None}}
    amplitudes = [(q, q.off, q.start - q.off) for q in effect.parameters if q.off is not None]
    columns = np.empty((len(before), len(amplitudes)))
    for i, (q, none, step) in enumerate(amplitudes):  # the secant: some effects are far from linear
        active = [*fit.acting, Active(effect, {**off, q.name: none + step})]
        columns[:, i] = (_expected(fit, fit.problem.predict(fit.base_values, active)) - before) / step
    return columns


def _strongest(
    effect: Effect, columns: Sequence[tuple[dict[str, float], Array]], fit: Fit, project: Projector
) -> tuple[list[EffectSensitivity], EffectSensitivity | None]:
    """Visibility of an effect from each start with any influence, under the noise of a fit; and the strongest one."""
    found = [s for start, of in columns if (s := _sensitivity(effect, start, of, fit, project)) is not None]
    return found, max(found, key=lambda s: s.d_prime, default=None)


def _sensitivity(
    effect: Effect, start: Mapping[str, float], columns: Array, fit: Fit, project: Projector
) -> EffectSensitivity | None:
    amplitudes = [q for q in effect.parameters if q.off is not None]
    spanned = columns * np.array([q.start - q.off for q in amplitudes if q.off is not None])
    shown = [one for series in (spanned.sum(axis=1), *spanned.T) if (one := _shown(series, fit, project)) is not None]
    if not shown:
        return None
    best = max(shown, key=lambda one: one.d_prime)
    names = tuple(q.name for q in amplitudes)
    return EffectSensitivity(effect, start, names, columns, best.kept, best.d_prime, best.by_priors, best.direction)


def _shown(change: Array, fit: Fit, project: Projector) -> Shown | None:
    """Visibility of a change of the predicted torque; None for no change."""
    white = _white(change[:, np.newaxis], fit)[:, 0]
    whole = float(np.linalg.norm(white))
    if not whole > 1e-9:
        return None
    left, pushed = project(white)
    data, prior = float(np.linalg.norm(left)), float(np.linalg.norm(pushed))
    rest = float(np.hypot(data, prior))
    direction = np.concatenate((left, pushed)) / max(rest, 1e-300)
    return Shown(rest / whole, rest, prior, direction)


def _projector(own_white: Array, fit: Fit) -> Projector:
    """Function that removes the part of a whitened series that the fit's own parameters explain.

    It returns the remainder of the series, and the resulting change of the parameters in prior standard deviations.
    """
    std = np.array([f.std for f in fit.free])
    scale = np.array([f.scale for f in fit.free])
    columns = own_white * scale
    information = columns.T @ columns + np.diag((scale / std) ** 2) + 1e-9 * np.eye(len(scale))
    factor: Array = np.linalg.inv(information)

    def project(series: Array) -> tuple[Array, Array]:
        taken = factor @ (columns.T @ series)
        return np.asarray(series - columns @ taken), np.asarray(taken * scale / std)

    return project


def _expected(fit: Fit, predicted: Sequence[Predicted]) -> Array:
    return np.concatenate(fit.problem.expected(predicted))


def _white(columns: Array, fit: Fit) -> Array:
    """Whitened columns over the noise's standard deviation, used rows only."""
    return valid_rows(fit.problem.white(fit.problem.split(columns), fit.noises))
