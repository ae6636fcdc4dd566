# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The way of a message from a transport to samples: its arrival, its turn, its values, and for a speed its publisher.

A transport fetches messages into the `Inbox`. The `MessageHandler` brings them into the order of origin, reads their samples by
`InputReader`, and passes these to the application; of a speed only those that `SpeedSources` chooses.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from itertools import chain
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from trackres_ros.estimator import columns as at
from trackres_ros.estimator.constants import LATEST_S
from trackres_ros.estimator.plausible import SHARE
from trackres_ros.node.notices import Guard
from trackres_ros.node.transport import InputTopic, KeepMessage, Transport, is_usable, nearest_usable, stamp_ns
from trackres_ros.recording.bindings import TopicBinding
from trackres_ros.recording.combining import DIRECTION, Companions, Dropped, Sum, readings_of
from trackres_ros.units import NANOSECOND

SET_NS = 50_000_000  # assumed: the machine's clock is slewed over less, with the steady clock; over more it is set
COLLECT_EVERY_NS = 2_000_000  # accuracy of an arrival; at 1 kHz two messages
MOST_BEFORE_CLOCK = 10000  # messages of an input
LONGEST_WAIT_NS = 50_000_000  # of a message for a speed that was sent later
LONGEST_HELD_NS = 10_000_000_000  # of a message that is handled after a later one; a clock that goes back further was set
MOST_COPIES = 10000  # origin times kept of latched messages, whose copies come within milliseconds
REPEATED_NS = 500_000_000  # at the next look, so once a second: as a slow publisher does
TOGETHER = frozenset({at.SPEED, at.TORQUE, at.SPECIFIC_FORCE, at.LATITUDE, at.LONGITUDE})  # channels whose stamps are compared
NO_CHANNEL = -1
"""In place of a channel: a direction is in the sign of the speed."""
RESOLUTION_MPS = 1.0 / 3.6  # of a bus that sends whole km/h
REMEMBERED_NS = 2_000_000_000  # two messages of the slowest usual publisher, 1 Hz

Arrival = tuple[int, int]
"""When a message came, by the steady clock and by the node's time [ns]."""
Sample = tuple[int, int, float]
"""Channel, stamp [ns] and value."""
UseSample = Callable[[int, int, float, int, int, int], None]
"""Takes a sample: channel, stamp [ns], value, and its arrival by the steady clock, the node's time and the recording [ns]."""
Take = Callable[[], Iterable[Any]]


class NodeClock:
    """The node's time, the machine's or a simulated one, and the steady time that counts ages and periods; all in ns."""

    def __init__(self, transport: Transport, is_simulated: bool, steady_ns: Callable[[], int], guard: Guard) -> None:
        self.simulated, self.steady_ns = is_simulated, steady_ns
        self.offset_ns = time.time_ns() - steady_ns()  # of the machine's clock at the start against steady time
        self._transport, self._guard = transport, guard
        self._refused_ns = 0  # last negative time

    def lack(self, steady_ns: int) -> str:
        """Why there is no simulated time; empty if there is one, or the machine's is used."""
        if not self.simulated or self.now_ns(steady_ns):
            return ""
        if self._refused_ns:
            problem = f"/clock shows {self._refused_ns * NANOSECOND:.1f} s: a time before 0 is none"
            return f"use_sim_time is set and {problem}; let the simulation start at 0 or later"
        return "use_sim_time is set and no /clock message has arrived"

    def arrival(self) -> Arrival:
        """The arrival of a message that comes now."""
        steady_ns = self.steady_ns()
        return steady_ns, self.now_ns(steady_ns)

    def now_ns(self, steady_ns: int) -> int:
        """The node's time: the machine's where a clock cannot be read; 0, none, for a simulated one or where it is negative."""
        time_ns = self._guard("the clock", self._transport.now_ns)
        if not self.simulated:
            return time_ns if time_ns is not None else steady_ns + self.offset_ns
        self._refused_ns = min(0, time_ns or 0)
        return max(0, time_ns or 0)

    def recorded_ns(self, steady_ns: int, now_ns: int) -> int:
        """An arrival as it is recorded: steady like the ages of samples, or simulated."""
        return now_ns if self.simulated else steady_ns + self.offset_ns

    def set_by_ns(self, now_ns: int, recorded_ns: int) -> int:
        """How far the machine's clock has been set since the start, as an arrival shows by both times."""
        return now_ns - recorded_ns if abs(now_ns - recorded_ns) > SET_NS else 0

    def pace_ns(self, steady_ns: int) -> int:
        """Time of the feed-forward's motion: the controller's, or the simulated one."""
        return nearest_usable(self.now_ns(steady_ns)) if self.simulated else steady_ns

    def present_ns(self, steady_ns: int) -> int:
        """The arrival of a message now, as it is recorded."""
        return self.recorded_ns(steady_ns, self.pace_ns(steady_ns))


