# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The whole diagnosis, step after step; each result is frozen and can be looked at."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.base.base import Base
from trackres_ros.diagnosis.base.instrument import usual_offset
from trackres_ros.diagnosis.base.loading import LoadedBase
from trackres_ros.diagnosis.base.watched import ByPlace
from trackres_ros.diagnosis.described.describe import Term, drift
from trackres_ros.diagnosis.described.explain import explain, judged
from trackres_ros.diagnosis.described.routes import SLOPES, Route, find_route, roads_of
from trackres_ros.diagnosis.described.terms import Described
from trackres_ros.diagnosis.described.told import course, said
from trackres_ros.diagnosis.described.watching import drift_on_held_out, drift_to_watch, spells_to_watch
from trackres_ros.diagnosis.findings.change_points import Change, changes
from trackres_ros.diagnosis.findings.locate import (
    ThermalCheck,
    acts,
    against_travel,
    regime_of,
    seen_where_it_acts,
    slow_residual,
    smoothed,
    spans,
    swings_of,
    thermal_check,
)
from trackres_ros.diagnosis.findings.next_drives import Advice, advise
from trackres_ros.diagnosis.findings.residual_bins import RegimeMap, cumulative_periodogram, regime_map
from trackres_ros.diagnosis.findings.verdict import MOST_STRAY, Found, Told, Verdict, by_weight, changed_values, judge
from trackres_ros.diagnosis.inference.fitting import Fit, Problem, fit
from trackres_ros.diagnosis.inference.levels import for_tests, with_levels
from trackres_ros.diagnosis.inference.noise import Noise
from trackres_ros.diagnosis.prepare.at_rest import seconds_without_torque
from trackres_ros.diagnosis.prepare.gate import Gated
from trackres_ros.diagnosis.prepare.order import in_order
from trackres_ros.diagnosis.prepare.refuse import Refusal
from trackres_ros.diagnosis.prepare.session import Session, Split
from trackres_ros.diagnosis.prepare.split import split
from trackres_ros.diagnosis.prepare.torque_checks import inconsistent_scale_notes, nothing_to_conclude
from trackres_ros.diagnosis.prepared import prepared
from trackres_ros.diagnosis.selection.as_used import AsUsed, choose_written, inside_ranges
from trackres_ros.diagnosis.selection.confirm import Graded, leave_unconfirmed
from trackres_ros.diagnosis.selection.held_out import CONFIRMED, HeldOut, HeldOutLaps, Improvement, held_out
from trackres_ros.diagnosis.selection.intervals import Interval, intervals
from trackres_ros.diagnosis.selection.naming import Step
from trackres_ros.diagnosis.selection.screening import QUICK_REPLICATES, REPLICATES
from trackres_ros.diagnosis.writing.kept import Kept, LearnedDisturbance
from trackres_ros.effects import catalogue
from trackres_ros.effects.effect import Effect
from trackres_ros.effects.sensor.torque_offset import TorqueOffset
from trackres_ros.effects.vehicle.rotating_inertia import RotatingInertia
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.opening import open_source
from trackres_ros.recording.recording import Recording
from trackres_ros.route.learned import SLOPE, TORQUE, of_kind
from trackres_ros.text.numbers import figures

Array = NDArray[np.float64]

