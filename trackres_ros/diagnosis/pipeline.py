# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The whole diagnosis: prepare, refit, search, judge, conclude. Each stage returns a frozen result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from trackres_ros.diagnosis.base.base import Base
from trackres_ros.diagnosis.base.loading import LoadedBase
from trackres_ros.diagnosis.empirical.finders import (
    closest_to_slow,
    describe,
    drift_on_held_out,
    drift_to_watch,
    slow_term,
    spells_to_watch,
)
from trackres_ros.diagnosis.empirical.routes import roads_of
from trackres_ros.diagnosis.empirical.spells import Chain
from trackres_ros.diagnosis.empirical.term import ONLY_BETWEEN, Round, Term, active_of, by_improvement
from trackres_ros.diagnosis.findings.next_drives import Advice, advise
from trackres_ros.diagnosis.findings.verdict import LARGE_SLOW_SHARE, Findings, Verdict, changed_values
from trackres_ros.diagnosis.findings.verdict import judge as verdict_of
from trackres_ros.diagnosis.findings.wording import assumed_sensor
from trackres_ros.diagnosis.inference.failures import attempt, failures, one_blas_thread
from trackres_ros.diagnosis.inference.fitting import Fit, Problem, fit, for_tests, with_levels
from trackres_ros.diagnosis.inference.noise import Noise
from trackres_ros.diagnosis.preparation import BY_DEFAULT, DiagnosisOptions, PreparedSessions, prepare
from trackres_ros.diagnosis.prepare.gate import Gated, in_order
from trackres_ros.diagnosis.prepare.session import Array, DriveSession, Split
from trackres_ros.diagnosis.prepare.torque_checks import inconsistent_scale_notes, nothing_to_conclude
from trackres_ros.diagnosis.search.choice import Choice, Chosen
from trackres_ros.diagnosis.search.cross_validation import CrossValidation
from trackres_ros.diagnosis.search.explanations import Search
from trackres_ros.diagnosis.selection.as_used import AsUsed, Bounds, choose_written, inside_ranges, intervals
from trackres_ros.diagnosis.selection.held_out import MUCH_LARGER, REFUTED, HeldOut, HeldOutLaps, held_out
from trackres_ros.diagnosis.selection.locate import (
    Change,
    RegimeMap,
    ThermalCheck,
    against_travel,
    changes,
    cumulative_periodogram,
    is_like_slope,
    locate,
    only_later,
    regime_map,
    regime_of,
    slow_residual,
    spans,
    thermal_check,
)
from trackres_ros.effects import learned
from trackres_ros.effects.effect import BELONGS_TO
from trackres_ros.errors import InputError
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.opening import open_source
from trackres_ros.recording.recording import Recording
from trackres_ros.route.learned import SLOPE, TORQUE, of_kind
from trackres_ros.vehicle.writing.changes import FileChanges, Interval, LearnedDisturbance


@dataclass(frozen=True, eq=False)
class Refitted:
    """The base re-fitted."""

    refitted: Fit  # with values by `fitting.with_levels`
    compared: Fit  # what terms are added to: the same, or one with values further outside the file's ranges, if surely better
    laps: HeldOutLaps
    validation: CrossValidation  # over laps
    use: AsUsed  # evaluation of a file in use
    at_base: RegimeMap  # residual by regime


def refit(preparation: PreparedSessions, options: DiagnosisOptions, rng: np.random.Generator) -> Refitted:
    """Fit the base from the values of the vehicle file, and bin its residual by regime."""
    options.on_stage("re-fit of the base")
    sessions, split_of_laps = preparation.sessions, preparation.split
    first_fit = fit(Problem(preparation.base, sessions, tuple(split_of_laps.training_mask(s) for s in sessions)))
    held_out = [split_of_laps.held_out_mask(s) for s in sessions]
    laps = HeldOutLaps(sessions, held_out, rng)
    use = AsUsed(preparation.base, sessions, preparation.recorded, laps)
    free_fit = with_levels(first_fit)
    base_fit = inside_ranges(free_fit, use)
    validation = CrossValidation(base_fit, held_out, rng)
    # A file that cannot describe the vehicle within its ranges would leave its error to the terms.
    is_better = validation.least_gain(validation.score(base_fit), validation.score(free_fit)) > 0.0
    options.on_stage("residual by regime")
    at_base = regime_map(for_tests(base_fit), rng)
    return Refitted(base_fit, free_fit if is_better else base_fit, laps, validation, use, at_base)