class Inbox:
    """Messages of all inputs that wait for the application, with their arrivals, however busy the estimate is.

    A middleware silently drops the oldest messages of a full queue, and its messages have no time of arrival. So they are fetched
    between the steps too, and wait here: bounded, with a count of those dropped.
    """

    def __init__(
        self,
        inputs: Sequence[Take],  # for each input: fetch new messages from the middleware
        deliver: Callable[[int, Any, Arrival], None],  # pass one message to the application: input, message, arrival
        arrival: Callable[[], Arrival],  # arrival time of a new message
        on_drop: Callable[[int], None],  # called with the input of each dropped message
        depth: int,  # limit of waiting messages per input
    ) -> None:
        self._inputs, self._deliver, self._arrival, self._on_drop, self._depth = inputs, deliver, arrival, on_drop, depth
        self._queues: list[deque[tuple[Any, Arrival]]] = [deque() for _ in inputs]
        self._collected_ns = 0

    @property
    def holds_any(self) -> bool:
        """Whether a message waits here, such as one fetched while others were passed on."""
        return any(self._queues)

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
        queue = self._queues[index]
        if len(queue) >= self._depth:
            queue.popleft()
            self._on_drop(index)
        queue.append((message, self._arrival()))

    def work_off(self, on_message: Callable[[], None], collecting: bool) -> None:
        """Pass on waiting messages; call `on_message` after each, and if `collecting`, fetch new messages too."""
        queues, self._queues = self._queues, [deque() for _ in self._inputs]
        for index, messages in enumerate(queues):
            for message, arrival in messages:
                self._deliver(index, message, arrival)
                if collecting and time.monotonic_ns() - self._collected_ns > COLLECT_EVERY_NS:
                    self.collect()
                on_message()