MOST_REFUTED = 3  # effects, before nothing more is looked for: held-out laps that decide too often are held out no more


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """All that was found.

    Attributes
    ----------
    base, gated, split
        The base model, what passed the gate, and what was held out.
    nominal
        Torque of each session with the values of the vehicle file [Nm].
    refitted, final
        The base re-fitted, and with the effects found; values as by `levels.with_levels`.
    at_base, at_end
        Residual by regime of both.
    changes
        When the residual of the re-fitted base changes its level; None where that could not be looked for.
    periodogram_p
        Probability that the last whitened residual is white.
    thermal
        Measured against simulated belt temperature, with the base re-fitted; None where none was measured.
    steps, found, refuted
        Rounds of the choice, the effects found, and those that were chosen and that held-out laps refute, or do not confirm
        beside a term without a name that they do.
    described, wanders, tracked
        Terms without a name that were found; how what is left wanders, where it does so by more than it should; and what held-out
        laps say of following that live.
    routes
        What goes by place, named or without a name: a slope, a torque, or a torque beside a slope.
    base_intervals
        Of the base's parameters in `final`.
    held_out, advice, verdict
        What it is worth, what to drive next, and what it comes to.
    kept
        What of it may be written.
    """

    base: Base
    gated: Gated
    split: Split
    nominal: tuple[Array, ...]
    refitted: Fit
    final: Fit
    at_base: RegimeMap
    at_end: RegimeMap
    changes: list[Change] | None
    periodogram_p: float
    thermal: ThermalCheck | None
    steps: tuple[Step, ...]
    found: tuple[Found, ...]
    described: tuple[Told, ...]
    wanders: Described | None
    tracked: Improvement | None
    routes: tuple[Route, ...]
    refuted: tuple[Graded, ...]
    base_intervals: dict[str, Interval]
    held_out: HeldOut
    advice: tuple[Advice, ...]
    verdict: Verdict
    kept: Kept

    @property
    def noise(self) -> Noise:
        """What whitens the residual of the last fit as far as it goes."""
        return for_tests(self.final).noise

    @property
    def modelled(self) -> tuple[str, ...]:
        """Names of all that the last fit has and the re-fitted base has not."""
        return self.final.effect_names

    @property
    def sessions(self) -> tuple[Session, ...]:
        """The recordings."""
        return self.final.problem.sessions


def read_recordings(paths: Sequence[Path], topics: Topics | None) -> list[Recording]:
    """Read recordings, each one session, in their order."""
    return in_order([Recording.from_source(open_source([path], topics)) for path in paths])


