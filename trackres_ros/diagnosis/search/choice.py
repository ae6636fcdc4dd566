# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Chooses among explanations by laps and recordings left out.

A term is confirmed if it surely predicts better, by more than the best of as many terms would by chance, in most recordings in
which it acts. An explanation is confirmed if all its terms are. One that another confirmed explanation surely beats is dropped;
of the rest, the one with the fewest unnamed terms is chosen, then the one with the highest level score.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trackres_ros.diagnosis.empirical.finders import SURE
from trackres_ros.diagnosis.empirical.forms import varies
from trackres_ros.diagnosis.empirical.term import (
    CLOCK,
    FORM,
    ONLY_BETWEEN,
    Round,
    Term,
    active_of,
    displaced_parameters,
    on_bounds,
)
from trackres_ros.diagnosis.findings.wording import NONE_OF_THESE
from trackres_ros.diagnosis.inference.fitting import Fit, fit
from trackres_ros.diagnosis.inference.noise import SHORT_ROOT
from trackres_ros.diagnosis.prepare.session import SLOWEST_MPS
from trackres_ros.diagnosis.search.cross_validation import Score
from trackres_ros.diagnosis.search.explanations import MOST_TERMS, Explanation, Key, Search, names_of
from trackres_ros.diagnosis.search.proposals import TIED
from trackres_ros.diagnosis.search.stability import find_instabilities
from trackres_ros.diagnosis.selection.as_used import ON_BOUND, AsUsed
from trackres_ros.diagnosis.selection.held_out import NO_WORSE, SMALL_SHARE, HeldOutLaps, Improvement
from trackres_ros.diagnosis.selection.locate import against_travel
from trackres_ros.diagnosis.selection.visibility import FORM_ERROR
from trackres_ros.text import figures

MOST_JUDGED = 5  # explanations, those with the highest worth
MOST_NAMED = 2  # explanations by names alone: forms bend to the data
ALIKE_WITHIN = 3.0  # in log-likelihood: a smaller difference decides nothing
MOVES = 0.2  # of the most: with a smaller spread in a recording, a term does not act there
SLOW = 0.1  # of the largest speed
LEAST_OF_SIZE = 0.05  # of the mean square that a term adds: with a smaller fall of the error, it cancels another term
FEWEST_SESSIONS = 6  # with fewer, differences between recordings may have any cause
LEAST_WITHIN = 0.3  # of its spread: with a smaller variation within recordings, a term differs only between them
NEAR = 100.0  # in level score: no rival further behind is as good
CLASS_SHARE = 0.8
NOT_AS_A_WHOLE = "is part of an explanation that laps left out do not confirm as a whole"


@dataclass(frozen=True, eq=False)
class Chosen:
    """The chosen explanation and its rivals."""

    explanation: Explanation  # the best one confirmed by cross-validation, its terms with grade and class; empty if none
    alone: Round  # from the base alone
    last: Round  # from all of it
    unconfirmed: tuple[Term, ...]  # best-fitting terms that cross-validation does not confirm
    shares: Mapping[str, float]  # probability of each name, and of no name, see `Choice._shares`

    @property
    def final(self) -> Fit:
        """Its predictive fit."""
        return self.explanation.fit


