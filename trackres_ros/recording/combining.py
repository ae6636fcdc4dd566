# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Combines the samples of several channels: sums of parts, validity, direction, and the unit of a position; equal live and from a
recording.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import copysign, inf, isnan, nan

import numpy as np

from trackres_ros.recording.bindings import TopicBinding
from trackres_ros.recording.roles import NEUTRAL, POSITION, ROLES, base_role
from trackres_ros.recording.samples import Finding, SampleBlock
from trackres_ros.text import some_of
from trackres_ros.units import DEGREE

APART_S, SLOW_APART_S = 0.5, 60.0
"""Longest time between two samples of a part for linear interpolation [s], for quickly changing channels and for the rest.
Assumed: a measured torque holds for 0.5 s. `max_age_s` of the role replaces it."""


@dataclass(frozen=True, slots=True)
class Reading:
    """Reading for a role: all of it, or a part of a sum."""

    role: str
    part: int | None
    binding: TopicBinding
    is_valid: bool = False  # whether it says if the next reading, of the same role and part, counts

    @property
    def name(self) -> str:
        """For messages and notes."""
        name = self.role if self.part is None else f"{self.role}: sum: part {self.part + 1}"
        return f"{name}: valid" if self.is_valid else name


def readings_of(roles: Sequence[str], bindings: Mapping[str, TopicBinding]) -> tuple[Reading, ...]:
    """Readings of some roles, in their order; a validity comes before what it is about."""
    found: list[Reading] = []
    for role in roles:
        for number, part in enumerate(bindings[role].sources):
            of = number if bindings[role].parts else None
            if part.valid:
                found.append(Reading(role, of, part.valid, is_valid=True))
            found.append(Reading(role, of, part))
    return tuple(found)


class Sums:
    """All sums of a bag. `readings`: from `readings_of`; `bindings`: by role."""

    def __init__(self, readings: Sequence[Reading], bindings: Mapping[str, TopicBinding]) -> None:
        roles = list(dict.fromkeys(one.role for one in readings))
        self._sums = {role: Sum(role, bindings[role]) for role in roles if bindings[role].parts}
        self._readings, self._is_roles = readings, len(readings) == len(roles)
        self._role_of = np.array([roles.index(one.role) for one in readings], np.int16)
        self._is_part = np.array([one.part is not None for one in readings], np.bool_)

    @property
    def notes(self) -> list[str]:
        """How roles are added, for people."""
        return [one.note for one in self._sums.values()]

    @property
    def findings(self) -> Iterator[Finding]:
        """Messages that gave no sum."""
        for role, one in self._sums.items():
            if one.alone:
                text = f"{one.alone} messages give no sample, because another part of the sum is missing"
                yield Finding(role, "part", one.alone, float("nan"), text)

    def added(self, block: SampleBlock) -> SampleBlock:
        """A block of readings, without validities, as one of roles: a sum replaces the part that completes it."""
        if not self._sums:
            return block if self._is_roles else replace(block, role=self._role_of[block.role])
        parts = np.flatnonzero(self._is_part[block.role])
        columns = (parts, block.role[parts], block.stamp_ns[parts], block.arrival_ns[parts], block.value[parts])
        rows, stamps, values = list[int](), list[int](), list[float]()
        for row, index, stamp_ns, arrival_ns, value in zip(*(column.tolist() for column in columns), strict=True):
            one = self._readings[index]
            assert one.part is not None
            for stamp, total in self._sums[one.role].add(one.part, stamp_ns, arrival_ns, value):
                rows.append(row)
                stamps.append(stamp)
                values.append(total)
        others = np.flatnonzero(~self._is_part[block.role])
        at = np.concatenate([others, np.array(rows, np.intp)])
        order = np.argsort(at, kind="stable")
        at = at[order]
        return SampleBlock(
            self._role_of[block.role[at]],
            np.concatenate([block.stamp_ns[others], np.array(stamps, np.int64)])[order],
            block.arrival_ns[at],
            np.concatenate([block.value[others], np.array(values, np.float64)])[order],
        )


