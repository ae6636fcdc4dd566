# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The verdict comes in; next drives and the changes to write go out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

from trackres_ros.diagnosis.empirical.live_disturbance import drift_to_watch, spells_to_watch
from trackres_ros.diagnosis.findings.found import NamedEffect, UnnamedTerm
from trackres_ros.diagnosis.findings.next_drives import Advice, advise
from trackres_ros.diagnosis.findings.verdict import Verdict
from trackres_ros.diagnosis.inference.failures import attempt
from trackres_ros.diagnosis.search.choice import Chosen
from trackres_ros.diagnosis.selection.as_used import choose_written
from trackres_ros.diagnosis.selection.held_out import CONFIRMED, REFUTED
from trackres_ros.diagnosis.stages.judge import Judgement
from trackres_ros.diagnosis.stages.options import DiagnosisOptions
from trackres_ros.diagnosis.stages.prepare import PreparedSessions
from trackres_ros.diagnosis.stages.refit import Refitted
from trackres_ros.effects.effect import BELONGS_TO
from trackres_ros.vehicle.writing.changes import FileChanges, LearnedDisturbance


def conclude(
    prepared: PreparedSessions, base: Refitted, chosen: Chosen, judged: Judgement, options: DiagnosisOptions
) -> tuple[tuple[Advice, ...], FileChanges]:
    """Next drives, and the changes that may be written."""
    options.on_stage("next drives")
    # The manoeuvres are for drivers.
    of_vehicle = prepared.vehicle.known.is_vehicle and all(s.pace == 1.0 for s in prepared.sessions)
    asked = [partial(advise, step, prepared.vehicle.known.max_speed) for step in chosen.steps.values() if of_vehicle]
    advice = [a for ask in asked for a in attempt("the best next drive", ask) or ()]
    keep_suspected, final = options.keep_suspected, chosen.final
    kinds = {name: effect.belongs_to for name, effect in prepared.effects.items()}
    believed = believed_in(judged.found, judged.described, judged.verdict, kinds, keep_suspected)
    confirmed = [g.name for g in chosen.graded.values() if g.confirmed]
    passing = [name for name in confirmed if chosen.term(name).chain is not None]
    kept = choose_written(believed, confirmed, final, base.refitted, base.use, judged.bounds, passing)
    names = {name for kind in BELONGS_TO for name in kept.names_of(kind)}
    # Those by place too, and those that have faded since: a disturbance is what the file lacks.
    written = [a for a in final.effects if a.effect.name in names or not base.use.written([a])]
    expected = base.use.recorded(kept.values, written)
    old = prepared.base.torque_scale  # divides the torques of the sessions; live, the scale of the written file does
    shown = (kept.values or {}).get("torque_scale", old) / old
    watched = [chosen.term(t.described.name) for t in judged.described if may_be_kept(t, judged.verdict, keep_suspected)]
    tracked = judged.tracked
    drifts = tracked is not None and (tracked.confirmed or (keep_suspected and tracked.grade != REFUTED))
    spells = next((term for term in watched if term.chain is not None), None)
    disturbance: LearnedDisturbance | None = None
    if spells is not None:
        disturbance = spells_to_watch(spells, final, expected, shown)
    elif drifts:
        disturbance = drift_to_watch(final, expected, shown)
    return tuple(advice), kept.with_disturbance(disturbance)


def believed_in(
    found: Sequence[NamedEffect], terms: Sequence[UnnamedTerm], verdict: Verdict, kinds: Mapping[str, str], keep_suspected: bool
) -> list[str]:
    """Names of the effects that may be written: accepted by the verdict, confirmed on hold-out laps, and with
    all alternatives of the same kind, by the `kinds` of the catalogue. An unnamed term must depend on inputs known at the time.
    With `keep_suspected`, all found effects except refuted ones.
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
    if keep_suspected:
        return f.graded.grade != REFUTED
    return verdict.names and f.graded.grade == CONFIRMED
