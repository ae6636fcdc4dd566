# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What it comes to: one of five verdicts, in one sentence."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.base.base import BaseParameter
from trackres_ros.diagnosis.base.variables import BY_NAME
from trackres_ros.diagnosis.described.terms import Described
from trackres_ros.diagnosis.findings.locate import STRAY_S, Acts, SlowResidual, Span
from trackres_ros.diagnosis.findings.residual_bins import Bin, RegimeMap
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.selection.confirm import Graded, moved_parameters
from trackres_ros.diagnosis.selection.held_out import CONFIRMED, REFUTED, SUSPECTED, HeldOut, Improvement
from trackres_ros.diagnosis.selection.intervals import Interval
from trackres_ros.diagnosis.selection.naming import Candidate, Step
from trackres_ros.effects.effect import Parameter
from trackres_ros.text.numbers import alike, figures, on_scale

Array = NDArray[np.float64]

LACK_OF_FIT_P = 0.01
MOST_STRAY = 0.015  # of the torque, in means over half a minute
LEFT_SHARE = 0.5  # of what the effects explain: more left over, and the names explain little
MOST_CERTAIN = 20.0  # in log-likelihood: more is no more certain
LEAST_GAIN = 0.01  # of the mean error on hold-out laps: a re-fit that gains more says which values were off
MOST_CHANGED = 3  # values that a sentence lists
FINE_R2 = 0.995  # above it R2 says nothing that the mean error does not


@dataclass(frozen=True, eq=False, repr=False)
class Found:
    """An effect that was named, alone or as one of a class.

    Attributes
    ----------
    name, text, acts_on, parameters
        As in the catalogue.
    step
        The round of the choice in which it was chosen: its rivals, and what it cannot be told from (`step.members`).
    values, intervals
        Of its parameters, and the 95 % interval of each.
    adds, resists
        What it adds to the expected torque of each session [Nm]; the same, positive against travel whichever way, as shown
        if a sensor adds it.
    where, acts, regime
        Spans of time, the variable that it follows best, and the residual of the base where it acts.
    seen
        The residual of the re-fitted base where it acts, in words, see `locate.Acts.residual`.
    graded
        What laps not used for fitting say of it (`graded.grade`).
    """

    name: str
    text: str
    acts_on: str
    parameters: Sequence[Parameter]
    step: Step
    values: Mapping[str, float]
    intervals: Mapping[str, Interval]
    adds: list[Array]
    resists: list[Array]
    where: Sequence[Span]
    acts: Acts
    regime: Sequence[Bin]
    seen: str
    graded: Graded

    def __repr__(self) -> str:
        units = {q.name: "" if q.unit == "1" else f" {q.unit}" for q in self.parameters}
        values = [f"{name} {_with_interval(v, self.intervals.get(name))}{units[name]}" for name, v in self.values.items()]
        return f"<{self.name}: {', '.join(values)}; {self.graded.grade}>"


@dataclass(frozen=True, eq=False)
class Told:
    """A term without a name that was found.

    Attributes
    ----------
    described
        How it is said.
    adds
        What it adds to the expected torque of each session [Nm].
    course
        What it follows in each session; empty where that is the clock alone.
    intervals
        Of its parameters.
    seen_nm
        Mean residual of the re-fitted base, in the direction of the term, where the term acts [Nm].
    graded
        What laps not used for fitting say of it.
    """

    described: Described
    adds: list[Array]
    course: list[Array]
    intervals: Mapping[str, Interval]
    seen_nm: float
    graded: Graded