def search(preparation: PreparedSessions, base: Refitted, options: DiagnosisOptions) -> Chosen:
    """Search explanations, and choose one."""
    kinds = [kind for kind in (SLOPE, TORQUE) if of_kind(preparation.vehicle.route, kind) is None]
    roads = roads_of(preparation.sessions) if kinds else None
    searcher = Search(base.compared, preparation.effects, roads, kinds, base.validation, options.on_stage)
    searcher.run()
    options.on_stage("cross-validation over laps")
    choice = Choice(searcher, base.refitted, base.laps, base.use).best(options.keep_suspected)
    if choice.explanation.key:
        return choice
    return replace(choice, explanation=replace(choice.explanation, fit=base.refitted))


@dataclass(frozen=True, eq=False)
class Judgement:
    """Final terms, errors, intervals and residuals."""

    terms: tuple[Term, ...]  # of the final fit, named or not: confirmed ones first, then the largest
    drift: Term | None  # the slow residual, where it is larger than expected, with the hold-out result of following it live
    held_out: HeldOut  # errors on hold-out laps
    tested_end: Fit  # the final fit with the noise that best whitens its residual
    at_end: RegimeMap  # its residual by regime
    bounds: Bounds  # intervals of the values of the final fit
    verdict: Verdict

    @property
    def found(self) -> tuple[Term, ...]:
        """Named effects, in the order of the terms."""
        return tuple(t for t in self.terms if t.is_named)

    @property
    def described(self) -> tuple[Term, ...]:
        """Terms without a name, in the order of the terms."""
        return tuple(t for t in self.terms if not t.is_named)


def judge(
    preparation: PreparedSessions, base: Refitted, choice: Chosen, options: DiagnosisOptions, rng: np.random.Generator
) -> Judgement:
    """Judge an explanation."""
    final_fit = choice.final
    as_file, file_error = _as_file(base, final_fit)
    errors = _held_out_errors(preparation, base, choice, as_file)
    options.on_stage("residual")
    tested_end = for_tests(final_fit)
    at_end = regime_map(tested_end, rng)
    options.on_stage("confidence intervals")
    bounds = intervals(final_fit)
    terms = by_improvement([_in_final_fit(term, base, final_fit, bounds) for term in choice.explanation.terms.values()])
    has_unnamed = any(not t.is_named for t in terms)
    slow_part = slow_residual(final_fit)
    if slow_part.share > LARGE_SLOW_SHARE:
        slow_part = replace(slow_part, closest=closest_to_slow(final_fit, slow_part.seconds))
    later_errors = only_later(base.refitted, errors.mae["refitted"])
    drift = slow_term(final_fit) if (slow_part.share > LARGE_SLOW_SHARE or later_errors) and not has_unnamed else None
    if drift is not None:
        drift = replace(drift, improvement=drift_on_held_out(final_fit, base.laps))
    value_changes = () if final_fit.effects else changed_values(base.refitted, bounds)
    verdict = verdict_of(
        Findings(
            terms=terms,
            unconfirmed=choice.unconfirmed,
            refitted=base.refitted,
            at_end=at_end,
            left_over=slow_part,
            hint=choice.last.hint,
            held_out=errors,
            drift=drift,
            changed=value_changes,
            shares=choice.shares,
            sensors=preparation.gated.sensors,
            by_load=_by_load(choice.unconfirmed),
            later=later_errors,
            sensor=assumed_sensor(final_fit.instrument, errors, "with the effects" if final_fit.effects else "of the re-fit"),
            unusable=file_error,
        )
    )
    return Judgement(tuple(terms), drift, errors, tested_end, at_end, bounds, verdict)


def _by_load(terms: Sequence[Term]) -> str:
    """A suspected form over the load that differs only between the recordings; empty without one."""
    load_terms = [t for t in terms if t.name.endswith(learned.VARIABLES[learned.LOAD].name)]
    return next((t.name for t in load_terms if any(fault.startswith(ONLY_BETWEEN) for fault in t.faults)), "")


def _as_file(base: Refitted, final_fit: Fit) -> tuple[Sequence[Array], str]:
    """Torque of each session from the re-fitted base as a file, thus without assumed errors of the sensor [Nm]; and why no
    command would accept that file, else empty. With effects in the final fit, another file is written.
    """
    values, file_error = base.refitted.base_values, ""
    if not final_fit.effects:
        try:
            return base.use.expected(values, (), is_alone=False), ""
        except InputError as error:  # the fit may be infeasible elsewhere: a belt that burns at its greatest speed
            file_error = str(error.given)
    return [p.torque for p in base.refitted.problem.predict(values, ())], file_error


