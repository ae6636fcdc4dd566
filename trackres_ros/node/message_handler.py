# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Takes in the messages of the inputs: records them, brings them into the order of sending and turns them into samples."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Collection, Sequence
from itertools import chain
from operator import attrgetter
from typing import NamedTuple

from trackres_ros.node.clock import Arrival, NodeClock
from trackres_ros.node.endpoints import InputTopic
from trackres_ros.node.guard import Guard
from trackres_ros.node.input_reader import InputReader
from trackres_ros.node.transport import KeepMessage

MOST_BEFORE_CLOCK = 10000  # messages of an input
LONGEST_WAIT_NS = 50_000_000  # of a message for a speed that was sent later
LONGEST_HELD_NS = 10_000_000_000  # of a message that is handled after a later one; a clock that goes back further was set

UseSample = Callable[[int, int, float, int, int, int], None]
"""Takes a sample: channel, stamp [ns], value, and its arrival by the steady clock, the node's time and the recording [ns]."""


class Arrived(NamedTuple):
    """A message of an input, with its times [ns]."""

    sent_ns: int  # by the clock of its publisher; 0 if unknown
    steady_ns: int  # arrival by the steady clock
    now_ns: int  # arrival by the node's time
    place: int  # of the input
    stamp_ns: int | None
    values: Sequence[float | str]
    raw: bytes | None  # to be recorded


class MessageHandler:
    """Passes the samples of all inputs to `use`, in the order in which their messages were sent.

    After a pause of this process, a middleware passes on one message of each topic in turn. So messages other than speeds are
    held back until a speed with a later sending time arrives, for `LONGEST_WAIT_NS` at most.

    Messages before the first simulated clock wait for it: without a time their age is unknown. The oldest make way for too many.
    """

    def __init__(self, inputs: Sequence[InputTopic], reader: InputReader, clock: NodeClock, guard: Guard, use: UseSample) -> None:
        self.reader = reader
        self.keep_raw: KeepMessage | None = None  # where all messages are recorded
        self.misread: Collection[int] = ()  # inputs with a publisher that has another definition of the type
        self._clock, self._guard, self._use = clock, guard, use
        self._widths = [len(given.roles) for given in inputs]
        self._is_speed = ["speed" in given.valued for given in inputs]
        self._held: list[Arrived] = []
        self._handled_ns = self._handled_now_ns = 0  # arrival of the last handled message, as recorded and by the node's time
        self._before_clock: list[deque[Arrived]] = [deque() for _ in inputs]

    def receive(
        self, index: int, message: object, sent_ns: int = 0, arrived: Arrival | None = None, raw: bytes | None = None
    ) -> None:
        """Process a decoded message of an input topic, sent at a time [ns] of its publisher's machine, 0 if unknown.

        By default it arrives now. `raw` are its bytes, to be recorded as it is handled.
        """
        read = self._guard.essential("reading a message", self.reader.read, index, message)
        if read is not None:
            self.receive_values(index, *read, sent_ns, arrived, raw)
        else:
            self.keep(index, raw, arrived)

    def receive_undecodable(self, index: int, sent_ns: int = 0, arrived: Arrival | None = None, raw: bytes | None = None) -> None:
        """Take note of a message of an input topic that cannot be decoded: no number, at the node's time."""
        self.receive_values(index, None, [math.nan] * self._widths[index], sent_ns, arrived, raw)

    def receive_values(
        self,
        index: int,
        stamp_ns: int | None,
        values: Sequence[float | str],
        sent_ns: int = 0,
        arrived: Arrival | None = None,
        raw: bytes | None = None,
    ) -> None:
        """Process values that a transport has read from a message of an input topic; see `InputReader.samples`."""
        if index in self.misread:
            self.keep(index, raw, arrived)
            return
        message = Arrived(sent_ns, *(arrived or self._clock.arrival()), index, stamp_ns, values, raw)
        self._guard.essential("taking a message", self._receive, message)

    def keep(self, index: int, raw: bytes | None, arrived: Arrival | None = None) -> None:
        """Record a raw message that is not handled, where all are recorded; None is not recorded."""
        self._record(index, raw, self._clock.recorded_ns(*(arrived or self._clock.arrival())))

    def dropped(self, index: int) -> None:
        """Take note of a message of an input topic that had to make way for later ones."""
        self.reader.dropped[index] += 1

    def handle_late(self, steady: int) -> None:
        """Handle the messages that have waited for too long."""
        self._handle_held(lambda message: steady - message.steady_ns > LONGEST_WAIT_NS)

    def handle_waiting(self) -> None:
        """Handle all messages that are held back."""
        self._handle_held(lambda _: True)

    def time_went_back(self) -> None:
        """Handle the messages of the time before, and begin anew."""
        self.handle_waiting()
        self._handled_ns = 0

    def close(self) -> None:
        """Handle all messages that are held back, and record those that wait for a clock."""
        self.handle_waiting()
        for message in self._take_waiting():
            self.keep(message.place, message.raw, (message.steady_ns, message.now_ns))

    def _receive(self, message: Arrived) -> None:
        if self._clock.simulated and message.now_ns == 0:
            message = message._replace(now_ns=self._clock.now_ns(message.steady_ns))
            if message.now_ns == 0:
                waiting = self._before_clock[message.place]
                waiting.append(message)
                if len(waiting) > MOST_BEFORE_CLOCK:
                    self.dropped(message.place)
                    oldest = waiting.popleft()
                    self.keep(oldest.place, oldest.raw, (oldest.steady_ns, 0))
                return
        for earlier in self._take_waiting():
            self._guard.essential("taking a message", self._receive, earlier)
        if message.sent_ns and not self._is_speed[message.place]:
            self._held.append(message)
            return
        self._handle_held(lambda other: other.sent_ns <= message.sent_ns or not message.sent_ns)
        self._handle(message)

    def _take_waiting(self) -> list[Arrived]:
        """The messages that wait for a clock, in the order of arrival; none wait afterwards."""
        if not any(self._before_clock):
            return []
        found = sorted(chain(*self._before_clock), key=attrgetter("steady_ns"))
        for waiting in self._before_clock:
            waiting.clear()
        return found

    def _handle_held(self, due: Callable[[Arrived], bool]) -> None:
        """Handle the messages held back that are due, in the order of sending."""
        if not self._held:
            return
        handled = [message for message in self._held if due(message)]
        self._held = [message for message in self._held if not due(message)]
        for message in sorted(handled, key=attrgetter("sent_ns")):
            self._handle(message)

    def _handle(self, message: Arrived) -> None:
        """Record a message and process its samples, by an arrival after that of the last one: so a replay keeps their order.

        Messages held back are 1 ns apart by both clocks. Their own readings differ by more than that, so their stamps would run
        backward.
        """
        _, steady, now, place, stamp_ns, values, raw = message
        recorded = self._clock.recorded_ns(steady, now)
        if 0 <= self._handled_ns - recorded < LONGEST_HELD_NS - 1:
            recorded, now = self._handled_ns + 1, self._handled_now_ns + 1
        self._handled_ns, self._handled_now_ns = recorded, now
        self._record(place, raw, recorded)
        set_ns = self._clock.set_by_ns(now, recorded)
        samples = self._guard.essential("taking a message", self.reader.samples, place, stamp_ns, values, recorded, set_ns)
        for channel, stamp, value in samples or ():
            self._guard.essential("the step", self._use, channel, stamp, value, steady, now, recorded)

    def _record(self, index: int, raw: bytes | None, recorded_ns: int) -> None:
        if self.keep_raw and raw is not None:
            self._guard("recording", self.keep_raw, index, raw, recorded_ns)
