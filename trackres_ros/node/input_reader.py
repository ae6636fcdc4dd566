# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Turns decoded messages into samples of channel, stamp and value, by the rules of reading a bag."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from operator import attrgetter
from typing import Any

import numpy as np

from trackres_ros.estimator import columns as at
from trackres_ros.node.clock import SET_NS
from trackres_ros.node.endpoints import InputTopic
from trackres_ros.node.transport import is_usable, stamp_ns
from trackres_ros.recording.bindings import TopicBinding
from trackres_ros.recording.combining import DIRECTION, Companions, Dropped, Reading, Sum, readings_of

TOGETHER = frozenset({at.SPEED, at.TORQUE, at.SPECIFIC_FORCE, at.LATITUDE, at.LONGITUDE})  # channels whose stamps are compared
Sample = tuple[int, int, float]
"""Channel, stamp [ns] and value."""
NO_CHANNEL = -1
"""In place of a channel: a direction is in the sign of the speed."""


class InputReader:
    """Reads the messages of all input topics into samples of the estimator's channels; bindings of sums say how to add the parts.

    Raises InputError for a role of an axle or assembly that the vehicle does not have.
    """

    def __init__(self, inputs: Sequence[InputTopic], channels: Sequence[str], bindings: Mapping[str, TopicBinding]) -> None:
        self.received = [0] * len(inputs)
        self.dropped = [0] * len(inputs)
        self.absent = [0] * len(channels)
        self.lacks = [""] * len(channels)  # the last field that a message did not have, and why
        self.bad_stamp = [0] * len(channels)
        self.unused = [0] * len(channels)  # samples of another publisher than the one in use
        self.stamped: dict[int, int] = {}  # how far the clock was set [ns] at the last stamp of a channel in `TOGETHER`
        self.sums = {role: Sum(role, bindings[role]) for i in inputs for role in i.roles if bindings[role].parts}
        self._channels = channels
        every = [
            Reading(role, part, b, place in i.validities)
            for i in inputs
            for place, (role, b, part) in enumerate(zip(i.roles, i.bindings, i.parts, strict=True))
        ]
        wanted = dict.fromkeys(one.role for one in every)
        self.companions = Companions(readings_of(tuple(wanted), bindings), bindings)
        self._readers = [
            [
                (_channel(one.role, channels), _getter(one.binding), one, self.sums.get(one.role))
                for one in itertools.islice(rest, len(i.roles))
            ]
            for rest in [iter(every)]
            for i in inputs
        ]

    def read(self, index: int, message: object) -> tuple[int | None, list[float | str]]:
        """Stamp and values of a message with fields as attributes, for `samples`."""
        return _stamp(message), [_value(read, message) for _, read, *_ in self._readers[index]]

    def samples(
        self, index: int, stamp_ns: int | None, values: Sequence[float | str], arrival_ns: int, set_ns: int = 0
    ) -> list[Sample]:
        """Samples from the values of a message of an input topic, that came at `arrival_ns`.

        The stamp is None where the message's type has none: then the arrival is used. One that was never set is 0 and stays so.
        Where the machine's clock was set by `set_ns` since the start, both follow it if they are compared with stamps of others.
        A stamp out of a message's range gives no sample: it could not be published again. There is a scaled value for each
        binding of the topic: nan where it is no number; the reason, and no sample, where the message has no such element.
        """
        self.received[index] += 1
        found = []
        absent, bad_stamp = set[int](), set[int]()  # channels: a sum has several parts in a message
        for (channel, _, one, total), value in zip(self._readers[index], values, strict=True):
            binding, by_header = one.binding, one.binding.stamp != "log"
            if isinstance(value, str):
                absent.add(channel)
                if channel != NO_CHANNEL:
                    self.lacks[channel] = f"{binding.field}: {value}"
                continue
            if by_header and stamp_ns and channel in TOGETHER:
                self.stamped[channel] = set_ns
            came_ns = arrival_ns + (set_ns if self.stamped and channel in TOGETHER else 0)
            as_before = channel in self.stamped and abs(set_ns - self.stamped[channel]) <= SET_NS  # as its last stamp
            given = by_header and (stamp_ns or came_ns == arrival_ns or as_before)
            stamp = binding.less_delay(stamp_ns if given and stamp_ns is not None else came_ns)
            if not is_usable(stamp):
                bad_stamp.add(channel)
                continue
            value = float(binding.meant(np.asarray(value))) if binding.has_modes else value
            if not self.companions.valid(one, arrival_ns, value):
                continue
            whole = [(stamp, value)] if total is None or one.part is None else total.add(one.part, stamp, came_ns, value)
            signed = [(at_ns, self.companions.signed(one.role, arrival_ns, number)) for at_ns, number in whole]
            found += [(channel, at_ns, number) for at_ns, number in signed if number is not None and channel != NO_CHANNEL]
        for channel in absent - {NO_CHANNEL}:
            self.absent[channel] += 1
        for channel in bad_stamp - {NO_CHANNEL}:
            self.bad_stamp[channel] += 1
        return found

    def dropped_by_companions(self) -> list[list[int]]:
        """Values of each channel that are not valid, and speeds without a known direction."""
        none = Dropped()
        each = (self.companions.dropped.get(role, none) for role in self._channels)
        return [[one.invalid, one.no_direction] for one in each]

    def alone(self) -> list[int]:
        """Messages of each channel that gave no sum, as another part is missing."""
        return [self.sums[role].alone if role in self.sums else 0 for role in self._channels]


def _channel(role: str, channels: Sequence[str]) -> int:
    if role == DIRECTION:
        return NO_CHANNEL
    if role not in channels:
        raise at.not_of_vehicle(role, channels)
    return channels.index(role)


def _getter(binding: TopicBinding) -> Callable[[Any], float]:
    """A function that reads the value of a role; a plain path is split once, here."""
    if binding.fix or any(step.index is not None or step.element is not None for step in binding.steps):
        return binding.read
    get, scale, offset = attrgetter(binding.field), binding.scale, binding.offset
    return lambda message: scale * float(get(message)) + offset


def _value(read: Callable[[Any], float], message: object) -> float | str:
    try:
        return read(message)
    except LookupError as error:
        return str(error)
    except (TypeError, ValueError, AttributeError):
        return math.nan


def _stamp(message: object) -> int | None:
    stamp = getattr(getattr(message, "header", message), "stamp", None)
    try:
        return None if stamp is None else stamp_ns(int(stamp.sec), int(stamp.nanosec))
    except (AttributeError, TypeError, ValueError):  # a field of that name which is no time
        return None
