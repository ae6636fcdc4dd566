# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The result of a diagnosis: one of five verdicts, its grade, and a few sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from trackres_ros.diagnosis.base.variables import BY_NAME
from trackres_ros.diagnosis.empirical.terms import Described
from trackres_ros.diagnosis.findings.found import Changed, NamedEffect, Told, by_weight, changed_values
from trackres_ros.diagnosis.findings.locate import SlowResidual
from trackres_ros.diagnosis.findings.residual_bins import Bin, RegimeMap
from trackres_ros.diagnosis.findings.wording import (
    Possible,
    confirmed_terms,
    differs,
    doubts,
    file_is_off,
    is_small,
    joined,
    likelier,
    look_for,
    may_be,
    mean_error,
    moved,
    only_later,
    possible,
    range_of,
    rejected,
    short,
    slow,
    unexplained,
)
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.selection.confirm import Graded, far_from_file, moved_parameters
from trackres_ros.diagnosis.selection.held_out import CONFIRMED, REFUTED, SUSPECTED, HeldOut
from trackres_ros.text.numbers import figures

__all__ = [
    "MOST_STRAY",
    "Changed",
    "Findings",
    "NamedEffect",
    "Told",
    "Verdict",
    "by_weight",
    "changed_values",
    "judge",
    "likelier",
]

LACK_OF_FIT_P = 0.01
MOST_STRAY = 0.015  # of the torque, in means over half a minute
LEFT_SHARE = 0.5  # of the effects' torque: with a larger residual, the names explain little
LEAST_GAIN = 0.01  # of the mean error on hold-out laps: least gain of a re-fit for naming the wrong values
MOST_CHANGED = 3  # values that a sentence lists


@dataclass(frozen=True, slots=True)
class Verdict:
    """The verdict of a diagnosis.

    Attributes
    ----------
    status
        ``none``, ``named``, ``one_of``, ``described`` or ``unexplained``.
    grade
        Hold-out grade of the sentence's first claim: ``confirmed``, ``suspected`` or ``refuted``.
    sentence
        The verdict in words.
    changed
        Wrong values of the vehicle file, if that is the verdict, the largest effect first.
    may_be
        Unconfirmed possibilities, each with its probability if known, the most likely first.
    seen
        Location and size of an unexplained difference.
    """

    status: str
    grade: str
    sentence: str
    changed: tuple[Changed, ...] = ()
    may_be: Possible = ()
    seen: str = ""

    @property
    def names(self) -> bool:
        """Whether a missing effect, named or not, is confirmed."""
        return self.status in ("named", "one_of", "described")


