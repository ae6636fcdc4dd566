# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The result of a diagnosis: one of five verdicts, its grade, and a few sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from trackres_ros.diagnosis.base.base import Base
from trackres_ros.diagnosis.base.variables import BY_NAME
from trackres_ros.diagnosis.empirical.term import Term, by_improvement
from trackres_ros.diagnosis.findings.wording import (
    LEFT_OUT,
    NO_NAME,
    Possible,
    capitalise,
    confirmed_terms,
    describe_difference,
    doubts,
    file_is_off,
    is_small,
    join_sentences,
    list_possible,
    look_for,
    may_be,
    mean_error,
    moved_text,
    only_later,
    range_of,
    rejected_sentences,
    short_text,
    slow,
    taken_from,
    unexplained,
)
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.prepare.session import SensorFinding
from trackres_ros.diagnosis.selection.as_used import far_from_file, moved_parameters
from trackres_ros.diagnosis.selection.held_out import CONFIRMED, REFUTED, SUSPECTED, HeldOut
from trackres_ros.diagnosis.selection.locate import Bin, RegimeMap, SlowResidual
from trackres_ros.text import alike, figures
from trackres_ros.vehicle.writing.changes import Interval

LACK_OF_FIT_P = 0.01
LARGE_SLOW_SHARE = 0.015  # of the torque, in means over half a minute
LEFT_SHARE = 0.5  # of the effects' torque: with a larger residual, the names explain little
LEAST_GAIN = 0.01  # of the mean error on hold-out laps: least gain of a re-fit for naming the wrong values
MOST_CHANGED = 3  # values that a sentence lists


@dataclass(frozen=True, slots=True)
class Changed:
    """A value of the vehicle file that a re-fit changes."""

    name: str
    unit: str
    nominal: float  # in the file
    value: float  # re-fitted
    low: float  # of its 95 % interval
    high: float
    torque_nm: float  # root mean square of the torque change
    at_bound: bool = False  # whether it is at the end of its range: then it has no interval

    @property
    def text(self) -> str:
        """A wrong value of the vehicle file, with its change and interval."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        difference = self.value - self.nominal
        share = f"{100.0 * abs(difference / self.nominal):.0f} %" if self.nominal else f"{figures(abs(difference))}{unit}"
        value, low, high, nominal = alike((self.value, self.low, self.high, self.nominal), self.high - self.low)
        if self.at_bound:
            way = "high" if difference > 0.0 else "low"
            return f"{self.name} is at the {way} end of its range, {value}{unit} instead of {nominal}"
        side = "higher" if difference > 0.0 else "lower"
        return f"{self.name} is {share} {side}, {value} [{low}, {high}]{unit} instead of {nominal}"


def changed_values(base_fit: Fit, bounds: Mapping[tuple[str, str], Interval]) -> tuple[Changed, ...]:
    """Values whose 95 % interval excludes the file's, the largest torque change first."""
    changes = []
    for q in base_fit.problem.base.parameters:
        value, interval = base_fit.base_values[q.name], bounds.get(("", q.name))
        if interval is None or interval.low <= q.nominal <= interval.high:
            continue
        as_in_file = base_fit.problem.predict({**base_fit.base_values, q.name: q.nominal}, base_fit.acting)
        change = [
            (p.torque - file_prediction.torque)[mask]
            for p, file_prediction, mask in zip(base_fit.predicted, as_in_file, base_fit.problem.masks, strict=True)
        ]
        size = float(np.sqrt(np.mean(np.concatenate(change) ** 2)))
        changes.append(Changed(q.name, q.unit, q.nominal, value, interval.low, interval.high, size, interval.bound_only))
    return tuple(sorted(changes, key=lambda c: -c.torque_nm))


@dataclass(frozen=True, slots=True)
class Verdict:
    """The verdict of a diagnosis."""

    status: str  # ``none``, ``named``, ``one_of``, ``described`` or ``unexplained``
    grade: str  # by the hold-out laps, of the sentence's first claim: ``confirmed``, ``suspected`` or ``refuted``
    sentence: str
    may_be: Possible = ()  # unconfirmed possibilities, each with its probability if known, the most likely first
    seen: str = ""  # location and size of an unexplained difference
    changed: tuple[Changed, ...] = ()  # wrong values of the vehicle file, if that is the verdict, the largest effect first
    slow: bool = False  # whether the unexplained difference is a slow residual, at no place

    @property
    def names(self) -> bool:
        """Whether a missing effect, named or not, is confirmed."""
        return self.status in ("named", "one_of", "described")


