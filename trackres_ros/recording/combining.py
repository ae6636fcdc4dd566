# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Combines the samples of several channels: sums of parts, validity, direction, and the unit of a position; equal live and from a
recording.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
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
    readings: list[Reading] = []
    for role in roles:
        for number, part in enumerate(bindings[role].sources):
            part_count = number if bindings[role].parts else None
            if part.valid:
                readings.append(Reading(role, part_count, part.valid, is_valid=True))
            readings.append(Reading(role, part_count, part))
    return tuple(readings)


class Sums:
    """All sums of a bag. `readings`: from `readings_of`; `bindings`: by role."""

    def __init__(self, readings: Sequence[Reading], bindings: Mapping[str, TopicBinding]) -> None:
        roles = list(dict.fromkeys(reading.role for reading in readings))
        self._sums = {role: Sum(role, bindings[role]) for role in roles if bindings[role].parts}
        self._readings, self._is_roles = readings, len(readings) == len(roles)
        self._role_of = np.array([roles.index(reading.role) for reading in readings], np.int16)
        self._is_part = np.array([reading.part is not None for reading in readings], np.bool_)

    @property
    def notes(self) -> list[str]:
        """How roles are added, for people."""
        return [total.note for total in self._sums.values()]

    @property
    def findings(self) -> Iterator[Finding]:
        """Messages that gave no sum."""
        for role, total in self._sums.items():
            if total.lone_samples:
                text = f"{total.lone_samples} messages give no sample, because another part of the sum is missing{total.lack}"
                yield Finding(role, "part", total.lone_samples, float("nan"), text)

    def add_totals(self, block: SampleBlock) -> SampleBlock:
        """A block of readings, without validities, as one of roles: a sum replaces the part that completes it."""
        if not self._sums:
            return block if self._is_roles else replace(block, role=self._role_of[block.role])
        parts = np.flatnonzero(self._is_part[block.role])
        columns = (parts, block.role[parts], block.stamp_ns[parts], block.arrival_ns[parts], block.value[parts])
        rows, stamps, values = list[int](), list[int](), list[float]()
        for row, index, stamp_ns, arrival_ns, value in zip(*(column.tolist() for column in columns), strict=True):
            reading = self._readings[index]
            assert reading.part is not None
            for stamp, total in self._sums[reading.role].add(reading.part, stamp_ns, arrival_ns, value):
                rows.append(row)
                stamps.append(stamp)
                values.append(total)
        whole_rows = np.flatnonzero(~self._is_part[block.role])
        sources = np.concatenate([whole_rows, np.array(rows, np.intp)])
        order = np.argsort(sources, kind="stable")
        sources = sources[order]
        return SampleBlock(
            self._role_of[block.role[sources]],
            np.concatenate([block.stamp_ns[whole_rows], np.array(stamps, np.int64)])[order],
            block.arrival_ns[sources],
            np.concatenate([block.value[whole_rows], np.array(values, np.float64)])[order],
        )


