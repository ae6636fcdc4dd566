# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Finds terms that follow the clock or the place in the residual of a fit: spells, a place, a mass by stretch, a wave, a route.

A term of the clock must gain more than noise and the model's own error would. A chosen one is described with the values of the
last fit. Spells and a drift become the live disturbance, relative to the torque of the written vehicle file.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import fields, replace
from functools import partial

import numpy as np

from trackres_ros.diagnosis.base.patterns import ClockTerm, ResidualPattern
from trackres_ros.diagnosis.empirical.forms import series
from trackres_ros.diagnosis.empirical.payload import PAYLOAD, Payload, find_payload
from trackres_ros.diagnosis.empirical.places import Place, Wave, find_place, find_wave, part_of, wave_forecast
from trackres_ros.diagnosis.empirical.routes import SLOPES, Roads, find_route
from trackres_ros.diagnosis.empirical.sentences import (
    describe_clock,
    describe_form,
    describe_payload,
    describe_place,
    describe_route,
    describe_spells,
    describe_wave,
    drift_term,
    possible_in,
    recordings_term,
)
from trackres_ros.diagnosis.empirical.spells import (
    Blocks,
    Chain,
    blocks,
    expected_level,
    find_chain,
    find_drifting_level,
    gain_over_drift,
    is_spells,
    path_cost,
    spell_levels,
    spell_probability,
)
from trackres_ros.diagnosis.empirical.term import Route, Term, active_of, rms, spurious_gain, term_of_fit
from trackres_ros.diagnosis.inference.failures import attempt
from trackres_ros.diagnosis.inference.fitting import Fit, fit
from trackres_ros.diagnosis.prepare.session import Array, DriveSession, Mask
from trackres_ros.diagnosis.selection.held_out import HeldOutLaps, Improvement
from trackres_ros.diagnosis.selection.locate import against_travel, closest_channel, torque_residuals
from trackres_ros.effects.learned import EmpiricalEffect
from trackres_ros.estimator.disturbance import BLOCK_S, predict_presence, update_presence
from trackres_ros.progress import counted
from trackres_ros.vehicle import Drift, Spells
from trackres_ros.vehicle.description import DISTURBANCES
from trackres_ros.vehicle.writing.changes import BY_PLACE, LearnedDisturbance

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


def _search_twice(current: Fit, name: str, search: Search) -> Term | None:
    """Find a term of the clock alone; a second search uses the base fitted together with the first result."""
    if name in current.effect_names:
        return None
    fit_before, result = current, None
    for _ in range(2):
        term = search(current, fit_before)
        if term is None:
            return result
        result, fit_before = term, term.fit
    return result


def _fit_pattern(
    current: Fit, name: str, text: str, shape: Sequence[Array], level: float, cost: float, forecast: Sequence[Array] | None = None
) -> Term:
    """Fit a term of the clock in addition to the current ones. It starts at its level and with its own noise, because
    otherwise the noise is a random walk, under which no level matters.
    """
    facts = current.problem.base.facts
    effect = ResidualPattern(name, text, shape, facts.weight * facts.radius, forecast)
    start = {**current.estimates, (name, "level"): level}
    result = fit(current.problem, [*(a.effect for a in current.effects), effect], start)
    return term_of_fit(current, result, effect, cost)


def _is_large(term: Term, current: Fit) -> bool:
    return term.matters and term.gain > spurious_gain(current) and term.evidence > SURE


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
    chain, probability, _ = find_chain(b)
    if not is_spells(chain) or gain_over_drift(b, chain, probability) < SURE:
        return None
    if chain.level < chain.rest:
        probability = 1.0 - probability
        chain = replace(chain, level=chain.rest, rest=chain.level, comes=chain.goes, goes=chain.comes)
    shape, forecast, cost = _shape(current, chain, residuals)
    text = "a torque that is there for a while and gone for a while"
    term = _fit_pattern(current, SPELLS, text, shape, chain.level - chain.rest, cost, forecast)
    if not _is_large(term, current) or sum(beginnings(b, probability)) < FEWEST_SPELLS:
        return None
    return replace(term, pattern=chain)