def _held_out_errors(preparation: PreparedSessions, base: Refitted, choice: Chosen, as_file: Sequence[Array]) -> HeldOut:
    """Errors on hold-out laps; raises where they allow no conclusion."""
    predictions = {"refitted": base.refitted.predicted, "with_effects": choice.final.predicted}
    torques_by_stage = {stage: [p.torque for p in values] for stage, values in predictions.items()}
    errors = held_out(base.laps, {"nominal": preparation.nominal, **torques_by_stage}, as_file)
    names = ", ".join(s.name for s in preparation.sessions)
    scale_notes = inconsistent_scale_notes(preparation.sessions, preparation.nominal, preparation.vehicle.known.is_vehicle)
    # Different vehicles also differ by load or hour, so an unnamed term would absorb the difference between them.
    has_name = any(term.is_name for term in choice.explanation.terms.values())
    stages = [stage for stage in errors.r2 if has_name or not scale_notes or stage != "with_effects"]
    r2, mae = ({stage: values[stage] for stage in stages} for values in (errors.r2, errors.mae))
    refusal = nothing_to_conclude(names, r2, mae, float(np.abs(base.laps.measured).mean()), scale_notes)
    if refusal and not is_like_slope(base.refitted):
        raise refusal
    final_fit = choice.final
    if final_fit.effects:  # a vehicle file holds no assumed errors of the sensor
        as_file = [p.torque for p in final_fit.problem.predict(final_fit.base_values, final_fit.effects)]
    error = float(np.abs(base.laps.measured - base.laps.samples(as_file)).mean())
    return replace(errors, without_sensor=error) if error > MUCH_LARGER * errors.mae["with_effects"] else errors


def _in_final_fit(term: Term, base: Refitted, final_fit: Fit, bounds: Bounds) -> Term:
    """A term with its values in the final fit, and its place or its sentences."""
    values, torques = active_of(final_fit, term.name).values, final_fit.contribution(term.name)
    term = replace(term, values=values, intervals=bounds_of(term.name, bounds), adds=torques)
    if not term.is_named:
        return describe(term, final_fit)
    sessions = final_fit.problem.sessions
    location = locate(final_fit, against_travel(sessions, torques))
    if term.is_by_place:
        location = replace(location, low=location.least, high=location.most)  # limits by place only
    place, sight = term.effect.acts(values)
    return replace(
        term,
        spans=spans(sessions, torques),
        location=location,
        place=place or location.text,
        seen=sight or location.size(final_fit.problem.base.noun),
        regime=regime_of(base.refitted, final_fit, base.at_base, location),
    )


def bounds_of(name: str, bounds: Bounds) -> dict[str, Interval]:
    """Intervals of the parameters of one effect."""
    return {parameter: interval for (effect, parameter), interval in bounds.items() if effect == name}


def conclude(
    preparation: PreparedSessions, base: Refitted, choice: Chosen, judgement: Judgement, options: DiagnosisOptions
) -> tuple[tuple[Advice, ...], FileChanges]:
    """Next drives, and the changes that may be written."""
    options.on_stage("next drives")
    terms = choice.explanation.terms.values()
    # The manoeuvres are for drivers.
    is_vehicle = preparation.vehicle.known.is_vehicle and all(s.pace == 1.0 for s in preparation.sessions)
    tasks = [partial(advise, term, preparation.vehicle.known.max_speed) for term in terms if is_vehicle]
    advice = [a for task in tasks for a in attempt("the best next drive", task) or ()]
    keep_suspected, final_fit = options.keep_suspected, choice.final
    kinds = {name: effect.belongs_to for name, effect in preparation.effects.items()}
    believed_names = credible_names(judgement.terms, judgement.verdict, kinds, keep_suspected)
    confirmed_names = [t.name for t in terms if t.confirmed]
    spell_names = [t.name for t in terms if t.confirmed and isinstance(t.pattern, Chain)]
    file_changes = choose_written(
        believed_names, confirmed_names, final_fit, base.refitted, base.use, judgement.bounds, spell_names
    )
    names = {name for kind in BELONGS_TO for name in file_changes.names_of(kind)}
    # Those by place too, and those that have faded since: a disturbance is what the file lacks.
    written_effects = [a for a in final_fit.effects if a.effect.name in names or not base.use.written([a])]
    model_torques = base.use.recorded(file_changes.values, written_effects)
    file_scale = preparation.base.torque_scale  # divides the torques of the sessions; live, the scale of the written file does
    sensor_scale = (file_changes.values or {}).get("torque_scale", file_scale) / file_scale
    spell_terms = [
        t for t in judgement.terms if isinstance(t.pattern, Chain) and may_be_kept(t, judgement.verdict, keep_suspected)
    ]
    drift, spells = judgement.drift, next(iter(spell_terms), None)
    drift_is_kept = drift is not None and (drift.confirmed or (keep_suspected and drift.grade != REFUTED))
    disturbance: LearnedDisturbance | None = None
    if spells is not None:
        disturbance = spells_to_watch(spells, final_fit, model_torques, sensor_scale)
    elif drift_is_kept:
        disturbance = drift_to_watch(final_fit, model_torques, sensor_scale)
    return tuple(advice), file_changes.with_disturbance(disturbance)