@dataclass(frozen=True, slots=True)
class Changed:
    """A value of the vehicle file that a re-fit changes.

    Attributes
    ----------
    nominal, value, low, high
        In the file, re-fitted, and the 95 % interval of the latter.
    torque_nm
        Root mean square of the torque that the change makes [Nm].
    """

    name: str
    unit: str
    nominal: float
    value: float
    low: float
    high: float
    torque_nm: float

    @property
    def text(self) -> str:
        """What was off, by how much and how surely."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        off = self.value - self.nominal
        share = f"{abs(off / self.nominal):.0%}" if self.nominal else f"{figures(abs(off))}{unit}"
        value, low, high, nominal = alike((self.value, self.low, self.high, self.nominal), self.high - self.low)
        return f"{self.name} is {share} {'higher' if off > 0.0 else 'lower'}, {value} [{low}, {high}]{unit} instead of {nominal}"


def changed_values(refitted: Fit, bounds: Mapping[tuple[str, str], Interval]) -> tuple[Changed, ...]:
    """Values whose 95 % interval excludes the file's, those that change the torque most first."""
    found = []
    for q in refitted.problem.base.parameters:
        value, interval = refitted.base_values[q.name], bounds.get(("", q.name))
        if interval is None or interval.low <= q.nominal <= interval.high:
            continue
        as_in_file = refitted.problem.predict({**refitted.base_values, q.name: q.nominal}, refitted.acting)
        change = [
            (p.torque - other.torque)[mask]
            for p, other, mask in zip(refitted.predicted, as_in_file, refitted.problem.masks, strict=True)
        ]
        size = float(np.sqrt(np.mean(np.concatenate(change) ** 2)))
        found.append(Changed(q.name, q.unit, q.nominal, value, interval.low, interval.high, size))
    return tuple(sorted(found, key=lambda c: -c.torque_nm))


@dataclass(frozen=True, slots=True)
class Verdict:
    """What it comes to.

    Attributes
    ----------
    status
        ``none``, ``named``, ``one_of``, ``described`` or ``unexplained``.
    grade
        Whether laps not used for fitting confirm it: ``confirmed``, ``suspected`` or ``refuted``.
    sentence
        In words.
    changed
        Values of the vehicle file that were off, where that is the verdict, the weightiest first.
    """

    status: str
    grade: str
    sentence: str
    changed: tuple[Changed, ...] = ()

    @property
    def names(self) -> bool:
        """Whether it stands by what was named or described."""
        return self.status in ("named", "one_of", "described")


def judge(
    found: Sequence[Found],
    terms: Sequence[Told],
    refuted: Sequence[Graded],
    refitted: Fit,
    at_end: RegimeMap,
    left_over: SlowResidual,
    hint: str,
    held_out: HeldOut,
    drift: Told | None = None,
    changed: Sequence[Changed] = (),
) -> Verdict:
    """The verdict.

    What is left over after the last fit counts as unexplained where nothing was named, or where it is large beside
    what the names explain. What strays for half-minutes and follows nothing recorded counts where nothing was named.

    Parameters
    ----------
    found, terms, refuted
        Effects and terms without a name that fit, and those that fit and that held-out laps refute.
    drift
        What strays, as a level that wanders, if it does. Where a regime other than of time or distance is left, there is more.
    changed
        Values of the vehicle file that the re-fit surely changes, see `changed_values`.
    """
    left = [b for b in at_end.bins if b.p < LACK_OF_FIT_P]
    besides = f" {_refuted(refuted)}" if refuted else ""
    if found or terms:
        adds = [*(f.adds for f in found), *(t.adds for t in terms)]
        added = np.concatenate([sum(x) for x in zip(*adds, strict=True)])
        explained = float(np.percentile(np.abs(added), 95.0))  # where they act: some do for minutes of an hour
        largest = max((abs(b.mean_residual) for b in left), default=0.0)
        if largest > LEFT_SHARE * explained:
            return Verdict("unexplained", SUSPECTED, f"{_unexplained(left)}; {_tentative(found, terms)}{besides}")
        status = "described" if not found else "named" if all(len(f.step.members) <= 1 for f in found) else "one_of"
        if left:
            besides += f" Something small is left, {_range(left[0])}."
        if left_over.share > MOST_STRAY:
            besides += f" And {_strays(left_over)}."
        grades = [*(f.graded for f in found), *(t.graded for t in terms)]
        doubted = [g for g in grades if g.grade != CONFIRMED]
        both = by_weight([*found, *terms])
        sure = _sentences([x for x in both if x.graded.grade == CONFIRMED])
        gain = f"{sure}. Confirmed {_gain(held_out, 'with_effects')}."
        if not doubted:
            return Verdict(status, CONFIRMED, f"{gain}{besides}")
        unsure, why = _sentences([x for x in both if x.graded.grade != CONFIRMED]), ". ".join(dict.fromkeys(map(_doubt, doubted)))
        also = f"{gain} Only suspected" if sure else "Suspected"
        return Verdict(status, SUSPECTED, f"{also}: {unsure}. {why}.{besides}")
    drifts = left_over.share > MOST_STRAY and all(BY_NAME[b.variable].as_clock for b in left)
    if drift is not None and drifts and drift.graded.grade == CONFIRMED:
        return Verdict("described", CONFIRMED, f"{_of_term(drift)}. {_followed(drift.graded)}.{besides}")
    if left:
        text = f"{_unexplained(left)}, and no effect of the catalogue explains it."
        return Verdict("unexplained", REFUTED if refuted else SUSPECTED, text + besides)
    if left_over.share > MOST_STRAY:
        text = f"Something is unexplained: {_strays(left_over)}."
        return Verdict("unexplained", REFUTED if refuted else SUSPECTED, text + besides)
    if hint:
        besides += f" Were the model exact, {hint} would be missing; as it is, its own error may look the same."
    moved = moved_parameters(refitted)
    listed = ", ".join(_moved(q, value) for q, value in moved)
    of_refit = held_out.of_refit
    if of_refit.grade == CONFIRMED and (moved or of_refit.after < (1.0 - LEAST_GAIN) * of_refit.before):
        off = "; ".join(c.text for c in changed[:MOST_CHANGED])
        off = f"values of the vehicle file were off: {off}" if off else "several values of the vehicle file were off together"
        return Verdict(
            "none",
            CONFIRMED,
            f"No physics is missing, but {off}. Confirmed {_gain(held_out, 'refitted')}.{besides}",
            tuple(changed),
        )
    if moved:
        return Verdict(
            "none",
            of_refit.grade,
            f"No physics is missing. A re-fit would move parameters of the vehicle file: {listed}; that is "
            f"{'refuted' if of_refit.grade == REFUTED else 'not confirmed'} {_gain(held_out, 'refitted')}.{besides}",
        )
    return Verdict(
        "none",
        CONFIRMED,
        f"No mismatch beyond noise: on laps not used for fitting the mean error is {figures(held_out.mae['nominal'])} Nm "
        f"with the vehicle file as it is and {figures(held_out.mae['refitted'])} Nm re-fitted.{besides}",
    )


