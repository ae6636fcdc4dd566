# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Finds terms that follow the clock or the place in the residual of a fit: spells, a place, a mass by
stretch, a wave, a route. A term of the clock must gain more than noise and the model's own error would.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from trackres_ros.diagnosis.base.patterns import ResidualPattern
from trackres_ros.diagnosis.empirical.closest import closest_channel
from trackres_ros.diagnosis.empirical.payload import PAYLOAD, Payload, find_payload
from trackres_ros.diagnosis.empirical.places import Place, find_place
from trackres_ros.diagnosis.empirical.routes import SLOPES, Roads, Route, find_route
from trackres_ros.diagnosis.empirical.spells import (
    Blocks,
    Chain,
    blocks,
    find_chain,
    find_drifting_level,
    gain_over_drift,
    is_spells,
    path_cost,
    spell_probability,
)
from trackres_ros.diagnosis.empirical.terms import Described, of_drift, of_recordings
from trackres_ros.diagnosis.empirical.torque import against_travel, torque_residuals
from trackres_ros.diagnosis.empirical.waves import Wave, find_wave, followed
from trackres_ros.diagnosis.inference.failures import attempt
from trackres_ros.diagnosis.inference.fitting import Fit, fit
from trackres_ros.diagnosis.prepare.session import Array, DriveSession, Mask
from trackres_ros.diagnosis.selection.candidate import Candidate, compared, rms, spurious_gain
from trackres_ros.estimator.disturbance import BLOCK_S, later_there, seen_there
from trackres_ros.progress import counted
from trackres_ros.vehicle.writing.changes import BY_PLACE

Search = Callable[[Fit, Fit], "Term | None"]
"""Searches for a term of the clock alone, in addition to a fit. The torque residual is that of a later fit, which may have it."""

SURE = 10.0  # in log-likelihood: spells over a drift, a drift over none, a term over none
FEWEST_SPELLS = 2  # with one, it is a step
LEAST_DRIFT_S = 60.0  # a faster drift is noise that the autoregression includes
LEAST_DRIFT = 0.01  # of the torque
BETWEEN = 0.7  # of the slow variance: share between recordings
PHASE_COST = 1.0  # in log-likelihood: gain by noise of the phase and size fitted to each stretch
SPELLS, WAVE, PLACE = "spells", "wave", "place"
LIKELY = 0.5  # probability of an active spell
FEWEST_TURNS = 2.0  # of a session, least for a circuit


@dataclass(frozen=True, eq=False)
class Term:
    """A found term: the fits with and without it, and its properties outside the fit."""

    candidate: Candidate
    chain: Chain | None = None
    wave: Wave | None = None
    place: Place | None = None
    payload: Payload | None = None
    route: Route | None = None


def _search_twice(current: Fit, name: str, search: Search) -> Term | None:
    """Find a term of the clock alone; a second search uses the base fitted together with the first result."""
    if name in current.effect_names:
        return None
    last, found = current, None
    for _ in range(2):
        term = search(current, last)
        if term is None:
            return found
        found, last = term, term.candidate.fit
    return found


def _fitted(
    current: Fit, name: str, text: str, shape: Sequence[Array], level: float, cost: float, ahead: Sequence[Array] | None = None
) -> Candidate:
    """Fit a term of the clock in addition to the current ones. It starts at its level and with its own noise, because
    otherwise the noise is a random walk, under which no level matters.
    """
    facts = current.problem.base.facts
    effect = ResidualPattern(name, text, shape, facts.weight * facts.radius, ahead)
    start = {**current.at, (name, "level"): level}
    found = fit(current.problem, [*(a.effect for a in current.effects), effect], start)
    return compared(current, found, name, cost)


def _counts(candidate: Candidate, current: Fit) -> bool:
    return candidate.matters and candidate.gain > spurious_gain(current) and candidate.evidence > SURE


def torque_blocks(
    current: Fit, residuals: Sequence[Array], masks: Sequence[Mask] | None = None, seconds: float = BLOCK_S
) -> Blocks:
    """Blocks of the torque residual against travel, of the given samples or of the fitted ones."""
    problem = current.problem
    against = against_travel(problem.sessions, residuals)
    return blocks(against, problem.masks if masks is None else masks, problem.sessions[0].step, seconds)


