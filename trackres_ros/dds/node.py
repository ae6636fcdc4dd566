"""The live node on Cyclone DDS: one thread that waits for messages and for the next tick."""

from __future__ import annotations

import gc
import importlib.util
import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from types import FrameType

from trackres_ros.cdr import MalformedError
from trackres_ros.dds.messages import InputReader, Prepared, clock_ns, diagnostic_array
from trackres_ros.dds.participant import Participant, Reader
from trackres_ros.errors import InputError
from trackres_ros.live.application import Application
from trackres_ros.live.edge import Level, Peer, Status
from trackres_ros.live.endpoints import Quality, full_name, input_name, input_quality, output_quality
from trackres_ros.parameters import Parameters

CLOCK_TYPE = "rosgraph_msgs/msg/Clock"
CLOCK_QUALITY = Quality(reliable=False, depth=1, deadline_s=0.0)
# Naps this short cost two percent of a core, and keep the way of a message in the caches: the torque leaves a tenth sooner.
LONGEST_WAIT_NS = 2_000_000
SECOND_NS = 1_000_000_000


class DdsNode:
    """The node; `spin` runs it.

    Raises
    ------
    InputError
        If parameters, vehicle or topics cannot be used.
    """

    def __init__(self, parameters: Parameters, node: str, namespace: str) -> None:
        self._name = full_name(node, "", namespace).replace("//", "/").strip("/").replace("/", ".")
        self._frame_id = parameters.text("frame_id")
        self.application = application = Application(parameters, self, node, namespace)
        self._input_readers = [InputReader(given, application.topics.origin) for given in application.inputs]
        self._participant = Participant(node, namespace)
        self._prepared: list[Prepared | None] = []
        self._writers = []
        for topic in application.outputs:
            name = full_name(topic.name, node, namespace)
            self._writers.append(self._participant.writer(name, topic.type, output_quality(parameters, topic)))
            self._prepared.append(None if topic.kind == "status" else Prepared(topic, self._frame_id))
        self._input_names = [input_name(given.name, namespace) for given in application.inputs]
        self._quality = input_quality(parameters)
        self._readers = [
            self._participant.reader(name, given.type, self._quality)
            for name, given in zip(self._input_names, application.inputs, strict=True)
        ]
        self._clock: Reader | None = None
        self._sim_ns = 0
        if parameters.sim_time:
            self._clock = self._participant.reader("/clock", CLOCK_TYPE, CLOCK_QUALITY)
        self._participant.announce()
        self._stop = False
        self._asked: list[Callable[[], str]] = []

    # What the application asks of its edge

    def now_ns(self) -> int:
        """The machine's time, or the last of /clock."""
        return self._sim_ns if self._clock else time.time_ns()

    def publish(self, output: int, stamp_ns: int, values: Sequence[float]) -> None:
        """Publish a message of numbers."""
        prepared = self._prepared[output]
        assert prepared is not None
        self._writers[output].write(prepared.filled(stamp_ns, values))

    def publish_status(self, output: int, stamp_ns: int, statuses: Sequence[Status]) -> None:
        """Publish a DiagnosticArray."""
        self._writers[output].write(diagnostic_array(stamp_ns, statuses, self._frame_id))

    def peers(self, index: int) -> Sequence[Peer]:
        """The publishers on the topic of an input."""
        if index == 0:  # the first of a round
            self._publications = list(self._participant.publications())
        wanted = self._quality
        return [
            Peer(
                found.type,
                (found.reliable or not wanted.reliable) and (not wanted.deadline_s or found.deadline_s <= wanted.deadline_s),
            )
            for found in self._publications
            if found.topic == self._input_names[index]
        ]

    def log(self, level: Level, text: str) -> None:
        """One line on standard error, as ROS 2 writes it."""
        severity = {Level.OK: "INFO", Level.ERROR: "ERROR"}.get(level, "WARN")
        try:
            print(f"[{severity}] [{time.time():.9f}] [{self._name}]: {text}", file=sys.stderr, flush=True)
        except OSError:  # nobody reads the log any more, which must end neither the node nor its exit code
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())

    # Running

    def stop(self) -> None:
        """Let `spin` end; may be called from a signal handler."""
        self._stop = True

    def ask(self, what: Callable[[], str]) -> None:
        """Have something done between two messages; may be called from a signal handler."""
        self._asked.append(what)

    def spin(self) -> None:
        """Run until `stop`."""
        application = self.application
        why = "without rclpy" if importlib.util.find_spec("rclpy") else "rclpy is not there"
        reach = self._participant.reach
        self.log(Level.OK, f"{why}: on Cyclone DDS {reach}: topics and presence, no parameter or lifecycle services")
        self.log(Level.OK, f"{application.vehicle.title}; {application.began_with}")
        application.activate()
        wait = self._participant.waiter()
        next_tick = time.monotonic_ns()
        while not self._stop:
            left = next_tick - time.monotonic_ns()
            if left > 0:
                wait(min(left, LONGEST_WAIT_NS))
            if self._clock:
                for raw, _ in self._clock.take():
                    with suppress(MalformedError):
                        self._set_clock(clock_ns(raw))
            # Looked at from the last, which feeds the speed: then whatever was sent before a speed is there with it.
            taken = [reader.take() for reader in reversed(self._readers)]
            for index, message in enumerate(self._input_readers):
                for raw, sent_ns in taken.pop():
                    try:
                        stamp_ns, values = message.read(raw)
                    except MalformedError:
                        application.undecodable(index, sent_ns)
                    else:
                        application.receive_values(index, stamp_ns, values, sent_ns)
            now = time.monotonic_ns()
            if now >= next_tick:
                application.tick()
                next_tick = max(next_tick + int(application.period_s * SECOND_NS), now)
            while self._asked:
                try:
                    self.log(Level.OK, self._asked.pop(0)())
                except InputError as error:
                    self.log(Level.WARN, str(error))

    def close(self) -> None:
        """Save the state and leave."""
        self.log(Level.OK, self.application.close())
        self._participant.close()

    def _set_clock(self, now_ns: int) -> None:
        back_ns = self._sim_ns - now_ns
        self._sim_ns = now_ns
        if back_ns > self.application.estimator.settings.clock_jump_s * SECOND_NS:
            self.application.time_went_back()


def run(parameters: Parameters, node: str, namespace: str, started: Callable[[Application], None] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM; SIGUSR1 saves the state, SIGUSR2 starts cold.

    Returns
    -------
    int
        Exit code, 0.
    """
    running = DdsNode(parameters, node, namespace)
    application = running.application

    def stop(_signal: int, _frame: FrameType | None) -> None:
        running.stop()

    signal.signal(signal.SIGINT, stop)
    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGUSR1, lambda *_: running.ask(application.save_state))
    signal.signal(signal.SIGUSR2, lambda *_: running.ask(application.reset))
    gc.freeze()  # what was loaded stays: looking through it would hold up a message now and then
    try:
        if started:
            started(application)
        running.spin()
    finally:
        running.close()
    return 0
