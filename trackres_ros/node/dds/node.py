# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The live node on Cyclone DDS: one thread that waits for messages and for the next tick."""

from __future__ import annotations

import gc
import importlib.util
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial

from trackres_ros.errors import InputError
from trackres_ros.node.application import Application
from trackres_ros.node.dds.wire import (
    CdrInput,
    Participant,
    Publication,
    Taken,
    TopicReader,
    Writer,
    clock_ns,
    diagnostic_array,
    prepared,
    type_hash,
    typestore,
)
from trackres_ros.node.inputs import Arrival, Sent
from trackres_ros.node.parameters import LOOK_EVERY_S, ParameterFile, Parameters, Value
from trackres_ros.node.process import Background, ErrorLines, ServiceManager, SignalRequests
from trackres_ros.node.transport import (
    DISCOVERY_NS,
    NAMELESS,
    TORQUES,
    InputTopic,
    Level,
    Peer,
    Quality,
    Reasons,
    Status,
    full_name,
    input_name,
)
from trackres_ros.recording.cdr import MalformedError
from trackres_ros.units import SECOND_NS

CLOCK_TYPE = "rosgraph_msgs/msg/Clock"
CLOCK_QUALITY = Quality(reliable=False, depth=1, deadline_s=0.0)
FAULT = 1
LOG_PATIENCE_S = 1.0  # with who reads the log, at the end