def parts_without_samples(parts: Sequence[TopicBinding], seen_parts: Container[int]) -> str:
    """Names of the parts of a sum without any sample, for the end of a sentence."""
    names = [
        f"part {place + 1} ({part.column or f'{part.topic} {part.field}'})"
        for place, part in enumerate(parts)
        if place not in seen_parts
    ]
    return f": {some_of(names, NAMES_SHOWN)} never has one" if names else ""


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
        default_s = APART_S if ROLES[base_role(role)].is_lively else SLOW_APART_S
        self._apart_s = binding.max_age_s or default_s
        self._apart_ns = round(self._apart_s * 1e9)
        self._message: list[tuple[tuple[int, int], tuple[int, ...], float]] = [((0, 0), (), 0.0)] * len(topics)  # parts so far
        self._pending: deque[tuple[int, int, float]] = deque()  # clock, stamp and value of the first topic
        self._other_samples: list[deque[tuple[int, float]]] = [deque() for _ in topics[1:]]
        self.lone_samples = 0
        self._seen_parts: set[int] = set()

    @property
    def lack(self) -> str:
        """Names of the parts without any sample, for people."""
        return parts_without_samples(self._binding.parts, self._seen_parts)

    @property
    def note(self) -> str:
        """How it is added, for people."""
        if len(self._topics) == 1:
            return f"{self._role}: sum of {len(self._topic_of)} fields of {self._topics[0]}"
        other_topics = ", ".join(self._topics[1:])
        apart_text = f"interpolated between samples at most {self._apart_s:g} s apart"
        return f"{self._role}: sum at the times of {self._topics[0]}; {other_topics} {apart_text}"

    def add(self, part: int, stamp_ns: int, arrival_ns: int, value: float) -> list[tuple[int, float]]:
        """Add a part of a message, and return the sums that it completes.

        `part`: its index among the parts; `stamp_ns`, `arrival_ns`: of its message [ns]; a stamp of 0, never set, is replaced by
        the arrival; `value`: scaled by its line of the topics file. Returns stamp [ns], and the sum in the unit of the role.
        """
        index = self._topic_of[part]
        self._seen_parts.add(part)
        message, parts_seen, total = self._message[index]
        if parts_seen and (message != (stamp_ns, arrival_ns) or part in parts_seen):
            self.lone_samples += 1
            parts_seen, total = (), 0.0
        parts_seen, total = (*parts_seen, part), total + value
        is_whole = len(parts_seen) == self._parts_of[index]
        self._message[index] = ((stamp_ns, arrival_ns), () if is_whole else parts_seen, 0.0 if is_whole else total)
        if not is_whole:
            return []
        clock = stamp_ns or arrival_ns
        if index == 0:
            self._wait(clock, stamp_ns, total)
        else:
            self._keep(self._other_samples[index - 1], clock, total)
        return self._complete_sums()

    def _wait(self, clock: int, stamp_ns: int, value: float) -> None:
        if self._pending and clock < self._pending[-1][0]:  # a bag that loops
            self.lone_samples += len(self._pending)
            self._pending.clear()
        self._pending.append((clock, stamp_ns, value))
        while clock - self._pending[0][0] > self._apart_ns:
            self._pending.popleft()
            self.lone_samples += 1

    def _keep(self, samples: deque[tuple[int, float]], clock: int, value: float) -> None:
        if samples and clock < samples[-1][0]:
            samples.clear()
        samples.append((clock, value))
        while len(samples) > 2 and clock - samples[1][0] > 2 * self._apart_ns:
            samples.popleft()

    def _complete_sums(self) -> list[tuple[int, float]]:
        sums = []
        while self._pending:
            clock, stamp_ns, total = self._pending[0]
            interpolated_values = [_interpolate(samples, clock, self._apart_ns) for samples in self._other_samples]
            if "later" in interpolated_values:
                break
            self._pending.popleft()
            values = [value for value in interpolated_values if isinstance(value, float)]
            if len(values) < len(interpolated_values):
                self.lone_samples += 1
                continue
            value = self._binding.scale * (total + sum(values)) + self._binding.offset
            sums.append((self._binding.less_delay(stamp_ns), value))
        return sums


def _interpolate(samples: deque[tuple[int, float]], clock: int, apart_ns: int) -> float | str:
    """The value at a time: "later" before the next sample has arrived, "never" without one near enough."""
    while len(samples) > 1 and samples[1][0] <= clock:
        samples.popleft()
    if not samples:
        return "later"
    previous_clock, value = samples[0]
    if previous_clock == clock:
        return value
    if previous_clock > clock:
        return "never"
    if len(samples) < 2:
        return "later"
    next_clock, next_value = samples[1]
    if next_clock - previous_clock > apart_ns:
        return "never"
    return value + (next_value - value) * ((clock - previous_clock) / (next_clock - previous_clock))


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

    def __init__(self, hold_s: float, shares_message: bool) -> None:
        self._hold_ns = 0 if shares_message else round(hold_s * 1e9)
        self._value, self._came_ns = nan, 0
        self.seen = False

    def take_sample(self, arrival_ns: int, value: float) -> None:
        """Take its next value; nan says nothing, and neutral keeps the way that the vehicle rolls."""
        if isnan(value):
            return
        self.seen = True
        if value == NEUTRAL and not isnan(self._value):
            self._came_ns = arrival_ns
        elif value != NEUTRAL:
            self._value, self._came_ns = value, arrival_ns

    def value_at(self, arrival_ns: int) -> float:
        """Its value at an arrival; nan where there is none, or it is too old. A time that ran back ends it too."""
        return self._value if 0 <= arrival_ns - self._came_ns <= self._hold_ns else nan