def _shape(current: Fit, chain: Chain, residuals: Sequence[Array]) -> tuple[list[Array], list[Array], float]:
    """Probability of the spell, its forecast from earlier blocks, and the cost of its transitions.

    On fitted laps the probability uses all samples, step by step, because a spell may change within a block. Elsewhere it
    is the live forecast.
    """
    sessions, masks = current.problem.sessions, current.problem.masks
    shape, forecast = ([np.zeros(len(s)) for s in sessions] for _ in range(2))
    all_blocks = torque_blocks(current, residuals, [s.used for s in sessions])
    fill(forecast, all_blocks, expected_there(all_blocks, chain))
    step = sessions[0].step
    step_blocks, step_chain = torque_blocks(current, residuals, seconds=step), chain.for_blocks(step)
    probability = spell_probability(step_blocks, step_chain)
    fill(shape, step_blocks, probability)
    shape = [np.where(m, x, a) for m, x, a in zip(masks, shape, forecast, strict=True)]
    return against_travel(sessions, shape), against_travel(sessions, forecast), path_cost(step_blocks, step_chain, probability)


def expected_there(b: Blocks, chain: Chain) -> Array:
    """Forecast of the spell's probability in each block from the blocks before it."""
    levels, probability = (chain.rest, chain.level), chain.share
    forecast = np.empty(len(b.mean))
    for i, (mean, variance) in enumerate(zip(b.mean.tolist(), (chain.noise**2 / b.count).tolist(), strict=True)):
        probability = chain.share if b.first[i] else predict_presence(probability, chain.comes, chain.goes)
        forecast[i] = probability
        probability = update_presence(probability, mean, levels, variance)
    return forecast


def fill(shape: Sequence[Array], b: Blocks, value: Array) -> None:
    """Put the value of each block into the series of its session."""
    for session, begin, end, x in zip(b.session, b.begin, b.end, value, strict=True):
        shape[session][begin:end] = x


def beginnings(b: Blocks, probability: Array, backwards: bool = False) -> Mask:
    """Blocks in which a spell begins, or ends if `backwards`."""
    is_spell = probability > LIKELY
    is_middle = is_spell[:-1] & is_spell[1:] & ~b.first[1:]
    return np.asarray(is_spell & ~np.concatenate((is_middle, [False]) if backwards else ([False], is_middle)))


def _wave(current: Fit, last: Fit) -> Term | None:
    """A wave in driven distance; on hold-out laps from earlier measurements."""
    residuals = residuals_without(last, WAVE)
    wave = find_wave(current)
    if wave is None:
        return None
    forecast = wave_forecast(wave, residuals, current.problem.sessions)
    shape = [np.where(m, x, a) for x, m, a in zip(wave.shape, current.problem.masks, forecast, strict=True)]
    cost = PHASE_COST * wave.phases
    term = _fit_pattern(current, WAVE, "a torque that comes again with distance", shape, wave.size, cost, forecast)
    return replace(term, pattern=wave) if term.evidence > SURE and term.matters else None


def _place(current: Fit, last: Fit) -> Term | None:
    """A torque at the same place on each pass; on hold-out laps known from the driven distance alone."""
    residuals = residuals_without(last, PLACE)
    sessions, masks = current.problem.sessions, current.problem.masks
    mean_weight = float(np.mean(np.concatenate([s.weight[m] for s, m in zip(sessions, masks, strict=True)])))
    loads = [s.weight / mean_weight for s in sessions]  # slopes, bends and soft ground take more torque at a higher weight
    place = find_place(driven_along(sessions), against_travel(sessions, residuals), masks, loads)
    if place is None:
        return None
    shape = against_travel(sessions, place.shape)
    term = _fit_pattern(current, PLACE, "a torque at the same place on each pass", shape, place.size, place.cost)
    return replace(term, pattern=place) if _is_large(term, current) else None


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