def residuals_without(current: Fit, name: str) -> list[Array]:
    """Torque residual of each session without one effect, if the fit has it, the others unchanged [Nm]."""
    if name not in current.effect_names:
        return torque_residuals(current)
    return [r + x for r, x in zip(torque_residuals(current), current.contribution(name), strict=True)]


def _spells(current: Fit, last: Fit) -> Term | None:
    """Spells, if two levels are more likely than a drift."""
    residuals = residuals_without(last, SPELLS)
    b = torque_blocks(current, residuals)
    chain, there, _ = find_chain(b)
    if not is_spells(chain) or gain_over_drift(b, chain, there) < SURE:
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
    there = spell_probability(by_step, quick)
    fill(shape, by_step, there)
    shape = [np.where(m, x, a) for m, x, a in zip(masks, shape, ahead, strict=True)]
    return against_travel(sessions, shape), against_travel(sessions, ahead), path_cost(by_step, quick, there)


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


def beginnings(b: Blocks, there: Array, backwards: bool = False) -> Mask:
    """Blocks in which a spell begins, or ends if `backwards`."""
    on = there > LIKELY
    goes_on = on[:-1] & on[1:] & ~b.first[1:]
    return np.asarray(on & ~np.concatenate((goes_on, [False]) if backwards else ([False], goes_on)))


def _wave(current: Fit, last: Fit) -> Term | None:
    """A wave in driven distance; on hold-out laps from earlier measurements."""
    residuals = residuals_without(last, WAVE)
    wave = find_wave(current)
    if wave is None:
        return None
    ahead = followed(wave, residuals, current.problem.sessions)
    shape = [np.where(m, x, a) for x, m, a in zip(wave.shape, current.problem.masks, ahead, strict=True)]
    cost = PHASE_COST * wave.phases
    candidate = _fitted(current, WAVE, "a torque that comes again with distance", shape, wave.size, cost, ahead)
    return Term(candidate, wave=wave) if candidate.evidence > SURE and candidate.matters else None


def _place(current: Fit, last: Fit) -> Term | None:
    """A torque at the same place on each pass; on hold-out laps known from the driven distance alone."""
    residuals = residuals_without(last, PLACE)
    sessions, masks = current.problem.sessions, current.problem.masks
    mean = float(np.mean(np.concatenate([s.weight[m] for s, m in zip(sessions, masks, strict=True)])))
    loads = [s.weight / mean for s in sessions]  # slopes, bends and soft ground take more torque at a higher weight
    place = find_place(driven_along(sessions), against_travel(sessions, residuals), masks, loads)
    if place is None:
        return None
    shape = against_travel(sessions, place.shape)
    candidate = _fitted(current, PLACE, "a torque at the same place on each pass", shape, place.size, place.cost)
    return Term(candidate, place=place) if _counts(candidate, current) else None


def driven_along(sessions: Sequence[DriveSession]) -> list[Array]:
    """Position of each session on its route, as the distance from its start [m]: it falls while the vehicle reverses, and is
    negative for laps in the other direction.

    A lap is one full turn. If each session turns at least twice in total, those that turn right in forward travel
    pass the same places in the reverse order.
    """
    turns = [float(np.nansum(s.yaw_rate)) * s.step / (2.0 * math.pi) for s in sessions]
    on_laps = all("yaw_rate" in s.given for s in sessions) and min(map(abs, turns)) >= FEWEST_TURNS
    driven = [np.cumsum(np.diff(s.distance, prepend=s.distance[0]) * np.sign(np.nan_to_num(s.speed))) for s in sessions]
    return [-d if on_laps and turn * d[-1] < 0.0 else d for d, turn in zip(driven, turns, strict=True)]


