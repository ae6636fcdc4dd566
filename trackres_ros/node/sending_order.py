# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Sorts messages of several topics by sending time, as in a bag."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import attrgetter
from typing import NamedTuple

from trackres_ros.node.input_reader import Sample

LONGEST_WAIT_NS = 50_000_000  # of a message for a speed that was sent later


class Arrived(NamedTuple):
    """The samples of a message, with its times.

    Attributes
    ----------
    sent_ns
        Sending time, by the clock of its publisher [ns]; 0 if unknown.
    steady_ns, now_ns
        Arrival, by the steady clock and by the node's time [ns].
    samples
        Its samples.
    """

    sent_ns: int
    steady_ns: int
    now_ns: int
    samples: Sequence[Sample]


class SendingOrder:
    """Holds messages back until all that were sent earlier have arrived.

    After a pause of this process, a middleware passes on one message of each topic in turn. So messages other than speeds are
    held back until a speed with a later sending time arrives, for `LONGEST_WAIT_NS` at most.
    """

    def __init__(self) -> None:
        self._waiting: list[Arrived] = []

    def put(self, message: Arrived, is_speed: bool) -> list[Arrived]:
        """Take a message; the messages to be handled now, in their order."""
        if message.sent_ns and not is_speed:
            self._waiting.append(message)
            return []
        earlier = self._release(lambda other: other.sent_ns <= message.sent_ns or not message.sent_ns)
        return [*earlier, message]

    def late(self, steady_ns: int) -> list[Arrived]:
        """The messages that have waited for too long."""
        return self._release(lambda message: steady_ns - message.steady_ns > LONGEST_WAIT_NS)

    def rest(self) -> list[Arrived]:
        """All waiting messages."""
        return self._release(lambda _: True)

    def _release(self, due: Callable[[Arrived], bool]) -> list[Arrived]:
        if not self._waiting:
            return []
        released = [message for message in self._waiting if due(message)]
        self._waiting = [message for message in self._waiting if not due(message)]
        return sorted(released, key=attrgetter("sent_ns"))