def by_weight(terms: Sequence[Found | Told]) -> list[Found | Told]:
    """The confirmed ones first, and of these those that take most off the error of the hold-out laps."""
    return sorted(terms, key=lambda t: (t.graded.grade != CONFIRMED, t.graded.improvement.after - t.graded.improvement.before))


def _sentences(terms: Sequence[Found | Told]) -> str:
    """What was found, a sentence each; empty where that is nothing."""
    said = [_of_effect(x) if isinstance(x, Found) else _of_term(x) for x in terms]
    return ". ".join([*said, *(["No effect of the catalogue does this"] if any(isinstance(x, Told) for x in terms) else [])])


def _of_effect(f: Found) -> str:
    where = f.acts.text
    measured = f"{where[0].upper() + where[1:] if where else 'Everywhere'} {f.seen}"
    units = {q.name: "" if q.unit == "1" else f" {q.unit}" for q in f.parameters}
    values = ", ".join(f"{name} {_with_interval(value, f.intervals.get(name))}{units[name]}" for name, value in f.values.items())
    members = f.step.members
    if len(members) <= 1:
        return f"{measured}: {f.text} ({f.name}: {values}){_rival(f)}"
    others = ", ".join(f"{name} ({f.step.weights[name]:.0%})" for name in members)
    return f"{measured}: one of {others}, which these recordings cannot tell apart"


def _of_term(t: Told) -> str:
    """A term without a name, and what to look at."""
    return f"{t.described.sentence}: look for {', or '.join(t.described.mechanisms)}"


def _followed(drift: Graded) -> str:
    """What it is worth to follow what wanders."""
    error = f"the mean error falls from {figures(drift.improvement.before)} to {figures(drift.improvement.after)} Nm"
    return f"It cannot be known ahead. Confirmed on laps not used for fitting: where it is followed as it goes, {error}"


