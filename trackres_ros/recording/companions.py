# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Channels that say how to take another one: whether its value is valid, and which way a speed without a sign is.

Equal live and from a recording. A value whose companion does not allow it, or is not known, gives no sample: no guess of a sign
moves a vehicle.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import copysign, inf, isnan, nan

import numpy as np

from trackres_ros.recording.binding import TopicBinding
from trackres_ros.recording.directions import NEUTRAL
from trackres_ros.recording.samples import Finding, SampleBlock
from trackres_ros.recording.sums import Reading
from trackres_ros.text import some_of

HOLD_S = 2.0
"""Longest age of the last direction, or validity, of another message [s]; `max_age_s` replaces it. Ours: buses repeat both ten
times a second, and a vehicle hardly stops and drives the other way in less."""
DIRECTION = "direction"
NAMES_SHOWN = 5


class Companion:
    """The last value of such a channel.

    `hold_s`: its longest age; `together`: whether it comes in the same message as what it is about. Then only the value of that
    message counts: the two must not be timed apart.
    """

    def __init__(self, hold_s: float, together: bool) -> None:
        self._hold_ns = 0 if together else round(hold_s * 1e9)
        self._value, self._came_ns = nan, 0
        self.seen = False

    def came(self, arrival_ns: int, value: float) -> None:
        """Take its next value; nan says nothing, and neutral keeps the way that the vehicle rolls."""
        if isnan(value):
            return
        self.seen = True
        if value == NEUTRAL and not isnan(self._value):
            self._came_ns = arrival_ns
        elif value != NEUTRAL:
            self._value, self._came_ns = value, arrival_ns

    def now(self, arrival_ns: int) -> float:
        """Its value at an arrival; nan where there is none, or it is too old. A time that ran back ends it too."""
        return self._value if 0 <= arrival_ns - self._came_ns <= self._hold_ns else nan


@dataclass(slots=True)
class Dropped:
    """Samples that a companion changed or let fall: their number."""

    invalid: int = 0
    no_direction: int = 0
    against: int = 0  # negative speeds where the direction is forward


