# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Terms without a name for what a fit leaves, one after the other, each only if it gains more than noise and the model's own
error would; and names that they make needless are taken away.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.base.watched import WATCHED, Watched
from trackres_ros.diagnosis.described.candidates import candidates, finer
from trackres_ros.diagnosis.described.level_changes import LevelChange, find_change, piece_s, sharpened
from trackres_ros.diagnosis.described.payload import Payload, find_payload
from trackres_ros.diagnosis.described.places import Place, find_place
from trackres_ros.diagnosis.described.routes import Roads, Route, find_route
from trackres_ros.diagnosis.described.spells import (
    Blocks,
    Chain,
    beyond_wander,
    blocks,
    find_chain,
    find_wander,
    is_spells,
    path_cost,
    there_given,
)
from trackres_ros.diagnosis.described.terms import Described, of_drift
from trackres_ros.diagnosis.described.waves import Wave, find_wave
from trackres_ros.diagnosis.inference.fitting import Fit, fit
from trackres_ros.diagnosis.selection.naming import ALIKE_WITHIN, Candidate, Step, compared, one_round, rms, spurious_gain
from trackres_ros.diagnosis.writing.kept import BY_PLACE
from trackres_ros.effects.effect import Effect
from trackres_ros.effects.learned import Curve, Learned
from trackres_ros.estimator.disturbance import BLOCK_S, later_there, seen_there
from trackres_ros.route.learned import TORQUE

Array = NDArray[np.float64]
Search = Callable[[Fit, Sequence[Array]], "Term | None"]
"""Looks for a term that follows the clock alone in the residual of the torque of each session [Nm], beside a fit."""

MOST_DESCRIBED = 2
SURE = 10.0  # in log-likelihood: spells over what only wanders, what wanders over what does not, a term over none
LEAST_FOLLOWED = 8.0  # in log-likelihood, to first order: what gains less does not pay for its knots
UNDECIDED = 3  # names that explain as much: none of them is known to be there
FEWEST_SPELLS = 3
FEWEST_REPLICATES = 19
SLOWEST_WANDER_S = 60.0  # what wanders faster is noise that the autoregression knows
LEAST_WANDER = 0.01  # of the torque
PHASE_COST = 1.0  # in log-likelihood: what a phase, which is fitted to each stretch, and its size gain by noise
SPELLS, WAVE, LEVEL_CHANGE, PLACE, PAYLOAD = "spells", "wave", "level_change", "place", "payload"
LIKELY = 0.5  # that it is there


@dataclass(frozen=True, eq=False)
class Term:
    """A term that was found: how it is said, and the fit with it beside the one without; and the round in which it was tied
    with others, None for what follows the clock alone.
    """

    candidate: Candidate
    tied: Step | None = None
    chain: Chain | None = None
    wave: Wave | None = None
    change: LevelChange | None = None
    place: Place | None = None
    payload: Payload | None = None
    route: Route | None = None


@dataclass(frozen=True, eq=False)
class Description:
    """A fit with all terms, the rounds of names that are left, the terms by name, and whether one of them stands instead of a
    name.
    """

    fit: Fit
    steps: list[Step]
    terms: Mapping[str, Term]
    instead: bool = False


def describe(
    best: Fit,
    steps: Sequence[Step],
    effects: Mapping[str, Effect],
    replicates: int,
    rng: np.random.Generator,
    on_stage: Callable[[str], None],
    roads: Roads | None = None,
    route: Route | None = None,
    kinds: Collection[str] = (),
    load: Term | None = None,
    undecided_may_go: bool = True,
) -> Description:
    """Look for terms without a name in what a fit leaves.

    Parameters
    ----------
    best, steps
        The fit with the effects that were named, and the rounds in which they were.
    effects
        The catalogue: what was hidden behind a term is looked for once more beside it.
    replicates
        Draws for the threshold of each round.
    roads, route, kinds
        Where positions say that the sessions are, what goes by place in the fit already, and what may.
    load
        A mass by stretch beside the names, where that was looked for already.
    undecided_may_go
        Whether a term may stand instead of names between which nothing decides.
    """
    current, kept, terms = best, list(steps), dict[str, Term]()
    if load is not None:
        current, terms[PAYLOAD] = load.candidate.fit, load
    if route is not None and not route.told:
        terms[route.candidate.name] = Term(route.candidate, route=route)
    replaced = False
    for step in [s for s in steps if undecided_may_go and s.chosen is not None and len(s.members) >= UNDECIDED]:
        on_stage(f"what has no name, instead of {', '.join(step.members)}")
        instead = _instead(step, current, replicates, rng)
        if instead is not None and instead.candidate.name not in terms:
            terms[instead.candidate.name], replaced = instead, True
            current, kept = instead.candidate.fit, [s for s in kept if s is not step]
    searches = {name: search for name, search in BY_CLOCK.items() if roads is None or name != PLACE}
    searches[PAYLOAD] = partial(_payload, route=route)
    for round_ in range(MOST_DESCRIBED - (load is not None)):
        on_stage(f"what has no name, round {round_ + 1}")
        followed = _followed(current, replicates, rng)
        by_clock = (_watched(current, name, search) for name, search in searches.items())
        ground = _ground(current, roads) if route is not None and route.told and TORQUE in kinds else None
        looked_for = (followed, _wave(current), ground, *by_clock)
        found = [t for t in looked_for if t is not None]
        if not found:
            break
        term = max(found, key=lambda t: t.candidate.net_evidence)
        with_term, still_named = _needed(term.candidate.fit, kept)
        if len(still_named) < len(kept) and with_term.log_evidence < current.log_evidence + SURE:
            break  # a name explains as much
        terms[term.candidate.name] = term
        current, kept = with_term, still_named
        if term.candidate.effect.acts_on != WATCHED:
            continue
        step = one_round(current, effects, replicates, rng)
        if step.chosen is not None and len(current.effects) - len(terms) < MOST_DESCRIBED:
            current, kept = step.chosen.fit, [*kept, step]
    return Description(current, kept, terms, replaced)