@dataclass(frozen=True, eq=False, kw_only=True)
class Findings:
    """Inputs of a verdict.

    Attributes
    ----------
    found, terms, refuted
        Named effects and unnamed terms that fit, and those that the hold-out laps reject.
    refitted, at_end, left_over
        The re-fitted base; the residual by regime of the last fit, and the slow part of it.
    hint, held_out
        The best effect below the threshold, if any; and the errors on hold-out laps.
    drift
        The slow residual as a level of each recording, or as a drift, if it is either.
    changed
        Values of the vehicle file that the re-fit changes significantly, see `changed_values`.
    shares
        Probability of each name over all explanations, with `wording.NONE_OF_THESE`. Without it the weights within each
        suspected class are listed.
    spread
        The regime with larger oscillations, if any. It is the verdict if all else is small or unconfirmed.
    later
        Errors on the fitted and on the hold-out laps [Nm], if the latter is much larger, see `locate.only_later`.
    """

    found: Sequence[NamedEffect]
    terms: Sequence[Told]
    refuted: Sequence[Graded]
    refitted: Fit
    at_end: RegimeMap
    left_over: SlowResidual
    hint: str
    held_out: HeldOut
    drift: Told | None = None
    changed: Sequence[Changed] = ()
    shares: Mapping[str, float] = field(default_factory=dict)
    spread: Described | None = None
    later: tuple[float, float] | None = None

    @cached_property
    def left(self) -> list[Bin]:
        """Regimes with a difference between the last fit and the measured torque."""
        return [b for b in self.at_end.bins if b.p < LACK_OF_FIT_P]

    @property
    def strays(self) -> bool:
        """Whether the slow residual is large."""
        return self.left_over.share > MOST_STRAY

    @cached_property
    def sure(self) -> list[NamedEffect | Told]:
        """Terms confirmed on hold-out laps, the largest first."""
        return [t for t in by_weight([*self.found, *self.terms]) if t.graded.grade == CONFIRMED]

    @cached_property
    def unsure(self) -> list[NamedEffect | Told]:
        """Terms not confirmed."""
        return [t for t in by_weight([*self.found, *self.terms]) if t.graded.grade != CONFIRMED]

    @cached_property
    def listed(self) -> Possible:
        """Unconfirmed possibilities."""
        return possible(self.unsure, self.sure, self.shares)

    @property
    def shakes(self) -> list[str]:
        """Sentences about larger oscillations."""
        return [] if self.spread is None else [self.spread.sentence, look_for(self.spread.mechanisms)]

    @property
    def after(self) -> list[str]:
        """Sentences that end each verdict."""
        return [*doubts([t.graded for t in self.unsure]), *rejected(self.refuted)]

    @property
    def rest(self) -> list[str]:
        """Sentences about the residual that the confirmed terms leave."""
        return [
            f"A small error remains {range_of(self.left[0])}" if self.left else "",
            *(slow(self.left_over) if self.strays else []),
        ]

    @property
    def worth_of_refit(self) -> str:
        """Gain of a re-fit, if confirmed."""
        refit = self.held_out.of_refit
        return mean_error(refit.before, refit.after) + " with a re-fit of the vehicle file" if refit.grade == CONFIRMED else ""


def judge(f: Findings) -> Verdict:
    """The verdict.

    It begins with the confirmed term that reduces the hold-out error most. Without a confirmed one it begins with
    the location and size of the difference; suspected terms are only listed.
    """
    if f.sure:
        return _confirmed(f)
    if far_from_file(f.refitted):
        return _far_from_file(f)
    if f.drift is not None and f.drift.graded.grade == CONFIRMED and _lasts(f.drift, f.left, f.strays):
        lines = [*_of_drift(f.drift), *f.shakes, may_be(f.listed, also=True), *f.after]
        return Verdict("described", CONFIRMED, joined(lines), (), f.listed)
    beside = max([*(abs(b.mean_residual) for b in f.left), f.left_over.size if f.strays else 0.0])
    if f.spread is not None and beside <= LEFT_SHARE * f.spread.size_nm:
        lines = [*f.shakes, may_be(f.listed, also=True), *f.after, *f.rest, f.worth_of_refit]
        return Verdict("described", CONFIRMED, joined(lines), (), f.listed)
    return _unexplained(f) or _nothing_missing(f)


def _confirmed(f: Findings) -> Verdict:
    """The verdict with confirmed terms, unless the remaining residual is large compared with them."""
    after = [*f.shakes, may_be(f.listed, also=True), *f.after]
    added = np.concatenate([sum(x) for x in zip(*(t.adds for t in f.sure), strict=True)])
    explained = float(np.percentile(np.abs(added), 95.0))  # where they act, which may be minutes of an hour
    if max((abs(b.mean_residual) for b in f.left), default=0.0) > LEFT_SHARE * explained:
        partly = (
            f"{' and '.join(map(short, f.sure))} would explain a part of it, but the remaining error is too large to confirm that"
        )
        seen = unexplained(f.left)
        return Verdict("unexplained", SUSPECTED, joined([seen, partly, *after]), (), f.listed, seen)
    named = [t for t in f.sure if isinstance(t, NamedEffect)]
    status = "described" if not named else "named" if all(len(t.step.members) <= 1 for t in named) else "one_of"
    return Verdict(status, CONFIRMED, joined([*confirmed_terms(f.sure, f.held_out), *after, *f.rest]), (), f.listed)


