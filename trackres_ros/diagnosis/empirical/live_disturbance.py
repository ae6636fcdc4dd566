# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Converts spells and a drift to the live disturbance, relative to the written vehicle file's torque."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields

import numpy as np

from trackres_ros.diagnosis.empirical.finders import Term, beginnings, fill, residuals_without, torque_blocks
from trackres_ros.diagnosis.empirical.spells import Blocks, expected_level, find_drifting_level, levels_given, spell_probability
from trackres_ros.diagnosis.empirical.torque import against_travel, torque_residuals
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.prepare.session import Array
from trackres_ros.diagnosis.selection.held_out import HeldOutLaps, Improvement
from trackres_ros.estimator.disturbance import BLOCK_S
from trackres_ros.vehicle import Drift, Spells
from trackres_ros.vehicle.description import DISTURBANCES
from trackres_ros.vehicle.writing.changes import LearnedDisturbance

Range = tuple[float, float]


def spells_to_watch(term: Term, final: Fit, expected: Sequence[Array], shown: float = 1.0) -> LearnedDisturbance:
    """Spells of the final fit, with both levels relative to the written file's torque [Nm], of each session.

    The file may include the mean of the spells: then the rest level is negative. Live, the torque is that of the sessions
    over `shown`.
    """
    assert term.chain is not None
    chain = term.chain
    with_spells = torque_blocks(final, residuals_without(final, term.candidate.name))
    there = spell_probability(with_spells, chain)
    b = _over(final, expected, shown)
    level, rest, noise = levels_given(b, there)
    found = Spells(level, rest, BLOCK_S / chain.goes, BLOCK_S / chain.comes, _of_blocks(noise, final))
    count = int(beginnings(b, there).sum())
    return _learned(
        found,
        {
            "level": _about(level, found.noise / math.sqrt(there.sum())),
            "rest": _about(rest, found.noise / math.sqrt((1.0 - there).sum())),
            "mean_there": _times(found.mean_there, count),
            "mean_away": _times(found.mean_away, count),
            "noise": _times(found.noise, 2 * len(b.mean)),
        },
    )


def drift_to_watch(final: Fit, expected: Sequence[Array], shown: float = 1.0) -> LearnedDisturbance:
    """Drift relative to the written file's torque [Nm], for each session; see `spells_to_watch` for `shown`."""
    b = _over(final, expected, shown)
    drifting, _ = find_drifting_level(b)
    found = Drift(drifting.size, drifting.seconds, _of_blocks(drifting.noise, final))
    apart = max(1.0, BLOCK_S * len(b.mean) / (2.0 * drifting.seconds))  # number of independent stretches
    return _learned(
        found,
        {
            "size": _times(found.size, 2.0 * apart),
            "time_constant": _times(found.time_constant, apart),
            "noise": _times(found.noise, 2 * len(b.mean)),
        },
    )


def drift_on_held_out(final: Fit, laps: HeldOutLaps) -> Improvement:
    """Hold-out improvement by following a drift live, with the forecast from earlier blocks."""
    sessions, without = final.problem.sessions, [p.torque for p in final.predicted]
    drifting, _ = find_drifting_level(_over(final, without))
    b = torque_blocks(final, torque_residuals(final), [s.used for s in sessions])
    shape = [np.zeros(len(s)) for s in sessions]
    fill(shape, b, expected_level(b, drifting)[0])
    return laps.improvement(without, [e + x for e, x in zip(without, against_travel(sessions, shape), strict=True)])


def _over(final: Fit, expected: Sequence[Array], shown: float = 1.0) -> Blocks:
    return torque_blocks(final, [(s.torque - e) / shown for s, e in zip(final.problem.sessions, expected, strict=True)])


def _of_blocks(noise: float, final: Fit) -> float:
    """Noise of a block's mean, from that of one sample [Nm]."""
    return noise / math.sqrt(BLOCK_S / final.problem.sessions[0].step)


def _about(value: float, std: float) -> Range:
    return value - 2.0 * std, value + 2.0 * std


def _times(value: float, count: float) -> Range:
    """Range of +-2 standard deviations of the logarithm, each 1 / sqrt(count): for the mean of `count` exponential times,
    or for a standard deviation with twice that count.
    """
    factor = math.exp(2.0 / math.sqrt(count))
    return value / factor, value * factor


def _learned(found: Spells | Drift, ranges: Mapping[str, Range]) -> LearnedDisturbance:
    """Disturbance with values and ranges within the limits of a vehicle file."""
    limits = DISTURBANCES[found.form]

    def within(name: str, value: float) -> float:
        return min(max(value, limits[name].low), limits[name].high)

    values = {item.name: within(item.name, getattr(found, item.name)) for item in fields(found)}
    clipped = {name: (within(name, low), within(name, high)) for name, (low, high) in ranges.items()}
    return LearnedDisturbance(type(found)(**values), clipped)