def diagnose(
    recordings: Sequence[Recording],
    vehicle: LoadedBase,
    hide: Sequence[str] = (),
    holdout: int | Sequence[str] | None = None,
    seed: int = 1,
    quick: bool = False,
    effects_dir: Path | None = None,
    keep_suspected: bool = False,
    on_stage: Callable[[str], None] = lambda _: None,
    unread: Sequence[Refusal] = (),
) -> Diagnosis:
    """Find where recordings part from a base model, which effect is left out, and what a model with it is worth.

    Parameters
    ----------
    vehicle
        See `loading.load_base`.
    hide
        Roles that are not to be read.
    holdout
        See `gate.split`.
    seed
        Of all that is drawn: equal seeds give equal results.
    quick
        Fewer draws.
    effects_dir
        Folder with effects of the user's own.
    keep_suspected
        Whether effects that fit and that held-out laps do not confirm are kept too.
    on_stage
        Takes the name of each stage.
    unread
        Recordings that could not be read.

    Raises
    ------
    InputError
        If the recordings cannot be used; says why.
    """
    rng, base = np.random.default_rng(seed), vehicle.base
    effects = {
        name: effect.beside(base.rotating_mass_factor) if isinstance(effect, RotatingInertia) else effect
        for name, effect in catalogue(effects_dir, base.facts.weight * base.facts.radius, on_tyres=not base.has_belt).items()
    }
    on_stage("gate: units, clocks, gaps")
    gated, nominal, recorded = prepared(recordings, vehicle, hide, unread)
    gated, effects = without_an_offset(gated, base, effects)
    chosen = split(gated.sessions, holdout)
    masks = tuple(chosen.training_mask(s) for s in gated.sessions)
    on_stage("re-fit of the base")
    tested = fit(Problem(base, gated.sessions, masks))
    laps = HeldOutLaps(gated.sessions, [chosen.held_out_mask(s) for s in gated.sessions], rng)
    use = AsUsed(base, gated.sessions, recorded, laps)
    refitted = inside_ranges(with_levels(tested), use)
    on_stage("where: residual by regime")
    tested_base = for_tests(refitted)
    at_base = regime_map(tested_base, rng)
    replicates = QUICK_REPLICATES if quick else REPLICATES
    on_stage("places: passes of the same streets")
    kinds = [kind for kind in (SLOPE, TORQUE) if of_kind(vehicle.route, kind) is None]
    roads = roads_of(gated.sessions) if kinds else None
    first = find_route(tested, roads, kinds) if roads is not None else None
    allowed, refuted = dict(effects), list[Graded]()
    while True:
        possible = allowed if first is None else {name: effect for name, effect in allowed.items() if name not in SLOPES}
        explanations = explain(tested, first, roads, possible, replicates, rng, on_stage, kinds)
        on_stage("what it is worth: laps held out")
        tried = judged(explanations, refitted, laps, use)
        final, graded = tried.final, tried.graded
        refuted += tried.refuted
        again = {g.name for g in tried.refuted} & allowed.keys()
        if final.effects or not again or len(refuted) >= MOST_REFUTED:
            break
        # What stood in front of the others is gone, and they are looked at anew.
        allowed = {name: effect for name, effect in allowed.items() if name not in again}
    explained = tried.explanation
    route, steps, description = explained.route, explained.steps, explained.description
    unconfirmed: tuple[Graded, ...] = ()
    if not keep_suspected:
        final, graded, unconfirmed = leave_unconfirmed(final, graded, refitted, laps)
    by_place_too = (route, *(term.route for term in description.terms.values()))
    routes = {r.candidate.name: r for r in by_place_too if r is not None and r.candidate.name in final.effect_names}
    refuted += unconfirmed
    predicted = {"refitted": refitted.predicted, "with_effects": final.predicted}
    worth = held_out(laps, {"nominal": nominal, **{stage: [p.torque for p in of] for stage, of in predicted.items()}})
    names, odd = ", ".join(s.name for s in gated.sessions), inconsistent_scale_notes(gated.sessions, nominal)
    # Recordings of different vehicles differ by load or hour too, and a term without a name takes on whatever tells them apart.
    in_catalogue = {a.effect.name for a in final.effects} - description.terms.keys()
    stages = [stage for stage in worth.r2 if in_catalogue or not odd or stage != "with_effects"]
    r2, mae = ({stage: of[stage] for stage in stages} for of in (worth.r2, worth.mae))
    refused = nothing_to_conclude(names, r2, mae, float(np.abs(laps.measured).mean()), odd)
    if refused:
        raise refused
    on_stage("what is left")
    tested_end = for_tests(final)
    at_end = regime_map(tested_end, rng)
    on_stage("how sure: intervals")
    bounds = intervals(final)
    by_name = {s.chosen.name: s for s in steps if s.chosen}
    of_base = [s.torque - p.torque for s, p in zip(gated.sessions, refitted.predicted, strict=True)]
    swings = swings_of([smoothed(s, r) for s, r in zip(gated.sessions, of_base, strict=True)])[1]
    found = []
    for active in final.effects:
        if active.effect.name in description.terms:
            continue
        adds = final.contribution(active.effect.name)
        resists = against_travel(final.problem.sessions, adds) if active.effect.acts_on != "sensor" else adds
        where = acts(final, resists)
        if isinstance(active.effect, ByPlace):
            where = replace(where, low=where.least, high=where.most)  # by the place, and by nothing that is looked over
        regime = regime_of(refitted, at_base, where)
        found.append(
            Found(
                active.effect.name,
                active.effect.text,
                active.effect.acts_on,
                active.effect.parameters,
                by_name[active.effect.name],
                active.values,
                bounds_of(active.effect.name, bounds),
                adds,
                resists,
                spans(final.problem.sessions, adds),
                where,
                regime,
                where.residual(regime[0], at_base, swings),
                graded[active.effect.name],
            )
        )
    on_stage("what to drive next")
    told = [s for s in steps if s.chosen and s.chosen.name in graded]
    told += [term.tied for name, term in description.terms.items() if term.tied is not None and name in final.effect_names]
    advice = [a for s in told for a in advise(s, vehicle.known.max_speed)]
    terms = [
        _told(description.terms[name], final, bounds, graded[name], of_base)
        for name in final.effect_names
        if name in description.terms
    ]
    found, terms = [f for f in by_weight(found) if isinstance(f, Found)], [t for t in by_weight(terms) if isinstance(t, Told)]
    left_over = slow_residual(final)
    wanders = drift(final) if left_over.share > MOST_STRAY and not terms else None
    tracked = drift_on_held_out(final, laps) if wanders is not None else None
    wandering = None if wanders is None or tracked is None else Told(wanders, [], [], {}, 0.0, Graded(wanders.form, tracked, ()))
    changed = () if final.effects else changed_values(refitted, bounds)
    verdict = judge(found, terms, tuple(refuted), refitted, at_end, left_over, steps[-1].hint, worth, wandering, changed)
    belong_to = {name: effect.belongs_to for name, effect in effects.items()}
    believed = believed_in(found, terms, verdict, belong_to, keep_suspected)
    kept = choose_written(believed, [g.name for g in graded.values() if g.grade == CONFIRMED], final, refitted, use, bounds)
    if base.has_belt:  # a road_load vehicle does not run live
        expected = use.expected(kept.values, kept.effects, alone=False)
        watched = [description.terms[t.described.name] for t in terms if may_be_kept(t, verdict, keep_suspected)]
        drifts = tracked is not None and (keep_suspected or tracked.grade == CONFIRMED)
        kept = kept.with_disturbance(to_watch(watched, drifts, final, expected))
    return Diagnosis(
        base, gated, chosen, nominal, refitted, final, at_base, at_end, changes(tested_base), cumulative_periodogram(tested_end),
        thermal_check(refitted),
        tuple(steps), tuple(found), tuple(terms), wanders, tracked, tuple(routes.values()), tuple(refuted), bounds_of("", bounds),
        worth, tuple(advice), verdict, kept,
    )  # fmt: skip


