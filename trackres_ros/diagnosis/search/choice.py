# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Chooses among explanations by cross-validation over laps: evidence proposes, prediction decides.

A term is confirmed if its own level score is surely above zero, the mean error does not grow, and what it improves fits its size.
Of explanations whose terms all are, none that another one surely predicts better is taken; of the others the one with the most
evidence.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.empirical.finders import SURE, Term
from trackres_ros.diagnosis.empirical.routes import Route
from trackres_ros.diagnosis.findings.wording import NONE_OF_THESE
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.inference.levels import with_levels
from trackres_ros.diagnosis.search.explanations import Explanation, Key, Search
from trackres_ros.diagnosis.search.left_out import LeaveLapsOut, Score
from trackres_ros.diagnosis.selection.as_used import AsUsed, inside_ranges
from trackres_ros.diagnosis.selection.confirm import Graded, displaced, far_from_file, on_bounds
from trackres_ros.diagnosis.selection.form_error import FORM_ERROR
from trackres_ros.diagnosis.selection.held_out import SMALL_SHARE, HeldOutLaps, Improvement
from trackres_ros.diagnosis.selection.naming import ALIKE_WITHIN, Step, spurious_gain

Array = NDArray[np.float64]

MOST_SCORED = 12  # explanations, of the most evidence
LEAST_OF_SIZE = 0.05  # of the mean square that a term adds: what improves less cancels another term
CLASS_SHARE = 0.8


@dataclass(frozen=True, eq=False)
class ScoredExplanation:
    """An explanation with values that predict, and what laps left out say of it."""

    explanation: Explanation
    final: Fit
    score: Score

    @property
    def key(self) -> Key:
        """Names of its terms."""
        return self.explanation.key


@dataclass(frozen=True, eq=False)
class Chosen:
    """What explains the recordings.

    Attributes
    ----------
    explanation, final, graded
        The best that laps left out confirm, with values that predict, and the grade of each term; nothing where none is.
    alone, steps, last
        The round beside the base alone; of each term the round without it, with its class; and the round beside all of it.
    refuted
        The terms that fit best, where laps left out do not confirm them.
    shares
        Probability of each name, and of none of them: over the explanations that are confirmed, or over all where none is.
    """

    explanation: Explanation
    final: Fit
    graded: Mapping[str, Graded]
    alone: Step
    steps: Mapping[str, Step]
    last: Step
    refuted: tuple[Graded, ...]
    shares: Mapping[str, float]

    def is_named(self, name: str) -> bool:
        """Whether a term has a name: it is of the catalogue, or surely a slope by place."""
        route = self.term(name).route
        return self.explanation.candidates[name].is_name or (route is not None and route.told)

    def term(self, name: str) -> Term:
        """A term with what its fit does not say."""
        return self.explanation.terms.get(name) or Term(self.explanation.candidates[name])

    @property
    def routes(self) -> tuple[Route, ...]:
        """What goes by place."""
        return tuple(term.route for term in self.explanation.terms.values() if term.route is not None)