class Sent(NamedTuple):
    """How a message left its publisher."""

    ns: int = 0  # by the clock of its machine [ns]; 0 if unknown
    source: int = 0  # number of the publisher; 0 where the middleware does not tell it
    latched: bool = False  # whether it came by an endpoint that also gets what publishers keep
    is_mixed: bool = False  # whether it is of one of several publishers that the middleware does not tell apart


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
    held back until a speed with a later origin time arrives, for `LONGEST_WAIT_NS` at most.

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
        self.misread_inputs: Collection[int] = ()  # inputs with a publisher that has another definition of the type
        self.mixed_inputs: Collection[int] = ()  # inputs with several publishers
        self.sources = sources
        self._clock, self._guard, self._use = clock, guard, use
        self._widths = [len(topic.readings) for topic in inputs]
        self._is_speed = ["speed" in topic.valued for topic in inputs]
        self._held_back: list[Arrived] = []
        self._handled_ns = self._handled_now_ns = 0  # arrival of the last handled message, as recorded and by the node's time
        self._before_clock: list[deque[Arrived]] = [deque() for _ in inputs]
        self._newest_ns = [0] * len(inputs)  # origin time of the newest message
        self._latched: list[dict[int, None]] = [{} for _ in inputs]  # origin times of latched messages, the oldest first
        self._last: list[Arrived | None] = [None for _ in inputs]

    def receive(
        self, index: int, message: object, origin: Sent = NOT_TOLD, arrival: Arrival | None = None, raw: bytes | None = None
    ) -> None:
        """Process a decoded message of an input topic.

        By default it arrives now. `raw` are its bytes, to be recorded as it is handled.
        """
        content = self._guard.essential("reading a message", self.reader.read, index, message)
        if content is not None:
            self.receive_values(index, *content, origin, arrival, raw)
        else:
            self.keep(index, raw, arrival)

    def receive_values(
        self,
        index: int,
        stamp_ns: int | None,
        values: Sequence[float | str] | None,
        origin: Sent = NOT_TOLD,
        arrival: Arrival | None = None,
        raw: bytes | None = None,
    ) -> None:
        """Process values that a transport has read from a message of an input topic; see `InputReader.samples`.

        None is a message that cannot be decoded: no number, at the node's time.
        """
        if self._has_come(index, origin):
            return
        if index in self.misread_inputs:
            self.keep(index, raw, arrival)
            return
        values = [math.nan] * self._widths[index] if values is None else values
        message = Arrived(origin, *(arrival or self._clock.arrival()), index, stamp_ns, values, raw)
        self._guard.essential("taking a message", self._receive, message)

    def keep(self, index: int, raw: bytes | None, arrival: Arrival | None = None) -> None:
        """Record a raw message that is not handled, where all are recorded; None is not recorded."""
        self._record(index, raw, self._clock.recorded_ns(*(arrival or self._clock.arrival())))

    def count_drop(self, index: int) -> None:
        """Take note of a message of an input topic that had to make way for later ones."""
        self.reader.drop_counts[index] += 1

    def _has_come(self, index: int, origin: Sent) -> bool:
        """Whether a message is a copy, as each of a publisher that keeps its messages comes by both endpoints of an input; or
        was kept since before the newest one.
        """
        if not origin.ns:
            return False
        latched = self._latched[index]
        if not origin.latched:
            is_copy = origin.ns in latched
        else:
            is_copy = origin.ns <= self._newest_ns[index]
            latched[origin.ns] = None
            if len(latched) > MOST_COPIES:
                del latched[next(iter(latched))]
        self._newest_ns[index] = max(self._newest_ns[index], origin.ns)
        return is_copy

    def repeat(self, index: int, sources: Collection[int]) -> None:
        """Let the last message of an input stand: one from a publisher that keeps it is repeated now, unless it has just come.

        `sources` are the publishers that are there and keep their messages. Its stamp moves on with the time.
        """
        last = self._last[index]
        if last is None or last.sent.ns not in self._latched[index] or last.sent.source not in sources:
            return
        steady_ns, now_ns = self._clock.arrival()
        if steady_ns - last.steady_ns < REPEATED_NS or (self._clock.simulated and now_ns == 0):
            return
        stamp, raw = last.stamp_ns, last.raw
        if stamp is not None:  # in a recording it would be a repeated stamp
            passed_ns = self._clock.recorded_ns(steady_ns, now_ns) - self._clock.recorded_ns(last.steady_ns, last.now_ns)
            stamp, raw = stamp + passed_ns, None
        self._handle(last._replace(steady_ns=steady_ns, now_ns=now_ns, stamp_ns=stamp, raw=raw))

    def handle_late(self, steady_ns: int) -> None:
        """Handle the messages that have waited for too long."""
        self._handle_held(lambda message: steady_ns - message.steady_ns > LONGEST_WAIT_NS)

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
        if self._clock.simulated:
            if message.now_ns == 0:
                message = message._replace(now_ns=self._clock.now_ns(message.steady_ns))
            if message.now_ns == 0:
                self._wait_for_clock(message)
                return
            for queue_message in self._take_waiting():
                self._guard.essential("taking a message", self._receive, queue_message)
        if message.sent.ns and not self._is_speed[message.place]:
            self._held_back.append(message)
            return
        if self._held_back:
            self._handle_held(lambda late_message: late_message.sent.ns <= message.sent.ns or not message.sent.ns)
        self._handle(message)

    def _wait_for_clock(self, message: Arrived) -> None:
        queue = self._before_clock[message.place]
        queue.append(message)
        if len(queue) > MOST_BEFORE_CLOCK:
            self.count_drop(message.place)
            first_message = queue.popleft()
            self.keep(first_message.place, first_message.raw, (first_message.steady_ns, 0))

    def _take_waiting(self) -> list[Arrived]:
        """The messages that wait for a clock, in the order of arrival; none wait afterwards."""
        messages = sorted(chain(*self._before_clock), key=attrgetter("steady_ns"))
        for queue in self._before_clock:
            queue.clear()
        return messages

    def _handle_held(self, is_due: Callable[[Arrived], bool]) -> None:
        """Handle the messages held back that are due, in the order of origin."""
        messages_due = [message for message in self._held_back if is_due(message)]
        self._held_back = [message for message in self._held_back if not is_due(message)]
        for message in sorted(messages_due, key=attrgetter("sent.ns")):
            self._handle(message)

    def _handle(self, message: Arrived) -> None:
        """Record a message and process its samples, by an arrival after that of the last one: so a replay keeps their order.

        Messages held back are 1 ns apart by both clocks. Their own readings differ by more than that, so their stamps would run
        backward.
        """
        origin, steady_ns, now_ns, place, stamp_ns, values, raw = message
        recorded_ns = self._clock.recorded_ns(steady_ns, now_ns)
        if 0 <= self._handled_ns - recorded_ns < LONGEST_HELD_NS - 1:
            recorded_ns, now_ns = self._handled_ns + 1, self._handled_now_ns + 1
        self._handled_ns, self._handled_now_ns = recorded_ns, now_ns
        self._last[place] = message
        self._record(place, raw, recorded_ns)
        set_ns = self._clock.set_by_ns(now_ns, recorded_ns)
        samples = self._guard.essential("taking a message", self.reader.samples, place, stamp_ns, values, recorded_ns, set_ns)
        for channel, stamp, value in samples or ():
            if channel == at.SPEED and not self.sources.takes(origin.source, value, recorded_ns, origin.is_mixed):
                self.reader.unused_counts[channel] += 1
                continue
            if place in self.mixed_inputs and channel not in TOGETHER:
                stamp = recorded_ns
            self._guard.essential("the step", self._use, channel, stamp, value, steady_ns, now_ns, recorded_ns)

    def _record(self, index: int, raw: bytes | None, recorded_ns: int) -> None:
        if self.keep_raw and raw is not None:
            self._guard("recording", self.keep_raw, index, raw, recorded_ns)