def _payload(current: Fit, last: Fit, by_place: Term | None) -> Term | None:
    """A mass for each stretch between stops, in addition to terms by place; on hold-out laps from earlier measurements."""
    residuals = residuals_without(last, PAYLOAD)
    payload = find_payload(last, residuals, None if by_place is None else by_place.joint_values(last))
    if payload is None:
        return None
    text = "another mass on each stretch between stops"
    term = _fit_pattern(current, PAYLOAD, text, payload.shape, payload.level, payload.cost, payload.ahead)
    return replace(term, pattern=payload) if term.matters else None


def find_terms(current: Fit, roads: Roads | None, kinds: Collection[str], by_place: Term | None, waves: bool) -> list[Term]:
    """All terms of clock or place in addition to a fit, one of each name. Quick machines have none, because spells, a payload
    and a road belong to vehicles.

    `kinds` are those of terms by place to learn, `by_place` the fit's own one. A search for `waves` takes long.
    """
    if any(s.pace < 1.0 for s in current.problem.sessions):
        return []
    searches: dict[str, Search] = {
        SPELLS: _spells,
        **({PLACE: _place} if roads is None else {}),
        **({WAVE: _wave} if waves else {}),
        PAYLOAD: partial(_payload, by_place=by_place),
    }
    items = counted(searches.items(), "terms that follow the clock", len(searches))
    terms = [attempt(_words(name), partial(_search_twice, current, name, search)) for name, search in items]
    place_term = attempt("a slope or a torque by place", partial(_by_place, current, roads, kinds))
    return [*filter(None, terms), *filter(None, [place_term])]


def _words(name: str) -> str:
    return f"a {name.replace('_', ' ')}" if name not in (SPELLS, PAYLOAD) else name


def _by_place(current: Fit, roads: Roads | None, kinds: Collection[str]) -> Term | None:
    """A slope or a torque by place, of a kind that the fit lacks, confirmed on passes not used for learning."""
    missing = [kind for kind in kinds if BY_PLACE[kind] not in current.effect_names]
    if roads is None or not missing or any(slope in current.effect_names for slope in SLOPES):
        return None
    return find_route(current, roads, missing)


def slow_term(final: Fit) -> Term | None:
    """Lasting residual: a level per recording, or a drifting level; with the channel that comes closest to it."""
    term = attempt("a drift", lambda: _recordings(final) or _drift(final))
    if term is None:
        return None
    described_term = replace(term, sentences=(*term.sentences, closest_to_slow(final, LEAST_DRIFT_S)))
    return possible_in(described_term, final.problem.base.noun)


def closest_to_slow(final: Fit, seconds: float) -> str:
    """Sentence on the channel that comes closest to the residual in means over some seconds."""
    sessions = final.problem.sessions
    b = torque_blocks(final, torque_residuals(final), [s.used for s in sessions], seconds)
    means = [np.full(len(s), math.nan) for s in sessions]
    fill(means, b, b.mean)
    return closest_channel(final, means)


def _recordings(final: Fit) -> Term | None:
    """A different level in each recording, if the residual hardly varies within them; of all laps, fitted or not."""
    sessions = final.problem.sessions
    levels, size, share = by_recording(torque_blocks(final, torque_residuals(final), [s.used for s in sessions]))
    large = size > LEAST_DRIFT * rms([s.torque for s in sessions], final)
    return recordings_term(final, levels) if large and share > BETWEEN else None


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


def _drift(final: Fit) -> Term | None:
    """Slow drift of the residual, if significant; only for vehicles, as `find_terms`."""
    if any(s.pace < 1.0 for s in final.problem.sessions):
        return None
    b = torque_blocks(final, torque_residuals(final))
    drifting, likelihood = find_drifting_level(b)
    mean, variance = float(np.average(b.mean, weights=b.count)), float(np.mean(b.count * b.mean**2))
    white = -0.5 * float(np.sum((b.mean - mean) ** 2 * b.count / variance + np.log(2.0 * math.pi * variance / b.count)))
    slow = drifting.seconds >= LEAST_DRIFT_S and likelihood > white + SURE
    large = drifting.size > LEAST_DRIFT * rms([s.torque for s in final.problem.sessions], final)
    return drift_term(final, drifting) if slow and large else None