class Choice:
    """Judges the explanations of a search.

    Parameters
    ----------
    refitted
        The base alone with values that predict.
    """

    def __init__(self, search: Search, refitted: Fit, left_out: LeaveLapsOut, laps: HeldOutLaps, use: AsUsed) -> None:
        self._search, self._refitted, self._left_out, self._laps, self._use = search, refitted, left_out, laps, use
        self._beyond_base = left_out.beyond(refitted)
        self._by_file = use.error(None)
        nothing = search.nothing
        self._judged: dict[Key, ScoredExplanation] = {nothing.key: ScoredExplanation(nothing, refitted, left_out.score(refitted))}
        self._graded: dict[tuple[Key, str], Graded] = {}

    @property
    def _nothing(self) -> ScoredExplanation:
        return self._judged[frozenset()]

    def judged(self, explanation: Explanation) -> ScoredExplanation:
        """Fit with values that predict, and score."""
        if explanation.key not in self._judged:
            final = inside_ranges(with_levels(replace(explanation.fit, problem=self._refitted.problem)), self._use)
            final = _off_bounds(final, self._refitted)
            self._judged[explanation.key] = ScoredExplanation(explanation, final, self._left_out.score(final))
        return self._judged[explanation.key]

    def graded(self, judged: ScoredExplanation, name: str) -> Graded:
        """What laps left out say of a term of an explanation."""
        at = judged.key, name
        if at not in self._graded:
            self._graded[at] = self._grade(judged, name)
        return self._graded[at]

    def _grade(self, judged: ScoredExplanation, name: str) -> Graded:
        without = self.judged(self._search.without(judged.explanation, name))
        change = name in judged.explanation.terms and judged.explanation.terms[name].change is not None
        improvement = self._left_out.improvement(without.score, judged.score, for_good=change)
        # The part of it that the base alone cannot take up should come off the mean square error.
        adds = self._beyond_base(judged.final.contribution(name))
        gained = float((without.score.square - judged.score.square).sum())
        cancels = gained < LEAST_OF_SIZE * float((adds**2).sum())
        active = next(a for a in judged.final.effects if a.effect.name == name)
        return Graded(name, improvement, on_bounds(active), displaced(improvement, judged.final, without.final), cancels=cancels)

    def _all_graded(self, judged: ScoredExplanation) -> dict[str, Graded]:
        return {name: self.graded(judged, name) for name in judged.explanation.candidates}

    def _is_confirmed(self, judged: ScoredExplanation) -> bool:
        once = any(term.change is not None for term in judged.explanation.terms.values())
        whole = self._left_out.improvement(self._nothing.score, judged.score, for_good=once)
        kept = self._kept(judged)
        # A re-fit may be worse than the file. What only mends that is not missing.
        if not whole.confirmed or kept.after > min(kept.before, self._by_file) or far_from_file(judged.final):
            return False
        return all(self.graded(judged, name).confirmed for name in judged.explanation.candidates)

    def _kept(self, judged: ScoredExplanation) -> Improvement:
        """Of the error on held-out laps."""
        return self._laps.improvement_of(self._refitted, judged.final)

    def best(self, keep_suspected: bool = False) -> Chosen:
        """The best explanation; each of its terms is compared with all that could stand in its place.

        Where none is confirmed, it is that with the most evidence if `keep_suspected`, else nothing.
        """
        best = self._nothing
        while True:
            counted = [j for j in map(self.judged, self._proposed()) if self._counts(j)]
            confirmed = [j for j in counted if self._is_confirmed(j)]
            before, best = best, self._pick(confirmed)
            again = [self._search.without(best.explanation, name) for name in best.explanation.candidates]
            new = [e for e in (best.explanation, *again) if e.key not in self._search.rounds]
            for explanation in new:
                self._search.expand(explanation)
            if not new and best is before:
                break
        shares = self._shares(confirmed or [self._nothing, *(j for j in counted if self._kept(j).after <= self._by_file)])
        first = counted[0] if counted else self._nothing
        doubted = tuple(g for g in self._all_graded(first).values() if not g.confirmed and g.name not in best.key)
        if keep_suspected and not best.key:
            best, doubted = first, ()
        steps = {name: self._round_of(best, name) for name in best.explanation.candidates}
        last = self._search.expand(best.explanation)
        alone = self._search.rounds[frozenset()]
        return Chosen(best.explanation, best.final, self._all_graded(best), alone, steps, last, doubted, shares)

    def _counts(self, judged: ScoredExplanation) -> bool:
        """Whether each term gains more than noise would beside all others, and one that improves little more than the model's own
        error would.

        What goes by place was sought on passes that it was not learned from: the price of all its places does not count again.
        """
        explanation = judged.explanation
        for name, candidate in explanation.candidates.items():
            if explanation.goes_by_place(name):
                continue
            without = self._search.without(explanation, name)
            step = self._search.rounds.get(without.key)
            by_model = step.threshold if step is not None else spurious_gain(without.fit)
            before, after = self.judged(without).score.error.sum(), judged.score.error.sum()
            small = before - after < SMALL_SHARE * before
            least = max(self._search.by_noise, by_model if small else 0.0)
            evidence = explanation.evidence - without.evidence
            gain = evidence + candidate.gain - candidate.criterion
            if not (candidate.matters and evidence > 0.0 and gain > least):
                return False
        return True

    def _proposed(self) -> list[Explanation]:
        """Those of the most evidence, and each with something that goes by place."""
        found = sorted((e for e in self._search.known.values() if e.key), key=lambda e: -e.evidence)
        return [e for i, e in enumerate(found) if i < MOST_SCORED or any(map(e.goes_by_place, e.key))]

    def _pick(self, confirmed: Sequence[ScoredExplanation]) -> ScoredExplanation:
        """Of those that none surely beats those with the fewest terms without a name, and of these that with the most evidence.

        The functions of a name are nature's to a tenth only: a form that bends to the data has more evidence beside a true name,
        and predicts no better.
        """
        unbeaten = [j for j in confirmed if not any(self._beats(k, j) or self._outdoes(k, j) for k in confirmed)]

        def rank(judged: ScoredExplanation) -> tuple[int, float]:
            return -judged.explanation.without_a_name, judged.explanation.evidence

        return max(unbeaten or confirmed, key=rank, default=self._nothing)

    def _beats(self, one: ScoredExplanation, other: ScoredExplanation) -> bool:
        """Whether one surely predicts better than another.

        A form in the place of a name has to by more: the function of a name is nature's to a tenth only, so the mean square
        error has to fall by more than the square of a tenth of what the names add.
        """
        more_forms = one.explanation.without_a_name > other.explanation.without_a_name
        if self._left_out.least_gain(other.score, one.score) <= (SURE if more_forms else ALIKE_WITHIN):
            return False
        names = [name for name, c in other.explanation.candidates.items() if c.is_name and name not in one.key]
        by_form = sum(float((self._beyond_base(other.final.contribution(name)) ** 2).sum()) for name in names) * FORM_ERROR**2
        return not more_forms or float((other.score.square - one.score.square).sum()) > by_form

    def _outdoes(self, one: ScoredExplanation, other: ScoredExplanation) -> bool:
        """Whether one is the other with a form of more evidence in the place of a name that takes little off the error.

        Of a small term the data do not show its function, so nothing speaks for the name but its evidence.
        """
        places = [(mine, its) for mine in one.key - other.key for its in other.key - one.key]
        if len(one.key) != len(other.key) or len(places) != 1:
            return False
        ((form, name),) = places
        if one.explanation.candidates[form].is_name or not other.explanation.candidates[name].is_name:
            return False
        without = self.judged(self._search.without(other.explanation, name)).score.error.sum()
        small = without - other.score.error.sum() < SMALL_SHARE * without
        return bool(small) and one.explanation.evidence > other.explanation.evidence

    def _round_of(self, best: ScoredExplanation, name: str) -> Step:
        """The round without a term, with its class: what stands in its place as well."""
        without = self._search.without(best.explanation, name)
        step = self._search.expand(without)
        chosen = best.explanation.candidates[name]
        beside = {c.name: c for c in step.candidates if c.is_name == chosen.is_name and c.counts(step.by_noise)}
        chosen = beside.setdefault(name, chosen)
        alike = set(step.separability.alike(name)) if name in step.separability.names else {name}
        near = [c for c in beside.values() if c is chosen or c.net_evidence > chosen.net_evidence - 2.0 * ALIKE_WITHIN]
        rivals = {c.name: self._search.known.get(without.key | {c.name}) for c in near if c is not chosen}
        judged = {name: best} | {other: self.judged(e) for other, e in rivals.items() if e is not None}
        judged = {other: j for other, j in judged.items() if j is best or self._is_confirmed(j)}
        shares = dict(zip(judged, self._left_out.shares([j.score for j in judged.values()]).tolist(), strict=True))
        as_good = {
            c.name
            for c in near
            if c.name in judged and c.net_evidence > chosen.net_evidence - ALIKE_WITHIN and not self._beats(best, judged[c.name])
        }
        members = _class_of(name, shares, (alike & shares.keys()) | as_good)
        total = sum(shares[m] for m in members)
        weights = {m: shares[m] / max(total, 1e-12) for m in members}
        rest = [c for c in step.candidates if c.name != name]
        return replace(
            step, candidates=(chosen, *rest), chosen=chosen, members=tuple(members), weights=weights, stability=float(total)
        )

    def _shares(self, judged: Sequence[ScoredExplanation]) -> dict[str, float]:
        """Probability of each name: its share over some explanations."""
        shares = self._left_out.shares([j.score for j in judged])
        found: dict[str, float] = {NONE_OF_THESE: 0.0}
        for one, share in zip(judged, shares.tolist(), strict=True):
            names = [name for name, c in one.explanation.candidates.items() if c.is_name]
            for name in names or [NONE_OF_THESE]:
                found[name] = found.get(name, 0.0) + share
        return dict(sorted(found.items(), key=lambda pair: -pair[1]))


def _off_bounds(final: Fit, refitted: Fit) -> Fit:
    """With typical values of what only shapes a term and lies on a bound, where that costs less than a tenth of what all terms
    gain: to a tenth a function is nature's.
    """
    typical = {
        (a.effect.name, q.name): q.start for a in final.effects for q in a.effect.parameters
        if q.off is None and q.name in on_bounds(a)
    }  # fmt: skip
    if not typical:
        return final
    inside = with_levels(final, fixed=typical)
    most = max(ALIKE_WITHIN, FORM_ERROR * (final.log_likelihood - refitted.log_likelihood))
    return inside if inside.log_likelihood > final.log_likelihood - most else final


def _class_of(name: str, shares: Mapping[str, float], alike: Collection[str]) -> list[str]:
    """The fewest that hold `CLASS_SHARE` of all, the one that was chosen among them, and those that are alike."""
    members, held = [name], shares[name]
    for other, share in sorted(shares.items(), key=lambda pair: -pair[1]):
        if held >= CLASS_SHARE:
            break
        if other != name:
            members.append(other)
            held += share
    return [*members, *(other for other in sorted(alike) if other not in members)]