@dataclass(slots=True)
class Dropped:
    """Samples that a companion changed or let fall: their number."""

    invalid_values: int = 0
    no_direction: int = 0
    opposite_signs: int = 0  # negative speeds where the direction is forward


class Companions:
    """All companions of a source.

    `readings`: from `readings_of`; `bindings`: by role; `required`: whether a speed waits for its first direction. A direction
    that was only guessed may never have a value; until it has one the speed is as it came.
    """

    def __init__(self, readings: Sequence[Reading], bindings: Mapping[str, TopicBinding], is_required: bool = True) -> None:
        self._readings, self._is_required = readings, is_required
        self._validity_values = {
            (reading.role, reading.part): Companion(
                reading.binding.max_age_s or HOLD_S, _share_message(reading.binding, target.binding)
            )
            for reading, target in itertools.pairwise(readings)
            if reading.is_valid
        }
        self._direction: Companion | None = None
        if DIRECTION in bindings and "speed" in bindings:
            way, speed = bindings[DIRECTION], bindings["speed"]
            self._direction = Companion(way.max_age_s or HOLD_S, not speed.parts and _share_message(way, speed))
        self.dropped: dict[str, Dropped] = {reading.role: Dropped() for reading in readings}

    @property
    def notes(self) -> list[str]:
        """What is not as it came, for people."""
        return ["speed: its sign is that of the direction"] if self._direction else []

    @property
    def findings(self) -> Iterator[Finding]:
        """Samples that gave no value, or contradict their direction."""
        for role, counts in self.dropped.items():
            if counts.invalid_values:
                text = f"{counts.invalid_values} values are not valid, as another channel says: they give no sample"
                yield Finding(role, "invalid", counts.invalid_values, nan, text)
            if counts.no_direction:
                text = f"{counts.no_direction} values have no known direction: they give no sample"
                yield Finding(role, "no_direction", counts.no_direction, nan, text)
            if counts.opposite_signs:
                text = f"{counts.opposite_signs} values are negative while the direction is forward: they keep their sign"
                yield Finding(role, "against_direction", counts.opposite_signs, nan, text)

    def is_valid_sample(self, reading: Reading, arrival_ns: int, value: float) -> bool:
        """Whether a value of a reading counts; the value of a validity is kept, and counts not."""
        companion = self._validity_values.get((reading.role, reading.part))
        if companion is None:
            return True
        if reading.is_valid:
            companion.take_sample(arrival_ns, 2.0 * float(value != 0.0) - 1.0 if not isnan(value) else value)
            return False
        if companion.value_at(arrival_ns) > 0.0:
            return True
        self.dropped[reading.role].invalid_values += 1
        return False

    def sign_speed(self, role: str, arrival_ns: int, value: float) -> float | None:
        """The value of a role with its sign; None of a speed whose direction is not known. A direction is kept.

        A negative speed has a sign of its own; one of 0 needs none.
        """
        if self._direction is None or role not in ("speed", DIRECTION):
            return value
        if role == DIRECTION:
            self._direction.take_sample(arrival_ns, value)
            return value
        way = self._direction.value_at(arrival_ns)
        if value < 0.0:
            self.dropped[role].opposite_signs += way > 0.0
        elif value > 0.0:
            if isnan(way) and (self._is_required or self._direction.seen):
                self.dropped[role].no_direction += 1
                return None
            return value if isnan(way) else copysign(value, way)
        return value

    def keep_valid(self, block: SampleBlock) -> SampleBlock:
        """A block of readings, before their sums: without validities, and what they let fall."""
        if not self._validity_values:
            return block
        has_validity = [(reading.role, reading.part) in self._validity_values for reading in self._readings]
        keep = np.ones(len(block), np.bool_)
        for row in np.flatnonzero(np.array(has_validity)[block.role]).tolist():
            keep[row] = self.is_valid_sample(self._readings[block.role[row]], int(block.arrival_ns[row]), float(block.value[row]))
        return _rows(block, keep)

    def with_signs(self, block: SampleBlock, roles: Sequence[str]) -> SampleBlock:
        """A block of roles, after their sums: with the signs of speeds, and without those of no known direction."""
        if self._direction is None:
            return block
        has_sign = np.array([role in ("speed", DIRECTION) for role in roles])
        keep, values = np.ones(len(block), np.bool_), block.value.copy()
        for row in np.flatnonzero(has_sign[block.role]).tolist():
            signed_value = self.sign_speed(roles[block.role[row]], int(block.arrival_ns[row]), float(values[row]))
            keep[row] = signed_value is not None
            values[row] = values[row] if signed_value is None else signed_value
        return _rows(SampleBlock(block.role, block.stamp_ns, block.arrival_ns, values), keep)


