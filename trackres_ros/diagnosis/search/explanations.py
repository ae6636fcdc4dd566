# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Searches for whole explanations: sets of names, forms and terms by clock or place, all in one pool.

It starts from the base alone. In each turn the best few are expanded by the proposals for their residual, and by removing one
term. Sets that no lap confirms are expanded too: two effects may pass only together. Laps left out score every set.

`LinearSets` scores sets of proposals to first order about one fit. Each set then costs one small system of equations instead of a
fit, so that pairs which only help together are found too.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.empirical.finders import find_terms
from trackres_ros.diagnosis.empirical.routes import SLOPES, Roads
from trackres_ros.diagnosis.empirical.term import Route, Term, share, term_of_fit
from trackres_ros.diagnosis.inference.fitting import Fit, first_look, fit, solve_bounded, valid_rows
from trackres_ros.diagnosis.inference.noise import SHORT_ROOT
from trackres_ros.diagnosis.prepare.session import Array
from trackres_ros.diagnosis.search.cross_validation import CrossValidation, Score
from trackres_ros.diagnosis.search.proposals import Proposals, Proposer, same_variable
from trackres_ros.diagnosis.selection.level_errors import PRIOR, RIDGE
from trackres_ros.diagnosis.selection.visibility import Proposal, amplitude_bounds, amplitude_spans, base_columns, is_name
from trackres_ros.effects.effect import Effect
from trackres_ros.progress import counted

Names = tuple[str, ...]

EXPANDED_SETS = 8  # best sets of each size that get a further term
FEWEST_RECORDINGS = 3  # to leave whole ones out