MOVING_MPS = 0.3
BEGINNINGS_S = 15.0  # largest time from a stop to a spell that begins with it
MOST_BEGIN = 0.7  # of the spells
MIDDLE_95 = (0.025, 0.975)  # quantiles


def describe(term: Term, final: Fit) -> Term:
    """A term without a name with its sentences and the values of the final fit."""
    noun = final.problem.base.noun
    term = possible_in(_with_sentences(term, final, noun), noun)
    if term.predictable or isinstance(term.pattern, Payload):
        return term
    torques = against_travel(final.problem.sessions, term.adds)
    return replace(term, sentences=(*term.sentences, closest_channel(final, torques)))


def _with_sentences(term: Term, final: Fit, noun: str) -> Term:
    effect, pattern, numbers = term.effect, term.pattern, active_of(final, term.name).numbers
    if isinstance(effect, EmpiricalEffect):
        return describe_form(term, noun)
    level = numbers[0]
    if isinstance(effect, ClockTerm):
        return describe_clock(term, effect, level, noun)
    if isinstance(pattern, Wave):
        return describe_wave(term, pattern, level, part_of(pattern.length_m, final.problem.base.parts))
    if isinstance(pattern, Place):
        return describe_place(term, level, pattern, noun)
    if isinstance(pattern, Payload):
        return describe_payload(term, level, pattern, noun)
    if isinstance(pattern, Route):
        torques = against_travel(final.problem.sessions, term.adds)
        used = np.concatenate([x[m] for x, m in zip(torques, final.problem.masks, strict=True)])
        least, most = (float(q) for q in np.quantile(used, MIDDLE_95))
        return describe_route(term, float(np.sqrt(np.mean(used**2))), least, most, pattern, noun)
    assert isinstance(pattern, Chain)
    spells = _spells_of(pattern, term.name, final)
    lengths = np.array([(end - begin) * final.problem.sessions[i].step for i, begin, end in spells])
    return describe_spells(term, pattern, level, lengths, _common_start(spells, final), noun)


def _spells_of(chain: Chain, name: str, final: Fit) -> list[tuple[int, int, int]]:
    """Spells on all laps: session, first sample and end. A spell continues over a stop, where no torque shows it."""
    b = torque_blocks(final, residuals_without(final, name), [s.used for s in final.problem.sessions])
    probability = spell_probability(b, chain)
    begins = np.flatnonzero(beginnings(b, probability))
    ends = np.flatnonzero(beginnings(b, probability, backwards=True))
    return [(int(b.session[i]), int(b.begin[i]), int(b.end[j])) for i, j in zip(begins, ends, strict=True)]


def variable_of(term: Term, final: Fit) -> list[Array]:
    """Variable of a term in each session; empty for the clock alone."""
    if isinstance(term.effect, EmpiricalEffect):
        return series(term.effect.variable, final)
    return list(term.pattern.course) if isinstance(term.pattern, Place | Route) else []


def _common_start(spells: Sequence[tuple[int, int, int]], final: Fit) -> str:
    """The common event at the beginning of most spells, in words; empty without one."""
    after_stop = []
    for i, begin, _ in spells:
        session = final.problem.sessions[i]
        rows = slice(max(0, begin - round(BEGINNINGS_S / session.step)), begin + round(BLOCK_S / session.step))
        after_stop.append(bool((np.abs(session.speed[rows]) < MOVING_MPS).any()))
    return ", mostly after a stop" if after_stop and np.mean(after_stop) > MOST_BEGIN else ""


Range = tuple[float, float]


