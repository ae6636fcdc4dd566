# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Holds messages between middleware and application, with their arrival times, however busy the estimate is.

A middleware silently drops the oldest messages of a full queue, and queued messages have no time of arrival.
So messages are also fetched between the steps, and wait here: bounded, with a count of those dropped.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from trackres_ros.node.clock import Arrival

Take = Callable[[], Iterable[Any]]

COLLECT_EVERY_NS = 2_000_000  # accuracy of an arrival; at 1 kHz two messages


class Inbox:
    """Messages of all inputs that wait for the application."""

    def __init__(
        self,
        inputs: Sequence[Take],  # for each input: fetch new messages from the middleware
        hand: Callable[[int, Any, Arrival], None],  # pass one message to the application: input, message, arrival
        now: Callable[[], Arrival],  # arrival time of a new message
        dropped: Callable[[int], None],  # called with the input of each dropped message
        depth: int,  # limit of waiting messages per input
    ) -> None:
        self._inputs, self._hand, self._now, self._dropped, self._depth = inputs, hand, now, dropped, depth
        self._waiting = self._empty()
        self._collected_ns = 0

    @property
    def holds_any(self) -> bool:
        """Whether a message waits here, such as one fetched while others were passed on."""
        return any(self._waiting)

    def collect(self) -> None:
        """Fetch new messages from the middleware.

        Topics are polled from the last to the first and passed on from the first to the last. The last feeds the speed,
        so everything sent before a speed is present when the speed is passed on. With polling in the same order, a load could
        arrive just after its topic was found empty, and a later speed just before its own was.
        """
        self._collected_ns = time.monotonic_ns()
        for index in reversed(range(len(self._inputs))):
            for message in self._inputs[index]():
                self.put(index, message)

    def put(self, index: int, message: object) -> None:
        """A message of an input that came just now."""
        waiting = self._waiting[index]
        if len(waiting) >= self._depth:
            waiting.popleft()
            self._dropped(index)
        waiting.append((message, self._now()))

    def work_off(self, meanwhile: Callable[[], None], collecting: bool) -> None:
        """Pass on waiting messages; call `meanwhile` after each, and if `collecting`, fetch new messages too."""
        handed, self._waiting = self._waiting, self._empty()
        for index, messages in enumerate(handed):
            for message, arrived in messages:
                self._hand(index, message, arrived)
                if collecting and time.monotonic_ns() - self._collected_ns > COLLECT_EVERY_NS:
                    self.collect()
                meanwhile()

    def _empty(self) -> list[deque[tuple[Any, Arrival]]]:
        return [deque() for _ in self._inputs]