class LinearSets:
    """Errors of sets of terms on rows left out.

    Parameters
    ----------
    fit, own
        The fit without the terms, and the derivatives of its own parameters, shape (n, parameters).
    terms
        The proposal of each term.
    lap, recording
        Number of the fold and of the recording of each row, shape (n,); a row of fold -1 is never left out.
    """

    def __init__(
        self, fit: Fit, own_columns: Array, terms: Mapping[str, Proposal], lap: NDArray[np.int64], recording: NDArray[np.int64]
    ) -> None:
        scale, std, nominal, low, high = (
            np.array([getattr(f, name) for f in fit.free]) for name in ("scale", "std", "nominal", "low", "high")
        )
        self._effects = {name: term.effect for name, term in terms.items()}
        self._own_count, count = len(scale), len(scale)
        self._indices: dict[str, NDArray[np.int64]] = {}
        for name, term in terms.items():
            self._indices[name] = np.arange(count, count + term.columns.shape[1])
            count += term.columns.shape[1]
        is_used = np.isfinite(weights := fit.weights)
        root = np.sqrt(weights[is_used])
        x, y = np.empty((len(root), count)), valid_rows(fit.white) * root
        # Term by term: together they would be the largest arrays of a diagnosis.
        term_columns = ((self._indices[name], term.columns, amplitude_spans(term.effect)) for name, term in terms.items())
        for indices, derivatives, sizes in [(np.arange(self._own_count), own_columns, scale), *term_columns]:
            white = fit.problem.white(fit.problem.split(derivatives * sizes), fit.noises)
            x[:, indices] = valid_rows(white) * root[:, np.newaxis]
        prior = np.full(count, PRIOR)
        prior[: self._own_count] = scale / std
        self._prior = np.diag(prior**2 + RIDGE * len(y))
        self._pull = np.zeros(count)
        self._pull[: self._own_count] = scale / std * np.nan_to_num((nominal - fit.point) / std)
        bounds = [((low - fit.point) / scale, (high - fit.point) / scale), *(amplitude_bounds(e) for e in self._effects.values())]
        self._lower_bounds, self._upper_bounds = (np.concatenate(sides) for sides in zip(*bounds, strict=True))
        pairs, group = np.unique(np.stack([lap[is_used], recording[is_used]]), axis=1, return_inverse=True)
        order = np.argsort(group.ravel(), kind="stable")
        parts = np.split(order, np.cumsum(np.bincount(group.ravel()))[:-1])
        self._information = np.stack([x[rows].T @ x[rows] for rows in parts])
        self._right_sides = np.stack([x[rows].T @ y[rows] for rows in parts])
        self._square = np.array([y[rows] @ y[rows] for rows in parts])
        self._rows = np.array([len(rows) for rows in parts])
        laps, recordings = np.unique(pairs[0][pairs[0] >= 0]), np.unique(pairs[1][pairs[0] >= 0])
        self._folds = [np.stack([pairs[0] == number for number in laps])]
        if len(recordings) >= FEWEST_RECORDINGS:
            self._folds.append(np.stack([(pairs[1] == number) & (pairs[0] >= 0) for number in recordings]))
        self._base_error = self._errors(())

    def gain(self, names: Collection[str]) -> float:
        """Gain in log-likelihood on the rows left out, less one for each amplitude beyond the first of a term."""
        extra_count = sum(len(self._indices[name]) - 1 for name in names)
        pairs = zip(self._base_error, self._errors(names), self._folds, strict=True)
        return (
            float(
                np.mean([0.5 * self._left_out(f) * np.log(error_before / error_after) for error_before, error_after, f in pairs])
            )
            - extra_count
        )

    def _left_out(self, folds: NDArray[np.bool_]) -> int:
        return int((folds @ self._rows).sum())

    def _errors(self, names: Collection[str]) -> list[float]:
        """Sum of squares of the rows left out, by laps and by recordings."""
        indices = np.concatenate([np.arange(self._own_count), *(self._indices[name] for name in names)]).astype(np.int64)
        square = np.ix_(indices, indices)
        information, right_sides = self._information[:, indices[:, np.newaxis], indices], self._right_sides[:, indices]
        prior, pull = self._prior[square], self._pull[indices]
        information_sum, all_right = information.sum(axis=0) + prior, right_sides.sum(axis=0) + pull
        values, is_free = solve_bounded(information_sum, all_right, self._lower_bounds[indices], self._upper_bounds[indices])
        bound_values = np.where(is_free, 0.0, values)
        errors = []
        for folds in self._folds:
            own_information, own_right = np.tensordot(folds, information, 1), folds @ right_sides
            rest = information_sum - own_information
            fold_values = np.tile(bound_values, (len(folds), 1))
            target = all_right - own_right - rest @ bound_values
            fold_values[:, is_free] = np.linalg.solve(rest[:, is_free][:, :, is_free], target[:, is_free, np.newaxis])[..., 0]
            fold_values = np.clip(fold_values, self._lower_bounds[indices], self._upper_bounds[indices])
            product = (fold_values[:, np.newaxis] @ own_information)[:, 0]
            errors.append(
                float(
                    (
                        folds @ self._square + (product * fold_values).sum(axis=1) - 2.0 * (fold_values * own_right).sum(axis=1)
                    ).sum()
                )
            )
        return errors

    def _is_addable(self, name: str, names: Names) -> bool:
        return name not in names and not any(
            same_variable(self._effects[name], self._effects[other_name]) for other_name in names
        )

    def best(self, pool: Collection[str], count: int, most_terms: int, cost: float) -> list[Names]:
        """The `count` sets of each size of some terms with the highest gain less a `cost` for each term, best first."""
        beam: list[Names] = [()]
        gains: dict[Names, float] = {}
        chosen_sets: list[Names] = []
        for size in range(1, most_terms + 1):
            pairs = ((names, name) for names in beam for name in pool if self._is_addable(name, names))
            sets = dict.fromkeys(tuple(sorted((*names, name))) for names, name in pairs)  # in an order of its own
            gains |= {names: self.gain(names) - cost * size for names in sets}
            beam = sorted(sets, key=lambda names: -gains[names])[:EXPANDED_SETS]
            chosen_sets += beam[:count]
        return sorted(chosen_sets, key=lambda names: -gains[names])


Key = frozenset[str]

EXPANDED = 2  # best explanations
SETS = 2  # of each number of terms, the best to first order: of all terms, and of names
MOST_TERMS = 3


@dataclass(frozen=True, eq=False)
class Explanation:
    """A set of terms, fitted together with predictive values, and scored on the laps left out."""

    fit: Fit
    score: Score
    net_gain: float = 0.0  # level score over the base alone, less the logarithm of the number of proposals for each one of them
    terms: Mapping[str, Term] = field(default_factory=dict)  # as added, by name
    settled: bool = False  # whether fit and noise were alternated until they settled

    @property
    def key(self) -> Key:
        """Names of its terms."""
        return frozenset(self.terms)

    @property
    def without_a_name(self) -> int:
        """Number of its unnamed terms; one of the clock counts twice, as a recorded channel goes before the clock."""
        return sum(term.kind for term in self.terms.values())

    @property
    def searched_key(self) -> Key:
        """Names of its terms by clock or place that were searched in the residual, not proposed."""
        return frozenset(name for name, term in self.terms.items() if term.pattern is not None)

    @property
    def by_place(self) -> Term | None:
        """Its term that was learned for each place of a route."""
        return next((term for term in self.terms.values() if isinstance(term.pattern, Route)), None)