def spells_to_watch(term: Term, final: Fit, expected: Sequence[Array], sensor_scale: float = 1.0) -> LearnedDisturbance:
    """Spells of the final fit, with both levels relative to the written file's torque [Nm], of each session.

    The file may include the mean of the spells: then the rest level is negative. Live, the torque is that of the sessions
    over `sensor_scale`.
    """
    assert isinstance(term.pattern, Chain)
    chain = term.pattern
    spell_blocks = torque_blocks(final, residuals_without(final, term.name))
    probability = spell_probability(spell_blocks, chain)
    b = _blocks_over(final, expected, sensor_scale)
    level, rest, noise = spell_levels(b, probability)
    spells = Spells(level, rest, BLOCK_S / chain.goes, BLOCK_S / chain.comes, _block_noise(noise, final))
    count = int(beginnings(b, probability).sum())
    return _disturbance(
        spells,
        {
            "level": _normal_range(level, spells.noise / math.sqrt(probability.sum())),
            "rest": _normal_range(rest, spells.noise / math.sqrt((1.0 - probability).sum())),
            "mean_there": _lognormal_range(spells.mean_there, count),
            "mean_away": _lognormal_range(spells.mean_away, count),
            "noise": _lognormal_range(spells.noise, 2 * len(b.mean)),
        },
    )


def drift_to_watch(final: Fit, expected: Sequence[Array], sensor_scale: float = 1.0) -> LearnedDisturbance:
    """Drift relative to the written file's torque [Nm], for each session; see `spells_to_watch` for `sensor_scale`."""
    b = _blocks_over(final, expected, sensor_scale)
    drifting, _ = find_drifting_level(b)
    drift = Drift(drifting.size, drifting.seconds, _block_noise(drifting.noise, final))
    stretches = max(1.0, BLOCK_S * len(b.mean) / (2.0 * drifting.seconds))  # number of independent stretches
    return _disturbance(
        drift,
        {
            "size": _lognormal_range(drift.size, 2.0 * stretches),
            "time_constant": _lognormal_range(drift.time_constant, stretches),
            "noise": _lognormal_range(drift.noise, 2 * len(b.mean)),
        },
    )


def drift_on_held_out(final: Fit, laps: HeldOutLaps) -> Improvement:
    """Hold-out improvement by following a drift live, with the forecast from earlier blocks."""
    sessions, expected = final.problem.sessions, [p.torque for p in final.predicted]
    drifting, _ = find_drifting_level(_blocks_over(final, expected))
    b = torque_blocks(final, torque_residuals(final), [s.used for s in sessions])
    shape = [np.zeros(len(s)) for s in sessions]
    fill(shape, b, expected_level(b, drifting)[0])
    return laps.improvement(expected, [e + x for e, x in zip(expected, against_travel(sessions, shape), strict=True)])


def _blocks_over(final: Fit, expected: Sequence[Array], sensor_scale: float = 1.0) -> Blocks:
    return torque_blocks(final, [(s.torque - e) / sensor_scale for s, e in zip(final.problem.sessions, expected, strict=True)])


def _block_noise(noise: float, final: Fit) -> float:
    """Noise of a block's mean, from that of one sample [Nm]."""
    return noise / math.sqrt(BLOCK_S / final.problem.sessions[0].step)


def _normal_range(value: float, std: float) -> Range:
    return value - 2.0 * std, value + 2.0 * std


def _lognormal_range(value: float, count: float) -> Range:
    """Range of +-2 standard deviations of the logarithm, each 1 / sqrt(count): for the mean of `count` exponential times,
    or for a standard deviation with twice that count.
    """
    factor = math.exp(2.0 / math.sqrt(count))
    return value / factor, value * factor


def _disturbance(disturbance: Spells | Drift, ranges: Mapping[str, Range]) -> LearnedDisturbance:
    """Disturbance with values and ranges within the limits of a vehicle file."""
    limits = DISTURBANCES[disturbance.form]

    def limited(name: str, value: float) -> float:
        return min(max(value, limits[name].low), limits[name].high)

    values = {item.name: limited(item.name, getattr(disturbance, item.name)) for item in fields(disturbance)}
    clipped = {name: (limited(name, low), limited(name, high)) for name, (low, high) in ranges.items()}
    return LearnedDisturbance(type(disturbance)(**values), clipped)
