# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Names and terms without a name for what a base leaves, one beside the other: names first, or first the mass that differs from
one stretch to the next, whichever explains more. The mean of loads that are not recorded looks like a scale of the torque, which
would have a name before anybody asked how it differs by stretch. With few stretches the likelihood hardly tells them apart; laps
that were not fitted do, as loads that were taken for friction are others there.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trackres_ros.diagnosis.described.describe import PAYLOAD, Description, Term, describe, load_by_stretch
from trackres_ros.diagnosis.described.payload import may_differ
from trackres_ros.diagnosis.described.routes import Roads, Route, beside_names, by_place
from trackres_ros.diagnosis.inference.fitting import Fit, fit
from trackres_ros.diagnosis.inference.levels import with_levels
from trackres_ros.diagnosis.selection.as_used import AsUsed, inside_ranges
from trackres_ros.diagnosis.selection.confirm import Graded, confirm
from trackres_ros.diagnosis.selection.held_out import CONFIRMED, HeldOutLaps
from trackres_ros.diagnosis.selection.naming import Step, choose, spurious_gain
from trackres_ros.effects.effect import Effect


@dataclass(frozen=True, eq=False)
class Explanation:
    """What goes by place, and all that was named or described beside it.

    Attributes
    ----------
    steps
        Rounds of names that are left, that of a slope by place among them.
    """

    route: Route | None
    steps: list[Step]
    description: Description

    @property
    def evidence(self) -> float:
        """Log-evidence of the fit, less what cost its terms that its parameters do not show."""
        chosen = [s.chosen for s in self.steps if s.chosen] + [t.candidate for t in self.description.terms.values()]
        return self.description.fit.log_evidence - sum(c.form_error_gain for c in chosen)


@dataclass(frozen=True, eq=False)
class Judged:
    """An explanation, and what `confirm` leaves of it on held-out laps."""

    explanation: Explanation
    final: Fit
    graded: dict[str, Graded]
    refuted: tuple[Graded, ...]


def explain(
    tested: Fit,
    first: Route | None,
    roads: Roads | None,
    effects: Mapping[str, Effect],
    replicates: int,
    rng: np.random.Generator,
    on_stage: Callable[[str], None],
    kinds: Collection[str],
) -> list[Explanation]:
    """Look for names and for what has none: one explanation, or several, that which explains more first.

    Parameters
    ----------
    tested, first
        The base as it was fitted, and what goes by place beside it.
    roads, kinds
        Where positions say that the sessions are, and what of them may be learned.
    effects
        Those that may be named.
    """

    def described(
        route: Route | None, named: Fit, rounds: list[Step], load: Term | None = None, undecided_may_go: bool = True
    ) -> Explanation:
        description = describe(named, rounds, effects, replicates, rng, on_stage, roads, route, kinds, load, undecided_may_go)
        steps = description.steps
        if route is not None and route.told and route.candidate.name in description.fit.effect_names:
            steps = [by_place(route, rounds[0]), *steps]
        return Explanation(route, steps, description)

    begin = tested if first is None else first.candidate.fit
    rounds, named = choose(begin, effects, replicates, rng, on_stage)
    beside = beside_names(first, roads, named, kinds)
    found = [described(*beside, rounds)]
    if found[0].description.instead:
        found.append(described(*beside, rounds, undecided_may_go=False))
    if named.effect_names == begin.effect_names or not may_differ(begin):
        return found
    load = load_by_stretch(begin, first)
    if load is None:
        return found
    on_stage("names beside a mass that differs by stretch")
    rounds, named = choose(load.candidate.fit, effects, replicates, rng, on_stage)
    others, route = [a.effect for a in named.effects if a.effect.name != PAYLOAD], first
    if len(others) > len(begin.effects):
        route, named = beside_names(first, roads, fit(named.problem, others, named.at, named.noises), kinds)
        load = load_by_stretch(named, route)
    if load is None:
        return found
    other = described(route, named, rounds, load)
    # Names beside which a payload is there in any case must gain over it alone what any name must.
    names = [s for s in found[0].steps if s.chosen and s.chosen.name not in other.description.fit.effect_names]
    least = sum(max(s.threshold, spurious_gain(other.description.fit)) for s in names)
    sure = least if PAYLOAD in found[0].description.terms else 0.0
    return [*found, other] if found[0].evidence > other.evidence + sure else [other, *found]


def judged(explanations: Sequence[Explanation], refitted: Fit, laps: HeldOutLaps, use: AsUsed) -> Judged:
    """The first explanation, unless held-out laps refute a part of it and none of the other, and confirm that this is better."""
    chosen = _judged(explanations[0], refitted, laps, use)
    for explanation in explanations[1:] if chosen.refuted else ():
        other = _judged(explanation, refitted, laps, use)
        if not other.refuted and laps.improvement_of(chosen.final, other.final).grade == CONFIRMED:
            return other
    return chosen


def _judged(explanation: Explanation, refitted: Fit, laps: HeldOutLaps, use: AsUsed) -> Judged:
    best = explanation.description.fit
    if not best.effects:
        return Judged(explanation, refitted, {}, ())
    return Judged(explanation, *confirm(inside_ranges(with_levels(best), use), refitted, laps))