class InputReader:
    """Reads the messages of all input topics into samples of the estimator's channels; bindings of sums say how to add the parts.

    Raises InputError for a role of an axle or assembly that the vehicle does not have.
    """

    def __init__(self, inputs: Sequence[InputTopic], channels: Sequence[str], bindings: Mapping[str, TopicBinding]) -> None:
        self.message_counts = [0] * len(inputs)
        self.drop_counts = [0] * len(inputs)
        self.absence_counts = [0] * len(channels)
        self.lack_texts = [""] * len(channels)  # the last field that a message did not have, and why
        self.bad_stamp = [0] * len(channels)
        self.unused_counts = [0] * len(channels)  # samples of another publisher than the one in use
        self.clock_shifts_ns: dict[int, int] = {}  # how far the clock was set [ns] at the last stamp of a channel in `TOGETHER`
        roles = dict.fromkeys(reading.role for topic in inputs for reading in topic.readings)
        self.sums = {role: Sum(role, bindings[role]) for role in roles if bindings[role].parts}
        self.companions = Companions(readings_of(tuple(roles), bindings), bindings)
        self._channels = channels
        self._readers = [
            [
                (_channel(reading.role, channels), _getter(reading.binding), reading, self.sums.get(reading.role))
                for reading in topic.readings
            ]
            for topic in inputs
        ]

    def read(self, index: int, message: object) -> tuple[int | None, list[float | str]]:
        """Stamp and values of a message with fields as attributes, for `samples`."""
        return _stamp(message), [_value(getter, message) for _, getter, *_ in self._readers[index]]

    def samples(
        self, index: int, stamp_ns: int | None, values: Sequence[float | str], arrival_ns: int, set_ns: int = 0
    ) -> list[Sample]:
        """Samples from the values of a message of an input topic, that came at `arrival_ns`.

        The stamp is None where the message's type has none: then the arrival is used. One that was never set is 0 and stays so.
        Where the machine's clock was set by `set_ns` since the start, both follow it if they are compared with stamps of others.
        A stamp out of a message's range gives no sample: it could not be published again. There is a scaled value for each
        binding of the topic: nan where it is no number; the reason, and no sample, where the message has no such element.
        """
        self.message_counts[index] += 1
        samples = []
        absent_channels, bad_stamps = set[int](), set[int]()  # channels: a sum has several parts in a message
        for (channel, _, reading, total), value in zip(self._readers[index], values, strict=True):
            binding, by_header = reading.binding, reading.binding.stamp != "log"
            if isinstance(value, str):
                absent_channels.add(channel)
                if channel != NO_CHANNEL:
                    self.lack_texts[channel] = f"{binding.field}: {value}"
                continue
            if by_header and stamp_ns and channel in TOGETHER:
                self.clock_shifts_ns[channel] = set_ns
            came_ns = arrival_ns + (set_ns if self.clock_shifts_ns and channel in TOGETHER else 0)
            as_before = (
                channel in self.clock_shifts_ns and abs(set_ns - self.clock_shifts_ns[channel]) <= SET_NS
            )  # as its last stamp
            has_stamp = by_header and (stamp_ns or came_ns == arrival_ns or as_before)
            stamp = binding.less_delay(stamp_ns if has_stamp and stamp_ns is not None else came_ns)
            if not is_usable(stamp):
                bad_stamps.add(channel)
                continue
            value = float(binding.directions(np.asarray(value))) if binding.has_modes else value
            if not self.companions.is_valid_sample(reading, arrival_ns, value):
                continue
            number_list = (
                [(stamp, value)] if total is None or reading.part is None else total.add(reading.part, stamp, came_ns, value)
            )
            signed_numbers = [
                (at_ns, self.companions.sign_speed(reading.role, arrival_ns, number)) for at_ns, number in number_list
            ]
            samples += [
                (channel, at_ns, number) for at_ns, number in signed_numbers if number is not None and channel != NO_CHANNEL
            ]
        for channel in absent_channels - {NO_CHANNEL}:
            self.absence_counts[channel] += 1
        for channel in bad_stamps - {NO_CHANNEL}:
            self.bad_stamp[channel] += 1
        return samples

    def counts(self) -> dict[str, list[int]]:
        """Samples of each channel that the guards have not seen, by the reason; `dropped` are messages of each input."""
        no_drops = Dropped()
        companions = [self.companions.dropped.get(role, no_drops) for role in self._channels]
        return {
            "bad_stamp": self.bad_stamp,
            "without_other_part": [self.sums[role].lone_samples if role in self.sums else 0 for role in self._channels],
            "absent": self.absence_counts,
            "unused": self.unused_counts,
            "dropped": self.drop_counts,
            "invalid": [counts.invalid_values for counts in companions],
            "without_direction": [counts.no_direction for counts in companions],
        }


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