class Sum:
    """The sum of parts, at the times of the first topic.

    Parts of one message belong together: a missing one leaves no sum. Those of other topics are interpolated linearly to the time
    of the first one; if the samples around it are too far apart, there is no sum.

    `role`: role of the sum; `binding`: its parts are fields of topics.
    """

    def __init__(self, role: str, binding: TopicBinding) -> None:
        topics = list(dict.fromkeys(part.topic for part in binding.parts))
        self._role, self._topics = role, topics
        self._binding = binding
        self._topic_of = [topics.index(part.topic) for part in binding.parts]
        self._parts_of = [self._topic_of.count(index) for index in range(len(topics))]
        default_s = APART_S if ROLES[base_role(role)].lively else SLOW_APART_S
        self._apart_s = binding.max_age_s or default_s
        self._apart_ns = round(self._apart_s * 1e9)
        self._message: list[tuple[tuple[int, int], tuple[int, ...], float]] = [((0, 0), (), 0.0)] * len(topics)  # parts so far
        self._waiting: deque[tuple[int, int, float]] = deque()  # clock, stamp and value of the first topic
        self._others: list[deque[tuple[int, float]]] = [deque() for _ in topics[1:]]
        self.alone = 0

    @property
    def note(self) -> str:
        """How it is added, for people."""
        if len(self._topics) == 1:
            return f"{self._role}: sum of {len(self._topic_of)} fields of {self._topics[0]}"
        others = ", ".join(self._topics[1:])
        between = f"interpolated between samples at most {self._apart_s:g} s apart"
        return f"{self._role}: sum at the times of {self._topics[0]}; {others} {between}"

    def add(self, part: int, stamp_ns: int, arrival_ns: int, value: float) -> list[tuple[int, float]]:
        """Add a part of a message, and return the sums that it completes.

        `part`: its index among the parts; `stamp_ns`, `arrival_ns`: of its message [ns]; a stamp of 0, never set, is replaced by
        the arrival; `value`: scaled by its line of the topics file. Returns stamp [ns], and the sum in the unit of the role.
        """
        index = self._topic_of[part]
        message, seen, total = self._message[index]
        if seen and (message != (stamp_ns, arrival_ns) or part in seen):
            self.alone += 1
            seen, total = (), 0.0
        seen, total = (*seen, part), total + value
        whole = len(seen) == self._parts_of[index]
        self._message[index] = ((stamp_ns, arrival_ns), () if whole else seen, 0.0 if whole else total)
        if not whole:
            return []
        clock = stamp_ns or arrival_ns
        if index == 0:
            self._wait(clock, stamp_ns, total)
        else:
            self._keep(self._others[index - 1], clock, total)
        return self._complete()

    def _wait(self, clock: int, stamp_ns: int, value: float) -> None:
        if self._waiting and clock < self._waiting[-1][0]:  # a bag that loops
            self.alone += len(self._waiting)
            self._waiting.clear()
        self._waiting.append((clock, stamp_ns, value))
        while clock - self._waiting[0][0] > self._apart_ns:
            self._waiting.popleft()
            self.alone += 1

    def _keep(self, samples: deque[tuple[int, float]], clock: int, value: float) -> None:
        if samples and clock < samples[-1][0]:
            samples.clear()
        samples.append((clock, value))
        while len(samples) > 2 and clock - samples[1][0] > 2 * self._apart_ns:
            samples.popleft()

    def _complete(self) -> list[tuple[int, float]]:
        done = []
        while self._waiting:
            clock, stamp_ns, total = self._waiting[0]
            found = [_at(samples, clock, self._apart_ns) for samples in self._others]
            if "later" in found:
                break
            self._waiting.popleft()
            values = [value for value in found if isinstance(value, float)]
            if len(values) < len(found):
                self.alone += 1
                continue
            value = self._binding.scale * (total + sum(values)) + self._binding.offset
            done.append((self._binding.less_delay(stamp_ns), value))
        return done


def _at(samples: deque[tuple[int, float]], clock: int, apart_ns: int) -> float | str:
    """The value at a time: "later" before the next sample has arrived, "never" without one near enough."""
    while len(samples) > 1 and samples[1][0] <= clock:
        samples.popleft()
    if not samples:
        return "later"
    before, value = samples[0]
    if before == clock:
        return value
    if before > clock:
        return "never"
    if len(samples) < 2:
        return "later"
    after, next_value = samples[1]
    if after - before > apart_ns:
        return "never"
    return value + (next_value - value) * ((clock - before) / (after - before))


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


LARGEST_RAD = {"latitude": 0.5 * math.pi, "longitude": math.pi}


class PositionUnits:
    """The unit of latitude and longitude if neither topics file, column nor message type gives it.

    There is no land within both 1.6 degrees of the equator and 3.2 degrees of the prime meridian. So a vehicle whose latitudes
    and longitudes are all within the range of angles in radians is recorded in radians.

    `bindings`: of the source, by role.
    """

    def __init__(self, bindings: Mapping[str, TopicBinding]) -> None:
        given = {role: bindings[role].unit for role in POSITION if role in bindings}
        said = {unit for unit in given.values() if unit}
        self._open = [role for role, unit in given.items() if not unit]
        self._scale = math.nan
        self.notes: tuple[str, ...] = ()
        if self._open and said:  # one receiver provides both
            self._decide(said == {"deg"}, f"as {', '.join(set(given) - set(self._open))}")

    def _decide(self, degrees: bool, why: str) -> None:
        self._scale = DEGREE if degrees else 1.0
        self.notes = (f"{', '.join(self._open)}: treated as {'degrees' if degrees else 'radians'}, {why}",)

    def in_radians(self, block: SampleBlock, roles: Sequence[str]) -> SampleBlock:
        """A block with its position in radians; nan until the unit is known.

        `block`: the next one of the source; `roles`: those of the source.
        """
        if not self._open:
            return block
        where = {role: block.role == roles.index(role) for role in self._open}
        if math.isnan(self._scale):
            seen = {role: np.abs(block.value[rows & np.isfinite(block.value)]) for role, rows in where.items()}
            if any((seen[role] > most).any() for role, most in LARGEST_RAD.items() if role in seen):
                self._decide(True, "by the values")
            elif all(values.any() for values in seen.values()):  # a receiver without a fix sends zeros
                self._decide(False, "by the values")
        value = block.value.copy()
        for rows in where.values():
            value[rows] *= self._scale
        return SampleBlock(block.role, block.stamp_ns, block.arrival_ns, value)
