# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Grades each effect by laps left out in turn."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from trackres_ros.diagnosis.base.base import BaseParameter
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.selection.held_out import CONFIRMED, REFUTED, SUSPECTED, Improvement
from trackres_ros.effects.effect import Active

ON_BOUND = 1e-3  # of the span between the bounds
ONLY_BETWEEN = "differs only between these"  # begins the fault of a term that other differences between recordings may explain
LITTLE = 0.1  # of the mean error: the largest improvement by an effect that replaces a base value
MOVED = 1.5  # standard deviations of the file's own range
FAR = 5.0  # such standard deviations


@dataclass(frozen=True, slots=True)
class Graded:
    """Grade of a term by laps and recordings left out in turn.

    Base parameters that it displaces are on a bound far from the file's value with the term, but not without it, although the
    hold-out error hardly improves. The term replaces a part of the base, as a sensor offset replaces rolling resistance.
    """

    name: str
    improvement: Improvement  # of the model with it over the one without, each fitted separately
    faults: tuple[str, ...] = ()  # why it is at best suspected, in words after its name
    on_bounds: tuple[str, ...] = ()  # parameters on a bound other than the value without effect
    displaces: tuple[str, ...] = ()

    def of_unconfirmed(self) -> Graded:
        """The same of an explanation that is not confirmed as a whole."""
        return replace(self, faults=("is part of an explanation that laps left out do not confirm as a whole", *self.faults))

    @property
    def grade(self) -> str:
        """`confirmed`, `suspected` or `refuted`."""
        if self.displaces or self.improvement.grade == REFUTED:
            return REFUTED
        return SUSPECTED if self.faults or self.on_bounds else self.improvement.grade

    @property
    def fault(self) -> str:
        """Why it is not confirmed whatever these laps show, in words after its name; empty if only they decide."""
        if self.displaces:
            return f"pushes {', '.join(self.displaces)} to the end of its range"
        if self.improvement.grade != CONFIRMED:
            return ""
        if self.on_bounds:
            return f"is at the limit of its plausible range ({', '.join(self.on_bounds)})"
        return self.faults[0] if self.faults else ""

    @property
    def confirmed(self) -> bool:
        """Whether it is confirmed."""
        return self.grade == CONFIRMED


def on_bounds(active: Active) -> tuple[str, ...]:
    """Parameters of an effect on a bound other than the value without effect."""
    return tuple(
        q.name
        for q in active.effect.parameters
        for bound in (q.low, q.high)
        if q.fitted and bound != q.off and abs(active.values[q.name] - bound) <= ON_BOUND * (q.high - q.low)
    )


def displaced(improvement: Improvement, final: Fit, without: Fit) -> tuple[str, ...]:
    """Base parameters that a weak effect replaces, see `Graded.displaces`."""
    if improvement.before - improvement.after >= LITTLE * improvement.before:
        return ()
    return tuple(sorted(set(at_implausible_bounds(final)) - set(at_implausible_bounds(without))))


def at_implausible_bounds(found: Fit) -> tuple[str, ...]:
    """Base parameters on a bound, more than `MOVED` standard deviations from the vehicle file's value."""
    return tuple(
        q.name for q, value in moved_parameters(found) if min(value - q.low, q.high - value) <= ON_BOUND * (q.high - q.low)
    )


def moved_parameters(found: Fit) -> list[tuple[BaseParameter, float]]:
    """Base parameters that moved by more than `MOVED` standard deviations of their range, furthest first."""
    moved = [(q, found.base_values[q.name]) for q in found.problem.base.parameters if np.isfinite(q.std)]
    far = [(q, value) for q, value in moved if abs(value - q.nominal) > MOVED * q.std]
    return sorted(far, key=lambda pair: -abs(pair[1] - pair[0].nominal) / pair[0].std)


def far_from_file(found: Fit) -> list[tuple[BaseParameter, float]]:
    """Several base parameters `FAR` outside their range, or as far as is plausible: they compensate another error of the file."""
    furthest = at_implausible_bounds(found)
    far = [
        (q, value)
        for q, value in moved_parameters(found)
        if abs(value - q.nominal) > FAR * q.std or (q.name in furthest and q.outside(value))
    ]
    return far if len(far) > 1 else []
