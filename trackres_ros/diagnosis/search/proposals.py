# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Proposes additions to an explanation: the few that predict the level best, and the few that whitening favours.

Most missing physics is slow: block means show it, see `selection.level_errors`. What is fast only the whitened likelihood shows:
a delay, a gain, an inertia. Neither judges; both lists go to the laps left out.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trackres_ros.diagnosis.empirical.forms import candidates, clock_forms, scanned_forms, series, variable_codes
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.prepare.session import Array, Mask
from trackres_ros.diagnosis.selection.level_errors import Amplitudes, Levels
from trackres_ros.diagnosis.selection.visibility import (
    EffectColumns,
    Proposal,
    Separability,
    amplitude_bounds,
    amplitude_spans,
    base_columns,
    separability,
)
from trackres_ros.effects.effect import Effect
from trackres_ros.effects.learned import EmpiricalEffect, sized_effect
from trackres_ros.progress import counted

BEST = 4  # of each list
TIED = ("torque_gain", "speed_scale", "rotating_inertia", "drivetrain_efficiency", "grade")
"""Names that most drives hardly separate: where one is proposed, the others are, too."""
LEAST_BEGUN = 0.05  # of the typical size: at zero, the shape of a term has no influence
BEGUN_WITHIN = 20.0  # typical sizes


@dataclass(frozen=True, eq=False)
class Proposals:
    """The proposals for one explanation, and how many terms they were chosen from."""

    own: Array  # derivatives of the fit's own parameters
    by_name: Mapping[str, Proposal]  # by name
    separability: Separability

    def best(self, left_out: Collection[str]) -> tuple[Proposal, ...]:
        """The best of each list, without some names; with one of `TIED`, all of these."""
        pool = [p for name, p in self.by_name.items() if name not in left_out]
        threshold = math.log(max(len(self.by_name), 1))  # the best of as many gains that by chance
        by_level = sorted(pool, key=lambda p: -p.level)[:BEST]
        by_white = sorted(pool, key=lambda p: -p.fast_gain)[:BEST]
        proposals = {p.effect.name: p for p in (*by_level, *by_white) if max(p.level, p.fast_gain) > threshold}
        if not proposals.keys().isdisjoint(TIED):
            proposals |= {p.effect.name: p for p in pool if p.effect.name in TIED}
        return tuple(proposals.values())


class Proposer:
    """Proposes names of a catalogue and forms; their first-order columns are those about the base."""

    def __init__(self, base: Fit, effects: Mapping[str, Effect], used_masks: Sequence[Mask]) -> None:
        self._pool = {**effects, **candidates(base)}
        self._columns, self._used_masks = EffectColumns(base), used_masks

    def proposals(self, current: Fit) -> Proposals:
        """The best additions to a fit."""
        own_columns = base_columns(current)
        levels = Levels(current, own_columns, self._used_masks)
        present_effects = [a.effect for a in current.effects]
        pool = {**self._pool, **self._scanned_forms(current, levels)}
        pool = {key: e for key, e in pool.items() if not any(e.name == p.name or same_variable(e, p) for p in present_effects)}
        separability_now = separability(pool, current, own_columns, self._columns)
        proposal_by_name: dict[str, Proposal] = {}
        for s in counted(separability_now.visible, "levels left out", len(separability_now.visible)):
            proposal = _proposal(s, levels)
            previous_proposal = proposal_by_name.get(proposal.effect.name)
            if previous_proposal is None:
                proposal_by_name[proposal.effect.name] = proposal
            else:
                proposal_by_name[proposal.effect.name] = _stronger(previous_proposal, proposal)
        return Proposals(own_columns, proposal_by_name, separability_now)

    def _scanned_forms(self, current: Fit, levels: Levels) -> dict[str, Effect]:
        """Forms whose thresholds depend on the residual."""
        facts, effects = current.problem.base.facts, dict[str, Effect]()
        self._columns.forget()
        forms = scanned_forms(current, levels, {code: series(code, current) for code in variable_codes(current)})
        for form, rows in (*forms, *clock_forms(current, levels)):
            effect = sized_effect(form, facts.weight * facts.radius) if isinstance(form, EmpiricalEffect) else form
            self._columns.give(effect, rows[:, np.newaxis])
            effects[f"scanned {form.name}"] = effect
        return effects


def same_variable(effect: Effect, other_effect: Effect) -> bool:
    """Whether both are forms over the same variable: then one of them describes it, and not a sum of both."""
    if not (
        isinstance(effect, EmpiricalEffect)
        and isinstance(other_effect, EmpiricalEffect)
        and effect.is_function
        and other_effect.is_function
    ):
        return False
    return effect.variable == other_effect.variable


def _stronger(first_proposal: Proposal, second_proposal: Proposal) -> Proposal:
    """The start with the larger gain; each list has the best of both."""
    strong_proposal = max(first_proposal, second_proposal, key=lambda p: max(p.level, p.fast_gain))
    return replace(
        strong_proposal,
        level=max(first_proposal.level, second_proposal.level),
        fast_gain=max(first_proposal.fast_gain, second_proposal.fast_gain),
    )


def _proposal(s: Proposal, levels: Levels) -> Proposal:
    """Gains of an effect from one start, and initial values by the list that favours it."""
    spans, (low, high) = amplitude_spans(s.effect), amplitude_bounds(s.effect)
    candidate = Amplitudes(levels.means(s.columns) * spans, low, high)
    level = levels.gain(candidate)
    amplitudes = levels.start(candidate) if level >= s.fast_gain else s.amplitudes
    return replace(s, start=_initial_values(s, amplitudes), level=level)


def _initial_values(s: Proposal, amplitude_shift: Array) -> dict[str, float]:
    """Initial values: the first-order optimum, but not zero, where the shape has no influence."""
    values = dict(s.start)
    amplitudes = [q for q in s.effect.parameters if q.off is not None]
    amplitude_shift = np.clip(amplitude_shift, -BEGUN_WITHIN, BEGUN_WITHIN)
    if len(amplitude_shift) == 1 and abs(amplitude_shift[0]) < LEAST_BEGUN:
        low, high = amplitude_bounds(s.effect)
        initial = np.copysign(LEAST_BEGUN, amplitude_shift)
        amplitude_shift = np.where((initial < low) | (initial > high), -initial, initial)
    for q, share in zip(amplitudes, amplitude_shift.tolist(), strict=True):
        assert q.off is not None
        values[q.name] = float(np.clip(q.off + share * (q.start - q.off), q.low, q.high))
    return values
