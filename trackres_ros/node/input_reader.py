# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Turns decoded messages into samples of channel, stamp and value, by the rules of reading a bag."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from operator import attrgetter
from typing import Any

import numpy as np

from trackres_ros.estimator import columns as at
from trackres_ros.node.clock import SET_NS
from trackres_ros.node.endpoints import InputTopic
from trackres_ros.node.transport import is_usable, stamp_ns
from trackres_ros.recording.binding import TopicBinding
from trackres_ros.recording.sums import Sum

TOGETHER = frozenset({at.SPEED, at.TORQUE, at.SPECIFIC_FORCE, at.LATITUDE, at.LONGITUDE})  # channels whose stamps are compared
Sample = tuple[int, int, float]
"""Channel, stamp [ns] and value."""


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
        self._readers = [
            [
                (_channel(role, channels), _getter(b), b.stamp != "log", b, self.sums.get(role), part)
                for role, b, part in zip(i.roles, i.bindings, i.parts, strict=True)
            ]
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
        for (channel, _, by_header, binding, total, part), value in zip(self._readers[index], values, strict=True):
            if isinstance(value, str):
                absent.add(channel)
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
            elif total is None or part is None:
                found.append((channel, stamp, float(binding.meant(np.asarray(value))) if binding.values else value))
            else:
                found += [(channel, *sample) for sample in total.add(part, stamp, came_ns, value)]
        for channel in absent:
            self.absent[channel] += 1
        for channel in bad_stamp:
            self.bad_stamp[channel] += 1
        return found

    def alone(self) -> list[int]:
        """Messages of each channel that gave no sum, as another part is missing."""
        return [self.sums[role].alone if role in self.sums else 0 for role in self._channels]


def _channel(role: str, channels: Sequence[str]) -> int:
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
