# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Grades each effect by the hold-out laps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trackres_ros.diagnosis.base.base import BaseParameter
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.selection.held_out import CONFIRMED, REFUTED, SUSPECTED, Improvement
from trackres_ros.effects.effect import Active

ON_BOUND = 1e-3  # of the span between the bounds
LITTLE = 0.1  # of the mean error: what takes the place of a value of the base makes no more than that better
MOVED = 1.5  # standard deviations of the file's own range
FAR = 5.0  # such standard deviations


@dataclass(frozen=True, slots=True)
class Graded:
    """An effect and what held-out laps say of it.

    Attributes
    ----------
    improvement
        Of the model with it over the one without, each fitted by itself.
    on_bounds
        Parameters that lie on a bound other than the value without effect.
    displaces
        Parameters of the base that lie on a bound, far from the file's value, beside it and not without it, where it makes
        held-out laps little better: it takes the place of what the base has, as an offset of the sensor does of all that rolling
        resists.
    cancels
        Whether it improves far less than its size says, as what cancels another term does.
    grade
        `confirmed`, `suspected` or `refuted`. What lies on a bound or cancels is at best suspected. What displaces is refuted.
    """

    name: str
    improvement: Improvement
    on_bounds: tuple[str, ...]
    displaces: tuple[str, ...] = ()
    cancels: bool = False

    @property
    def grade(self) -> str:
        """See above."""
        if self.displaces:
            return REFUTED
        unsure = bool(self.on_bounds) or self.cancels
        return SUSPECTED if unsure and self.improvement.grade == CONFIRMED else self.improvement.grade

    @property
    def confirmed(self) -> bool:
        """Whether laps left out confirm it."""
        return self.grade == CONFIRMED


def on_bounds(active: Active) -> tuple[str, ...]:
    """Parameters of an effect that lie on a bound other than the value without effect."""
    return tuple(
        q.name
        for q in active.effect.parameters
        for bound in (q.low, q.high)
        if q.fitted and bound != q.off and abs(active.values[q.name] - bound) <= ON_BOUND * (q.high - q.low)
    )


def displaced(improvement: Improvement, final: Fit, without: Fit) -> tuple[str, ...]:
    """Parameters of the base that an effect which improves little takes the place of, see `Graded.displaces`."""
    if improvement.before - improvement.after >= LITTLE * improvement.before:
        return ()
    return tuple(sorted(set(at_implausible_bounds(final)) - set(at_implausible_bounds(without))))


def at_implausible_bounds(found: Fit) -> tuple[str, ...]:
    """Parameters of the base on a bound that is further from the vehicle file's value than its range says."""
    return tuple(
        q.name for q, value in moved_parameters(found) if min(value - q.low, q.high - value) <= ON_BOUND * (q.high - q.low)
    )


def moved_parameters(found: Fit, by: float = MOVED) -> list[tuple[BaseParameter, float]]:
    """Parameters of the base that moved by more than so many standard deviations of their range, furthest first."""
    moved = [(q, found.base_values[q.name]) for q in found.problem.base.parameters if np.isfinite(q.std)]
    far = [(q, value) for q, value in moved if abs(value - q.nominal) > by * q.std]
    return sorted(far, key=lambda pair: -abs(pair[1] - pair[0].nominal) / pair[0].std)


def far_from_file(found: Fit) -> list[tuple[BaseParameter, float]]:
    """Parameters of the base that are `FAR` outside their range, where there are several: one value of a file may be wrong, but
    several that are so far off together imitate something else that is wrong in it.
    """
    far = moved_parameters(found, FAR)
    return far if len(far) > 1 else []
