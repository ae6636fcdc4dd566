# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The result of a diagnosis: one of five verdicts, its grade, and a few sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

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

__all__ = ["MOST_STRAY", "Changed", "NamedEffect", "Told", "Verdict", "by_weight", "changed_values", "judge", "likelier"]

LACK_OF_FIT_P = 0.01
MOST_STRAY = 0.015  # of the torque, in means over half a minute
LEFT_SHARE = 0.5  # of what the effects explain: more left over, and the names explain little
LEAST_GAIN = 0.01  # of the mean error on hold-out laps: a re-fit that gains more says which values were off
MOST_CHANGED = 3  # values that a sentence lists
NO_SHARES: Mapping[str, float] = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class Verdict:
    """The result.

    Attributes
    ----------
    status
        ``none``, ``named``, ``one_of``, ``described`` or ``unexplained``.
    grade
        Whether laps not used for fitting confirm what the sentence begins with: ``confirmed``, ``suspected`` or ``refuted``.
    sentence
        In words.
    changed
        Values of the vehicle file that were off, where that is the verdict, the weightiest first.
    may_be
        What is possible and not confirmed, each with its probability where that is known, the likeliest first.
    seen
        Where and by how much the measured torque differs, where nothing explains that.
    """

    status: str
    grade: str
    sentence: str
    changed: tuple[Changed, ...] = ()
    may_be: Possible = ()
    seen: str = ""

    @property
    def names(self) -> bool:
        """Whether something that is missing is confirmed, with a name or without."""
        return self.status in ("named", "one_of", "described")


def judge(
    found: Sequence[NamedEffect],
    terms: Sequence[Told],
    refuted: Sequence[Graded],
    refitted: Fit,
    at_end: RegimeMap,
    left_over: SlowResidual,
    hint: str,
    held_out: HeldOut,
    drift: Told | None = None,
    changed: Sequence[Changed] = (),
    shares: Mapping[str, float] = NO_SHARES,
    spread: Described | None = None,
    later: tuple[float, float] | None = None,
) -> Verdict:
    """The verdict.

    It begins with the confirmed term that takes most off the error of the hold-out laps. Where none is confirmed it begins with
    where and by how much the measured torque differs; suspected terms are only listed.

    Parameters
    ----------
    found, terms, refuted
        Effects and terms without a name that fit, and those that fit and that the hold-out laps reject.
    drift
        The slow residual as a level of each recording, or one that drifts, if it is either.
    changed
        Values of the vehicle file that the re-fit surely changes, see `changed_values`.
    shares
        Probability of each name over all explanations, with `wording.NONE_OF_THESE`. Without it the weights within each
        suspected class are listed.
    spread
        Where the torque shakes more than elsewhere, if it does. It is the verdict where all else is small or not confirmed.
    later
        Errors on the fitted and on the hold-out laps [Nm], where the latter differ plainly more, see `locate.only_later`.
    """
    left = [b for b in at_end.bins if b.p < LACK_OF_FIT_P]
    both = by_weight([*found, *terms])
    sure, unsure = ([t for t in both if (t.graded.grade == CONFIRMED) == want] for want in (True, False))
    listed = possible(unsure, sure, shares)
    shakes = [] if spread is None else [spread.sentence, look_for(spread.mechanisms)]
    after = [*doubts([t.graded for t in unsure]), *rejected(refuted)]
    if sure:
        return _confirmed(sure, left, left_over, held_out, listed, [*shakes, may_be(listed, also=True), *after])
    far = far_from_file(refitted)
    if far:
        seen, *more = file_is_off(far)
        worth = mean_error(held_out.mae["nominal"], held_out.mae["refitted"]) + " with that re-fit"
        return Verdict("unexplained", SUSPECTED, joined([seen, *more, worth, *shakes, may_be(listed), *after]), (), listed, seen)
    strays = left_over.share > MOST_STRAY
    if drift is not None and drift.graded.grade == CONFIRMED and _lasts(drift, left, strays):
        lines = [*_of_drift(drift), *shakes, may_be(listed, also=True), *after]
        return Verdict("described", CONFIRMED, joined(lines), (), listed)
    large = [t for t in unsure if not is_small(t)]
    refit = held_out.of_refit
    worth = mean_error(refit.before, refit.after) + " with a re-fit of the vehicle file" if refit.grade == CONFIRMED else ""
    beside = max([*(abs(b.mean_residual) for b in left), left_over.size if strays else 0.0])
    shaking = spread is not None and beside <= LEFT_SHARE * spread.size_nm
    if (left or strays or large or later) and not shaking:
        if later and not left:
            seen, *more = only_later(*later)
        else:
            seen, *more = [unexplained(left)] if left else slow(left_over) if strays else [differs(large[0])]
        nothing = "No effect of the catalogue explains it" if left and not listed else ""
        grade = REFUTED if refuted and not unsure else SUSPECTED
        lines = [seen, *more, nothing, *shakes, may_be(listed), *after, worth]
        return Verdict("unexplained", grade, joined(lines), (), listed, seen)
    if shaking:
        lines = [*shakes, may_be(listed, also=True), *after, *_rest(left, left_over), worth]
        return Verdict("described", CONFIRMED, joined(lines), (), listed)
    return _nothing_missing(refitted, hint, held_out, changed, listed, [may_be(listed, also=True), *after])


def _confirmed(
    sure: Sequence[NamedEffect | Told],
    left: Sequence[Bin],
    left_over: SlowResidual,
    held_out: HeldOut,
    listed: Possible,
    after: Sequence[str],
) -> Verdict:
    """The verdict with confirmed terms, unless the remaining residual is large compared with them."""
    added = np.concatenate([sum(x) for x in zip(*(t.adds for t in sure), strict=True)])
    explained = float(np.percentile(np.abs(added), 95.0))  # where they act: some do for minutes of an hour
    if max((abs(b.mean_residual) for b in left), default=0.0) > LEFT_SHARE * explained:
        partly = (
            f"{' and '.join(map(short, sure))} would explain a part of it, but the remaining error is too large to confirm that"
        )
        return Verdict("unexplained", SUSPECTED, joined([unexplained(left), partly, *after]), (), listed, unexplained(left))
    named = [t for t in sure if isinstance(t, NamedEffect)]
    status = "described" if not named else "named" if all(len(f.step.members) <= 1 for f in named) else "one_of"
    lines = [*confirmed_terms(sure, held_out), *after, *_rest(left, left_over)]
    return Verdict(status, CONFIRMED, joined(lines), (), listed)


def _rest(left: Sequence[Bin], left_over: SlowResidual) -> list[str]:
    """Sentences about the remaining residual besides the confirmed terms."""
    return [
        f"A small error remains {range_of(left[0])}" if left else "",
        *(slow(left_over) if left_over.share > MOST_STRAY else []),
    ]


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


def _nothing_missing(
    refitted: Fit, hint: str, held_out: HeldOut, changed: Sequence[Changed], listed: Possible, after: Sequence[str]
) -> Verdict:
    """The verdict where no physics is missing: values of the file were off, or nothing was."""
    if hint:
        after = [*after, f"{hint} would fit, but the model's own error can look the same"]
    out_of_range = moved_parameters(refitted)
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
