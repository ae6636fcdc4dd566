# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The chosen explanation comes in; the range of each term, intervals and the verdict go out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from trackres_ros.diagnosis.base.patterns import ByPlace
from trackres_ros.diagnosis.empirical.finders import closest_to_slow, slow_term
from trackres_ros.diagnosis.empirical.live_disturbance import drift_on_held_out
from trackres_ros.diagnosis.empirical.statements import describe, variable_of
from trackres_ros.diagnosis.empirical.terms import Described
from trackres_ros.diagnosis.empirical.torque import against_travel
from trackres_ros.diagnosis.findings.found import NamedEffect, UnnamedTerm, by_improvement, changed_values
from trackres_ros.diagnosis.findings.locate import (
    is_like_slope,
    locate,
    only_later,
    regime_of,
    slow_residual,
    spans,
)
from trackres_ros.diagnosis.findings.residual_bins import RegimeMap, regime_map
from trackres_ros.diagnosis.findings.verdict import LARGE_SLOW_SHARE, Findings, Verdict
from trackres_ros.diagnosis.findings.verdict import judge as verdict_of
from trackres_ros.diagnosis.findings.wording import assumed_sensor
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.inference.levels import for_tests
from trackres_ros.diagnosis.prepare.session import Array
from trackres_ros.diagnosis.prepare.torque_checks import inconsistent_scale_notes, nothing_to_conclude
from trackres_ros.diagnosis.search.choice import Chosen
from trackres_ros.diagnosis.selection.as_used import Bounds
from trackres_ros.diagnosis.selection.grade import ONLY_BETWEEN, Graded
from trackres_ros.diagnosis.selection.held_out import MUCH_LARGER, HeldOut, Improvement, held_out
from trackres_ros.diagnosis.selection.intervals import intervals
from trackres_ros.diagnosis.stages.options import DiagnosisOptions
from trackres_ros.diagnosis.stages.prepare import PreparedSessions
from trackres_ros.diagnosis.stages.refit import Refitted
from trackres_ros.effects import learned
from trackres_ros.errors import InputError
from trackres_ros.vehicle.writing.changes import Interval


@dataclass(frozen=True, eq=False)
class Judgement:
    """Final terms, errors, intervals and residuals."""

    found: tuple[NamedEffect, ...]  # confirmed named effects, the largest first
    described: tuple[UnnamedTerm, ...]  # unnamed terms, the largest first
    drift: Described | None  # the slow residual, where it is larger than expected
    tracked: Improvement | None  # hold-out result of following the drift live
    held_out: HeldOut  # errors on hold-out laps
    tested_end: Fit  # the final fit with the noise that best whitens its residual
    at_end: RegimeMap  # its residual by regime
    bounds: Bounds  # intervals of the values of the final fit
    verdict: Verdict


def judge(
    prepared: PreparedSessions, base: Refitted, chosen: Chosen, options: DiagnosisOptions, rng: np.random.Generator
) -> Judgement:
    """Judge an explanation."""
    final = chosen.final
    as_file, unusable = _as_file(base, final)
    worth = _worth(prepared, base, chosen, as_file)
    options.on_stage("residual")
    tested_end = for_tests(final)
    at_end = regime_map(tested_end, rng)
    options.on_stage("confidence intervals")
    bounds = intervals(final)
    found, terms = _found(base, chosen, bounds), _terms(chosen, bounds)
    left_over = slow_residual(final)
    if left_over.share > LARGE_SLOW_SHARE:
        left_over = replace(left_over, closest=closest_to_slow(final, left_over.seconds))
    later = only_later(base.refitted, worth.mae["refitted"])
    drift = slow_term(final) if (left_over.share > LARGE_SLOW_SHARE or later) and not terms else None
    tracked = drift_on_held_out(final, base.laps) if drift is not None else None
    as_term = None if drift is None or tracked is None else UnnamedTerm(drift, [], [], {}, Graded(drift.form, tracked))
    changed = () if final.effects else changed_values(base.refitted, bounds)
    verdict = verdict_of(
        Findings(
            found=found,
            terms=terms,
            unconfirmed=chosen.unconfirmed,
            refitted=base.refitted,
            at_end=at_end,
            left_over=left_over,
            hint=chosen.last.hint,
            held_out=worth,
            drift=as_term,
            changed=changed,
            shares=chosen.shares,
            sensors=prepared.gated.sensors,
            by_load=_by_load(chosen.unconfirmed),
            later=later,
            sensor=assumed_sensor(final.instrument, worth, "with the effects" if final.effects else "of the re-fit"),
            unusable=unusable,
        )
    )
    return Judgement(tuple(found), tuple(terms), drift, tracked, worth, tested_end, at_end, bounds, verdict)


