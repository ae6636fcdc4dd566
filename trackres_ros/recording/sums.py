# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Adds the parts of a role from messages at different times; equal live and from a bag."""

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trackres_ros.recording.binding import TopicBinding
from trackres_ros.recording.roles import ROLES, base_role
from trackres_ros.recording.samples import Finding, SampleBlock

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
