# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Holds messages between middleware and application, with the time at which each came, whatever the estimate is busy with.

A middleware keeps so many messages of a topic and then drops the oldest, without a word; and what waits there has no time of
arrival. So messages are taken off it between the steps too, and wait here: bounded, and counted where one is dropped.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from typing import Any

Arrival = tuple[int, int]
"""When a message came, by the steady clock and by the node's time [ns]."""
Take = Callable[[], Iterable[Any]]

COLLECT_EVERY_NS = 2_000_000  # so exactly is an arrival known; at 1 kHz two messages


class Inbox:
    """Messages of all inputs that wait for the application.

    Parameters
    ----------
    inputs
        A function for each input that takes what has come off the middleware.
    hand
        Hands one message to the application: input, message, arrival.
    now
        The arrival of what comes now.
    dropped
        Is told the input of each message that is dropped.
    depth
        Messages of one input that may wait.
    """

    def __init__(
        self,
        inputs: Sequence[Take],
        hand: Callable[[int, Any, Arrival], None],
        now: Callable[[], Arrival],
        dropped: Callable[[int], None],
        depth: int,
    ) -> None:
        self._inputs, self._hand, self._now, self._dropped, self._depth = inputs, hand, now, dropped, depth
        self._waiting = self._empty()
        self._collected_ns = 0

    def collect(self) -> None:
        """Take what has come off the middleware.

        The topics are looked at from the last to the first and handed over from the first to the last. The last feeds the speed,
        so whatever was sent before a speed is there when the speed is handed over. Looked at in turn, a load could come just
        after its topic was found empty, and the speed sent after it just before its own was.
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
        """Hand over what waits; `meanwhile` is called after each message, and if `collecting`, new messages are collected too."""
        handed, self._waiting = self._waiting, self._empty()
        for index, messages in enumerate(handed):
            for message, arrived in messages:
                self._hand(index, message, arrived)
                if collecting and time.monotonic_ns() - self._collected_ns > COLLECT_EVERY_NS:
                    self.collect()
                meanwhile()

    def _empty(self) -> list[deque[tuple[Any, Arrival]]]:
        return [deque() for _ in self._inputs]