def _followed(current: Fit, replicates: int, rng: np.random.Generator) -> Term | None:
    """The best curve, gated curve or build-up; of those as good the simplest."""
    forms = {key: e for key, e in candidates(current).items() if e.name not in current.effect_names}
    step = one_round(current, forms, max(FEWEST_REPLICATES, replicates // 2), rng, LEAST_FOLLOWED)
    if step.chosen is None or step.chosen.net_evidence < math.log(len(forms)):
        return None
    as_good = [
        c for c in step.candidates if c.net_evidence > step.chosen.net_evidence - ALIKE_WITHIN and c.counts(step.threshold)
    ]
    chosen = min(as_good, key=_count)
    for more in finer(chosen.effect, current) if isinstance(chosen.effect, Curve) else ():
        tried = _with(current, more, chosen)
        if tried.net_evidence > chosen.net_evidence + ALIKE_WITHIN:
            chosen = tried
    return Term(chosen, _tied(step, chosen, as_good))


def _instead(step: Step, current: Fit, replicates: int, rng: np.random.Generator) -> Term | None:
    """A term that explains more than a name that stands for several, between which nothing decides."""
    assert step.chosen is not None
    others = [a.effect for a in current.effects if a.effect.name != step.chosen.name]
    term = _followed(fit(current.problem, others, current.at, current.noises), replicates, rng)
    if term is None or term.candidate.fit.log_evidence < current.log_evidence + ALIKE_WITHIN:
        return None
    return term


def _tied(step: Step, chosen: Candidate, as_good: Sequence[Candidate]) -> Step:
    """A round with the form that was chosen and those with other names that are as good."""
    best = {c.name: c for c in sorted(as_good, key=lambda c: c.net_evidence)} | {chosen.name: chosen}
    raw = {name: math.exp(min(0.0, c.net_evidence - chosen.net_evidence)) for name, c in best.items()}
    weights = {name: x / sum(raw.values()) for name, x in raw.items()}
    return replace(step, candidates=tuple(best.values()), chosen=chosen, members=tuple(best), weights=weights)


def _count(candidate: Candidate) -> tuple[int, float]:
    assert isinstance(candidate.effect, Learned)
    return candidate.effect.knots, -candidate.net_evidence


def _with(current: Fit, effect: Effect, like: Candidate) -> Candidate:
    """Another form of a candidate, fitted beside what is there."""
    found = fit(current.problem, [*(a.effect for a in current.effects), effect], current.at, current.noises)
    return compared(current, found, effect.name, like.kept, like.d_prime, like.form_error_gain)


def _watched(current: Fit, name: str, search: Search) -> Term | None:
    """A term that follows the clock alone; it is looked for twice, the second time beside a base that it no longer bends."""
    if name in current.effect_names:
        return None
    residuals, found = _residuals(current), None
    for _ in range(2):
        term = search(current, residuals)
        if term is None:
            return found
        found, residuals = term, residuals_without(term.candidate.fit, name)
    return found


def _fitted(current: Fit, name: str, text: str, shape: Sequence[Array], level: float, cost: float = 0.0) -> Candidate:
    """What follows the clock alone, fitted beside what is there; it begins at its level and with the noise beside that, as
    without it the noise is taken for a random walk, under which no level counts.
    """
    facts = current.problem.base.facts
    effect = Watched(name, text, shape, facts.weight * facts.radius)
    start = {**current.at, (name, "level"): level}
    found = fit(current.problem, [*(a.effect for a in current.effects), effect], start)
    return compared(current, found, name, 1.0, math.nan, cost)


def _counts(candidate: Candidate, current: Fit) -> bool:
    return candidate.counts(spurious_gain(current)) and candidate.net_evidence > SURE


def torque_blocks(
    current: Fit, residuals: Sequence[Array], masks: Sequence[NDArray[np.bool_]] | None = None, seconds: float = BLOCK_S
) -> Blocks:
    """Blocks of the torque's residual against travel, of the given samples or of those that are fitted."""
    problem = current.problem
    against = [r * np.sign(s.speed) for r, s in zip(residuals, problem.sessions, strict=True)]
    return blocks(against, problem.masks if masks is None else masks, problem.sessions[0].step, seconds)


def _residuals(current: Fit) -> list[Array]:
    return [r for r, g in zip(current.residuals, current.problem.segments, strict=True) if g.kind == "torque"]


def residuals_without(current: Fit, name: str) -> list[Array]:
    """What the torque of each session would leave without one effect, the others as they are [Nm]."""
    return [r + x for r, x in zip(_residuals(current), current.contribution(name), strict=True)]


def _spells(current: Fit, residuals: Sequence[Array]) -> Term | None:
    """Spells, if two levels are likelier than one that wanders."""
    b = torque_blocks(current, residuals)
    chain, there, _ = find_chain(b)
    if not is_spells(chain) or beyond_wander(b, chain, there) < SURE:
        return None
    if chain.level < chain.rest:
        there = 1.0 - there
        chain = replace(chain, level=chain.rest, rest=chain.level, comes=chain.goes, goes=chain.comes)
    shape, cost = _shape(current, chain, residuals)
    text = "a torque that is there for a while and gone for a while"
    candidate = _fitted(current, SPELLS, text, shape, chain.level - chain.rest, cost)
    if not _counts(candidate, current) or sum(beginnings(b, there)) < FEWEST_SPELLS:
        return None
    return Term(candidate, chain=chain)


def _shape(current: Fit, chain: Chain, residuals: Sequence[Array]) -> tuple[list[Array], float]:
    """How likely it is there, and what its comings and goings cost.

    On the laps fitted it is by all of them, step by step, as it comes and goes within a block; elsewhere by what was measured
    up to the block before, as one who watches live knows it.
    """
    problem = current.problem
    shape, step = [np.zeros(len(s)) for s in problem.sessions], problem.sessions[0].step
    by_step = torque_blocks(current, residuals, seconds=step)
    quick = chain.for_blocks(step)
    there = there_given(by_step, quick)[0]
    fill(shape, by_step, there)
    held_out = [s.used & ~m for s, m in zip(problem.sessions, problem.masks, strict=True)]
    if any(m.any() for m in held_out):
        other = torque_blocks(current, residuals, held_out)
        fill(shape, other, expected_there(other, chain))
    against = [np.asarray(x * np.sign(s.speed)) for x, s in zip(shape, problem.sessions, strict=True)]
    return against, path_cost(by_step, quick, there)


def expected_there(b: Blocks, chain: Chain) -> Array:
    """How likely it is there in each block by the blocks before it."""
    levels, now = (chain.rest, chain.level), chain.share
    found = np.empty(len(b.mean))
    for i, (mean, variance) in enumerate(zip(b.mean.tolist(), (chain.noise**2 / b.count).tolist(), strict=True)):
        now = chain.share if b.first[i] else later_there(now, chain.comes, chain.goes)
        found[i] = now
        now = seen_there(now, mean, levels, variance)
    return found


def fill(shape: Sequence[Array], b: Blocks, value: Array) -> None:
    """Put the value of each block into the series of its session."""
    for session, begin, end, x in zip(b.session, b.begin, b.end, value, strict=True):
        shape[session][begin:end] = x


def beginnings(b: Blocks, there: Array, backwards: bool = False) -> NDArray[np.bool_]:
    """Blocks in which a spell begins, or ends if looked at backwards."""
    on = there > LIKELY
    goes_on = on[:-1] & on[1:] & ~b.first[1:]
    return np.asarray(on & ~np.concatenate((goes_on, [False]) if backwards else ([False], goes_on)))


def _ground(current: Fit, roads: Roads | None) -> Term | None:
    """A torque by place beside a slope by place."""
    if roads is None or BY_PLACE[TORQUE] in current.effect_names:
        return None
    found = find_route(current, roads, (TORQUE,))
    return Term(found.candidate, route=found) if found is not None and _counts(found.candidate, current) else None


def _wave(current: Fit) -> Term | None:
    """A wave in driven distance."""
    if WAVE in current.effect_names:
        return None
    wave = find_wave(current)
    if wave is None:
        return None
    used = [np.where(m, x, 0.0) for x, m in zip(wave.shape, current.problem.masks, strict=True)]
    candidate = _fitted(current, WAVE, "a torque that comes again with distance", used, wave.size)
    chosen = PHASE_COST * wave.phases
    return Term(candidate, wave=wave) if candidate.net_evidence > SURE + chosen and candidate.matters else None


def _level_change(current: Fit, residuals: Sequence[Array]) -> Term | None:
    """A level that changed for good. It is known of the laps that are not fitted by their time alone."""
    sessions, masks = current.problem.sessions, current.problem.masks
    step = sessions[0].step
    seconds = piece_s(step * sum(int(m.sum()) for m in masks))
    change = find_change(torque_blocks(current, residuals, seconds=seconds), step)
    if change is None:
        return None
    against = residuals[change.session] * np.sign(sessions[change.session].speed)
    change = sharpened(change, against, masks[change.session], round(seconds / step))
    shape = [x * np.sign(s.speed) for x, s in zip(change.shape([len(s) for s in sessions]), sessions, strict=True)]
    candidate = _fitted(current, LEVEL_CHANGE, "a torque that is there from some time on", shape, change.size, change.cost)
    return Term(candidate, change=change) if _counts(candidate, current) else None


def _place(current: Fit, residuals: Sequence[Array]) -> Term | None:
    """A torque at the same place on each pass. It is known of the laps that are not fitted by the distance driven alone."""
    sessions, masks = current.problem.sessions, current.problem.masks
    distances = [np.cumsum(np.abs(np.nan_to_num(s.speed))) * s.step for s in sessions]
    place = find_place(distances, [r * np.sign(s.speed) for r, s in zip(residuals, sessions, strict=True)], masks)
    if place is None:
        return None
    shape = [x * np.sign(s.speed) for x, s in zip(place.shape, sessions, strict=True)]
    candidate = _fitted(current, PLACE, "a torque at the same place on each pass", shape, place.size, place.cost)
    return Term(candidate, place=place) if _counts(candidate, current) else None


def load_by_stretch(current: Fit, route: Route | None) -> Term | None:
    """A mass that differs from one stretch to the next in what a fit leaves."""
    return _watched(current, PAYLOAD, partial(_payload, route=route))


def _payload(current: Fit, residuals: Sequence[Array], route: Route | None = None) -> Term | None:
    """A mass that differs from one stretch between stops to the next, beside what goes by place; on laps that are not fitted by
    what was measured before.
    """
    beside = route.beside(current) if route is not None and route.candidate.name in current.effect_names else None
    payload = find_payload(current, residuals, beside)
    if payload is None:
        return None
    text = "another mass on each stretch between stops"
    candidate = _fitted(current, PAYLOAD, text, payload.shape, payload.level, payload.cost)
    return Term(candidate, payload=payload) if _counts(candidate, current) else None


BY_CLOCK: Mapping[str, Search] = {SPELLS: _spells, LEVEL_CHANGE: _level_change, PLACE: _place, PAYLOAD: _payload}


def _needed(current: Fit, steps: list[Step]) -> tuple[Fit, list[Step]]:
    """Leave out names that gain less than their thresholds now that the terms are there."""
    for step in list(steps):
        if step.chosen is None or step.chosen.name not in current.effect_names:
            continue
        without = [a.effect for a in current.effects if a.effect.name != step.chosen.name]
        reduced = fit(current.problem, without, current.at, current.noises)
        gain = current.log_likelihood - reduced.log_likelihood
        if gain < step.threshold + step.chosen.form_error_gain or current.log_evidence < reduced.log_evidence:
            current, steps = reduced, [s for s in steps if s is not step]
    return current, steps


def drift(final: Fit) -> Described | None:
    """What wanders in what is left, if it does so slowly and more than by chance."""
    b = torque_blocks(final, _residuals(final))
    wander, likelihood = find_wander(b)
    mean, variance = float(np.average(b.mean, weights=b.count)), float(np.mean(b.count * b.mean**2))
    white = -0.5 * float(np.sum((b.mean - mean) ** 2 * b.count / variance + np.log(2.0 * math.pi * variance / b.count)))
    slow = wander.seconds >= SLOWEST_WANDER_S and likelihood > white + SURE
    large = wander.size > LEAST_WANDER * rms([s.torque for s in final.problem.sessions], final)
    return of_drift(wander) if slow and large else None