def _value(getter: Callable[[Any], float], message: object) -> float | str:
    try:
        return getter(message)
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


class LastSpeed(NamedTuple):
    """The last speed of a publisher [m/s], and its arrival [ns]."""

    speed: float
    arrival_ns: int


class SpeedSources:
    """Uses the speed of one publisher, the first that is heard; another one only once that is silent for `max_age_s`.

    Two publishers disagree once their speeds have differed for `max_age_s`: by more than a quarter and the resolution of a bus,
    so a delay of 0.1 s between two sensors is no difference for longer than 0.4 s after a start from rest (ours). Speeds that
    came at different times may also differ by what the vehicle gains in between. While two disagree, and for 2 s after they last
    differed, none is used.

    A middleware that does not tell publishers apart passes all as one. Where there are several (`mixed`), a speed that differs
    from the last one used is of another publisher.
    """

    def __init__(self, max_acceleration: float, max_age_s: Callable[[], float]) -> None:
        self._max_acceleration, self._max_age_s = max_acceleration, max_age_s
        self._speeds: dict[int, LastSpeed] = {}
        self._used_source: int | None = None
        self._differing_since_ns: int | None = None  # when they began to differ
        self._differed_ns = 0  # when they last did
        self._speed_pair: tuple[tuple[int, float], tuple[int, float]] | None = None

    def disagreeing(self, now_ns: int) -> tuple[tuple[int, float], tuple[int, float]] | None:
        """Two publishers with the speed of each [m/s], when they last differed; None while none disagree."""
        return self._speed_pair if self._are_apart(now_ns) else None

    def takes(self, source: int, speed: float, arrival_ns: int, is_mixed: bool = False) -> bool:
        """Whether to use a speed [m/s] of a publisher, or with `is_mixed` of one of several, that arrives now [ns]."""
        if not math.isfinite(speed):
            return True  # it is refused and counted
        if any(arrival_ns < last.arrival_ns for last in self._speeds.values()):  # time went back
            self._speeds.clear()
            self._used_source = self._differing_since_ns = None
        if self._differs(source, speed, arrival_ns, is_mixed) and is_mixed:
            return False
        last_used = self._speeds.get(self._used_source) if self._used_source is not None else None
        if last_used is None or (arrival_ns - last_used.arrival_ns) * NANOSECOND > self._max_age_s():
            self._used_source = source
        self._speeds[source] = LastSpeed(speed, arrival_ns)
        for old_source in [source for source, last in self._speeds.items() if arrival_ns - last.arrival_ns > REMEMBERED_NS]:
            del self._speeds[old_source]
        return source == self._used_source and not self._are_apart(arrival_ns)

    def _differs(self, source: int, speed: float, arrival_ns: int, is_mixed: bool) -> bool:
        agrees = False
        for other_source, last in self._speeds.items():
            age_s = (arrival_ns - last.arrival_ns) * NANOSECOND
            if age_s > self._max_age_s() or (other_source == source and not is_mixed):
                continue
            excess = abs(speed - last.speed) - SHARE * max(abs(speed), abs(last.speed)) - RESOLUTION_MPS
            agrees |= excess <= 0.0
            if excess > self._max_acceleration * max(0.0, age_s - LATEST_S):
                if self._differing_since_ns is None or arrival_ns - self._differed_ns > REMEMBERED_NS:
                    self._differing_since_ns = arrival_ns
                self._differed_ns, self._speed_pair = arrival_ns, ((other_source, last.speed), (source, speed))
                return True
        if agrees and not is_mixed and not self._are_apart(arrival_ns):
            self._differing_since_ns = None
        return False

    def _are_apart(self, now_ns: int) -> bool:
        if self._differing_since_ns is None or now_ns - self._differed_ns > REMEMBERED_NS:
            return False
        return (self._differed_ns - self._differing_since_ns) * NANOSECOND > self._max_age_s()