class DdsNode:
    """The node; `spin` runs it. Raises InputError if parameters, vehicle or topics cannot be used."""

    def __init__(self, parameters: Parameters, node: str, namespace: str) -> None:
        self._name = full_name(node, "", namespace).replace("//", "/").strip("/").replace("/", ".")
        self._frame_id, self._namespace = parameters.text("frame_id"), namespace
        self._lines = ErrorLines()
        self.application = application = Application(parameters, self, node, namespace)
        self._input_readers = [CdrInput(given, application.topics.origin) for given in application.inputs]
        self._participant = Participant(node, namespace)
        self._began_ns = time.monotonic_ns()
        self._output_names = [full_name(topic.name, node, namespace) for topic in application.outputs]
        self._torques = {full_name(name, node, namespace) for name in TORQUES}
        self._fills = [None if topic.kind == "status" else prepared(topic, self._frame_id) for topic in application.outputs]
        self._writers: dict[int, Writer] = {}
        self._open(shared=True)
        self._input_names = [self.topic_name(given.name) for given in application.inputs]
        self._quality, self._latched_quality = parameters.input_quality(), parameters.latched_quality()
        self._readers = [
            self._participant.reader(name, given.type, self._quality)
            for name, given in zip(self._input_names, application.inputs, strict=True)
        ]
        self._latched: dict[int, TopicReader] = {}
        self._kept: list[tuple[int, TopicReader]] = []
        self._clock: TopicReader | None = None
        self._sim_ns = 0
        if parameters.sim_time:
            self._clock = self._participant.reader("/clock", CLOCK_TYPE, CLOCK_QUALITY)
        self._participant.announce()
        self._inbox = application.inbox(self._fetch, self._deliver)
        self._next_tick = 0
        self._looking = Background("parameter file")
        self._looked: tuple[Mapping[str, Value], list[InputError]] | BaseException = {}, []
        self._next_look = 0

    # Interface of the application's transport

    def now_ns(self) -> int:
        """The machine's time, or the last of /clock."""
        return self._sim_ns if self._clock else time.time_ns()

    def publish(self, output: int, stamp_ns: int, values: Sequence[float], reasons: Reasons) -> None:
        """Publish a message of numbers."""
        fill = self._fills[output]
        assert fill
        self._writers[output].write(fill(stamp_ns, values, reasons))

    def publish_status(self, output: int, stamp_ns: int, statuses: Sequence[Status]) -> None:
        """Publish a DiagnosticArray."""
        self._writers[output].write(diagnostic_array(stamp_ns, statuses, self._frame_id))

    def peers(self, index: int) -> Sequence[Peer]:
        """The publishers on the topic of an input."""
        connected, name, kind = self._readers[index].connected, self._input_names[index], self.application.inputs[index].type
        return [
            Peer(
                found.type,
                found.handle in connected,
                found.type != kind or _is_ours(kind, found),
                self._participant.node_of(found),
                found.handle,
                found.latched,
            )
            for found in self._participant.publications()
            if found.topic == name
        ]

    def latch(self, index: int) -> None:
        """Receive what the publishers of an input keep, too."""
        kind = self.application.inputs[index].type
        self._latched[index] = self._participant.reader(self._input_names[index], kind, self._latched_quality)
        self._participant.announce()

    def rivals(self) -> Sequence[str] | None:
        """The nodes of other publishers on our topics with the feed-forward."""
        if time.monotonic_ns() - self._began_ns < DISCOVERY_NS:
            return None
        there = [found for found in self._participant.publications() if found.topic in self._torques]
        return [
            f"{self._participant.node_of(found) or NAMELESS} on {found.topic}"
            for found in there
            if not self._participant.is_own(found)
        ]

    def open_outputs(self) -> None:
        """Open the topics below the node's own name."""
        self._open(shared=False)
        self._participant.announce()

    def _open(self, shared: bool) -> None:
        for output, (name, topic) in enumerate(zip(self._output_names, self.application.outputs, strict=True)):
            if topic.shared is shared:
                quality = self.application.parameters.output_quality(topic)
                self._writers[output] = self._participant.writer(name, topic.type, quality)

    def record(self, others: Sequence[InputTopic]) -> Sequence[str | None]:
        """Record every message, including those of other topics."""
        store = typestore()
        for index, given in enumerate(others, len(self._readers)):
            if given.type in store.types:
                self._kept.append((index, self._participant.reader(self.topic_name(given.name), given.type, self._quality)))
        self._participant.announce()
        kinds = [given.type for given in (*self.application.inputs, *others)]
        return [store.generate_msgdef(kind, ros_version=2)[0] if kind in store.types else None for kind in kinds]

    def topic_name(self, name: str) -> str:
        """The full name of a topic; without ROS nothing is remapped."""
        return input_name(name, self._namespace)

    def log(self, level: Level, text: str) -> None:
        """One line on standard error, as ROS 2 writes it."""
        severity = {Level.OK: "INFO", Level.ERROR: "ERROR"}.get(level, "WARN")
        self._lines.put(f"[{severity}] [{time.time():.9f}] [{self._name}]: {text}")

    # Running

    def spin(self, requests: SignalRequests, watched: ParameterFile | None = None) -> None:
        """Run until a signal requests a stop, and carry out other requests; a parameter file may be watched."""
        application = self.application
        why = "without rclpy" if importlib.util.find_spec("rclpy") else "rclpy is not installed"
        reach = self._participant.reach
        instead = f"; {watched.path} is watched for changes" if watched else ""
        self.log(Level.OK, f"{why}: on Cyclone DDS {reach}: topics and presence, no parameter or lifecycle services{instead}")
        self.log(Level.OK, f"{application.vehicle.title}; {application.began_with}")
        application.activate()
        wait = self._participant.waiter()
        self._next_tick = self._next_look = time.monotonic_ns()
        guard = application.guard
        requests.started()
        while not requests.to_stop:
            left = self._next_tick - time.monotonic_ns()
            if left > 0 and not self._inbox.holds_any:  # a signal waits as long: `period_s` is 0.1 s at most
                wait(left)
            if self._clock:
                guard.essential("reading the clock", self._take_clock, self._clock)
            guard.essential("taking messages", self._inbox.collect)
            guard("recording", self._take_kept)
            # A simulated clock stands still while messages are processed.
            guard.essential("taking messages", self._inbox.work_off, self._tick_if_due, collecting=self._clock is None)
            self._tick_if_due()
            guard("a request", application.carry_out, requests)
            if watched:
                guard("the parameter file", self._follow, watched)

    def _take_clock(self, clock: TopicReader) -> None:
        for taken in clock.take():
            with suppress(MalformedError):
                before, self._sim_ns = self._sim_ns, clock_ns(taken.raw)
                self.application.time_went_back(before - self._sim_ns)

    def _fetch(self, index: int) -> list[Taken]:
        """The messages that wait at an input."""
        latched = self._latched.get(index)
        return [*(latched.take() if latched else ()), *self._readers[index].take()]

    def _take_kept(self) -> None:
        for index, kept in self._kept:
            for taken in kept.take():
                self.application.messages.keep(index, taken.raw)

    def _follow(self, watched: ParameterFile) -> None:
        """Apply the changes of a parameter file, and report each refused line. Another thread reads the file."""
        if self._looking.busy:
            return
        looked, self._looked = self._looked, ({}, [])
        if isinstance(looked, BaseException):
            raise looked
        changed, refused = looked
        for error in refused:
            self.log(Level.WARN, watched.refused(error))
        if changed:
            self.application.change(changed)
            self.log(Level.OK, watched.applied(changed))
        if time.monotonic_ns() >= self._next_look:
            self._next_look = time.monotonic_ns() + int(LOOK_EVERY_S * SECOND_NS)
            self._looking.start(partial(self._look, watched))

    def _look(self, watched: ParameterFile) -> None:
        try:
            self._looked = watched.look(self.application.checked_change)
        except BaseException as error:  # raised in the loop, which handles it
            self._looked = error

    def _deliver(self, index: int, message: Taken, arrived: Arrival) -> None:
        sent = Sent(message.sent_ns, message.source, message.latched)
        try:
            stamp, values = self._input_readers[index].read(message.raw)
        except Exception:  # no bytes, whatever they are, end the node
            self.application.messages.receive_values(index, None, None, sent, arrived, message.raw)
        else:
            self.application.messages.receive_values(index, stamp, values, sent, arrived, message.raw)

    def _tick_if_due(self) -> None:
        now = time.monotonic_ns()
        if now >= self._next_tick:
            self._next_tick = max(self._next_tick + int(self.application.period_s * SECOND_NS), now)
            self.application.tick()

    def close(self) -> None:
        """Save the state and leave the domain."""
        self.log(Level.OK, self.application.close())
        self._participant.close()
        self._lines.close(LOG_PATIENCE_S)


def run(
    parameters: Parameters,
    node: str,
    namespace: str,
    requests: SignalRequests,
    started: Callable[[Application], None] | None = None,
    watched: ParameterFile | None = None,
) -> int:
    """Run the node until a signal requests a stop; the exit code is 0, or 1 if a fault of the loop itself ended it."""
    running = DdsNode(parameters, node, namespace)
    gc.freeze()  # loaded objects stay: scanning them would delay a message now and then
    fault: Exception | None = None
    try:
        if started:
            started(running.application)
        running.spin(requests, watched)
    except InputError:
        raise
    except Exception as error:
        fault = error
    finally:
        ServiceManager().stopping()
        running.application.deactivate(fault)
        running.close()
    return FAULT if fault else 0


def _is_ours(kind: str, found: Publication) -> bool:
    """Whether its definition of a type is ours, as far as it announces one."""
    return b"typehash=" not in found.user_data or type_hash(kind) in found.user_data
