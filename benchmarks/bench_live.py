# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The node on Cyclone DDS, with four belts under four loads. The rival is a bare echo, `dds_echo.py`: a process that answers
each speed with one torque of the same stamp. At the default rate it answers the newest speed at 50 Hz, as the node does. So
it does for start and shares. The node publishes eight more topics. Latency is from speed to torque, and shares are of a core.
Memory is resident. Before its first torque the node looks for another publisher of it, for one second: two would fight.
"""

from __future__ import annotations

import importlib.util
import os
import random
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from measuring import COMMAND, HERE, ROOT, Row, alone, compared

DOMAIN = "188"
CONFIGURATION = """<CycloneDDS><Domain>
<General><AllowMulticast>false</AllowMulticast>
<Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>
<Peers><Peer address="127.0.0.1"/></Peers></Discovery>
</Domain></CycloneDDS>"""
HZ = 50.0
MESSAGES, ROUNDS, SHARE_S, STARTS = 600, 3, 20.0, 7
SMALL = {"messages": 5, "rounds": 1, "share_s": 0.5, "starts": 1}
WARM_UP = 50
LOAD_EVERY = 10
BETWEEN_S = 0.005  # of messages until the first answer
WITHIN_S = 60.0
PLACES = ("front_left", "front_right", "rear_left", "rear_right")
LOADS_N = (60e3, 65e3, 70e3, 75e3)
NUMBER = "std_msgs/msg/Float64"
TOPICS = "\n".join(
    ["speed: {topic: /vehicle/speed, type: geometry_msgs/msg/TwistStamped, field: twist.linear.x}"]
    + [f"load/{place}: {{topic: /load/{place}, type: std_msgs/msg/Float64, field: data}}" for place in PLACES]
)
TARGETS = {"median": 1.3, "p99": 2.0}
START_TARGET, SHARE_TARGET, MEMORY_TARGET_MB = 1.3, 3.0, 110.0


def environment() -> dict[str, str]:
    """Loopback, and a domain of our own."""
    paths = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    own = {"ROS_DOMAIN_ID": DOMAIN, "CYCLONEDDS_URI": CONFIGURATION, "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT"}
    return {**os.environ, **own, "PYTHONPATH": paths}


@contextmanager
def running(command: list[str], client: Client) -> Iterator[subprocess.Popen[bytes]]:
    """A process while the block runs; after it the client has lost its endpoints."""
    process = subprocess.Popen(
        [sys.executable, *command], env=environment(), stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(10.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
    client.forget()


class Client:
    """Publishes speeds and waits for torques."""

    def __init__(self) -> None:
        from dds_echo import SPEED, STAMP, TORQUE, TWIST, WRENCH

        from trackres_ros.node.dds.wire import Participant, serialized, typestore
        from trackres_ros.node.transport import Quality

        self._stamp, self._twist = STAMP, TWIST
        self._participant = Participant("client", "/")
        self._writer = self._participant.writer(SPEED, TWIST, Quality(True, 10, 0.0))
        self._reader = self._participant.reader(TORQUE, WRENCH, Quality(True, 100, 0.0))
        self._loads = [self._participant.writer(f"/load/{place}", NUMBER, Quality(True, 10, 0.0)) for place in PLACES]
        self._participant.announce()
        self._wait = self._participant.waiter()
        self._serialized, self._types = serialized, typestore().types

    @property
    def readers(self) -> int:
        """How many receive its speeds."""
        return int(self._writer.readers)

    def forget(self) -> None:
        """Wait until nobody receives its speeds any more, and leave no old answer."""
        until = time.monotonic() + WITHIN_S
        while self.readers and time.monotonic() < until:
            time.sleep(0.05)
        while list(self._reader.take()):
            pass

    def load(self) -> None:
        """Give each assembly another load."""
        for writer, load in zip(self._loads, LOADS_N, strict=True):
            writer.write(self._serialized(self._types[NUMBER](data=load), NUMBER))

    def message(self, speed: float) -> bytes:
        """A speed of now, in bytes."""
        t, now = self._types, time.time_ns()
        stamp = t["builtin_interfaces/msg/Time"](sec=now // 10**9, nanosec=now % 10**9)
        vector = t["geometry_msgs/msg/Vector3"]
        twist = t["geometry_msgs/msg/Twist"](linear=vector(x=speed, y=0.0, z=0.0), angular=vector(x=0.0, y=0.0, z=0.0))
        header = t["std_msgs/msg/Header"](stamp=stamp, frame_id="")
        return bytes(self._serialized(t[self._twist](header=header, twist=twist), self._twist))

    def exchange(self, raw: bytes) -> float | None:
        """Time until the answer came [s], None if it did not."""
        begin = time.perf_counter()
        self._writer.write(raw)
        while time.perf_counter() - begin < 1.0:
            self._wait(100_000_000)
            if any(answer.raw[self._stamp] == raw[self._stamp] for answer in self._reader.take()):
                return time.perf_counter() - begin
        return None

    def first_answer(self) -> None:
        """Publish until the first torque comes. Raises RuntimeError if none does."""
        until = time.monotonic() + WITHIN_S
        while time.monotonic() < until:
            if self.readers:
                self._writer.write(self.message(3.0))
            self._wait(int(1e9 * BETWEEN_S))
            if list(self._reader.take()):
                return
            time.sleep(BETWEEN_S)
        raise RuntimeError("nobody answers")

    def publish(self, duration_s: float) -> None:
        """Publish at 50 Hz, and take the answers."""
        begin = time.monotonic()
        for i in range(int(HZ * duration_s)):
            if i % LOAD_EVERY == 0:
                self.load()
            self._writer.write(self.message(3.0 + 0.0005 * i))
            time.sleep(max(0.0, begin + (i + 1) / HZ - time.monotonic()))
            list(self._reader.take())

    def latencies(self, count: int) -> list[float]:
        """Times from a speed to its torque [s], after some to warm up; pauses differ, so that no phase to a rate is kept."""
        pauses, times = random.Random(1), []
        self.first_answer()
        warm_up = min(WARM_UP, count)
        for i in range(count + warm_up):
            if i % LOAD_EVERY == 0:
                self.load()
            took = self.exchange(self.message(3.0 + 0.0005 * i))
            if took is not None and i >= warm_up:
                times.append(took)
            time.sleep(pauses.uniform(0.5, 1.5) / HZ)
        return times

    def close(self) -> None:
        """Leave."""
        self._participant.close()


def p99(times: list[float]) -> float:
    """The time that one in a hundred exceeds."""
    return sorted(times)[int(0.99 * len(times))]


def processor_s(pid: int) -> float:
    """Processor time of a process, all threads [s]; the scheduler's own, as a tick of 10 ms is much for an idle one."""
    return sum(1e-9 * int(task.read_text().split()[0]) for task in Path(f"/proc/{pid}/task").glob("*/schedstat"))


