# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What laps that were never used say of each effect."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from trackres_ros.diagnosis.base.base import BaseParameter
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.inference.levels import with_levels
from trackres_ros.diagnosis.selection.held_out import CONFIRMED, REFUTED, SUSPECTED, HeldOutLaps, Improvement
from trackres_ros.effects.effect import Active

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
    together
        Of the model with all that was found over the re-fitted base; None where that was not asked.
    displaces
        Parameters of the base that lie on a bound, far from the file's value, beside it and not without it, where it makes
        held-out laps little better: it takes the place of what the base has, as an offset of the sensor does of all that rolling
        resists.
    grade
        `confirmed`, `suspected` or `refuted`. What lies on a bound is at best suspected, and so is what helps only beside others
        while all of it together is not confirmed. What displaces is refuted.
    """

    name: str
    improvement: Improvement
    on_bounds: tuple[str, ...]
    displaces: tuple[str, ...] = ()
    together: Improvement | None = None

    @property
    def grade(self) -> str:
        """See above."""
        if self.displaces:
            return REFUTED
        unsure = bool(self.on_bounds) or self.confirmed_only_beside_others
        return SUSPECTED if unsure and self.improvement.grade == CONFIRMED else self.improvement.grade

    @property
    def confirmed_only_beside_others(self) -> bool:
        """Whether held-out laps confirm it, but not all of it together."""
        return self.improvement.grade == CONFIRMED and self.together is not None and self.together.grade != CONFIRMED


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
        together = laps.improvement_of(refitted, final)
        if worst.grade != REFUTED and together.grade != REFUTED:
            return final, {name: replace(g, together=together) for name, g in graded.items()}, tuple(refuted)
        refuted.append(worst)
        final = with_levels(final, [worst.name]) if len(graded) > 1 else refitted
    return final, {}, tuple(refuted)


def leave_unconfirmed(
    final: Fit, graded: dict[str, Graded], refitted: Fit, laps: HeldOutLaps
) -> tuple[Fit, dict[str, Graded], tuple[Graded, ...]]:
    """Leave out what is only suspected where something else is confirmed, one after the other, what gains least first.

    What is confirmed then has the values that it has by itself, and all in the fit is confirmed, or all of it is suspected.

    Returns
    -------
    fit, graded, left
        As of `confirm`, and what was left out: what was suspected, and what held-out laps refute without it.
    """
    left = list[Graded]()
    while True:
        unsure = [g for g in graded.values() if g.grade != CONFIRMED]
        if len(unsure) in (0, len(graded)):
            return final, graded, tuple(left)
        least = max(unsure, key=lambda g: g.improvement.after - g.improvement.before)
        final, graded, worse = confirm(with_levels(final, [least.name]), refitted, laps)
        left += [least, *worse]


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