class Signs:
    """Whether a speed was ever negative: one that never is may lack its sign."""

    def __init__(self, roles: Sequence[str]) -> None:
        self._speed = roles.index("speed") if "speed" in roles else -1
        self._lowest_speed, self._highest_speed = inf, -inf

    def seen(self, block: SampleBlock) -> SampleBlock:
        """Look at a block of roles, and pass it on."""
        values = block.value[block.role == self._speed]
        values = values[np.isfinite(values)]
        if values.size:
            self._lowest_speed, self._highest_speed = (
                min(self._lowest_speed, values.min()),
                max(self._highest_speed, values.max()),
            )
        return block

    def findings(self, names: Sequence[str], lines: Iterable[str]) -> Iterator[Finding]:
        """A speed that is never negative, beside columns or topics that may say reverse, with their lines of a topics file."""
        if names and self._lowest_speed >= 0.0 and self._highest_speed > 0.0:
            text = (
                f"it is never negative, and {some_of(names, NAMES_SHOWN)} may say when the vehicle drives backwards: the torque "
                f"then has the wrong sign. If so, write in a topics file, with the values that it has: {next(iter(lines))}"
            )
            yield Finding("speed", "unsigned", len(names), nan, text)


def _share_message(first_binding: TopicBinding, second_binding: TopicBinding) -> bool:
    """Whether two channels come in one message."""
    return first_binding.topic != "" and first_binding.topic == second_binding.topic


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
        units = {role: bindings[role].unit for role in POSITION if role in bindings}
        known_units = {unit for unit in units.values() if unit}
        self._unitless_roles = [role for role, unit in units.items() if not unit]
        self._scale = math.nan
        self.notes: tuple[str, ...] = ()
        if self._unitless_roles and known_units:  # one receiver provides both
            self._decide(known_units == {"deg"}, f"as {', '.join(set(units) - set(self._unitless_roles))}")

    def _decide(self, degrees: bool, reason: str) -> None:
        self._scale = DEGREE if degrees else 1.0
        self.notes = (f"{', '.join(self._unitless_roles)}: treated as {'degrees' if degrees else 'radians'}, {reason}",)

    def in_radians(self, block: SampleBlock, roles: Sequence[str]) -> SampleBlock:
        """A block with its position in radians; nan until the unit is known.

        `block`: the next one of the source; `roles`: those of the source.
        """
        if not self._unitless_roles:
            return block
        role_rows = {role: block.role == roles.index(role) for role in self._unitless_roles}
        if math.isnan(self._scale):
            magnitudes = {role: np.abs(block.value[rows & np.isfinite(block.value)]) for role, rows in role_rows.items()}
            if any((magnitudes[role] > largest_rad).any() for role, largest_rad in LARGEST_RAD.items() if role in magnitudes):
                self._decide(True, "by the values")
            elif all(values.any() for values in magnitudes.values()):  # a receiver without a fix sends zeros
                self._decide(False, "by the values")
        value = block.value.copy()
        for rows in role_rows.values():
            value[rows] *= self._scale
        return SampleBlock(block.role, block.stamp_ns, block.arrival_ns, value)
