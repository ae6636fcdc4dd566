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
    resistances = against_travel(problem.sessions, residuals)
    return blocks(resistances, problem.masks if masks is None else masks, problem.sessions[0].step, seconds)


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
        chain = replace(chain, level=chain.rest, rest=chain.level, come_rate=chain.go_rate, go_rate=chain.come_rate)
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
        probability = chain.share if b.first[i] else predict_presence(probability, chain.come_rate, chain.go_rate)
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
    distances = [np.cumsum(np.diff(s.distance, prepend=s.distance[0]) * np.sign(np.nan_to_num(s.speed))) for s in sessions]
    return [-d if on_laps and turn * d[-1] < 0.0 else d for d, turn in zip(distances, turns, strict=True)]


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
    missing_kinds = [kind for kind in kinds if BY_PLACE[kind] not in current.effect_names]
    if roads is None or not missing_kinds or any(slope in current.effect_names for slope in SLOPES):
        return None
    return find_route(current, roads, missing_kinds)


def slow_term(final_fit: Fit) -> Term | None:
    """Lasting residual: a level per recording, or a drifting level; with the channel that comes closest to it."""
    term = attempt("a drift", lambda: _recordings(final_fit) or _drift(final_fit))
    if term is None:
        return None
    described_term = replace(term, sentences=(*term.sentences, closest_to_slow(final_fit, LEAST_DRIFT_S)))
    return possible_in(described_term, final_fit.problem.base.noun)


def closest_to_slow(final_fit: Fit, seconds: float) -> str:
    """Sentence on the channel that comes closest to the residual in means over some seconds."""
    sessions = final_fit.problem.sessions
    b = torque_blocks(final_fit, torque_residuals(final_fit), [s.used for s in sessions], seconds)
    means = [np.full(len(s), math.nan) for s in sessions]
    fill(means, b, b.mean)
    return closest_channel(final_fit, means)


def _recordings(final_fit: Fit) -> Term | None:
    """A different level in each recording, if the residual hardly varies within them; of all laps, fitted or not."""
    sessions = final_fit.problem.sessions
    levels, size, share = by_recording(torque_blocks(final_fit, torque_residuals(final_fit), [s.used for s in sessions]))
    is_large = size > LEAST_DRIFT * rms([s.torque for s in sessions], final_fit)
    return recordings_term(final_fit, levels) if is_large and share > BETWEEN else None


def by_recording(b: Blocks) -> tuple[Array, float, float]:
    """Mean of each recording [Nm], nan without blocks; the standard deviation of these means [Nm], and their share of the
    slow variance.
    """
    count = np.bincount(b.session, weights=b.count)
    levels = np.bincount(b.session, weights=b.count * b.mean) / np.where(count > 0.0, count, np.nan)
    middle = np.average(b.mean, weights=b.count)
    variance_between = float(np.average((levels[b.session] - middle) ** 2, weights=b.count))
    # Half of the squared difference of consecutive means is noise.
    quick_variance = 0.5 * float(np.mean(np.diff(b.mean)[~b.first[1:]] ** 2))
    slow_variance = float(np.average((b.mean - middle) ** 2, weights=b.count)) - quick_variance
    return levels, math.sqrt(variance_between), variance_between / max(slow_variance, variance_between, 1e-300)


def _drift(final_fit: Fit) -> Term | None:
    """Slow drift of the residual, if significant; only for vehicles, as `find_terms`."""
    if any(s.pace < 1.0 for s in final_fit.problem.sessions):
        return None
    b = torque_blocks(final_fit, torque_residuals(final_fit))
    drift, likelihood = find_drifting_level(b)
    mean, variance = float(np.average(b.mean, weights=b.count)), float(np.mean(b.count * b.mean**2))
    white = -0.5 * float(np.sum((b.mean - mean) ** 2 * b.count / variance + np.log(2.0 * math.pi * variance / b.count)))
    is_slow = drift.seconds >= LEAST_DRIFT_S and likelihood > white + SURE
    is_large = drift.size > LEAST_DRIFT * rms([s.torque for s in final_fit.problem.sessions], final_fit)
    return drift_term(final_fit, drift) if is_slow and is_large else None


MOVING_MPS = 0.3
BEGINNINGS_S = 15.0  # largest time from a stop to a spell that begins with it
MOST_BEGIN = 0.7  # of the spells
MIDDLE_95 = (0.025, 0.975)  # quantiles


def describe(term: Term, final_fit: Fit) -> Term:
    """A term without a name with its sentences and the values of the final fit."""
    noun = final_fit.problem.base.noun
    term = possible_in(_with_sentences(term, final_fit, noun), noun)
    if term.predictable or isinstance(term.pattern, Payload):
        return term
    torques = against_travel(final_fit.problem.sessions, term.adds)
    return replace(term, sentences=(*term.sentences, closest_channel(final_fit, torques)))


def _with_sentences(term: Term, final_fit: Fit, noun: str) -> Term:
    effect, pattern, numbers = term.effect, term.pattern, active_of(final_fit, term.name).numbers
    if isinstance(effect, EmpiricalEffect):
        return describe_form(term, noun)
    level = numbers[0]
    if isinstance(effect, ClockTerm):
        return describe_clock(term, effect, level, noun)
    if isinstance(pattern, Wave):
        return describe_wave(term, pattern, level, part_of(pattern.length_m, final_fit.problem.base.parts))
    if isinstance(pattern, Place):
        return describe_place(term, level, pattern, noun)
    if isinstance(pattern, Payload):
        return describe_payload(term, level, pattern, noun)
    if isinstance(pattern, Route):
        torques = against_travel(final_fit.problem.sessions, term.adds)
        used_torques = np.concatenate([x[m] for x, m in zip(torques, final_fit.problem.masks, strict=True)])
        lower_end, upper_end = (float(q) for q in np.quantile(used_torques, MIDDLE_95))
        return describe_route(term, float(np.sqrt(np.mean(used_torques**2))), lower_end, upper_end, pattern, noun)
    assert isinstance(pattern, Chain)
    spells = _spells_of(pattern, term.name, final_fit)
    lengths = np.array([(end - begin) * final_fit.problem.sessions[i].step for i, begin, end in spells])
    return describe_spells(term, pattern, level, lengths, _common_start(spells, final_fit), noun)


