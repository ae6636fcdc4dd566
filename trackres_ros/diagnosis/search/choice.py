# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Chooses among explanations by cross-validation over laps: evidence proposes, prediction decides.

A term is confirmed if its own level score is significantly above zero, the mean error does not grow, and the gain fits
its size. A fully confirmed explanation is dropped if another one predicts significantly better. Of the rest, the one with
the most evidence is chosen.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

from trackres_ros.diagnosis.empirical.finders import SURE, Term
from trackres_ros.diagnosis.empirical.routes import Route
from trackres_ros.diagnosis.findings.wording import NONE_OF_THESE
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.inference.levels import with_levels
from trackres_ros.diagnosis.search.cross_validation import CrossValidation, Score
from trackres_ros.diagnosis.search.explanations import Explanation, Key, Search
from trackres_ros.diagnosis.selection.as_used import AsUsed, inside_ranges
from trackres_ros.diagnosis.selection.confirm import Graded, displaced, far_from_file, may_be_off, on_bounds
from trackres_ros.diagnosis.selection.form_error import FORM_ERROR
from trackres_ros.diagnosis.selection.held_out import SMALL_SHARE, HeldOutLaps, Improvement
from trackres_ros.diagnosis.selection.naming import ALIKE_WITHIN, Step, spurious_gain

MOST_SCORED = 12  # explanations, those with the most evidence
LEAST_OF_SIZE = 0.05  # of the mean square that a term adds: a smaller gain means that it cancels another term
MOST_OF_SIZE = 10.0  # of the mean square of a term that may be nothing: a larger gain comes from other values of the fit
CLASS_SHARE = 0.8


@dataclass(frozen=True, eq=False)
class ScoredExplanation:
    """An explanation with predictive values, and its cross-validated score."""

    explanation: Explanation
    final: Fit
    score: Score

    @property
    def key(self) -> Key:
        """Names of its terms."""
        return self.explanation.key


@dataclass(frozen=True, eq=False)
class Chosen:
    """The chosen explanation and its rivals."""

    explanation: Explanation  # the best one confirmed by cross-validation; empty if none
    final: Fit  # its predictive fit
    graded: Mapping[str, Graded]
    alone: Step  # the round from the base alone
    steps: Mapping[str, Step]  # for each term the round without it, with its class
    last: Step  # the round from all of it
    unconfirmed: tuple[Graded, ...]  # best-fitting terms that cross-validation does not confirm
    shares: Mapping[str, float]  # probability of each name, and of no name, see `Choice._shares`

    def is_named(self, name: str) -> bool:
        """Whether a term has a name: it is in the catalogue, or certainly a slope by place."""
        route = self.term(name).route
        return self.explanation.candidates[name].is_name or (route is not None and route.is_slope)

    def term(self, name: str) -> Term:
        """A term with its properties outside the fit."""
        return self.explanation.terms.get(name) or Term(self.explanation.candidates[name])

    def instead_of(self, name: str) -> str:
        """The name with the most evidence that would gain more than the threshold in place of a term; empty without one."""
        step = self.steps[name]
        names = [c for c in step.candidates if c.is_name and c.name != name and c.counts(step.threshold)]
        return max(names, key=lambda c: c.net_evidence).name if names else ""

    @property
    def routes(self) -> tuple[Route, ...]:
        """The terms by place."""
        return tuple(term.route for term in self.explanation.terms.values() if term.route is not None)