def credible_names(terms: Sequence[Term], verdict: Verdict, kinds: Mapping[str, str], keep_suspected: bool) -> list[str]:
    """Names of the effects that may be written: accepted by the verdict, confirmed on hold-out laps, and with
    all alternatives of the same kind, by the `kinds` of the catalogue. An unnamed term must depend on inputs known at the time.
    With `keep_suspected`, all found effects except refuted ones.
    """

    def is_settled(t: Term) -> bool:
        kind = kinds.get(t.name)
        return keep_suspected or {kinds.get(m, kind) for m in t.members} <= {kind}

    terms_kept = [t for t in terms if may_be_kept(t, verdict, keep_suspected)]
    return [t.name for t in terms_kept if (is_settled(t) if t.is_named else t.predictable)]


def may_be_kept(t: Term, verdict: Verdict, keep_suspected: bool) -> bool:
    """Whether the verdict accepts the term and hold-out laps confirm it, or suspected ones are kept."""
    return t.grade != REFUTED if keep_suspected else verdict.names and t.confirmed


@dataclass(frozen=True, eq=False)
class Diagnosis(Judgement):
    """Result of a diagnosis.

    Attributes
    ----------
    base, gated, split
        The base model, the sessions that passed the gate, and the split into fitted and hold-out laps.
    nominal
        Torque of each session with the values of the vehicle file [Nm].
    refitted, at_base
        The re-fitted base, with values from `fitting.with_levels`, and its residual by regime.
    final, shares
        The same with the effects found; and the probability of each name, and of no name.
    alone, last, unconfirmed
        The search rounds from the base alone and from all terms; and the best-fitting terms that cross-validation does not
        confirm.
    advice, kept
        Next drives, and changes that may be written.
    """

    base: Base
    gated: Gated
    split: Split
    nominal: tuple[Array, ...]
    refitted: Fit
    at_base: RegimeMap
    final: Fit
    shares: Mapping[str, float]
    alone: Round
    last: Round
    unconfirmed: tuple[Term, ...]
    advice: tuple[Advice, ...]
    kept: FileChanges

    @cached_property
    def changes(self) -> list[Change]:
        """Level changes in the residual of the re-fitted base."""
        return changes(for_tests(self.refitted))

    @cached_property
    def periodogram_p(self) -> float:
        """Probability that the final whitened residual is white."""
        return cumulative_periodogram(self.tested_end)

    @cached_property
    def thermal(self) -> ThermalCheck | None:
        """Measured against simulated belt temperature, from the re-fitted base; None without a measured one."""
        return thermal_check(self.refitted)

    @property
    def base_intervals(self) -> dict[str, Interval]:
        """Intervals of the base's parameters in `final`."""
        return bounds_of("", self.bounds)

    @property
    def noise(self) -> Noise:
        """Noise model that best whitens the residual of the last fit."""
        return self.tested_end.noise

    @property
    def in_order(self) -> list[Term]:
        """The terms in the order of the final fit."""
        return [next(t for t in self.terms if t.name == name) for name in self.modelled]

    @property
    def modelled(self) -> tuple[str, ...]:
        """Names of the terms that the last fit adds to the re-fitted base."""
        return self.final.effect_names

    @property
    def sessions(self) -> tuple[DriveSession, ...]:
        """The recordings."""
        return self.final.problem.sessions


def read_recordings(paths: Sequence[Path], topics: Topics | None) -> list[Recording]:
    """Read recordings in the given order, one session each."""
    sources = [open_source([path], topics) for path in paths]
    return in_order([replace(Recording.from_source(source), bindings=source.bindings) for source in sources])


@one_blas_thread()
def diagnose(recordings: Sequence[Recording], vehicle: LoadedBase, options: DiagnosisOptions = BY_DEFAULT) -> Diagnosis:
    """Find where recordings differ from a base model, the missing effects, and the error of the improved model.

    Parameters
    ----------
    vehicle
        See `loading.load_base`.

    Raises
    ------
    InputError
        If the recordings cannot be used, with the reason.
    """
    rng = np.random.default_rng(options.seed)
    preparation = prepare(recordings, vehicle, options)
    with failures() as failure_notes:
        base = refit(preparation, options, rng)
        choice = search(preparation, base, options)
        judgement = judge(preparation, base, choice, options, rng)
        advice, file_changes = conclude(preparation, base, choice, judgement, options)
    return Diagnosis(
        **vars(judgement),
        base=preparation.base,
        gated=replace(preparation.gated, notes=(*preparation.gated.notes, *failure_notes)),
        split=preparation.split,
        nominal=preparation.nominal,
        refitted=base.refitted,
        at_base=base.at_base,
        final=choice.final,
        shares=choice.shares,
        alone=choice.alone,
        last=choice.last,
        unconfirmed=choice.unconfirmed,
        advice=advice,
        kept=file_changes,
    )
