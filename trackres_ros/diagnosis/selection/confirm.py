# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What laps that were never used say of each effect, and which of all that was found may be written and fed forward."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.base.base import BaseParameter
from trackres_ros.diagnosis.base.watched import WATCHED, ByPlace
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.inference.levels import with_levels
from trackres_ros.diagnosis.selection.held_out import CONFIRMED, REFUTED, SUSPECTED, HeldOut, HeldOutLaps, Improvement
from trackres_ros.diagnosis.selection.intervals import Interval, intervals
from trackres_ros.diagnosis.writing.kept import Kept
from trackres_ros.effects.effect import Active
from trackres_ros.text.numbers import figures

Array = NDArray[np.float64]

ON_BOUND = 1e-3  # of the span between the bounds
LITTLE = 0.1  # of the mean error: what takes the place of a value of the base makes no more than that better
MOVED = 1.5  # standard deviations of the file's own range


@dataclass(frozen=True, slots=True)
class Graded:
    """An effect and what held-out laps say of it.

    Attributes
    ----------
    improvement
        Of the model with it over the one without, each fitted by itself.
    on_bounds
        Parameters that lie on a bound other than the value without effect.
    displaces
        Parameters of the base that lie on an implausible bound beside it, and not without it, where it makes held-out laps
        little better: it takes the place of what the base has, as an offset of the sensor does of all that rolling resists.
    grade
        `confirmed`, `suspected` or `refuted`; what lies on a bound is at best suspected, what displaces is refuted.
    """

    name: str
    improvement: Improvement
    on_bounds: tuple[str, ...]
    displaces: tuple[str, ...] = ()

    @property
    def grade(self) -> str:
        """See above."""
        if self.displaces:
            return REFUTED
        return SUSPECTED if self.on_bounds and self.improvement.grade == CONFIRMED else self.improvement.grade


def confirm(final: Fit, refitted: Fit, laps: HeldOutLaps) -> tuple[Fit, dict[str, Graded], tuple[Graded, ...]]:
    """Grade each effect of a fit, and leave out what held-out laps refute, the worst first.

    Parameters
    ----------
    final, refitted
        Fits of `levels.with_levels` with the effects and with none.

    Returns
    -------
    fit, graded, refuted
        The fit with what is left, the grade of each of its effects, and the effects that were left out.
    """
    refuted: list[Graded] = []
    while final.effects:
        graded = {a.effect.name: _graded(a, final, refitted, laps) for a in final.effects}
        worst = max(graded.values(), key=lambda g: (bool(g.displaces), g.improvement.after - g.improvement.before))
        together = laps.improvement_of(refitted, final).grade
        if worst.grade != REFUTED and together != REFUTED:
            return final, graded, tuple(refuted)
        refuted.append(worst)
        final = with_levels(final, [worst.name]) if len(graded) > 1 else refitted
    return final, {}, tuple(refuted)


def leave_unconfirmed(
    final: Fit, graded: dict[str, Graded], terms: Collection[str], refitted: Fit, laps: HeldOutLaps
) -> tuple[Fit, dict[str, Graded], tuple[Graded, ...]]:
    """Leave out names that are only suspected beside a term without a name that is confirmed: what that explains in part was
    theirs before it was found.

    Returns
    -------
    fit, graded, left
        As of `confirm`, and what was left out: those names, and what held-out laps refute without them.
    """
    left = tuple(g for name, g in graded.items() if name not in terms and g.grade != CONFIRMED)
    if not left or not any(graded[name].grade == CONFIRMED for name in terms if name in graded):
        return final, graded, ()
    final, graded, worse = confirm(with_levels(final, [g.name for g in left]), refitted, laps)
    return final, graded, (*left, *worse)


def keep(
    believed: Sequence[str],
    final: Fit,
    refitted: Fit,
    held_out: HeldOut,
    laps: HeldOutLaps,
    bounds: Mapping[tuple[str, str], Interval],
) -> Kept:
    """What may be written: the best model of believed effects whose error on held-out laps is not above the vehicle file's.

    Parameters
    ----------
    believed
        Names of the effects that may be written.
    bounds
        Intervals of `final`.
    """
    doubted = [a.effect.name for a in final.effects if a.effect.name not in believed and a.effect.acts_on != WATCHED]
    models = [refitted]
    if believed:
        models.insert(0, with_levels(final, doubted) if doubted else final)
    before = held_out.mae["nominal"]
    but = f"; not written: {', '.join(doubted)}" if doubted else ""
    for model in models:
        after = float(np.abs(laps.measured - laps.of(model.of_file())).mean())
        if after <= before:
            found = bounds if model is final else intervals(model)
            written = [a for a in model.effects if a.effect.acts_on != WATCHED]
            effects = tuple(a for a in written if not isinstance(a.effect, ByPlace))
            route = tuple(a.effect.learned(a.numbers[0]) for a in written if isinstance(a.effect, ByPlace))
            of_effects = ", ".join(a.effect.name for a in written)
            what = f"the base's values and {of_effects}" if of_effects else "the base's values"
            error = f"the mean error on laps not used for fitting is {figures(after)} Nm, {figures(before)} Nm with the old one"
            return Kept(dict(model.base_values), effects, found, f"written: {what}; {error}{but}", route=route)
    why = f"as no re-fit has a smaller error on laps not used for fitting than they, {figures(before)} Nm"
    return Kept(None, (), {}, f"written: the file's own values, {why}{but}")


def _graded(active: Active, final: Fit, refitted: Fit, laps: HeldOutLaps) -> Graded:
    name = active.effect.name
    without = refitted if len(final.effects) == 1 else with_levels(final, [name])
    on_bounds = tuple(
        q.name
        for q in active.effect.parameters
        for bound in (q.low, q.high)
        if q.fitted and bound != q.off and abs(active.values[q.name] - bound) <= ON_BOUND * (q.high - q.low)
    )
    improvement = laps.improvement_of(without, final)
    little = improvement.before - improvement.after < LITTLE * improvement.before
    gone = set(at_implausible_bounds(final)) - set(at_implausible_bounds(without)) if little else ()
    return Graded(name, improvement, on_bounds, tuple(sorted(gone)))


def at_implausible_bounds(found: Fit) -> tuple[str, ...]:
    """Parameters of the base on a bound that is further from the vehicle file's value than its range says."""
    return tuple(
        q.name for q, value in moved_parameters(found) if min(value - q.low, q.high - value) <= ON_BOUND * (q.high - q.low)
    )


def moved_parameters(found: Fit) -> list[tuple[BaseParameter, float]]:
    """Parameters of the base that moved further than their range says, furthest first."""
    moved = [(q, found.base_values[q.name]) for q in found.problem.base.parameters if np.isfinite(q.std)]
    far = [(q, value) for q, value in moved if abs(value - q.nominal) > MOVED * q.std]
    return sorted(far, key=lambda pair: -abs(pair[1] - pair[0].nominal) / pair[0].std)