class Companions:
    """All companions of a source.

    `readings`: from `readings_of`; `bindings`: by role; `required`: whether a speed waits for its first direction. A direction
    that was only guessed may never have a value; until it has one the speed is as it came.
    """

    def __init__(self, readings: Sequence[Reading], bindings: Mapping[str, TopicBinding], required: bool = True) -> None:
        self._readings, self._required = readings, required
        self._valid = {
            (one.role, one.part): Companion(one.binding.max_age_s or HOLD_S, _together(one.binding, target.binding))
            for one, target in itertools.pairwise(readings)
            if one.is_valid
        }
        self._direction: Companion | None = None
        if DIRECTION in bindings and "speed" in bindings:
            way, speed = bindings[DIRECTION], bindings["speed"]
            self._direction = Companion(way.max_age_s or HOLD_S, not speed.parts and _together(way, speed))
        self.dropped: dict[str, Dropped] = {one.role: Dropped() for one in readings}

    @property
    def notes(self) -> list[str]:
        """What is not as it came, for people."""
        return ["speed: its sign is that of the direction"] if self._direction else []

    @property
    def findings(self) -> Iterator[Finding]:
        """Samples that gave no value, or contradict their direction."""
        for role, found in self.dropped.items():
            if found.invalid:
                text = f"{found.invalid} values are not valid, as another channel says: they give no sample"
                yield Finding(role, "invalid", found.invalid, nan, text)
            if found.no_direction:
                text = f"{found.no_direction} values have no known direction: they give no sample"
                yield Finding(role, "no_direction", found.no_direction, nan, text)
            if found.against:
                text = f"{found.against} values are negative while the direction is forward: they keep their sign"
                yield Finding(role, "against_direction", found.against, nan, text)

    def valid(self, one: Reading, arrival_ns: int, value: float) -> bool:
        """Whether a value of a reading counts; the value of a validity is kept, and counts not."""
        companion = self._valid.get((one.role, one.part))
        if companion is None:
            return True
        if one.is_valid:
            companion.came(arrival_ns, 2.0 * float(value != 0.0) - 1.0 if not isnan(value) else value)
            return False
        if companion.now(arrival_ns) > 0.0:
            return True
        self.dropped[one.role].invalid += 1
        return False

    def signed(self, role: str, arrival_ns: int, value: float) -> float | None:
        """The value of a role with its sign; None of a speed whose direction is not known. A direction is kept.

        A negative speed has a sign of its own; one of 0 needs none.
        """
        if self._direction is None or role not in ("speed", DIRECTION):
            return value
        if role == DIRECTION:
            self._direction.came(arrival_ns, value)
            return value
        way = self._direction.now(arrival_ns)
        if value < 0.0:
            self.dropped[role].against += way > 0.0
        elif value > 0.0:
            if isnan(way) and (self._required or self._direction.seen):
                self.dropped[role].no_direction += 1
                return None
            return value if isnan(way) else copysign(value, way)
        return value

    def kept(self, block: SampleBlock) -> SampleBlock:
        """A block of readings, before their sums: without validities, and what they let fall."""
        if not self._valid:
            return block
        watched = [(one.role, one.part) in self._valid for one in self._readings]
        keep = np.ones(len(block), np.bool_)
        for row in np.flatnonzero(np.array(watched)[block.role]).tolist():
            keep[row] = self.valid(self._readings[block.role[row]], int(block.arrival_ns[row]), float(block.value[row]))
        return _rows(block, keep)

    def with_signs(self, block: SampleBlock, roles: Sequence[str]) -> SampleBlock:
        """A block of roles, after their sums: with the signs of speeds, and without those of no known direction."""
        if self._direction is None:
            return block
        concerned = np.array([role in ("speed", DIRECTION) for role in roles])
        keep, values = np.ones(len(block), np.bool_), block.value.copy()
        for row in np.flatnonzero(concerned[block.role]).tolist():
            found = self.signed(roles[block.role[row]], int(block.arrival_ns[row]), float(values[row]))
            keep[row] = found is not None
            values[row] = values[row] if found is None else found
        return _rows(SampleBlock(block.role, block.stamp_ns, block.arrival_ns, values), keep)


class Signs:
    """Whether a speed was ever negative: one that never is may lack its sign."""

    def __init__(self, roles: Sequence[str]) -> None:
        self._speed = roles.index("speed") if "speed" in roles else -1
        self._lowest, self._highest = inf, -inf

    def seen(self, block: SampleBlock) -> SampleBlock:
        """Look at a block of roles, and pass it on."""
        values = block.value[block.role == self._speed]
        values = values[np.isfinite(values)]
        if values.size:
            self._lowest, self._highest = min(self._lowest, values.min()), max(self._highest, values.max())
        return block

    def findings(self, names: Sequence[str], lines: Iterable[str]) -> Iterator[Finding]:
        """A speed that is never negative, beside columns or topics that may say reverse, with their lines of a topics file."""
        if names and self._lowest >= 0.0 and self._highest > 0.0:
            text = (
                f"it is never negative, and {some_of(names, NAMES_SHOWN)} may say when the vehicle drives backwards: the torque "
                f"then has the wrong sign. If so, write in a topics file, with the values that it has: {next(iter(lines))}"
            )
            yield Finding("speed", "unsigned", len(names), nan, text)


def _together(one: TopicBinding, other: TopicBinding) -> bool:
    """Whether two channels come in one message."""
    return one.topic != "" and one.topic == other.topic


def _rows(block: SampleBlock, keep: np.ndarray) -> SampleBlock:
    if keep.all():
        return block
    return SampleBlock(block.role[keep], block.stamp_ns[keep], block.arrival_ns[keep], block.value[keep])
