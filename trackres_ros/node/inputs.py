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

from trackres_ros.estimator import columns as at
from trackres_ros.node.clock import Arrival, NodeClock
from trackres_ros.node.endpoints import InputTopic
from trackres_ros.node.guard import Guard
from trackres_ros.node.input_reader import TOGETHER, InputReader
from trackres_ros.node.speed_sources import SpeedSources
from trackres_ros.node.transport import KeepMessage

MOST_BEFORE_CLOCK = 10000  # messages of an input
LONGEST_WAIT_NS = 50_000_000  # of a message for a speed that was sent later
LONGEST_HELD_NS = 10_000_000_000  # of a message that is handled after a later one; a clock that goes back further was set

MOST_COPIES = 10000  # sending times kept of latched messages, whose copies come within milliseconds
REPEATED_NS = 500_000_000  # at the next look, so once a second: as a slow publisher does

UseSample = Callable[[int, int, float, int, int, int], None]
"""Takes a sample: channel, stamp [ns], value, and its arrival by the steady clock, the node's time and the recording [ns]."""


class Sent(NamedTuple):
    """How a message left its publisher."""

    ns: int = 0  # by the clock of its machine [ns]; 0 if unknown
    source: int = 0  # number of the publisher; 0 where the middleware does not tell it
    latched: bool = False  # whether it came by an endpoint that also gets what publishers keep
    mixed: bool = False  # whether it is of one of several publishers that the middleware does not tell apart


NOT_TOLD = Sent()