class Choice:
    """Judges the explanations of a search; `refitted` is the base alone with predictive values."""

    def __init__(self, search: Search, refitted: Fit, validation: CrossValidation, laps: HeldOutLaps, use: AsUsed) -> None:
        self._search, self._refitted, self._validation, self._laps, self._use = search, refitted, validation, laps, use
        self._beyond_base = validation.beyond(refitted)
        self._by_file = use.error(None)
        nothing = search.nothing
        self._judged: dict[Key, ScoredExplanation] = {
            nothing.key: ScoredExplanation(nothing, refitted, validation.score(refitted))
        }
        self._graded: dict[tuple[Key, str], Graded] = {}

    @property
    def _nothing(self) -> ScoredExplanation:
        return self._judged[frozenset()]

    def judged(self, explanation: Explanation) -> ScoredExplanation:
        """Fit with predictive values, and score."""
        if explanation.key not in self._judged:
            final = inside_ranges(with_levels(replace(explanation.fit, problem=self._refitted.problem)), self._use)
            final = _off_bounds(final, self._refitted)
            self._judged[explanation.key] = ScoredExplanation(explanation, final, self._validation.score(final))
        return self._judged[explanation.key]

    def graded(self, judged: ScoredExplanation, name: str) -> Graded:
        """Cross-validated grade of a term of an explanation."""
        at = judged.key, name
        if at in self._graded:
            return self._graded[at]
        without = self.judged(self._search.without(judged.explanation, name))
        change = name in judged.explanation.terms and judged.explanation.terms[name].change is not None
        improvement = self._validation.improvement(without.score, judged.score, for_good=change)
        # The part orthogonal to the base should reduce the mean square error.
        adds = judged.final.contribution(name)
        gained = float((without.score.square - judged.score.square).sum())
        cancels = gained < LEAST_OF_SIZE * float((self._beyond_base(adds) ** 2).sum())
        by_others = gained > MOST_OF_SIZE * sum(float((a**2).sum()) for a in adds) and may_be_off(judged.final, name)
        active = next(a for a in judged.final.effects if a.effect.name == name)
        instead = displaced(improvement, judged.final, without.final)
        self._graded[at] = Graded(name, improvement, on_bounds(active), instead, cancels, by_others)
        return self._graded[at]

    def _all_graded(self, judged: ScoredExplanation) -> dict[str, Graded]:
        return {name: self.graded(judged, name) for name in judged.explanation.candidates}

    def _graded_beyond(self, key: Key) -> dict[str, Graded]:
        """The known grades of single terms that are added to an explanation."""
        return {name: graded for (of, name), graded in self._graded.items() if of - {name} == key}

    def _is_confirmed(self, judged: ScoredExplanation) -> bool:
        once = any(term.change is not None for term in judged.explanation.terms.values())
        whole = self._validation.improvement(self._nothing.score, judged.score, for_good=once)
        kept = self._kept(judged)
        # A re-fit may be worse than the file. A term that only corrects that is not missing physics.
        if not whole.confirmed or kept.after > min(kept.before, self._by_file) or far_from_file(judged.final):
            return False
        return all(self.graded(judged, name).confirmed for name in judged.explanation.candidates)

    def _kept(self, judged: ScoredExplanation) -> Improvement:
        return self._laps.improvement_of(self._refitted, judged.final)

    def best(self, keep_suspected: bool = False) -> Chosen:
        """The best explanation; each of its terms is compared with all possible replacements.

        If none is confirmed: with `keep_suspected` the one with the most evidence, else nothing.
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
        scored = [j for j in confirmed if _competes(j.explanation, best.explanation)]
        scored = scored or [self._nothing, *(j for j in counted if self._kept(j).after <= self._by_file)]
        shares = self._shares(scored, best.key)
        first = counted[0] if counted else self._nothing
        doubted = tuple(g for g in self._all_graded(first).values() if not g.confirmed and g.name not in best.key)
        graded = self._all_graded(best)
        if keep_suspected and not best.key:
            best, doubted = first, ()
            graded = {name: replace(g, of_unconfirmed=True) for name, g in self._all_graded(first).items()}
        steps = {name: self._round_of(best, name) for name in best.explanation.candidates}
        last = replace(self._search.expand(best.explanation), graded=self._graded_beyond(best.key))
        alone = self._search.rounds[frozenset()]
        return Chosen(best.explanation, best.final, graded, alone, steps, last, doubted, shares)

    def _counts(self, judged: ScoredExplanation) -> bool:
        """Whether each term gains more than noise would, given the others. A small improvement must also exceed the model's
        own error.

        Terms by place were found on other passes than those learned from, so their places add no further penalty.
        """
        explanation = judged.explanation
        for name, candidate in explanation.candidates.items():
            if explanation.goes_by_place(name):
                continue
            without = self._search.without(explanation, name)
            step = self._search.rounds.get(without.key)
            by_noise, by_model = (step.by_noise, step.threshold) if step else (self._search.by_noise, spurious_gain(without.fit))
            before, after = self.judged(without).score.error.sum(), judged.score.error.sum()
            small = before - after < SMALL_SHARE * before
            least = max(by_noise, by_model if small else 0.0)
            evidence = explanation.evidence - without.evidence
            gain = evidence + candidate.gain - candidate.criterion
            if not (candidate.matters and evidence > 0.0 and gain > least):
                return False
        return True

    def _proposed(self) -> list[Explanation]:
        """Explanations with the most evidence, and all with a term by place."""
        found = sorted((e for e in self._search.known.values() if e.key), key=lambda e: -e.evidence)
        return [e for i, e in enumerate(found) if i < MOST_SCORED or any(map(e.goes_by_place, e.key))]

    def _pick(self, confirmed: Sequence[ScoredExplanation]) -> ScoredExplanation:
        """Choose among those that no other significantly beats: fewest unnamed terms first, then most evidence.

        A named function is accurate to about 10 %: a flexible form added to a true name has more evidence, but predicts
        no better.
        """
        unbeaten = [j for j in confirmed if not any(self._beats(k, j) or self._outdoes(k, j) for k in confirmed)]

        def rank(judged: ScoredExplanation) -> tuple[int, float]:
            return -judged.explanation.without_a_name, judged.explanation.evidence

        return max(unbeaten or confirmed, key=rank, default=self._nothing)

    def _beats(self, one: ScoredExplanation, other: ScoredExplanation) -> bool:
        """Whether one explanation predicts significantly better than another.

        A form that replaces a name needs a larger margin, because a named function is accurate to about 10 %: the mean square
        error must fall by more than the square of a tenth of the names' torque.
        """
        more_forms = one.explanation.without_a_name > other.explanation.without_a_name
        once = any(t.change is not None for name, t in one.explanation.terms.items() if name not in other.key)
        if self._validation.least_gain(other.score, one.score, once) <= (SURE if more_forms else ALIKE_WITHIN):
            return False
        names = [name for name, c in other.explanation.candidates.items() if c.is_name and name not in one.key]
        by_form = sum(float((self._beyond_base(other.final.contribution(name)) ** 2).sum()) for name in names) * FORM_ERROR**2
        return not more_forms or float((other.score.square - one.score.square).sum()) > by_form

    def _outdoes(self, one: ScoredExplanation, other: ScoredExplanation) -> bool:
        """Whether one replaces a name of little effect in the other by a form with more evidence.

        Data do not show the function of a small term, so the name has only its evidence.
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
        """The round without a term, with its class: the term and its equivalent replacements."""
        without = self._search.without(best.explanation, name)
        step = self._search.expand(without)
        chosen = best.explanation.candidates[name]
        alternatives = {c.name: c for c in step.candidates if c.is_name == chosen.is_name and c.counts(step.by_noise)}
        chosen = alternatives.setdefault(name, chosen)
        alike = set(step.separability.alike(name)) if name in step.separability.names else {name}
        near = [c for c in alternatives.values() if c is chosen or c.net_evidence > chosen.net_evidence - 2.0 * ALIKE_WITHIN]
        rivals = {c.name: self._search.known.get(without.key | {c.name}) for c in near if c is not chosen}
        judged = {name: best} | {other: self.judged(e) for other, e in rivals.items() if e is not None}
        judged = {other: j for other, j in judged.items() if j is best or self._is_confirmed(j)}
        shares = dict(zip(judged, self._validation.shares([j.score for j in judged.values()]).tolist(), strict=True))
        worse = {other for other, j in judged.items() if j is not best and self._beats(best, j)}
        as_likely = {c.name for c in near if c.net_evidence > chosen.net_evidence - ALIKE_WITHIN}
        as_good = (as_likely & judged.keys()) - worse
        members = _class_of(name, shares, (alike & shares.keys()) | as_good)
        total = sum(shares[m] for m in members)
        weights = {m: shares[m] / max(total, 1e-12) for m in members}
        rest = [c for c in step.candidates if c.name != name]
        return replace(
            step,
            candidates=(chosen, *rest),
            chosen=chosen,
            members=tuple(members),
            worse=tuple(sorted(worse)),
            weights=weights,
            stability=float(total),
            graded=self._graded_beyond(without.key),
        )

    def _shares(self, judged: Sequence[ScoredExplanation], chosen: Key) -> dict[str, float]:
        """Probability of each name: its parts of the shares of the given explanations. The rest has no name."""
        shares = self._validation.shares([j.score for j in judged])
        found: dict[str, float] = {}
        for one, share in zip(judged, shares.tolist(), strict=True):
            parts = self._parts(one.explanation, chosen)
            rest = 1.0 - max(parts.values(), default=0.0)
            for name, part in (parts | {NONE_OF_THESE: rest} if rest else parts).items():
                found[name] = found.get(name, 0.0) + share * part
        return dict(sorted(found.items(), key=lambda pair: -pair[1]))

    def _parts(self, explanation: Explanation, chosen: Key) -> dict[str, float]:
        """Part of an explanation that each name has; a `chosen` one has all of it.

        A small name may only repair a form that does the work. So a name shares with the forms, by the evidence that the
        explanation loses without each. The level score does not show who does the work: a form alone may predict badly.
        """
        names = {name for name, c in explanation.candidates.items() if c.is_name}
        new = explanation.key - chosen
        if new <= names:
            return dict.fromkeys(names, 1.0)
        lost = {name: max(explanation.evidence - self._search.without(explanation, name).evidence, 0.0) for name in new}
        by_forms = sum(lost[name] for name in new - names)
        return {name: lost[name] / ((lost[name] + by_forms) or 1.0) if name in new else 1.0 for name in names}


def _competes(one: Explanation, chosen: Explanation) -> bool:
    """Whether the share of a confirmed explanation shows a doubt about the chosen one.

    A form bends to the data, so its score says little against a name. With more forms than the chosen one, an explanation
    competes only by another name, and if its evidence is not far below.
    """
    other_name = any(c.is_name for name, c in one.candidates.items() if name not in chosen.key)
    as_likely = one.evidence > chosen.evidence - ALIKE_WITHIN
    return one.without_a_name <= chosen.without_a_name or (other_name and as_likely)


def _off_bounds(final: Fit, refitted: Fit) -> Fit:
    """Re-fit with typical values of shape parameters on a bound, if that costs less than a tenth of the gain of all terms."""
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
    """The smallest set with `CLASS_SHARE` of the probability, including the chosen one, plus those that look alike."""
    members, held = [name], shares[name]
    for other, share in sorted(shares.items(), key=lambda pair: -pair[1]):
        if held >= CLASS_SHARE:
            break
        if other != name:
            members.append(other)
            held += share
    return [*members, *(other for other in sorted(alike) if other not in members)]