def _spells_of(chain: Chain, name: str, final_fit: Fit) -> list[tuple[int, int, int]]:
    """Spells on all laps: session, first sample and end. A spell continues over a stop, where no torque shows it."""
    b = torque_blocks(final_fit, residuals_without(final_fit, name), [s.used for s in final_fit.problem.sessions])
    probability = spell_probability(b, chain)
    begin_blocks = np.flatnonzero(beginnings(b, probability))
    ends = np.flatnonzero(beginnings(b, probability, backwards=True))
    return [(int(b.session[i]), int(b.begin[i]), int(b.end[j])) for i, j in zip(begin_blocks, ends, strict=True)]


def variable_of(term: Term, final_fit: Fit) -> list[Array]:
    """Variable of a term in each session; empty for the clock alone."""
    if isinstance(term.effect, EmpiricalEffect):
        return series(term.effect.variable, final_fit)
    return list(term.pattern.course) if isinstance(term.pattern, Place | Route) else []


def _common_start(spells: Sequence[tuple[int, int, int]], final_fit: Fit) -> str:
    """The common event at the beginning of most spells, in words; empty without one."""
    after_stop = []
    for i, begin, _ in spells:
        session = final_fit.problem.sessions[i]
        rows = slice(max(0, begin - round(BEGINNINGS_S / session.step)), begin + round(BLOCK_S / session.step))
        after_stop.append(bool((np.abs(session.speed[rows]) < MOVING_MPS).any()))
    return ", mostly after a stop" if after_stop and np.mean(after_stop) > MOST_BEGIN else ""


Range = tuple[float, float]


def spells_to_watch(term: Term, final_fit: Fit, model_torques: Sequence[Array], sensor_scale: float = 1.0) -> LearnedDisturbance:
    """Spells of the final fit, with both levels relative to the written file's torque [Nm], of each session.

    The file may include the mean of the spells: then the rest level is negative. Live, the torque is that of the sessions
    over `sensor_scale`.
    """
    assert isinstance(term.pattern, Chain)
    chain = term.pattern
    spell_blocks = torque_blocks(final_fit, residuals_without(final_fit, term.name))
    probability = spell_probability(spell_blocks, chain)
    b = _blocks_over(final_fit, model_torques, sensor_scale)
    level, rest, noise = spell_levels(b, probability)
    spells = Spells(level, rest, BLOCK_S / chain.go_rate, BLOCK_S / chain.come_rate, _block_noise(noise, final_fit))
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


def drift_to_watch(final_fit: Fit, model_torques: Sequence[Array], sensor_scale: float = 1.0) -> LearnedDisturbance:
    """Drift relative to the written file's torque [Nm], for each session; see `spells_to_watch` for `sensor_scale`."""
    b = _blocks_over(final_fit, model_torques, sensor_scale)
    drift_found, _ = find_drifting_level(b)
    drift = Drift(drift_found.size, drift_found.seconds, _block_noise(drift_found.noise, final_fit))
    stretches = max(1.0, BLOCK_S * len(b.mean) / (2.0 * drift_found.seconds))  # number of independent stretches
    return _disturbance(
        drift,
        {
            "size": _lognormal_range(drift.size, 2.0 * stretches),
            "time_constant": _lognormal_range(drift.time_constant, stretches),
            "noise": _lognormal_range(drift.noise, 2 * len(b.mean)),
        },
    )


def drift_on_held_out(final_fit: Fit, laps: HeldOutLaps) -> Improvement:
    """Hold-out improvement by following a drift live, with the forecast from earlier blocks."""
    sessions, model_torques = final_fit.problem.sessions, [p.torque for p in final_fit.predicted]
    drift, _ = find_drifting_level(_blocks_over(final_fit, model_torques))
    b = torque_blocks(final_fit, torque_residuals(final_fit), [s.used for s in sessions])
    shape = [np.zeros(len(s)) for s in sessions]
    fill(shape, b, expected_level(b, drift)[0])
    return laps.improvement(model_torques, [e + x for e, x in zip(model_torques, against_travel(sessions, shape), strict=True)])


def _blocks_over(final_fit: Fit, model_torques: Sequence[Array], sensor_scale: float = 1.0) -> Blocks:
    return torque_blocks(
        final_fit, [(s.torque - e) / sensor_scale for s, e in zip(final_fit.problem.sessions, model_torques, strict=True)]
    )


def _block_noise(noise: float, final_fit: Fit) -> float:
    """Noise of a block's mean, from that of one sample [Nm]."""
    return noise / math.sqrt(BLOCK_S / final_fit.problem.sessions[0].step)


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

    def limit_value(name: str, value: float) -> float:
        return min(max(value, limits[name].low), limits[name].high)

    values = {item.name: limit_value(item.name, getattr(disturbance, item.name)) for item in fields(disturbance)}
    clipped_ranges = {name: (limit_value(name, low), limit_value(name, high)) for name, (low, high) in ranges.items()}
    return LearnedDisturbance(type(disturbance)(**values), clipped_ranges)
