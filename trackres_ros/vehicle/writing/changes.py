# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The results of a diagnosis that may be written to files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from trackres_ros.effects.effect import Active
from trackres_ros.route.learned import SLOPE, TORQUE, RouteMap
from trackres_ros.vehicle import Disturbance

DIAGNOSE = "trackres diagnose"
BY_PLACE = {SLOPE: "grade", TORQUE: "place"}  # names of values learned by place


@dataclass(frozen=True, slots=True)
class Interval:
    """A 95 % interval; `bound_only` if the likelihood does not fall on one side before the bounds: then it is only a bound."""

    low: float
    high: float
    bound_only: bool


@dataclass(frozen=True, eq=False)
class LearnedDisturbance:
    """A disturbance to watch for, and the range of each of its values."""

    disturbance: Disturbance
    ranges: Mapping[str, tuple[float, float]]


@dataclass(frozen=True, eq=False)
class FileChanges:
    """Changes to write: only those that the hold-out laps confirm, see `confirm.keep`."""

    values: Mapping[str, float] | None  # of the base's parameters; None if the file's own stay
    effects: tuple[Active, ...]  # added to those of the file
    intervals: Mapping[tuple[str, str], Interval]  # of parameters, by (effect or "", parameter)
    text: str = ""  # accepted changes and the reason, in a sentence
    disturbance: LearnedDisturbance | None = None  # to watch for live; None keeps that of the file
    route: tuple[RouteMap, ...] = ()  # a slope, or a torque, by place; others given with the surroundings stay
    command: str = DIAGNOSE  # the command that found it
    amend: Callable[[str], str] = str  # makes the text of the vehicle file that is written, from that with all other changes

    def with_disturbance(self, disturbance: LearnedDisturbance | None) -> FileChanges:
        """The same changes, with a disturbance to watch for."""
        if disturbance is None:
            return self
        text = f"{self.text}; and a disturbance to watch with a torque sensor: {disturbance.disturbance.form}"
        return replace(self, text=text, disturbance=disturbance)

    def effects_of(self, kind: str) -> list[Active]:
        """The effects that belong to `vehicle`, `surroundings` or `sensor`, with their intervals as ranges."""
        return [_with_ranges(active, self.intervals) for active in self.effects if active.effect.belongs_to == kind]

    def names_of(self, kind: str) -> list[str]:
        """Names of all changes to `vehicle`, `surroundings` or `sensor`, including those by place."""
        by_place = (BY_PLACE[route_map.kind] for route_map in self.route if kind == "surroundings")
        return [*by_place, *(active.effect.name for active in self.effects_of(kind))]

    def range_of(self, parameter: str) -> tuple[float, float] | None:
        """The interval of a parameter of the base."""
        interval = self.intervals.get(("", parameter))
        return None if interval is None else (interval.low, interval.high)


def _with_ranges(active: Active, intervals: Mapping[tuple[str, str], Interval]) -> Active:
    ranges = {}
    for name, value in active.values.items():
        interval = intervals.get((active.effect.name, name))
        if interval is not None:
            ranges[name] = (min(interval.low, value), max(interval.high, value))
    return Active(active.effect, active.values, ranges)