def _told(term: Term, final: Fit, bounds: Mapping[tuple[str, str], Interval], graded: Graded, of_base: Sequence[Array]) -> Told:
    name = term.candidate.name
    adds = final.contribution(name)
    seen_nm = seen_where_it_acts(final.problem.sessions, adds, of_base)
    return Told(said(term, final), adds, course(term, final), bounds_of(name, bounds), seen_nm, graded)


def bounds_of(name: str, bounds: Mapping[tuple[str, str], Interval]) -> dict[str, Interval]:
    """Intervals of the parameters of one effect."""
    return {parameter: interval for (effect, parameter), interval in bounds.items() if effect == name}


def believed_in(
    found: Sequence[Found], terms: Sequence[Told], verdict: Verdict, kinds: Mapping[str, str], keep_suspected: bool
) -> list[str]:
    """Names of the effects that may be written: the verdict stands by them, held-out laps confirm them, and all that may be
    meant belong to the same; of terms without a name, those that follow what is known at the time. Or whatever was found, if
    suspected ones are kept.

    Parameters
    ----------
    kinds
        What each effect of the catalogue belongs to.
    """

    def settled(f: Found) -> bool:
        return {kinds[m] for m in f.step.members} <= {kinds[f.name]}

    ahead = [t for t in terms if t.described.predictable]
    return [f.name for f in found if may_be_kept(f, verdict, keep_suspected) and (keep_suspected or settled(f))] + [
        t.described.name for t in ahead if may_be_kept(t, verdict, keep_suspected)
    ]


def may_be_kept(f: Found | Told, verdict: Verdict, keep_suspected: bool) -> bool:
    """Whether the verdict stands by it and held-out laps confirm it, or suspected ones are kept."""
    return keep_suspected or (verdict.names and f.graded.grade == CONFIRMED)


def to_watch(terms: Sequence[Term], drifts: bool, final: Fit, expected: Sequence[Array]) -> LearnedDisturbance | None:
    """What is to be watched for live: the spells among terms that may be kept, else a drift; None where there is neither.

    Parameters
    ----------
    expected
        Torque of each session that the written file expects [Nm].
    """
    spells = next((t for t in terms if t.chain is not None), None)
    if spells is not None:
        return spells_to_watch(spells, final, expected)
    return drift_to_watch(final, expected) if drifts else None


def without_an_offset(gated: Gated, base: Base, effects: Mapping[str, Effect]) -> tuple[Gated, dict[str, Effect]]:
    """The effects that may be found: no offset of a torque sensor that reads none at rest for long; and a note that says so."""
    none = usual_offset(base)
    seconds = seconds_without_torque(gated.sessions, none)
    if not seconds or TorqueOffset.name not in effects:
        return gated, dict(effects)
    note = f"the torque reads 0 Nm at rest, within {figures(none)} Nm, over {seconds:.0f} s: its sensor has no offset"
    return replace(gated, notes=(*gated.notes, note)), {n: e for n, e in effects.items() if n != TorqueOffset.name}