class Arrived(NamedTuple):
    """A message of an input, with its times [ns]."""

    sent: Sent
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

    Stamps of several publishers do not compare. So a speed is of one publisher, see `SpeedSources`; other inputs with several
    count by their arrival.

    Messages before the first simulated clock wait for it: without a time their age is unknown. The oldest make way for too many.
    """

    def __init__(
        self,
        inputs: Sequence[InputTopic],
        reader: InputReader,
        sources: SpeedSources,
        clock: NodeClock,
        guard: Guard,
        use: UseSample,
    ) -> None:
        self.reader = reader
        self.keep_raw: KeepMessage | None = None  # where all messages are recorded
        self.misread: Collection[int] = ()  # inputs with a publisher that has another definition of the type
        self.mixed: Collection[int] = ()  # inputs with several publishers
        self.sources = sources
        self._clock, self._guard, self._use = clock, guard, use
        self._widths = [len(given.roles) for given in inputs]
        self._is_speed = ["speed" in given.valued for given in inputs]
        self._held: list[Arrived] = []
        self._handled_ns = self._handled_now_ns = 0  # arrival of the last handled message, as recorded and by the node's time
        self._before_clock: list[deque[Arrived]] = [deque() for _ in inputs]
        self._newest_ns = [0] * len(inputs)  # sending time of the newest message
        self._latched: list[dict[int, None]] = [{} for _ in inputs]  # sending times of latched messages, the oldest first
        self._last: list[Arrived | None] = [None for _ in inputs]

    def receive(
        self, index: int, message: object, sent: Sent = NOT_TOLD, arrived: Arrival | None = None, raw: bytes | None = None
    ) -> None:
        """Process a decoded message of an input topic.

        By default it arrives now. `raw` are its bytes, to be recorded as it is handled.
        """
        read = self._guard.essential("reading a message", self.reader.read, index, message)
        if read is not None:
            self.receive_values(index, *read, sent, arrived, raw)
        else:
            self.keep(index, raw, arrived)

    def receive_undecodable(
        self, index: int, sent: Sent = NOT_TOLD, arrived: Arrival | None = None, raw: bytes | None = None
    ) -> None:
        """Take note of a message of an input topic that cannot be decoded: no number, at the node's time."""
        self.receive_values(index, None, [math.nan] * self._widths[index], sent, arrived, raw)

    def receive_values(
        self,
        index: int,
        stamp_ns: int | None,
        values: Sequence[float | str],
        sent: Sent = NOT_TOLD,
        arrived: Arrival | None = None,
        raw: bytes | None = None,
    ) -> None:
        """Process values that a transport has read from a message of an input topic; see `InputReader.samples`."""
        if self._has_come(index, sent):
            return
        if index in self.misread:
            self.keep(index, raw, arrived)
            return
        message = Arrived(sent, *(arrived or self._clock.arrival()), index, stamp_ns, values, raw)
        self._guard.essential("taking a message", self._receive, message)

    def keep(self, index: int, raw: bytes | None, arrived: Arrival | None = None) -> None:
        """Record a raw message that is not handled, where all are recorded; None is not recorded."""
        self._record(index, raw, self._clock.recorded_ns(*(arrived or self._clock.arrival())))

    def dropped(self, index: int) -> None:
        """Take note of a message of an input topic that had to make way for later ones."""
        self.reader.dropped[index] += 1

    def _has_come(self, index: int, sent: Sent) -> bool:
        """Whether a message is a copy, as each of a publisher that keeps its messages comes by both endpoints of an input; or
        was kept since before the newest one.
        """
        if not sent.ns:
            return False
        latched = self._latched[index]
        if not sent.latched:
            copied = sent.ns in latched
        else:
            copied = sent.ns <= self._newest_ns[index]
            latched[sent.ns] = None
            if len(latched) > MOST_COPIES:
                del latched[next(iter(latched))]
        self._newest_ns[index] = max(self._newest_ns[index], sent.ns)
        return copied

    def repeat(self, index: int, sources: Collection[int]) -> None:
        """Let the last message of an input stand: one from a publisher that keeps it is repeated now, unless it has just come.

        `sources` are the publishers that are there and keep their messages. Its stamp moves on with the time.
        """
        last = self._last[index]
        if last is None or last.sent.ns not in self._latched[index] or last.sent.source not in sources:
            return
        steady, now = self._clock.arrival()
        if steady - last.steady_ns < REPEATED_NS or (self._clock.simulated and now == 0):
            return
        stamp, raw = last.stamp_ns, last.raw
        if stamp is not None:  # in a recording it would be a repeated stamp
            passed = self._clock.recorded_ns(steady, now) - self._clock.recorded_ns(last.steady_ns, last.now_ns)
            stamp, raw = stamp + passed, None
        self._handle(last._replace(steady_ns=steady, now_ns=now, stamp_ns=stamp, raw=raw))

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
        if message.sent.ns and not self._is_speed[message.place]:
            self._held.append(message)
            return
        self._handle_held(lambda other: other.sent.ns <= message.sent.ns or not message.sent.ns)
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
        for message in sorted(handled, key=attrgetter("sent.ns")):
            self._handle(message)

    def _handle(self, message: Arrived) -> None:
        """Record a message and process its samples, by an arrival after that of the last one: so a replay keeps their order.

        Messages held back are 1 ns apart by both clocks. Their own readings differ by more than that, so their stamps would run
        backward.
        """
        sent, steady, now, place, stamp_ns, values, raw = message
        recorded = self._clock.recorded_ns(steady, now)
        if 0 <= self._handled_ns - recorded < LONGEST_HELD_NS - 1:
            recorded, now = self._handled_ns + 1, self._handled_now_ns + 1
        self._handled_ns, self._handled_now_ns = recorded, now
        self._last[place] = message
        self._record(place, raw, recorded)
        set_ns = self._clock.set_by_ns(now, recorded)
        samples = self._guard.essential("taking a message", self.reader.samples, place, stamp_ns, values, recorded, set_ns)
        for channel, stamp, value in samples or ():
            if channel == at.SPEED and not self.sources.takes(sent.source, value, recorded, sent.mixed):
                self.reader.unused[channel] += 1
                continue
            if place in self.mixed and channel not in TOGETHER:
                stamp = recorded
            self._guard.essential("the step", self._use, channel, stamp, value, steady, now, recorded)

    def _record(self, index: int, raw: bytes | None, recorded_ns: int) -> None:
        if self.keep_raw and raw is not None:
            self._guard("recording", self.keep_raw, index, raw, recorded_ns)
