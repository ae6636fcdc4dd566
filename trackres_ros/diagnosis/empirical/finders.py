# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Finds terms that follow the clock or the place in the residual of a fit: spells, a change of level, a place, a mass by
stretch, a wave, a route. A term of the clock must gain more than noise and the model's own error would.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.base.patterns import ResidualPattern
from trackres_ros.diagnosis.empirical.level_changes import LevelChange, find_change, piece_s, sharpened
from trackres_ros.diagnosis.empirical.on_laps import place_in
from trackres_ros.diagnosis.empirical.payload import Payload, find_payload
from trackres_ros.diagnosis.empirical.places import Place
from trackres_ros.diagnosis.empirical.routes import SLOPES, Roads, Route, find_route
from trackres_ros.diagnosis.empirical.spells import (
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
from trackres_ros.diagnosis.empirical.terms import Described, of_drift, of_recordings
from trackres_ros.diagnosis.empirical.waves import Wave, find_wave, followed
from trackres_ros.diagnosis.inference.fitting import Fit, fit
from trackres_ros.diagnosis.inference.threads import side_by_side
from trackres_ros.diagnosis.selection.naming import Candidate, compared, rms, spurious_gain
from trackres_ros.estimator.disturbance import BLOCK_S, later_there, seen_there
from trackres_ros.vehicle.writing.changes import BY_PLACE

Array = NDArray[np.float64]
Search = Callable[[Fit, Sequence[Array]], "Term | None"]
"""Searches the torque residual of each session [Nm] for a term of the clock alone, in addition to a fit."""

SURE = 10.0  # in log-likelihood: spells over a drift, a drift over none, a term over none
FEWEST_SPELLS = 2  # with one, it is a level change
SLOWEST_WANDER_S = 60.0  # a faster drift is noise that the autoregression includes
LEAST_WANDER = 0.01  # of the torque
BETWEEN = 0.7  # of the slow variance: share between recordings
PHASE_COST = 1.0  # in log-likelihood: gain by noise of the phase and size fitted to each stretch
SPELLS, WAVE, LEVEL_CHANGE, PLACE, PAYLOAD = "spells", "wave", "level_change", "place", "payload"
LIKELY = 0.5  # probability of an active spell


@dataclass(frozen=True, eq=False)
class Term:
    """A found term: the fits with and without it, and its properties outside the fit."""

    candidate: Candidate
    chain: Chain | None = None
    wave: Wave | None = None
    change: LevelChange | None = None
    place: Place | None = None
    payload: Payload | None = None
    route: Route | None = None


def _watched(current: Fit, name: str, search: Search) -> Term | None:
    """Find a term of the clock alone; a second search uses the base fitted together with the first result."""
    if name in current.effect_names:
        return None
    residuals, found = _residuals(current), None
    for _ in range(2):
        term = search(current, residuals)
        if term is None:
            return found
        found, residuals = term, residuals_without(term.candidate.fit, name)
    return found


def _fitted(
    current: Fit,
    name: str,
    text: str,
    shape: Sequence[Array],
    level: float,
    cost: float = 0.0,
    ahead: Sequence[Array] | None = None,
) -> Candidate:
    """Fit a term of the clock in addition to the current ones. It starts at its level and with its own noise, because
    otherwise the noise is a random walk, under which no level matters.
    """
    facts = current.problem.base.facts
    effect = ResidualPattern(name, text, shape, facts.weight * facts.radius, ahead)
    start = {**current.at, (name, "level"): level}
    found = fit(current.problem, [*(a.effect for a in current.effects), effect], start)
    return compared(current, found, name, 1.0, math.nan, cost)


def _counts(candidate: Candidate, current: Fit) -> bool:
    return candidate.counts(spurious_gain(current)) and candidate.net_evidence > SURE


def torque_blocks(
    current: Fit, residuals: Sequence[Array], masks: Sequence[NDArray[np.bool_]] | None = None, seconds: float = BLOCK_S
) -> Blocks:
    """Blocks of the torque residual against travel, of the given samples or of the fitted ones."""
    problem = current.problem
    against = [r * np.sign(s.speed) for r, s in zip(residuals, problem.sessions, strict=True)]
    return blocks(against, problem.masks if masks is None else masks, problem.sessions[0].step, seconds)


def _residuals(current: Fit) -> list[Array]:
    return [r for r, g in zip(current.residuals, current.problem.segments, strict=True) if g.kind == "torque"]


def residuals_without(current: Fit, name: str) -> list[Array]:
    """Torque residual of each session without one effect, the others unchanged [Nm]."""
    return [r + x for r, x in zip(_residuals(current), current.contribution(name), strict=True)]


def _spells(current: Fit, residuals: Sequence[Array]) -> Term | None:
    """Spells, if two levels are more likely than a drift."""
    b = torque_blocks(current, residuals)
    chain, there, _ = find_chain(b)
    if not is_spells(chain) or beyond_wander(b, chain, there) < SURE:
        return None
    if chain.level < chain.rest:
        there = 1.0 - there
        chain = replace(chain, level=chain.rest, rest=chain.level, comes=chain.goes, goes=chain.comes)
    shape, ahead, cost = _shape(current, chain, residuals)
    text = "a torque that is there for a while and gone for a while"
    candidate = _fitted(current, SPELLS, text, shape, chain.level - chain.rest, cost, ahead)
    if not _counts(candidate, current) or sum(beginnings(b, there)) < FEWEST_SPELLS:
        return None
    return Term(candidate, chain=chain)


def _shape(current: Fit, chain: Chain, residuals: Sequence[Array]) -> tuple[list[Array], list[Array], float]:
    """Probability of the spell, its forecast from earlier blocks, and the cost of its transitions.

    On fitted laps the probability uses all samples, step by step, because a spell may change within a block. Elsewhere it
    is the live forecast.
    """
    sessions, masks = current.problem.sessions, current.problem.masks
    shape, ahead = ([np.zeros(len(s)) for s in sessions] for _ in range(2))
    every = torque_blocks(current, residuals, [s.used for s in sessions])
    fill(ahead, every, expected_there(every, chain))
    step = sessions[0].step
    by_step, quick = torque_blocks(current, residuals, seconds=step), chain.for_blocks(step)
    there = there_given(by_step, quick)[0]
    fill(shape, by_step, there)
    shape = [np.where(m, x, a) for m, x, a in zip(masks, shape, ahead, strict=True)]

    def against(series: Sequence[Array]) -> list[Array]:
        return [np.asarray(x * np.sign(s.speed)) for x, s in zip(series, sessions, strict=True)]

    return against(shape), against(ahead), path_cost(by_step, quick, there)


def expected_there(b: Blocks, chain: Chain) -> Array:
    """Forecast of the spell's probability in each block from the blocks before it."""
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
    """Blocks in which a spell begins, or ends if `backwards`."""
    on = there > LIKELY
    goes_on = on[:-1] & on[1:] & ~b.first[1:]
    return np.asarray(on & ~np.concatenate((goes_on, [False]) if backwards else ([False], goes_on)))


def _wave(current: Fit, residuals: Sequence[Array]) -> Term | None:
    """A wave in driven distance; on hold-out laps from earlier measurements."""
    wave = find_wave(current)
    if wave is None:
        return None
    ahead = followed(wave, residuals, current.problem.sessions)
    shape = [np.where(m, x, a) for x, m, a in zip(wave.shape, current.problem.masks, ahead, strict=True)]
    cost = PHASE_COST * wave.phases
    candidate = _fitted(current, WAVE, "a torque that comes again with distance", shape, wave.size, cost, ahead)
    return Term(candidate, wave=wave) if candidate.net_evidence > SURE and candidate.matters else None


def _level_change(current: Fit, residuals: Sequence[Array]) -> Term | None:
    """A lasting level change; on hold-out laps known from their time alone."""
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
    """A torque at the same place on each pass; on hold-out laps known from the driven distance alone."""
    place = place_in(current, residuals)
    if place is None:
        return None
    shape = [x * np.sign(s.speed) for x, s in zip(place.shape, current.problem.sessions, strict=True)]
    candidate = _fitted(current, PLACE, "a torque at the same place on each pass", shape, place.size, place.cost)
    return Term(candidate, place=place) if _counts(candidate, current) else None


def _payload(current: Fit, residuals: Sequence[Array], route: Route | None) -> Term | None:
    """A mass for each stretch between stops, in addition to terms by place; on hold-out laps from
    earlier measurements.
    """
    beside = None if route is None else route.beside(current)
    payload = find_payload(current, residuals, beside)
    if payload is None:
        return None
    text = "another mass on each stretch between stops"
    candidate = _fitted(current, PAYLOAD, text, payload.shape, payload.level, payload.cost, payload.ahead)
    return Term(candidate, payload=payload) if _counts(candidate, current) else None


BY_CLOCK: Mapping[str, Search] = {SPELLS: _spells, LEVEL_CHANGE: _level_change, PLACE: _place, WAVE: _wave}


def terms_beside(
    current: Fit, roads: Roads | None, kinds: Collection[str], routes: Mapping[str, Route], waves: bool
) -> list[Term]:
    """All terms of clock or place in addition to a fit, one of each name. Quick machines have none, because spells, a payload
    and a road belong to vehicles.

    Parameters
    ----------
    roads, kinds
        Matched roads of the sessions, and the kinds of terms by place to learn.
    routes
        Learned values of the fit's own terms by place.
    waves
        Whether to search for waves, which takes long.
    """
    if any(s.pace < 1.0 for s in current.problem.sessions):
        return []
    route = next((routes[name] for name in current.effect_names if name in routes), None)
    left_out = {name for name, wanted in ((PLACE, roads is None), (WAVE, waves)) if not wanted}
    searches = {name: search for name, search in BY_CLOCK.items() if name not in left_out}
    searches[PAYLOAD] = partial(_payload, route=route)
    found = side_by_side(lambda item: _watched(current, *item), list(searches.items()), "terms that follow the clock")
    return [*filter(None, found), *filter(None, [_by_place(current, roads, kinds)])]


def _by_place(current: Fit, roads: Roads | None, kinds: Collection[str]) -> Term | None:
    """A slope or a torque by place, of a kind that the fit lacks, confirmed on passes not used for learning."""
    left = [kind for kind in kinds if BY_PLACE[kind] not in current.effect_names]
    if roads is None or not left or any(slope in current.effect_names for slope in SLOPES):
        return None
    found = find_route(current, roads, left)
    return None if found is None else Term(found.candidate, route=found)


def slow_term(final: Fit) -> Described | None:
    """Lasting residual: a level per recording, or a drifting level."""
    return recordings(final) or drift(final)


def recordings(final: Fit) -> Described | None:
    """A different level in each recording, if the residual hardly varies within them; of all laps, fitted or not."""
    sessions = final.problem.sessions
    levels, size, share = by_recording(torque_blocks(final, _residuals(final), [s.used for s in sessions]))
    large = size > LEAST_WANDER * rms([s.torque for s in sessions], final)
    return of_recordings(levels, sessions) if large and share > BETWEEN else None


def by_recording(b: Blocks) -> tuple[Array, float, float]:
    """Mean of each recording [Nm], nan without blocks; the standard deviation of these means [Nm], and their share of the
    slow variance.
    """
    count = np.bincount(b.session, weights=b.count)
    levels = np.bincount(b.session, weights=b.count * b.mean) / np.where(count > 0.0, count, np.nan)
    middle = np.average(b.mean, weights=b.count)
    between = float(np.average((levels[b.session] - middle) ** 2, weights=b.count))
    # Half of the squared difference of consecutive means is noise.
    quick = 0.5 * float(np.mean(np.diff(b.mean)[~b.first[1:]] ** 2))
    slow = float(np.average((b.mean - middle) ** 2, weights=b.count)) - quick
    return levels, math.sqrt(between), between / max(slow, between, 1e-300)


def drift(final: Fit) -> Described | None:
    """Slow drift of the residual, if significant; only for vehicles, as `terms_beside`."""
    if any(s.pace < 1.0 for s in final.problem.sessions):
        return None
    b = torque_blocks(final, _residuals(final))
    wander, likelihood = find_wander(b)
    mean, variance = float(np.average(b.mean, weights=b.count)), float(np.mean(b.count * b.mean**2))
    white = -0.5 * float(np.sum((b.mean - mean) ** 2 * b.count / variance + np.log(2.0 * math.pi * variance / b.count)))
    slow = wander.seconds >= SLOWEST_WANDER_S and likelihood > white + SURE
    large = wander.size > LEAST_WANDER * rms([s.torque for s in final.problem.sessions], final)
    return of_drift(wander) if slow and large else None
