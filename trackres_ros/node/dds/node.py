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
    prepare_message,
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
        self._input_readers = [CdrInput(topic, application.topics.origin) for topic in application.inputs]
        self._participant = Participant(node, namespace)
        self._start_ns = time.monotonic_ns()
        self._output_names = [full_name(topic.name, node, namespace) for topic in application.outputs]
        self._torques = {full_name(name, node, namespace) for name in TORQUES}
        self._fills = [
            None if topic.kind == "status" else prepare_message(topic, self._frame_id) for topic in application.outputs
        ]
        self._writers: dict[int, Writer] = {}
        self._open(is_shared=True)
        self._input_names = [self.topic_name(topic.name) for topic in application.inputs]
        self._quality, self._latched_quality = parameters.input_quality(), parameters.latched_quality()
        self._readers = [
            self._participant.reader(name, topic.type, self._quality)
            for name, topic in zip(self._input_names, application.inputs, strict=True)
        ]
        self._latched: dict[int, TopicReader] = {}
        self._record_only: list[tuple[int, TopicReader]] = []
        self._clock: TopicReader | None = None
        self._sim_ns = 0
        if parameters.sim_time:
            self._clock = self._participant.reader("/clock", CLOCK_TYPE, CLOCK_QUALITY)
        self._participant.announce()
        self._inbox = application.inbox(self._fetch, self._deliver)
        self._next_tick = 0
        self._file_watch = Background("parameter file")
        self._file_changes: tuple[Mapping[str, Value], list[InputError]] | BaseException = {}, []
        self._next_look_ns = 0

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
        connections, name, kind = self._readers[index].connections, self._input_names[index], self.application.inputs[index].type
        return [
            Peer(
                publication.type,
                publication.handle in connections,
                publication.type != kind or _is_ours(kind, publication),
                self._participant.node_of(publication),
                publication.handle,
                publication.latched,
            )
            for publication in self._participant.publications()
            if publication.topic == name
        ]

    def latch(self, index: int) -> None:
        """Receive what the publishers of an input keep, too."""
        kind = self.application.inputs[index].type
        self._latched[index] = self._participant.reader(self._input_names[index], kind, self._latched_quality)
        self._participant.announce()

    def rivals(self) -> Sequence[str] | None:
        """The nodes of other publishers on our topics with the feed-forward."""
        if time.monotonic_ns() - self._start_ns < DISCOVERY_NS:
            return None
        publications = [publication for publication in self._participant.publications() if publication.topic in self._torques]
        return [
            f"{self._participant.node_of(publication) or NAMELESS} on {publication.topic}"
            for publication in publications
            if not self._participant.is_own(publication)
        ]

    def open_outputs(self) -> None:
        """Open the topics below the node's own name."""
        self._open(is_shared=False)
        self._participant.announce()

    def _open(self, is_shared: bool) -> None:
        for output, (name, topic) in enumerate(zip(self._output_names, self.application.outputs, strict=True)):
            if topic.shared is is_shared:
                quality = self.application.parameters.output_quality(topic)
                self._writers[output] = self._participant.writer(name, topic.type, quality)

    def record(self, other_inputs: Sequence[InputTopic]) -> Sequence[str | None]:
        """Record every message, including those of other topics."""
        store = typestore()
        for index, topic in enumerate(other_inputs, len(self._readers)):
            if topic.type in store.types:
                self._record_only.append(
                    (index, self._participant.reader(self.topic_name(topic.name), topic.type, self._quality))
                )
        self._participant.announce()
        kinds = [topic.type for topic in (*self.application.inputs, *other_inputs)]
        return [store.generate_msgdef(kind, ros_version=2)[0] if kind in store.types else None for kind in kinds]

    def topic_name(self, name: str) -> str:
        """The full name of a topic; without ROS nothing is remapped."""
        return input_name(name, self._namespace)

    def log(self, level: Level, text: str) -> None:
        """One line on standard error, as ROS 2 writes it."""
        severity = {Level.OK: "INFO", Level.ERROR: "ERROR"}.get(level, "WARN")
        self._lines.put(f"[{severity}] [{time.time():.9f}] [{self._name}]: {text}")

    # Running

    def spin(self, requests: SignalRequests, parameter_file: ParameterFile | None = None) -> None:
        """Run until a signal requests a stop, and carry out other requests; a parameter file may be watched."""
        application = self.application
        cause = "without rclpy" if importlib.util.find_spec("rclpy") else "rclpy is not installed"
        reach = self._participant.reach
        file_text = f"; {parameter_file.path} is watched for changes" if parameter_file else ""
        self.log(Level.OK, f"{cause}: on Cyclone DDS {reach}: topics and presence, no parameter or lifecycle services{file_text}")
        self.log(Level.OK, f"{application.vehicle.title}; {application.began_with}")
        application.activate()
        wait = self._participant.waiter()
        self._next_tick = self._next_look_ns = time.monotonic_ns()
        guard = application.guard
        requests.start()
        while not requests.to_stop:
            left_ns = self._next_tick - time.monotonic_ns()
            if left_ns > 0 and not self._inbox.holds_any:  # a signal waits as long: `period_s` is 0.1 s at most
                wait(left_ns)
            if self._clock:
                guard.essential("reading the clock", self._take_clock, self._clock)
            guard.essential("taking messages", self._inbox.collect)
            guard("recording", self._record_others)
            # A simulated clock stands still while messages are processed.
            guard.essential("taking messages", self._inbox.work_off, self._tick_when_due, collecting=self._clock is None)
            self._tick_when_due()
            guard("a request", application.carry_out, requests)
            if parameter_file:
                guard("the parameter file", self._follow, parameter_file)

    def _take_clock(self, clock: TopicReader) -> None:
        for message in clock.take():
            with suppress(MalformedError):
                last_ns, self._sim_ns = self._sim_ns, clock_ns(message.raw)
                self.application.time_went_back(last_ns - self._sim_ns)

    def _fetch(self, index: int) -> list[Taken]:
        """The messages that wait at an input."""
        latched = self._latched.get(index)
        return [*(latched.take() if latched else ()), *self._readers[index].take()]

    def _record_others(self) -> None:
        for index, reader in self._record_only:
            for message in reader.take():
                self.application.messages.keep(index, message.raw)

    def _follow(self, parameter_file: ParameterFile) -> None:
        """Apply the changes of a parameter file, and report each refused line. Another thread reads the file."""
        if self._file_watch.busy:
            return
        outcome, self._file_changes = self._file_changes, ({}, [])
        if isinstance(outcome, BaseException):
            raise outcome
        changes, errors = outcome
        for error in errors:
            self.log(Level.WARN, parameter_file.refusal_text(error))
        if changes:
            self.application.change(changes)
            self.log(Level.OK, parameter_file.note_changes(changes))
        if time.monotonic_ns() >= self._next_look_ns:
            self._next_look_ns = time.monotonic_ns() + int(LOOK_EVERY_S * SECOND_NS)
            self._file_watch.start(partial(self._read_file, parameter_file))

    def _read_file(self, parameter_file: ParameterFile) -> None:
        try:
            self._file_changes = parameter_file.look(self.application.checked_change)
        except BaseException as error:  # raised in the loop, which handles it
            self._file_changes = error

    def _deliver(self, index: int, message: Taken, arrival: Arrival) -> None:
        origin = Sent(message.sent_ns, message.source, message.latched)
        try:
            stamp, values = self._input_readers[index].read(message.raw)
        except Exception:  # no bytes, whatever they are, end the node
            self.application.messages.receive_values(index, None, None, origin, arrival, message.raw)
        else:
            self.application.messages.receive_values(index, stamp, values, origin, arrival, message.raw)

    def _tick_when_due(self) -> None:
        now_ns = time.monotonic_ns()
        if now_ns >= self._next_tick:
            self._next_tick = max(self._next_tick + int(self.application.period_s * SECOND_NS), now_ns)
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
    on_start: Callable[[Application], None] | None = None,
    parameter_file: ParameterFile | None = None,
) -> int:
    """Run the node until a signal requests a stop; the exit code is 0, or 1 if a fault of the loop itself ended it."""
    dds_node = DdsNode(parameters, node, namespace)
    gc.freeze()  # loaded objects stay: scanning them would delay a message now and then
    fault: Exception | None = None
    try:
        if on_start:
            on_start(dds_node.application)
        dds_node.spin(requests, parameter_file)
    except InputError:
        raise
    except Exception as error:
        fault = error
    finally:
        ServiceManager().stopping()
        dds_node.application.deactivate(fault)
        dds_node.close()
    return FAULT if fault else 0


def _is_ours(kind: str, publication: Publication) -> bool:
    """Whether its definition of a type is ours, as far as it announces one."""
    return b"typehash=" not in publication.user_data or type_hash(kind) in publication.user_data