def _far_from_file(f: Findings) -> Verdict:
    """The verdict for a re-fit implausibly far from the vehicle file."""
    seen, *more = file_is_off(far_from_file(f.refitted))
    worth = mean_error(f.held_out.mae["nominal"], f.held_out.mae["refitted"]) + " with that re-fit"
    lines = [seen, *more, worth, *f.shakes, may_be(f.listed), *f.after]
    return Verdict("unexplained", SUSPECTED, joined(lines), (), f.listed, seen)


def _unexplained(f: Findings) -> Verdict | None:
    """The verdict for an unexplained difference of the measured torque; None without a difference."""
    large = [t for t in f.unsure if not is_small(t)]
    if f.left:
        seen, *more = [unexplained(f.left)]
    elif f.later:
        seen, *more = only_later(*f.later)
    elif f.strays:
        seen, *more = slow(f.left_over)
    elif large:
        seen, *more = [differs(large[0])]
    else:
        return None
    nothing = "No effect of the catalogue explains it" if f.left and not f.listed else ""
    grade = REFUTED if f.refuted and not f.unsure else SUSPECTED
    lines = [seen, *more, nothing, *f.shakes, may_be(f.listed), *f.after, f.worth_of_refit]
    return Verdict("unexplained", grade, joined(lines), (), f.listed, seen)


def _lasts(drift: Told, left: Sequence[Bin], strays: bool) -> bool:
    """Whether the residual is a level of each recording, or follows only the clock."""
    return drift.described.form == "recordings" or (strays and all(BY_NAME[b.variable].as_clock for b in left))


def _of_drift(drift: Told) -> list[str]:
    i = drift.graded.improvement
    return [
        drift.described.sentence,
        look_for(drift.described.mechanisms),
        "The model cannot predict it",
        f"{mean_error(i.before, i.after)} when the live estimate tracks it",
    ]


def _nothing_missing(f: Findings) -> Verdict:
    """The verdict without missing physics: values of the file were wrong, or none."""
    held_out, changed, listed = f.held_out, f.changed, f.listed
    after = [may_be(listed, also=True), *f.after]
    if f.hint:
        after = [*after, f"{f.hint} would fit, but the model's own error can look the same"]
    out_of_range = moved_parameters(f.refitted)
    refit = held_out.of_refit
    worth = mean_error(held_out.mae["nominal"], held_out.mae["refitted"])
    if refit.grade == CONFIRMED and (out_of_range or refit.after < (1.0 - LEAST_GAIN) * refit.before):
        missing = "The hold-out laps confirm no missing physics" if listed else "No physics is missing"
        which = "values of the vehicle file were off" if changed else "several values of the vehicle file were off together"
        off = [c.text for c in changed[:MOST_CHANGED]]
        text = joined([f"{missing}, but {which}", *off, worth, *after])
        return Verdict("none", CONFIRMED, text, tuple(changed), listed)
    if out_of_range:
        values = ", ".join(moved(q, value) for q, value in out_of_range)
        judged = "reject" if refit.grade == REFUTED else "do not confirm"
        lines = ["No physics is missing", f"A re-fit would move parameters of the vehicle file: {values}"]
        return Verdict("none", refit.grade, joined([*lines, f"The hold-out laps {judged} that", worth, *after]), (), listed)
    nominal, re_fitted = (figures(held_out.mae[stage]) for stage in ("nominal", "refitted"))
    lines = [
        "No mismatch beyond noise",
        f"The mean error on hold-out laps is {nominal} Nm with the vehicle file and {re_fitted} Nm re-fitted",
    ]
    return Verdict("none", CONFIRMED, joined([*lines, *after]), (), listed)
