"""From a decoded message to samples: which channel, which stamp, which value. The rules are those of reading a bag."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from operator import attrgetter
from typing import Any

from trackres_ros.errors import InputError
from trackres_ros.live.endpoints import InputTopic
from trackres_ros.topics import TopicBinding

SECOND_NS = 1_000_000_000


class Intake:
    """Reads the messages of all input topics.

    Parameters
    ----------
    inputs
        The topics.
    channels
        Names of the estimator's channels, in their order.

    Raises
    ------
    InputError
        For a role of an axle or assembly that the vehicle does not have.
    """

    def __init__(self, inputs: Sequence[InputTopic], channels: Sequence[str]) -> None:
        self.received = [0] * len(inputs)
        self.absent = [0] * len(channels)
        self._readers = [
            [(_channel(role, channels), _getter(b), b.stamp != "log") for role, b in zip(i.roles, i.bindings, strict=True)]
            for i in inputs
        ]
        self._last_clock = [0] * len(channels)
        self._same_clock = [0] * len(channels)

    def samples(self, index: int, message: object, now_ns: int) -> Iterator[tuple[int, int, float]]:
        """Channel, stamp [ns] and value of each sample in a message.

        A stamp that was never set stays 0. What has no stamp gets the node's time. A message without the element gives no
        sample, one with a value that is no number gives nan.
        """
        self.received[index] += 1
        stamp = _stamp(message)
        for channel, read, by_header in self._readers[index]:
            try:
                value = read(message)
            except LookupError:
                self.absent[channel] += 1
                continue
            except (TypeError, ValueError, AttributeError):
                value = math.nan
            yield channel, stamp if by_header and stamp is not None else self._own_stamp(channel, now_ns), value

    def undecodable(self, index: int, now_ns: int) -> Iterator[tuple[int, int, float]]:
        """What a message that cannot be decoded counts as: no number, at the node's time."""
        self.received[index] += 1
        for channel, _, _ in self._readers[index]:
            yield channel, self._own_stamp(channel, now_ns), math.nan

    def _own_stamp(self, channel: int, now_ns: int) -> int:
        """The node's time; a simulated clock stands between its ticks, so what comes meanwhile is a nanosecond apart."""
        if now_ns == self._last_clock[channel]:
            self._same_clock[channel] += 1
        else:
            self._last_clock[channel], self._same_clock[channel] = now_ns, 0
        return now_ns + self._same_clock[channel]


def _channel(role: str, channels: Sequence[str]) -> int:
    if role not in channels:
        raise InputError(f"role {role}", role, f"what this vehicle has: {', '.join(channels)}")
    return channels.index(role)


def _getter(binding: TopicBinding) -> Callable[[Any], float]:
    """Reads the value of a role; a plain path without taking the path apart each time."""
    if any(step.index is not None or step.element is not None for step in binding.steps):
        return binding.read
    get, scale, offset = attrgetter(binding.field), binding.scale, binding.offset
    return lambda message: scale * float(get(message)) + offset


def _stamp(message: object) -> int | None:
    stamp = getattr(getattr(message, "header", message), "stamp", None)
    return None if stamp is None else int(stamp.sec) * SECOND_NS + int(stamp.nanosec)
