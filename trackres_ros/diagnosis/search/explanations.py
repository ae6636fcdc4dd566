# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Searches for whole explanations: sets of names, forms and terms by clock or place, all in one pool.

It starts from the base alone. In each turn the best few are expanded by everything in the pool, and by removing one
term. Duplicate sets merge. The first order is linear algebra on columns simulated once; only promising sets are fitted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from trackres_ros.diagnosis.empirical.candidates import candidates
from trackres_ros.diagnosis.empirical.finders import Term, find_terms
from trackres_ros.diagnosis.empirical.routes import SLOPES, Roads
from trackres_ros.diagnosis.inference.fitting import Fit, fit
from trackres_ros.diagnosis.selection.naming import Candidate, Pool, Step, one_round
from trackres_ros.diagnosis.selection.screening import PLAINLY
from trackres_ros.diagnosis.selection.visibility import EffectColumns
from trackres_ros.effects.effect import Effect

Key = frozenset[str]

EXPANDED = 2  # best explanations in each turn
MOST_TERMS = 3
LEAST_EXPANDED = 0.4  # of the best evidence: weaker explanations are not expanded


@dataclass(frozen=True, eq=False)
class Explanation:
    """A set of terms, fitted together."""

    fit: Fit
    evidence: float = 0.0  # log-evidence over the base alone, less the cost of the terms beyond that of their parameters
    candidates: Mapping[str, Candidate] = field(default_factory=dict)  # each term, as added
    terms: Mapping[str, Term] = field(default_factory=dict)  # properties outside the fit of terms by clock or place

    @property
    def key(self) -> Key:
        """Names of its terms."""
        return frozenset(self.candidates)

    @property
    def without_a_name(self) -> int:
        """Number of its unnamed terms."""
        return sum(not c.is_name for c in self.candidates.values())

    def goes_by_place(self, name: str) -> bool:
        """Whether one of its terms was learned for each place of a route."""
        return name in self.terms and self.terms[name].route is not None


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
        replicates: int,
        rng: np.random.Generator,
        on_stage: Callable[[str], None],
    ) -> None:
        self._roads, self._kinds, self._replicates, self._rng, self._on_stage = roads, kinds, replicates, rng, on_stage
        self._pool = Pool({**effects, **candidates(base)}, EffectColumns(base))
        self.nothing = Explanation(base)
        self.known: dict[Key, Explanation] = {self.nothing.key: self.nothing}
        self.rounds: dict[Key, Step] = {}

    @property
    def by_noise(self) -> float:
        """Gain that the best candidate reaches over the base by noise alone with 5 % probability."""
        return math.inf if self._pool.by_noise is None else self._pool.by_noise

    def run(self) -> None:
        """Explore all promising explanations."""
        frontier = [self.nothing]
        for _ in range(MOST_TERMS):
            for explanation in frontier:
                self.expand(explanation)
            frontier = self._best_unexpanded()
            for explanation in frontier:
                for name in explanation.key if len(explanation.key) > 1 else ():
                    self.without(explanation, name)
            frontier = self._best_unexpanded()

    def expand(self, explanation: Explanation) -> Step:
        """Add each candidate for the remaining residual, one at a time."""
        if explanation.key in self.rounds:
            return self.rounds[explanation.key]
        self._on_stage(f"missing physics besides {', '.join(explanation.fit.effect_names) or 'the base alone'}")
        current = explanation.fit
        pool = self._pool
        if any(map(explanation.goes_by_place, explanation.key)):
            pool = replace(pool, effects={key: e for key, e in pool.effects.items() if e.name not in SLOPES})
        gained = current.log_likelihood - self.nothing.fit.log_likelihood
        if not explanation.without_a_name and gained > PLAINLY * self.by_noise:
            # What its names explain was in the noise drawn from the base alone. A form may leave some of its cause there.
            pool = replace(pool, by_noise=None)
        step = one_round(current, pool, self._replicates, self._rng)
        if self._pool.by_noise is None:
            self._pool = replace(self._pool, by_noise=step.by_noise)
        self.rounds[explanation.key] = step
        routes = {name: term.route for name, term in explanation.terms.items() if term.route is not None}
        found: Iterable[tuple[Candidate, Term | None]] = [
            *((c, None) for c in step.candidates if c.counts(step.by_noise)),
            *((t.candidate, t) for t in find_terms(current, self._roads, self._kinds, routes, waves=not explanation.key)),
        ]
        for candidate, term in found:
            terms = explanation.terms if term is None else {**explanation.terms, candidate.name: term}
            added = {**explanation.candidates, candidate.name: candidate}
            self._keep(Explanation(candidate.fit, explanation.evidence + candidate.net_evidence, added, terms))
        return step

    def _keep(self, explanation: Explanation) -> None:
        same = self.known.get(explanation.key)
        if same is None or explanation.evidence > same.evidence:
            self.known[explanation.key] = explanation

    def without(self, explanation: Explanation, name: str) -> Explanation:
        """An explanation without one of its terms."""
        key = explanation.key - {name}
        if key not in self.known:
            current = explanation.fit
            left = [a.effect for a in current.effects if a.effect.name != name]
            kept = {n: c for n, c in explanation.candidates.items() if n != name}
            found = fit(current.problem, left, current.at, current.noises)
            cost = sum(c.form_error_gain for c in kept.values())
            evidence = found.log_evidence - self.nothing.fit.log_evidence - cost
            terms = {n: t for n, t in explanation.terms.items() if n != name}
            self._keep(Explanation(found, evidence, kept, terms))
        return self.known[key]

    def likelier_base(self) -> Fit | None:
        """The base alone, from the base values of the explanation with the most evidence, if that is likelier; else None.

        A fit ends in the nearest optimum, and a term may only lead out of a worse one. Its gain is then no evidence for it. The
        base is likelier if it gains more than the best candidate does by noise.
        """
        nothing, best = self.nothing.fit, max(self.known.values(), key=lambda e: e.evidence)
        if not best.key:
            return None
        again = fit(nothing.problem, (), best.fit.at, best.fit.noises, rounds=1)
        return again if again.log_likelihood > nothing.log_likelihood + self.by_noise else None

    def _best_unexpanded(self) -> list[Explanation]:
        best = max(e.evidence for e in self.known.values())
        room = [
            e
            for key, e in self.known.items()
            if key not in self.rounds and len(key) < MOST_TERMS and e.evidence > LEAST_EXPANDED * best
        ]
        return sorted(room, key=lambda e: -e.evidence)[:EXPANDED]
