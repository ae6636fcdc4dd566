# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The verdict comes in; next drives and the changes to write go out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.empirical.finders import Term
from trackres_ros.diagnosis.empirical.live_disturbance import drift_to_watch, spells_to_watch
from trackres_ros.diagnosis.findings.found import NamedEffect, UnnamedTerm
from trackres_ros.diagnosis.findings.next_drives import Advice, advise
from trackres_ros.diagnosis.findings.verdict import Verdict
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.search.choice import Chosen
from trackres_ros.diagnosis.selection.as_used import choose_written
from trackres_ros.diagnosis.selection.held_out import CONFIRMED
from trackres_ros.diagnosis.stages.judge import Judgement
from trackres_ros.diagnosis.stages.options import DiagnosisOptions
from trackres_ros.diagnosis.stages.prepare import PreparedSessions
from trackres_ros.diagnosis.stages.refit import Refitted
from trackres_ros.vehicle.writing.changes import FileChanges, LearnedDisturbance

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Concluded:
    """Next drives, and the changes that may be written."""

    advice: tuple[Advice, ...]
    kept: FileChanges


def conclude(
    prepared: PreparedSessions, base: Refitted, chosen: Chosen, judged: Judgement, options: DiagnosisOptions
) -> Concluded:
    """Choose the changes to keep and the next drives."""
    options.on_stage("next drives")
    of_vehicle = all(s.pace == 1.0 for s in prepared.sessions)  # the manoeuvres are for drivers
    advice = [a for step in chosen.steps.values() if of_vehicle for a in advise(step, prepared.vehicle.known.max_speed)]
    keep_suspected, final = options.keep_suspected, chosen.final
    kinds = {name: effect.belongs_to for name, effect in prepared.effects.items()}
    believed = believed_in(judged.found, judged.terms, judged.verdict, kinds, keep_suspected)
    confirmed = [g.name for g in chosen.graded.values() if g.confirmed]
    kept = choose_written(believed, confirmed, final, base.refitted, base.use, judged.bounds)
    expected = base.use.expected(kept.values, kept.effects, alone=False)
    watched = [chosen.term(t.described.name) for t in judged.terms if may_be_kept(t, judged.verdict, keep_suspected)]
    tracked = judged.tracked
    drifts = tracked is not None and (keep_suspected or tracked.confirmed)
    kept = kept.with_disturbance(to_watch(watched, drifts, final, expected))
    return Concluded(tuple(advice), kept)


def believed_in(
    found: Sequence[NamedEffect], terms: Sequence[UnnamedTerm], verdict: Verdict, kinds: Mapping[str, str], keep_suspected: bool
) -> list[str]:
    """Names of the effects that may be written: accepted by the verdict, confirmed on hold-out laps, and with
    all alternatives of the same kind. An unnamed term must depend on inputs known at the time. With
    `keep_suspected`, all found effects.

    Parameters
    ----------
    kinds
        Kind of each effect of the catalogue.
    """

    def settled(f: NamedEffect) -> bool:
        own = kinds.get(f.name)
        return {kinds.get(m, own) for m in f.step.members} <= {own}

    ahead = [t for t in terms if t.described.predictable]
    return [f.name for f in found if may_be_kept(f, verdict, keep_suspected) and (keep_suspected or settled(f))] + [
        t.described.name for t in ahead if may_be_kept(t, verdict, keep_suspected)
    ]


def may_be_kept(f: NamedEffect | UnnamedTerm, verdict: Verdict, keep_suspected: bool) -> bool:
    """Whether the verdict accepts the term and hold-out laps confirm it, or suspected ones are kept."""
    return keep_suspected or (verdict.names and f.graded.grade == CONFIRMED)


def to_watch(terms: Sequence[Term], drifts: bool, final: Fit, expected: Sequence[Array]) -> LearnedDisturbance | None:
    """Disturbance to estimate live: the spells among terms that may be kept, else a drift; None without either.

    Parameters
    ----------
    expected
        Torque of each session from the written file [Nm].
    """
    spells = next((t for t in terms if t.chain is not None), None)
    if spells is not None:
        return spells_to_watch(spells, final, expected)
    return drift_to_watch(final, expected) if drifts else None
