# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Describes a found term with the values of the last fit: its sentence and its variable."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trackres_ros.diagnosis.base.patterns import ClockTerm
from trackres_ros.diagnosis.empirical import terms
from trackres_ros.diagnosis.empirical.candidates import series
from trackres_ros.diagnosis.empirical.closest import closest_channel
from trackres_ros.diagnosis.empirical.finders import Term, beginnings, residuals_without, torque_blocks
from trackres_ros.diagnosis.empirical.spells import Chain, spell_probability
from trackres_ros.diagnosis.empirical.terms import Described
from trackres_ros.diagnosis.empirical.torque import against_travel
from trackres_ros.diagnosis.empirical.waves import part_of
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.prepare.session import Array
from trackres_ros.effects.learned import EmpiricalEffect
from trackres_ros.estimator.disturbance import BLOCK_S

MOVING_MPS = 0.3
BEGINNINGS_S = 15.0  # largest time from a stop to a spell that begins with it
MOST_BEGIN = 0.7  # of the spells
MOST_OF_IT = (0.025, 0.975)  # quantiles


def describe(term: Term, final: Fit) -> Described:
    """Description of a term, with the values of the final fit."""
    described = _described(term, final, final.problem.base.noun).of(final.problem.base.noun)
    if described.predictable or term.payload is not None:
        return described
    adds = against_travel(final.problem.sessions, final.contribution(term.candidate.name))
    return replace(described, sentence=f"{described.sentence}. {closest_channel(final, adds)}")


def _described(term: Term, final: Fit, noun: str) -> Described:
    name = term.candidate.name
    active = next(a for a in final.effects if a.effect.name == name)
    if isinstance(active.effect, EmpiricalEffect):
        return terms.of_learned(active.effect, active.values, noun)
    level = active.numbers[0]
    if isinstance(active.effect, ClockTerm):
        return terms.of_clock(active.effect, level, noun)
    if term.wave is not None:
        return terms.of_wave(name, term.wave, level, part_of(term.wave.length_m, final.problem.base.parts))
    if term.place is not None:
        return terms.of_place(name, level, term.place, noun)
    if term.payload is not None:
        return terms.of_payload(name, level, term.payload, noun)
    if term.route is not None:
        adds = against_travel(final.problem.sessions, final.contribution(name))
        used = np.concatenate([x[m] for x, m in zip(adds, final.problem.masks, strict=True)])
        least, most = (float(q) for q in np.quantile(used, MOST_OF_IT))
        return terms.of_route(name, float(np.sqrt(np.mean(used**2))), least, most, term.route, noun)
    assert term.chain is not None
    spells = _spells_of(term.chain, name, final)
    lengths = np.array([(end - begin) * final.problem.sessions[i].step for i, begin, end in spells])
    return terms.of_spells(name, term.chain, level, len(spells), lengths, _begins_with(spells, final), noun)


def _spells_of(chain: Chain, name: str, final: Fit) -> list[tuple[int, int, int]]:
    """Spells on all laps: session, first sample and end. A spell continues over a stop, where no torque shows it."""
    b = torque_blocks(final, residuals_without(final, name), [s.used for s in final.problem.sessions])
    there = spell_probability(b, chain)
    begins = np.flatnonzero(beginnings(b, there))
    ends = np.flatnonzero(beginnings(b, there, backwards=True))
    return [(int(b.session[i]), int(b.begin[i]), int(b.end[j])) for i, j in zip(begins, ends, strict=True)]


def variable_of(term: Term, final: Fit) -> list[Array]:
    """Variable of a term in each session; empty for the clock alone."""
    effect = term.candidate.effect
    if isinstance(effect, EmpiricalEffect):
        return series(effect.variable, final)
    if term.place is not None:
        return list(term.place.course)
    if term.route is not None:
        return list(term.route.course)
    return []


def _begins_with(spells: Sequence[tuple[int, int, int]], final: Fit) -> str:
    """The common event at the beginning of most spells, in words; empty without one."""
    after_stop = []
    for i, begin, _ in spells:
        session = final.problem.sessions[i]
        near = slice(max(0, begin - round(BEGINNINGS_S / session.step)), begin + round(BLOCK_S / session.step))
        after_stop.append(bool((np.abs(session.speed[near]) < MOVING_MPS).any()))
    return ", mostly after a stop" if after_stop and np.mean(after_stop) > MOST_BEGIN else ""