class Choice:
    """Judges the explanations of a search; on hold-out laps none may be worse than the base as it was `refitted`."""

    def __init__(self, search: Search, base_fit: Fit, laps: HeldOutLaps, use: AsUsed) -> None:
        self._search, self._validation, self._base_fit, self._laps = search, search.validation, base_fit, laps
        self._beyond_base = self._validation.beyond(search.base_explanation.fit)
        self._use, self._by_file = use, use.error(None)
        self._wide_fits: dict[Key, tuple[Fit, Score]] = {}  # fits with values beyond the ranges of the vehicle file
        self._terms_by_name: dict[tuple[Key, str], Term] = {}
        self._unstable_names = set[str]()  # names whose size changes

    def grade_term(self, explanation: Explanation, name: str) -> Term:
        """A term of an explanation with its cross-validated grade."""
        term, key = explanation.terms[name], (explanation.key, name)
        if key not in self._terms_by_name:
            remainder = self._search.without(explanation, name)
            improvement = self._validation.improvement(remainder.score, explanation.score)
            faults = self._faults(explanation, name, improvement, remainder) if improvement.confirmed else ()
            displaces = displaced_parameters(improvement, explanation.fit, remainder.fit)
            bounds = on_bounds(active_of(explanation.fit, name))
            self._terms_by_name[key] = replace(
                term, improvement=improvement, faults=tuple(faults), on_bounds=bounds, displaces=displaces
            )
        return term.graded_as(self._terms_by_name[key])

    def _faults(self, explanation: Explanation, name: str, improvement: Improvement, remainder: Explanation) -> list[str]:
        """Why laps and recordings left out do not confirm a term that predicts the laps better, in words after its name."""
        term, validation = explanation.terms[name], self._validation
        change = f"from {figures(improvement.before)} to {figures(improvement.after)} Nm on laps left out"
        faults = []
        threshold = ALIKE_WITHIN if term.kind == CLOCK else ALIKE_WITHIN + self._search.cost
        if not improvement.likelihood_bound > 0.0 or improvement.level_gain < threshold:
            faults.append(f"gains no more than the best of many candidates may by chance: {change}")
        if not term.matters:
            faults.append(f"adds only {100.0 * term.share:.1f} % of the torque")
        is_small = improvement.before - improvement.after < SMALL_SHARE * improvement.before
        if is_small and not validation.level_falls(remainder.score, explanation.score):
            faults.append(f"hardly reduces the error: {change}")
        decrease = float((remainder.score.square - explanation.score.square).sum())
        if decrease < LEAST_OF_SIZE * float((self._beyond_base(explanation.fit.contribution(name)) ** 2).sum()):
            faults.append("mostly cancels another term")
        spreads = np.array([float(np.std(x[np.isfinite(x)])) for x in explanation.fit.contribution(name)])
        is_active = (spreads > MOVES * spreads.max()) & (validation.by_recording(np.ones_like(remainder.score.error)) > 0.0)
        if len(spreads) < FEWEST_SESSIONS and self._only_between(explanation, name):
            faults.append(f"{ONLY_BETWEEN} {len(spreads)} recordings, as other things may")
        gains = validation.by_recording(remainder.score.error - explanation.score.error)[is_active]
        if len(gains) > 1 and np.mean(gains > 0.0) <= 0.5:
            faults.append(f"helps in {int((gains > 0.0).sum())} of the {len(gains)} recordings in which it acts")
        error_before, error_after = remainder.score.unseen, explanation.score.unseen
        if is_active.sum() >= 3 and error_after > NO_WORSE * error_before:
            faults.append(f"predicts recordings left out worse: {figures(error_before)} to {figures(error_after)} Nm")
        if term.is_name and not faults:
            faults += self._size_faults(explanation, name)
        if not term.is_name and not faults:
            faults += self._clock_rivals(explanation, name, remainder)
        return faults or self._value_rivals(explanation, remainder)

    def _size_faults(self, explanation: Explanation, name: str) -> list[str]:
        """Faults of a name whose size changes, or that is confirmed only together with a form."""
        faults = find_instabilities(explanation.fit, name, self._validation.scored)
        if faults:
            self._unstable_names.add(name)
            return faults
        by_names = explanation
        for other_name, term in explanation.terms.items():
            by_names = by_names if term.is_name else self._search.without(by_names, other_name)
        if by_names.key == explanation.key:
            return []
        improvement = self._validation.improvement(self._search.without(by_names, name).score, by_names.score)
        return [] if improvement.confirmed else ["passes only beside a form, which bends to the data"]

    def _value_rivals(self, explanation: Explanation, remainder: Explanation) -> list[str]:
        """A fault if base values outside the ranges of the vehicle file predict as well as the term."""
        base_fit = remainder.fit
        values = [(q, base_fit.base_values[q.name]) for q in base_fit.problem.base.parameters]
        if not any(min(value - q.low, q.high - value) <= ON_BOUND * (q.high - q.low) for q, value in values):
            return []
        if remainder.key not in self._wide_fits:
            problem = replace(base_fit.problem, base=self._use.base)
            wide_fit = fit(
                problem, [a.effect for a in base_fit.effects], base_fit.estimates, base_fit.noises, largest_root=SHORT_ROOT
            )
            self._wide_fits[remainder.key] = wide_fit, self._validation.score(wide_fit)
        wide_fit, score = self._wide_fits[remainder.key]
        if self._validation.least_gain(score, explanation.score) > 0.0:
            return []
        names = [q.name for q in wide_fit.problem.base.parameters if q.outside(wide_fit.base_values[q.name])]
        return [f"predicts no better than {', '.join(names)} outside the given range"] if names else []

    @staticmethod
    def _only_between(explanation: Explanation, name: str) -> bool:
        """Whether the torque of a term hardly varies within recordings, but varies between them."""
        problem = explanation.fit.problem
        resistance = against_travel(problem.sessions, explanation.fit.contribution(name))
        slow_mps = min(SLOWEST_MPS, SLOW * max(float(np.nanmax(np.abs(s.speed))) for s in problem.sessions))
        rows = [
            x[m & np.isfinite(x) & (np.abs(s.speed) > slow_mps)]
            for x, m, s in zip(resistance, problem.masks, problem.sessions, strict=True)
        ]
        series = np.concatenate(rows)
        variance_within = sum(len(x) * float(np.var(x)) for x in rows if len(x)) / len(series)
        return varies(series) and variance_within < (LEAST_WITHIN * float(np.std(series))) ** 2

    def _clock_rivals(self, explanation: Explanation, name: str, remainder: Explanation) -> list[str]:
        """A fault if the laps left out do not separate a form over a channel from one over the clock."""
        other_kind = {FORM: CLOCK, CLOCK: FORM}[explanation.terms[name].kind]
        for key, rival in self._search.known.items():
            new_names = key - remainder.key
            if len(key) != len(explanation.key) or not remainder.key <= key or len(new_names) != 1:
                continue
            (other_name,) = new_names
            was_searched = other_name in rival.searched_key or name in explanation.searched_key
            if rival.terms[other_name].kind != other_kind or other_name == name or was_searched:
                continue
            if (
                self._validation.least_gain(rival.score, explanation.score) <= 0.0
                and rival.net_gain > explanation.net_gain - SURE
            ):
                return [f"cannot be separated from {other_name} in these drives"]
        return []

    def _graded_terms(self, explanation: Explanation) -> dict[str, Term]:
        return {name: self.grade_term(explanation, name) for name in explanation.terms}

    def _is_confirmed(self, explanation: Explanation) -> bool:
        improvement = self._validation.improvement(self._search.base_explanation.score, explanation.score)
        hold_out = self._hold_out_improvement(explanation)
        # Terms that pass only together were chosen from many more sets, and cancel each other as they please.
        if explanation.net_gain <= SURE * (len(explanation.key) - 1):
            return False
        # A re-fit may be worse than the file. A term that only corrects that is not missing physics.
        if (
            not improvement.confirmed
            or hold_out.after > min(hold_out.before, self._by_file)
            or not self._laps.predicts(explanation.fit)
        ):
            return False
        return all(self.grade_term(explanation, name).confirmed for name in explanation.terms)

    def _hold_out_improvement(self, explanation: Explanation) -> Improvement:
        return self._laps.improvement_of(self._base_fit, explanation.fit)

    def best(self, keep_suspected: bool = False) -> Chosen:
        """The best explanation; each of its terms is compared with all possible replacements.

        If none is confirmed: with `keep_suspected` the one with the highest worth, else nothing.
        """
        base_explanation = self._search.base_explanation
        for _ in range(2):  # replacements of each term may make a better explanation
            explanations, confirmed_explanations, best_explanation = self._judge()
            # A name whose size changes hides what is there instead.
            if (
                explanations
                and explanations[0].net_gain > best_explanation.net_gain
                and self._search.leave_out(explanations[0].key & self._unstable_names)
            ):
                explanations, confirmed_explanations, best_explanation = self._judge()
            for explanation in (
                best_explanation,
                *(self._search.without(best_explanation, name) for name in names_of(best_explanation)),
            ):
                self._search.expand(explanation)
        first_explanation = explanations[0] if explanations else base_explanation
        doubts = tuple(
            term
            for term in self._graded_terms(first_explanation).values()
            if not term.confirmed and term.name not in best_explanation.key
        )
        graded_terms = self._graded_terms(best_explanation)
        shares = self._shares([e for e in confirmed_explanations if _competes(e, best_explanation)] or [base_explanation])
        if keep_suspected and not best_explanation.key:
            best_explanation, doubts, graded_terms = first_explanation, (), self._graded_terms(first_explanation)
            graded_terms = {name: replace(term, faults=(NOT_AS_A_WHOLE, *term.faults)) for name, term in graded_terms.items()}
        terms = {name: self._classify(best_explanation, term) for name, term in graded_terms.items()}
        return Chosen(
            replace(best_explanation, terms=terms), self._round(base_explanation), self._round(best_explanation), doubts, shares
        )

    def _judge(self) -> tuple[list[Explanation], list[Explanation], Explanation]:
        """The judged explanations, the confirmed ones of them, and the best one of these."""
        explanations = self._judged_explanations()
        confirmed_explanations = [e for e in explanations if self._is_confirmed(e)]
        return explanations, confirmed_explanations, self._select(confirmed_explanations)

    def _judged_explanations(self) -> list[Explanation]:
        """The explanations with the highest worth and all with a term by place, and each without some of its terms."""
        known_explanations = self._search.known
        candidates = (
            e
            for e in known_explanations.values()
            if 0 < len(e.key) <= MOST_TERMS and e.net_gain > 0.0 and not self._search.has_left_out(e)
        )
        ranking = sorted(candidates, key=lambda e: -e.net_gain)
        by_names = [e for e in ranking if not e.without_a_name][:MOST_NAMED]
        queue = [e for i, e in enumerate(ranking) if i < MOST_JUDGED or e in by_names or e.by_place is not None]
        explanations: dict[Key, Explanation] = {}
        while queue:
            explanation = queue.pop(0)
            if explanation.key and explanation.key not in explanations:
                explanations[explanation.key] = self._search.polish(explanation)
                queue += [self._search.without(explanation, name) for name in explanation.terms]
        return sorted(explanations.values(), key=lambda e: -e.net_gain)

    def _select(self, confirmed_explanations: Sequence[Explanation]) -> Explanation:
        """Choose among those that no other significantly beats: fewest unnamed terms first, then the highest worth.

        A named function is accurate to about 10 %: a flexible form added to a true name has a higher score, but predicts
        no better.
        """
        contenders = [e for e in confirmed_explanations if not any(self._beats(rival, e) for rival in confirmed_explanations)]

        def rank(explanation: Explanation) -> tuple[int, float]:
            return -explanation.without_a_name, explanation.net_gain

        return max(contenders or confirmed_explanations, key=rank, default=self._search.base_explanation)

    def _beats(self, rival: Explanation, explanation: Explanation) -> bool:
        """Whether a rival predicts significantly better than an explanation.

        A further form, or one in place of a name, needs a larger margin, because a function is accurate to about 10 %: the
        mean square error must fall by more than the square of a tenth of the others' torque. A map learned by place has no form.
        """
        more_forms = rival.without_a_name > explanation.without_a_name
        if self._validation.least_gain(explanation.score, rival.score) <= (SURE if more_forms else ALIKE_WITHIN):
            return False
        torques = [
            self._beyond_base(explanation.fit.contribution(name))
            for name, term in explanation.terms.items()
            if not term.is_by_place
        ]
        by_form = sum(float((torque**2).sum()) for torque in torques) * FORM_ERROR**2
        return not more_forms or float((explanation.score.square - rival.score.square).sum()) > by_form

    def _round(self, explanation: Explanation) -> Round:
        """The round from an explanation, with the fitted candidates and their grades, where laps left out have judged them."""
        proposals = self._search.rounds.get(explanation.key) or self._search.rounds[frozenset()]
        terms_added = []
        for key, child in self._search.known.items():
            if len(key - explanation.key) == 1 and explanation.key < key:
                (name,) = key - explanation.key
                term = replace(child.terms[name], level=self._validation.gain(explanation.score, child.score))
                terms_added.append(term.graded_as(self._terms_by_name.get((key, name), term)))
        terms_by_level = tuple(sorted(terms_added, key=lambda term: -term.level))
        return Round(explanation.fit, proposals.separability, terms_by_level, self._search.cost)

    def _classify(self, explanation: Explanation, term: Term) -> Term:
        """A term with the round without it and its class: the term and the rivals of its kind that it does not surely beat."""
        remainder, name = self._search.without(explanation, term.name), term.name
        search_round = self._round(remainder)
        level = self._validation.gain(remainder.score, explanation.score)
        contenders = [c for c in search_round.candidates if c.is_name == term.is_name and c.level > level - NEAR]
        rivals = {c.name: self._search.polish(self._search.known[remainder.key | {c.name}]) for c in contenders}
        rivals = {
            rival_name: e for rival_name, e in rivals.items() if e.net_gain > 0.0 and self._is_rival(e, rival_name, name)
        } | {name: explanation}
        worse_names = {rival_name for rival_name, e in rivals.items() if e is not explanation and self._beats(explanation, e)}
        shares = dict(zip(rivals, self._validation.shares([e.score for e in rivals.values()]).tolist(), strict=True))
        separability = search_round.separability
        similar_names = set(separability.alike(name)) & rivals.keys() if name in separability.names else {name}
        members = _class_of(name, shares, (rivals.keys() - worse_names) | similar_names)
        total = sum(shares[m] for m in members)
        return replace(
            term,
            level=level,
            rivals=replace(search_round, candidates=tuple(c for c in search_round.candidates if c.name != name)),
            members=tuple(members),
            weights={m: shares[m] / max(total, 1e-12) for m in members},
            stability=float(total),
            worse=tuple(sorted(worse_names)),
        )

    def _is_rival(self, explanation: Explanation, name: str, chosen_name: str) -> bool:
        """Whether a replacement of a chosen term would be confirmed itself, or these drives hardly separate the two."""
        return {name, chosen_name} <= set(TIED) or (
            self.grade_term(explanation, name).confirmed and self._is_confirmed(explanation)
        )

    def _shares(self, explanations: Sequence[Explanation]) -> dict[str, float]:
        """Probability of each name, and of no name: shares of the explanations that have it."""
        shares = self._validation.shares([e.score for e in explanations])
        probabilities: dict[str, float] = {}
        for explanation, share in zip(explanations, shares.tolist(), strict=True):
            for name in names_of(explanation) or [NONE_OF_THESE]:
                probabilities[name] = probabilities.get(name, 0.0) + share
        return dict(sorted(probabilities.items(), key=lambda pair: -pair[1]))


def _competes(rival: Explanation, explanation: Explanation) -> bool:
    """Whether a confirmed rival casts doubt on the chosen explanation: not with more forms, which bend."""
    return rival.without_a_name <= explanation.without_a_name


def _class_of(name: str, shares: Mapping[str, float], similar_names: Collection[str]) -> list[str]:
    """The smallest set with `CLASS_SHARE` of the probability, including the chosen one, plus those that it does not beat."""
    members, total = [name], shares[name]
    for other_name, share in sorted(shares.items(), key=lambda pair: -pair[1]):
        if total >= CLASS_SHARE:
            break
        if other_name != name:
            members.append(other_name)
            total += share
    return [*members, *(other_name for other_name in sorted(similar_names) if other_name not in members)]