@dataclass(frozen=True, eq=False, kw_only=True)
class Findings:
    """Inputs of a verdict."""

    terms: Sequence[Term]
    unconfirmed: Sequence[Term]  # best-fitting terms that are left out
    refitted: Fit
    at_end: RegimeMap  # residual by regime of the last fit
    left_over: SlowResidual  # of the last fit
    hint: str  # the best effect below the threshold, if any
    held_out: HeldOut
    drift: Term | None = None  # the slow residual as a level of each recording, or as a drift
    changed: Sequence[Changed] = ()  # values of the vehicle file that the re-fit changes significantly
    shares: Mapping[str, float] = field(default_factory=dict)  # probability of each name over all explanations, if known
    sensor: str = ""  # sentence about errors that the fit assumes of the torque sensor, if they matter
    unusable: str = ""  # why no command would accept a file with the re-fit; empty if one would
    sensors: Sequence[SensorFinding] = ()  # that other inputs contradict, as the warnings say
    by_load: str = ""  # a suspected term that follows the load, where only the recordings differ in that
    later: tuple[float, float] | None = None  # errors on the fitted and the hold-out laps [Nm], see `locate.only_later`

    @property
    def base(self) -> Base:
        """The model, whose noun the sentences take."""
        return self.refitted.problem.base

    @cached_property
    def left(self) -> list[Bin]:
        """Regimes with a difference between the last fit and the measured torque."""
        return [b for b in self.at_end.bins if b.p < LACK_OF_FIT_P]

    @property
    def has_slow_residual(self) -> bool:
        """Whether the slow residual is large."""
        return self.left_over.share > LARGE_SLOW_SHARE

    @cached_property
    def sure(self) -> list[Term]:
        """Terms confirmed on hold-out laps, the largest first."""
        return [t for t in by_improvement(self.terms) if t.confirmed]

    @cached_property
    def unsure(self) -> list[Term]:
        """Terms not confirmed."""
        return [t for t in by_improvement(self.terms) if not t.confirmed]

    @cached_property
    def listed(self) -> Possible:
        """Unconfirmed possibilities, without those that the hold-out laps reject."""
        rejected_names = {t.name for t in self.unconfirmed if t.grade == REFUTED}
        return list_possible(
            self.unsure, self.sure, {name: share for name, share in self.shares.items() if name not in rejected_names}
        )

    @property
    def after(self) -> list[str]:
        """Sentences that end each verdict."""
        return [self.sensor, *doubts(self.unsure), *rejected_sentences(self.unconfirmed)]

    @property
    def rest(self) -> list[str]:
        """Sentences about the residual that the confirmed terms leave."""
        return [
            f"A small error remains at {range_of(self.left[0])}" if self.left else "",
            *(slow(self.left_over) if self.has_slow_residual else []),
        ]

    @property
    def worth_of_refit(self) -> str:
        """Gain of a re-fit, if confirmed."""
        refit = self.held_out.of_refit
        return (
            mean_error(refit.before, refit.after) + f" with a re-fit of the {self.base.file}" if refit.grade == CONFIRMED else ""
        )


def judge(f: Findings) -> Verdict:
    """The verdict.

    It begins with the confirmed term that reduces the hold-out error most. Without a confirmed one it begins with
    the location and size of the difference; suspected terms are only listed. What the warnings say of sensors is in each verdict:
    first where no physics is missing, else last.
    """
    verdict, warnings = _by_terms(f), join_sentences([s.statement for s in f.sensors])
    parts = (warnings, verdict.sentence) if verdict.status == "none" else (verdict.sentence, warnings)
    return replace(verdict, sentence=" ".join(filter(None, parts)))


def _by_terms(f: Findings) -> Verdict:
    """The verdict by the terms and the residual."""
    if f.sure:
        return _confirmed(f)
    if far_from_file(f.refitted) or f.unusable:
        return _far_from_file(f)
    drift = f.drift if f.drift is not None and f.drift.confirmed else None
    follows_clock = f.has_slow_residual and all(BY_NAME[b.variable].as_clock for b in f.left)
    if drift is not None and (drift.form == "recordings" or follows_clock):
        improvement = drift.improvement
        lines = [
            drift.sentence,
            look_for(drift.mechanisms),
            mean_error(improvement.before, improvement.after),
            taken_from(drift),
        ]
        return Verdict("described", CONFIRMED, join_sentences([*lines, may_be(f.listed, is_addition=True), *f.after]), f.listed)
    return _unexplained(f) or _nothing_missing(f)


def _confirmed(f: Findings) -> Verdict:
    """The verdict with confirmed terms, unless the remaining residual is large compared with them."""
    tail = [may_be(f.listed, is_addition=True), *f.after]
    term_sum = np.concatenate([sum(x) for x in zip(*(t.adds for t in f.sure), strict=True)])
    explained_torque = float(np.percentile(np.abs(term_sum), 95.0))  # where they act, which may be minutes of an hour
    if max((abs(b.mean_residual) for b in f.left), default=0.0) > LEFT_SHARE * explained_torque:
        names, sight = " and ".join(map(short_text, f.sure)), unexplained(f.left, f.base.noun)
        partial_text = f"{names} would explain a part of it, but the remaining error is too large to confirm that"
        return Verdict("unexplained", SUSPECTED, join_sentences([sight, partial_text, *tail]), f.listed, sight)
    named_terms = [t for t in f.sure if t.is_named]
    status = "described" if not named_terms else "named" if all(len(t.members) <= 1 for t in named_terms) else "one_of"
    lines = [*confirmed_terms(f.sure, f.held_out, f.listed, f.sensors), *tail, *f.rest]
    return Verdict(status, CONFIRMED, join_sentences(lines), f.listed)