def resident_mb(pid: int) -> float:
    """Resident memory of a process [MB]."""
    return 1e-6 * int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def share(pid: int, duration_s: float, run: Callable[[float], None]) -> float:
    """Share of a core [%] that a process takes meanwhile."""
    before, begin = processor_s(pid), time.monotonic()
    run(duration_s)
    return 100.0 * (processor_s(pid) - before) / (time.monotonic() - begin)


def run(messages: int = MESSAGES, rounds: int = ROUNDS, share_s: float = SHARE_S, starts: int = STARTS) -> list[Row]:
    """Measure in turns; nothing without `cyclonedds`."""
    if importlib.util.find_spec("cyclonedds") is None:
        return []
    os.environ.update({key: value for key, value in environment().items() if key.startswith(("ROS_", "CYCLONE"))})
    client = Client()
    try:
        with tempfile.TemporaryDirectory() as name:
            topics = Path(name, "topics.yaml")
            topics.write_text(TOPICS)
            node = [*COMMAND, "live", "--transport", "dds", "--quiet", "--vehicle", "xgd24d", "--topics", str(topics)]
            node += ["-p", "state_file:=none"]
            echo = [str(HERE / "dds_echo.py")]
            at_rate = [*echo, str(HZ)]
            on_each = [*node, "-p", "output_rate_hz:=0.0"]
            return [
                *_latency(client, f"latency at {HZ:g} Hz", (node, at_rate), messages, rounds),
                *_latency(client, "latency on each message", (on_each, echo), messages, rounds),
                *_started(client, (node, at_rate), starts),
                *_shares(client, (node, at_rate), share_s, rounds),
            ]
    finally:
        client.close()


Commands = tuple[list[str], list[str]]  # the node's and the echo's


def _latency(client: Client, title: str, commands: Commands, messages: int, rounds: int) -> list[Row]:
    times: list[list[list[float]]] = [[], []]
    for _ in range(rounds):
        for of, command in zip(times, commands, strict=True):
            with running(command, client):
                of.append(client.latencies(messages))
    return [
        compared(f"{title}, {what} [ms]", *([each(one) for one in of] for of in times), TARGETS[what], 1e3)
        for what, each in (("median", statistics.median), ("p99", p99))
    ]


def _started(client: Client, commands: Commands, starts: int) -> list[Row]:
    listens: list[list[float]] = [[], []]
    answers: list[list[float]] = [[], []]
    for _ in range(starts):
        for i, command in enumerate(commands):
            begin = time.monotonic()
            with running(command, client):
                while not client.readers:
                    time.sleep(BETWEEN_S)
                listens[i].append(time.monotonic() - begin)
                client.first_answer()
                answers[i].append(time.monotonic() - begin)
    first = statistics.median(answers[0])
    return [compared("start, until it listens [s]", *listens, START_TARGET), alone("start, until the first torque [s]", first)]


def _shares(client: Client, commands: Commands, share_s: float, rounds: int) -> list[Row]:
    idle: list[list[float]] = [[], []]
    busy: list[list[float]] = [[], []]
    memory: list[float] = []
    for _ in range(rounds):
        for i, command in enumerate(commands):
            with running(command, client) as process:
                while not client.readers:
                    time.sleep(0.1)
                time.sleep(min(3.0, share_s))  # it has started
                idle[i].append(share(process.pid, share_s, time.sleep))
                client.first_answer()
                busy[i].append(share(process.pid, share_s, client.publish))
                if i == 0:
                    memory.append(resident_mb(process.pid))
    return [
        compared("share, idle [%]", *idle, SHARE_TARGET),
        compared(f"share at {HZ:g} Hz [%]", *busy, SHARE_TARGET),
        alone(f"memory at {HZ:g} Hz [MB]", statistics.median(memory), MEMORY_TARGET_MB),
    ]