class Search:
    """All explored explanations of the residual of a fitted base, by named `effects`, forms, and terms by place on matched
    `roads`, of some `kinds`.
    """

    def __init__(
        self,
        base: Fit,
        effects: Mapping[str, Effect],
        roads: Roads | None,
        kinds: Collection[str],
        validation: CrossValidation,
        on_stage: Callable[[str], None],
    ) -> None:
        self._roads, self._kinds, self.validation, self._on_stage = roads, kinds, validation, on_stage
        self._proposer = Proposer(base, effects, validation.scored)
        self.base_explanation = Explanation(base, validation.score(base), settled=True)
        self.known: dict[Key, Explanation] = {self.base_explanation.key: self.base_explanation}
        self.rounds: dict[Key, Proposals] = {}
        self._left_out = set[str]()

    def run(self) -> None:
        """Explore the promising explanations: names and forms first, then the clock for what they leave."""
        self._combine(self.expand(self.base_explanation))
        for explanation in {e.key: e for e in (self._best_known(), self.base_explanation)}.values():
            self._follow_clock(explanation)
        if self._best_known().searched_key:  # a slope by place and spells may pass only together
            self._follow_clock(self._best_known())
        for explanation in self._best_unexpanded(1):
            self._swap(self.polish(explanation))

    def leave_out(self, names: Collection[str]) -> bool:
        """Go on without some names; whether any of them was not left out before."""
        new_names = set(names) - self._left_out
        if new_names:
            self._left_out |= new_names
            proposals = self.rounds[self.base_explanation.key]
            self._add_best(self.base_explanation, proposals)
            self._combine(proposals)
        return bool(new_names)

    def has_left_out(self, explanation: Explanation) -> bool:
        """Whether the search goes on without one of its terms."""
        return not explanation.key.isdisjoint(self._left_out)

    def _combine(self, proposals: Proposals) -> None:
        self._add_sets(proposals)
        for explanation in self._best_unexpanded(EXPANDED):
            self._swap(self.polish(explanation))

    def _add_sets(self, proposals: Proposals) -> None:
        """Fit the sets of proposals that predict laps and recordings left out best to first order."""
        base = self.base_explanation.fit
        # An error of the sensors is free in the base already.
        excluded_names = self._left_out | {a.effect.name for a in base.instrument}
        terms = {name: p for name, p in proposals.by_name.items() if name not in excluded_names}
        sets = LinearSets(base, proposals.own, terms, *self.validation.rows(base.problem))
        own_columns = _by_parameter(base, proposals.own)
        catalogue = [name for name in terms if is_name(proposals.by_name[name].effect)]
        best_sets = [names for pool in (terms, catalogue) for names in sets.best(pool, SETS, MOST_TERMS, self.cost)]
        for names in dict.fromkeys(best_sets):
            chosen_proposals = [proposals.by_name[name] for name in names]
            known_columns, start = dict(own_columns), dict[tuple[str, str], float]()
            for p in chosen_proposals:
                known_columns |= p.derivatives
                start |= {(p.effect.name, q): value for q, value in p.start.items()}
            result, columns = first_look(base, [p.effect for p in chosen_proposals], known_columns, start, SHORT_ROOT)
            new_terms = {p.effect.name: term_of_fit(base, result, p.effect, 0.0, p.kept, p.d_prime) for p in chosen_proposals}
            self._keep(self._explanation(result, self.validation.score(result, columns), new_terms))

    def _swap(self, explanation: Explanation) -> None:
        """Expand an explanation, and look at what it is without each of its terms."""
        self.expand(explanation)
        for name in explanation.terms if len(explanation.key) > 1 else ():
            self.without(explanation, name)

    def polish(self, explanation: Explanation) -> Explanation:
        """The same explanation, with its fit settled and scored again."""
        known_explanation = self.known[explanation.key]
        if known_explanation.settled:
            return known_explanation
        result = self._refit(known_explanation.fit, [a.effect for a in known_explanation.fit.effects], {})
        terms = {name: replace(term, share=share(result, name)) for name, term in known_explanation.terms.items()}
        explanation_refined = self._explanation(result, self.validation.score(result), terms)
        self.known[known_explanation.key] = replace(explanation_refined, settled=True)
        return self.known[known_explanation.key]

    def _explanation(self, result: Fit, score: Score, terms: Mapping[str, Term]) -> Explanation:
        new_explanation = Explanation(result, score, terms=terms)
        net_gain = self.validation.gain(self.base_explanation.score, score) - self.cost * len(
            new_explanation.key - new_explanation.searched_key
        )
        return replace(new_explanation, net_gain=net_gain)

    def expand(self, explanation: Explanation) -> Proposals:
        """Add each proposal for the remaining residual, one at a time."""
        if explanation.key in self.rounds:
            return self.rounds[explanation.key]
        explanation = self.polish(explanation)
        self._on_stage(f"missing physics besides {', '.join(explanation.fit.effect_names) or 'the base alone'}")
        proposals = self.rounds[explanation.key] = self._proposer.proposals(explanation.fit)
        self._add_best(explanation, proposals)
        return proposals

    def _add_best(self, explanation: Explanation, proposals: Proposals) -> None:
        current, by_place = explanation.fit, explanation.by_place is not None
        best_proposals = [p for p in proposals.best(self._left_out) if not (by_place and p.effect.name in SLOPES)]
        own_columns, effects = _by_parameter(current, proposals.own), [a.effect for a in current.effects]
        for p in counted(best_proposals, "fits of candidate effects", len(best_proposals)):
            start = {(p.effect.name, q): value for q, value in p.start.items()}
            fit_of_proposal, columns = first_look(current, [*effects, p.effect], own_columns | p.derivatives, start, SHORT_ROOT)
            self._add(explanation, term_of_fit(current, fit_of_proposal, p.effect, 0.0, p.kept, p.d_prime), columns)

    @property
    def cost(self) -> float:
        """Logarithm of the number of terms from which each was chosen."""
        return math.log(max(len(self.expand(self.base_explanation).by_name), 1))

    def _follow_clock(self, explanation: Explanation) -> None:
        """Add each term that follows the clock or a place."""
        if len(explanation.key) >= MOST_TERMS:
            return
        current = explanation.fit
        effects = [a.effect for a in current.effects]
        test_fit = fit(current.problem, effects, current.estimates)  # with the noise that best whitens: a drift is no spell
        for term in find_terms(test_fit, self._roads, self._kinds, explanation.by_place, waves=not explanation.key):
            fit_of_clock = self._refit(current, [*effects, term.effect], term.fit.estimates)
            self._add(explanation, replace(term, fit=fit_of_clock))

    def _refit(self, current: Fit, effects: list[Effect], start: Mapping[tuple[str, str], float]) -> Fit:
        """A fit with predictive values, its base inside the ranges of the vehicle file as that of the base alone."""
        return fit(
            self.base_explanation.fit.problem, effects, {**current.estimates, **start}, current.noises, largest_root=SHORT_ROOT
        )

    def _add(self, explanation: Explanation, term: Term, columns: Array | None = None) -> None:
        score = self.validation.score(term.fit, columns)
        term = replace(term, level=self.validation.gain(explanation.score, score))
        self._keep(self._explanation(term.fit, score, {**explanation.terms, term.name: term}))

    def _keep(self, explanation: Explanation) -> None:
        """Keep the better of two explanations by the same names. A slope by place has the name of a constant one."""
        previous_explanation = self.known.get(explanation.key)
        if previous_explanation is None or (
            explanation.net_gain > previous_explanation.net_gain
            and not (previous_explanation.settled and previous_explanation.searched_key == explanation.searched_key)
        ):
            self.known[explanation.key] = explanation
            self.rounds.pop(explanation.key, None)

    def without(self, explanation: Explanation, name: str) -> Explanation:
        """An explanation without one of its terms."""
        key = explanation.key - {name}
        if key not in self.known:
            effects = [a.effect for a in explanation.fit.effects if a.effect.name != name]
            known_columns = _by_parameter(explanation.fit, base_columns(explanation.fit))
            result, columns = first_look(explanation.fit, effects, known_columns, {}, SHORT_ROOT)
            terms = {other_name: term for other_name, term in explanation.terms.items() if other_name != name}
            self.known[key] = self._explanation(result, self.validation.score(result, columns), terms)
        return self.known[key]

    def _best_known(self) -> Explanation:
        return max(self.known.values(), key=lambda e: e.net_gain)

    def _best_unexpanded(self, count: int) -> list[Explanation]:
        """The best explanations with room for a term; not those that are worth less than the base alone."""
        candidates = (e for key, e in self.known.items() if key not in self.rounds and not self.has_left_out(e))
        room = [e for e in candidates if 0 < len(e.key) < MOST_TERMS and e.net_gain > 0.0]
        return sorted(room, key=lambda e: -e.net_gain)[:count]


def _by_parameter(result: Fit, columns: Array) -> dict[tuple[str, str], Array]:
    return dict(zip([f.key for f in result.free], columns.T, strict=True))


def names_of(explanation: Explanation) -> list[str]:
    """Its terms of the catalogue."""
    return [name for name, term in explanation.terms.items() if term.is_name]