def _far_from_file(f: Findings) -> Verdict:
    """The verdict for a re-fit implausibly far from the vehicle file, or that no command would accept."""
    parameters_outside = [(q, value) for q, value in moved_parameters(f.refitted) if q.outside(value)]
    lead_sentence, *rest_sentences = file_is_off(far_from_file(f.refitted) or parameters_outside, f.base, f.by_load)
    refit = f.held_out.of_refit
    error_text = f"{mean_error(refit.before, refit.after)} with that re-fit"
    if f.unusable:
        error_text = f"No command would accept a file with them: {f.unusable}"
    lines = [lead_sentence, *rest_sentences, error_text, may_be(f.listed), *f.after]
    return Verdict("unexplained", SUSPECTED, join_sentences(lines), f.listed, lead_sentence)


def _unexplained(f: Findings) -> Verdict | None:
    """The verdict for an unexplained difference of the measured torque; None without a difference."""
    large_terms = [t for t in f.unsure if not is_small(t)]
    if f.left:
        lead_sentence, *rest_sentences = [unexplained(f.left, f.base.noun), *(slow(f.left_over) if f.has_slow_residual else [])]
    elif f.later:
        lead_sentence, *rest_sentences = only_later(*f.later)
    elif f.has_slow_residual:
        lead_sentence, *rest_sentences = slow(f.left_over)
    elif large_terms:
        lead_sentence, *rest_sentences = [describe_difference(large_terms[0])]
    else:
        return None
    hint = f"{capitalise(f.hint)} would explain a part of it, but is not confirmed" if f.hint and not f.listed else ""
    hint_text = NO_NAME if f.left and not f.listed and not hint else hint
    grades = {t.grade for t in (*f.unconfirmed, *f.unsure)}
    grade = REFUTED if grades == {REFUTED} else SUSPECTED
    lines = [lead_sentence, *rest_sentences, hint_text, may_be(f.listed), *f.after, f.worth_of_refit]
    return Verdict(
        "unexplained",
        grade,
        join_sentences(lines),
        f.listed,
        lead_sentence,
        slow=not f.left and not f.later and f.has_slow_residual,
    )


def _nothing_missing(f: Findings) -> Verdict:
    """The verdict without missing physics: values of the file were wrong, or none."""
    held_out, value_changes, possible_effects = f.held_out, f.changed, f.listed
    negation = "Apart from that, no" if f.sensors else "No"
    hint = f"{f.hint} would fit, but the model's own error can look the same" if f.hint else ""
    tail = [may_be(possible_effects, is_addition=True), *f.after, hint]
    out_of_range = moved_parameters(f.refitted)
    refit = held_out.of_refit
    error_text = mean_error(refit.before, refit.after)
    if refit.grade == CONFIRMED and refit.after < (1.0 - LEAST_GAIN) * refit.before:
        lead_sentence = (
            f"{capitalise(LEFT_OUT)} confirm no missing physics" if possible_effects else f"{negation} physics is missing"
        )
        change_sentences = [
            f"{lead_sentence}, but values of the {f.base.file} were off",
            *(c.text for c in value_changes[:MOST_CHANGED]),
        ]
        if not value_changes:
            change_sentences = [
                lead_sentence,
                f"No value of the {f.base.file} is surely off, but a re-fit of all of them predicts better",
            ]
        text = join_sentences([*change_sentences, error_text, *tail])
        return Verdict("none", CONFIRMED, text, possible_effects, changed=tuple(value_changes))
    if out_of_range:
        values = ", ".join(moved_text(q, value) for q, value in out_of_range)
        judgement = "reject" if refit.grade == REFUTED else "do not confirm"
        lines = [f"{negation} physics is missing", f"A re-fit would move parameters of the {f.base.file}: {values}"]
        grade = REFUTED if refit.grade == REFUTED else SUSPECTED
        return Verdict(
            "none", grade, join_sentences([*lines, f"The hold-out laps {judgement} that", error_text, *tail]), possible_effects
        )
    nominal, re_fitted = figures(refit.before), figures(refit.after)
    lines = [
        f"{negation} mismatch beyond noise" + (" and an error of the torque sensor" if f.sensor else ""),
        f"The mean error on hold-out laps is {nominal} Nm with the {f.base.file} and {re_fitted} Nm re-fitted",
    ]
    return Verdict("none", CONFIRMED, join_sentences([*lines, *tail]), possible_effects)