def _by_load(unconfirmed: Sequence[Graded]) -> str:
    """A suspected form over the load that differs only between the recordings; empty without one."""
    of_load = [g for g in unconfirmed if g.name.endswith(learned.VARIABLES[learned.LOAD].name)]
    return next((g.name for g in of_load if any(fault.startswith(ONLY_BETWEEN) for fault in g.faults)), "")


def _as_file(base: Refitted, final: Fit) -> tuple[Sequence[Array], str]:
    """Torque of each session from the re-fitted base as a file, thus without assumed errors of the sensor [Nm]; and why no
    command would accept that file, else empty. With effects in the final fit, another file is written.
    """
    values, unusable = base.refitted.base_values, ""
    if not final.effects:
        try:
            return base.use.expected(values, (), alone=False), ""
        except InputError as error:  # the fit may be infeasible elsewhere: a belt that burns at its greatest speed
            unusable = str(error.given)
    return [p.torque for p in base.refitted.problem.predict(values, ())], unusable


def _worth(prepared: PreparedSessions, base: Refitted, chosen: Chosen, as_file: Sequence[Array]) -> HeldOut:
    """Errors on hold-out laps; raises where they allow no conclusion."""
    predicted = {"refitted": base.refitted.predicted, "with_effects": chosen.final.predicted}
    expected = {stage: [p.torque for p in of] for stage, of in predicted.items()}
    worth = held_out(base.laps, {"nominal": prepared.nominal, **expected}, as_file)
    names = ", ".join(s.name for s in prepared.sessions)
    odd = inconsistent_scale_notes(prepared.sessions, prepared.nominal, prepared.vehicle.known.is_vehicle)
    # Different vehicles also differ by load or hour, so an unnamed term would absorb the difference between them.
    has_name = any(c.is_name for c in chosen.explanation.candidates.values())
    stages = [stage for stage in worth.r2 if has_name or not odd or stage != "with_effects"]
    r2, mae = ({stage: of[stage] for stage in stages} for of in (worth.r2, worth.mae))
    refused = nothing_to_conclude(names, r2, mae, float(np.abs(base.laps.measured).mean()), odd)
    if refused and not is_like_slope(base.refitted):
        raise refused
    final = chosen.final
    if final.effects:  # a vehicle file holds no assumed errors of the sensor
        as_file = [p.torque for p in final.problem.predict(final.base_values, final.effects)]
    error = float(np.abs(base.laps.measured - base.laps.of(as_file)).mean())
    return replace(worth, without_sensor=error) if error > MUCH_LARGER * worth.mae["with_effects"] else worth


def _found(base: Refitted, chosen: Chosen, bounds: Bounds) -> list[NamedEffect]:
    final, sessions, found = chosen.final, chosen.final.problem.sessions, []
    for active in final.effects:
        effect = active.effect
        if not chosen.is_named(effect.name):
            continue
        adds = final.contribution(effect.name)
        resists = against_travel(sessions, adds)
        where = locate(final, resists)
        if isinstance(effect, ByPlace):
            where = replace(where, low=where.least, high=where.most)  # limits by place only
        regime = regime_of(base.refitted, final, base.at_base, where)
        place, seen = effect.acts(active.values)
        found.append(
            NamedEffect(
                effect.name, effect.text, effect.acts_on, effect.parameters, chosen.steps[effect.name], active.values,
                bounds_of(effect.name, bounds), adds, resists, spans(sessions, adds), where,
                place or where.text, regime, seen or where.size(final.problem.base.noun), chosen.graded[effect.name],
            )
        )  # fmt: skip
    return [f for f in by_improvement(found) if isinstance(f, NamedEffect)]


def _terms(chosen: Chosen, bounds: Bounds) -> list[UnnamedTerm]:
    final, terms = chosen.final, []
    for name in final.effect_names:
        if not chosen.is_named(name):
            adds, term = final.contribution(name), chosen.term(name)
            course, within, instead = variable_of(term, final), bounds_of(name, bounds), chosen.instead_of(name)
            graded, alike = chosen.graded[name], chosen.variables_like(name)
            terms.append(UnnamedTerm(describe(term, final), adds, course, within, graded, instead, alike))
    return [t for t in by_improvement(terms) if isinstance(t, UnnamedTerm)]


def bounds_of(name: str, bounds: Bounds) -> dict[str, Interval]:
    """Intervals of the parameters of one effect."""
    return {parameter: interval for (effect, parameter), interval in bounds.items() if effect == name}
