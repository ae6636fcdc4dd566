# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Results of a diagnosis: named effects, unnamed terms, and wrong values of the vehicle file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trackres_ros.diagnosis.empirical.terms import Described
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.prepare.session import Array
from trackres_ros.diagnosis.selection.grade import Graded
from trackres_ros.diagnosis.selection.held_out import CONFIRMED
from trackres_ros.diagnosis.selection.locate import Bin, Location, Span
from trackres_ros.diagnosis.selection.steps import Step
from trackres_ros.effects.effect import Parameter
from trackres_ros.text.numbers import alike, figures
from trackres_ros.vehicle.writing.changes import Interval


@dataclass(frozen=True, eq=False, repr=False)
class NamedEffect:
    """A named effect, alone or as one of a class."""

    name: str  # this and the next three as in the catalogue
    text: str
    acts_on: str
    parameters: Sequence[Parameter]
    step: Step  # the search round that chose it: its rivals, and the effects not distinguishable from it (`step.members`)
    values: Mapping[str, float]  # of its parameters
    intervals: Mapping[str, Interval]  # 95 %, of its parameters
    adds: list[Array]  # predicted torque of each session [Nm]
    resists: list[Array]  # the same, positive against travel in both directions
    where: Sequence[Span]  # times at which it acts most
    location: Location  # its main variable, and the range of that
    place: str  # when it acts, in words; empty if always
    regime: Sequence[Bin]  # residual of the base where it acts
    seen: str  # its torque there, in words
    graded: Graded  # by laps left out in turn (`graded.grade`)

    @property
    def values_text(self) -> str:
        """Its values with their intervals and units."""
        units = {q.name: "" if q.unit == "1" else f" {q.unit}" for q in self.parameters}
        return ", ".join(f"{name} {with_interval(v, self.intervals.get(name))}{units[name]}" for name, v in self.values.items())

    def __repr__(self) -> str:
        return f"<{self.name}: {self.values_text}; {self.graded.grade}>"


@dataclass(frozen=True, eq=False)
class UnnamedTerm:
    """A confirmed or suspected unnamed term."""

    described: Described
    adds: list[Array]  # predicted torque of each session [Nm]
    course: list[Array]  # its variable in each session; empty for the clock alone
    intervals: Mapping[str, Interval]  # 95 %, of its parameters
    graded: Graded
    instead: str = ""  # the name that would explain it best, if one gains more than the threshold
    alike: tuple[str, ...] = ()  # other variables of forms that laps left out do not separate from it


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
        off = self.value - self.nominal
        share = f"{100.0 * abs(off / self.nominal):.0f} %" if self.nominal else f"{figures(abs(off))}{unit}"
        value, low, high, nominal = alike((self.value, self.low, self.high, self.nominal), self.high - self.low)
        if self.at_bound:
            way = "high" if off > 0.0 else "low"
            return f"{self.name} is at the {way} end of its range, {value}{unit} instead of {nominal}"
        return f"{self.name} is {share} {'higher' if off > 0.0 else 'lower'}, {value} [{low}, {high}]{unit} instead of {nominal}"


def changed_values(refitted: Fit, bounds: Mapping[tuple[str, str], Interval]) -> tuple[Changed, ...]:
    """Values whose 95 % interval excludes the file's, the largest torque change first."""
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
        found.append(Changed(q.name, q.unit, q.nominal, value, interval.low, interval.high, size, interval.bound_only))
    return tuple(sorted(found, key=lambda c: -c.torque_nm))


def by_improvement(terms: Sequence[NamedEffect | UnnamedTerm]) -> list[NamedEffect | UnnamedTerm]:
    """Sort terms: confirmed ones first, then by their reduction of the hold-out error."""
    return sorted(terms, key=lambda t: (t.graded.grade != CONFIRMED, t.graded.improvement.after - t.graded.improvement.before))


def with_interval(value: float, interval: Interval | None) -> str:
    """A value and its 95 % interval."""
    if interval is None:
        return figures(value)
    if interval.bound_only:
        return f"between {figures(interval.low)} and {figures(interval.high)}"
    shown, low, high = alike((value, interval.low, interval.high), interval.high - interval.low)
    return f"{shown} [{low}, {high}]"