def _doubt(graded: Graded) -> str:
    """Why an effect is only suspected."""
    i, together = graded.improvement, graded.together
    if i.grade == CONFIRMED and graded.on_bounds:
        return f"{graded.name} lies on a bound of what is plausible ({', '.join(graded.on_bounds)})"
    if together is not None and graded.confirmed_only_beside_others:
        return f"Laps not used for fitting do not confirm all of it together: with it their mean error goes {_from_to(together)}"
    return f"Laps not used for fitting do not confirm {graded.name}: with it their mean error goes {_from_to(i)}"


def _from_to(i: Improvement) -> str:
    return f"from {figures(i.before)} to {figures(i.after)} Nm ({figures(i.low, 2)} to {figures(i.high, 2)} Nm better, 95 %)"


def _refuted(refuted: Sequence[Graded]) -> str:
    worse = "; ".join(
        f"{g.name}, {figures(g.improvement.before)} to {figures(g.improvement.after)} Nm of mean error"
        for g in refuted
        if g.grade == REFUTED and not g.displaces
    )
    instead = "; ".join(f"{g.name} ({', '.join(g.displaces)})" for g in refuted if g.displaces)
    unsure = ", ".join(g.name for g in refuted if g.grade != REFUTED)
    return " ".join(
        ([f"Refuted, as it fits the laps that were used and makes the others worse: {worse}."] if worse else [])
        + ([f"Left out, as beside it a value of the file goes to the end of its range: {instead}."] if instead else [])
        + ([f"Not confirmed beside it, and left out: {unsure}."] if unsure else [])
    )


def _moved(q: BaseParameter, value: float) -> str:
    """A parameter of the base and where it went."""
    unit = "" if q.unit == "1" else f" {q.unit}"
    return f"{q.name} {figures(q.nominal, 4)} -> {figures(value, 4)}{unit}"


def _rival(f: Found) -> str:
    """The next best candidate, and how much less likely it is."""
    others = [c for c in f.step.candidates if c.name not in f.step.members]
    if not others or f.step.chosen is None:
        return ""
    next_best = max(others, key=lambda c: c.net_evidence)
    return f"; {next_best.name} is {likelier(f.step.chosen, next_best)} times less likely"


def likelier(one: Candidate, other: Candidate) -> str:
    """How many times likelier one is than another."""
    times = math.exp(min(one.net_evidence - other.net_evidence, MOST_CERTAIN))
    return f"{times:.0f}" if times < 1000.0 else "over a thousand"


def _with_interval(value: float, interval: Interval | None) -> str:
    if interval is None:
        return figures(value)
    if interval.bound_only:
        return f"{figures(value)}, only bounded by {figures(interval.low)} to {figures(interval.high)}"
    return f"{figures(value)} [{figures(interval.low)}, {figures(interval.high)}]"


def _gain(h: HeldOut, stage: str) -> str:
    before = "refitted" if stage == "with_effects" else "nominal"
    was, now = figures(h.mae[before]), figures(h.mae[stage])
    way = f"stays at {now}" if was == now else f"{'falls' if h.mae[stage] < h.mae[before] else 'rises'} from {was} to {now}"
    text = f"on laps not used for fitting: the mean error {way} Nm"
    if h.r2[before] <= FINE_R2:
        text += f", R2 from {h.r2[before]:.3f} to {h.r2[stage]:.3f}"
    return text


def _range(b: Bin) -> str:
    low, high = (on_scale(edge, b.high - b.low) for edge in (b.low, b.high))
    return f"at {b.variable} {low} to {high} {b.unit}"


def _unexplained(left: Sequence[Bin]) -> str:
    first = max(left, key=lambda b: abs(b.mean_residual))
    side = "above" if first.mean_residual > 0 else "below"
    return f"Something is unexplained: the measured torque is {abs(first.mean_residual):.0f} Nm {side} the model {_range(first)}"


def _strays(s: SlowResidual) -> str:
    slope = "" if math.isnan(s.slope) else f"; an unrecorded slope of {s.slope:.1%} would do as much"
    return (
        f"averaged over {STRAY_S:.0f} s the measured torque still strays from the model by "
        f"{s.size:.0f} Nm, {s.share:.0%} of the torque, and follows nothing that was recorded{slope}"
    )


def _tentative(found: Sequence[Found], terms: Sequence[Told]) -> str:
    names = ", ".join([*(f.name for f in found), *(t.described.name for t in terms)])
    return f"{names} would take up a part of it, but what is left is too large for the name to be believed."