def _payload(current: Fit, last: Fit, route: Route | None) -> Term | None:
    """A mass for each stretch between stops, in addition to terms by place; on hold-out laps from earlier measurements."""
    residuals = residuals_without(last, PAYLOAD)
    payload = find_payload(last, residuals, None if route is None else route.joint_values(last))
    if payload is None:
        return None
    text = "another mass on each stretch between stops"
    candidate = _fitted(current, PAYLOAD, text, payload.shape, payload.level, payload.cost, payload.ahead)
    return Term(candidate, payload=payload) if candidate.matters else None


def find_terms(current: Fit, roads: Roads | None, kinds: Collection[str], routes: Mapping[str, Route], waves: bool) -> list[Term]:
    """All terms of clock or place in addition to a fit, one of each name. Quick machines have none, because spells, a payload
    and a road belong to vehicles.

    `kinds` are those of terms by place to learn, `routes` the fit's own terms by place. A search for `waves` takes long.
    """
    if any(s.pace < 1.0 for s in current.problem.sessions):
        return []
    route = next((routes[name] for name in current.effect_names if name in routes), None)
    searches: dict[str, Search] = {
        SPELLS: _spells,
        **({PLACE: _place} if roads is None else {}),
        **({WAVE: _wave} if waves else {}),
        PAYLOAD: partial(_payload, route=route),
    }
    each = counted(searches.items(), "terms that follow the clock", len(searches))
    found = [attempt(_words(name), partial(_search_twice, current, name, search)) for name, search in each]
    by_place = attempt("a slope or a torque by place", partial(_by_place, current, roads, kinds))
    return [*filter(None, found), *filter(None, [by_place])]


def _words(name: str) -> str:
    return f"a {name.replace('_', ' ')}" if name not in (SPELLS, PAYLOAD) else name


def _by_place(current: Fit, roads: Roads | None, kinds: Collection[str]) -> Term | None:
    """A slope or a torque by place, of a kind that the fit lacks, confirmed on passes not used for learning."""
    left = [kind for kind in kinds if BY_PLACE[kind] not in current.effect_names]
    if roads is None or not left or any(slope in current.effect_names for slope in SLOPES):
        return None
    found = find_route(current, roads, left)
    return None if found is None else Term(found.candidate, route=found)


def slow_term(final: Fit) -> Described | None:
    """Lasting residual: a level per recording, or a drifting level; with the channel that comes closest to it."""
    described = attempt("a drift", lambda: _recordings(final) or _drift(final))
    if described is None:
        return None
    text = f"{described.sentence}. {closest_to_slow(final, LEAST_DRIFT_S)}"
    return replace(described, sentence=text).of(final.problem.base.noun)


def closest_to_slow(final: Fit, seconds: float) -> str:
    """Sentence on the channel that comes closest to the residual in means over some seconds."""
    sessions = final.problem.sessions
    b = torque_blocks(final, torque_residuals(final), [s.used for s in sessions], seconds)
    means = [np.full(len(s), math.nan) for s in sessions]
    fill(means, b, b.mean)
    return closest_channel(final, means)


def _recordings(final: Fit) -> Described | None:
    """A different level in each recording, if the residual hardly varies within them; of all laps, fitted or not."""
    sessions = final.problem.sessions
    levels, size, share = by_recording(torque_blocks(final, torque_residuals(final), [s.used for s in sessions]))
    large = size > LEAST_DRIFT * rms([s.torque for s in sessions], final)
    return of_recordings(levels, final.problem.base.noun) if large and share > BETWEEN else None


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


def _drift(final: Fit) -> Described | None:
    """Slow drift of the residual, if significant; only for vehicles, as `find_terms`."""
    if any(s.pace < 1.0 for s in final.problem.sessions):
        return None
    b = torque_blocks(final, torque_residuals(final))
    drifting, likelihood = find_drifting_level(b)
    mean, variance = float(np.average(b.mean, weights=b.count)), float(np.mean(b.count * b.mean**2))
    white = -0.5 * float(np.sum((b.mean - mean) ** 2 * b.count / variance + np.log(2.0 * math.pi * variance / b.count)))
    slow = drifting.seconds >= LEAST_DRIFT_S and likelihood > white + SURE
    large = drifting.size > LEAST_DRIFT * rms([s.torque for s in final.problem.sessions], final)
    return of_drift(drifting) if slow and large else None
