# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Grades each effect by laps left out in turn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trackres_ros.diagnosis.base.base import BaseParameter
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.selection.held_out import CONFIRMED, REFUTED, SUSPECTED, Improvement
from trackres_ros.effects.effect import Active
from trackres_ros.text.numbers import figures

ON_BOUND = 1e-3  # of the span between the bounds
LITTLE = 0.1  # of the mean error: the largest improvement by an effect that replaces a base value
MOVED = 1.5  # standard deviations of the file's own range
SURELY = 2.0  # standard deviations of an estimate
FAR = 5.0  # such standard deviations


@dataclass(frozen=True, slots=True)
class Graded:
    """Grade of an effect by laps left out in turn.

    Base parameters that it displaces are on a bound far from the file's value with the effect, but not without it, although the
    hold-out error hardly improves. The effect replaces a part of the base, as a sensor offset replaces rolling resistance.
    """

    name: str
    improvement: Improvement  # of the model with it over the one without, each fitted separately
    on_bounds: tuple[str, ...]  # parameters on a bound other than the value without effect
    displaces: tuple[str, ...] = ()
    cancels: bool = False  # far too small an improvement for its size, as of a term that cancels another one
    by_others: bool = False  # far too large an improvement for its size, which may be zero: other values of the fit gained it
    of_unconfirmed: bool = False  # of an explanation that is not confirmed as a whole

    @property
    def grade(self) -> str:
        """`confirmed`, `suspected` or `refuted`. On a bound, cancelling, improved by others or of an unconfirmed
        explanation: at best suspected. Displacing: refuted.
        """
        if self.displaces:
            return REFUTED
        unsure = bool(self.on_bounds) or self.cancels or self.by_others or self.of_unconfirmed
        return SUSPECTED if unsure and self.improvement.grade == CONFIRMED else self.improvement.grade

    @property
    def fault(self) -> str:
        """Why it is not confirmed whatever these laps show, in words after its name; empty if only they decide."""
        shows = f"from {figures(self.improvement.before)} to {figures(self.improvement.after)} Nm on laps left out"
        if self.displaces:
            return f"pushes {', '.join(self.displaces)} of the vehicle file to the end of its range"
        if self.improvement.grade != CONFIRMED:
            return ""
        if self.on_bounds:
            return f"is at the limit of its plausible range ({', '.join(self.on_bounds)})"
        if self.cancels:
            return f"reduces the error far less than its size suggests: {shows}"
        return f"reduces the error far more than its size explains: {shows}" if self.by_others else ""

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


def may_be_off(found: Fit, name: str) -> bool:
    """Whether the interval of each size of an effect includes the value without effect."""
    active = next(a for a in found.effects if a.effect.name == name)
    return all(
        abs(active.values[q.name] - q.off) <= SURELY * found.std_of(name, q.name)
        for q in active.effect.parameters
        if q.fitted and q.off is not None
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
