# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What of a diagnosis may be written out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from trackres_ros.effects.effect import Active

if TYPE_CHECKING:
    from trackres_ros.diagnosis.selection.intervals import Interval


@dataclass(frozen=True, eq=False)
class Kept:
    """What may be written: nothing that held-out laps do not bear out, see `confirm.keep`.

    Attributes
    ----------
    values
        Of the base's parameters; None where the file's own stay.
    effects
        What is added to those of the file.
    intervals
        Of parameters, by (effect or "", parameter).
    text
        What was kept and why, in a sentence.
    """

    values: Mapping[str, float] | None
    effects: tuple[Active, ...]
    intervals: Mapping[tuple[str, str], Interval]
    text: str = ""

    def of(self, kind: str) -> list[Active]:
        """The effects that belong to `vehicle`, `surroundings` or `sensor`, with their intervals as ranges."""
        return [_with_ranges(active, self.intervals) for active in self.effects if active.effect.belongs_to == kind]

    def range_of(self, parameter: str) -> tuple[float, float] | None:
        """The interval of a parameter of the base."""
        found = self.intervals.get(("", parameter))
        return None if found is None else (found.low, found.high)


def _with_ranges(active: Active, intervals: Mapping[tuple[str, str], Interval]) -> Active:
    ranges = {}
    for name, value in active.values.items():
        found = intervals.get((active.effect.name, name))
        if found is not None:
            ranges[name] = (min(found.low, value), max(found.high, value))
    return Active(active.effect, active.values, ranges)
