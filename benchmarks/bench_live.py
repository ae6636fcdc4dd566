# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The live node: time from a published speed to the received torque, against a bare echo; its share of a core; its start."""

from __future__ import annotations

import importlib.util
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from measuring import Target, at_most

ROOT = Path(__file__).resolve().parents[1]
DOMAIN = "188"
HZ, MESSAGES, ROUNDS, WARM_UP = 100, 800, 2, 50
CPU_S = 15.0
MEMORY_MESSAGES = 6000
SPEED, TORQUE = "/vehicle/speed", "/trackres/feedforward_torque"
TWIST, WRENCH = "geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/WrenchStamped"
PLACES = ("front_left", "front_right", "rear_left", "rear_right")
TOPICS = "\n".join(
    [f"speed: {{topic: {SPEED}, type: {TWIST}, field: twist.linear.x}}"]
    + [f"load/{place}: {{topic: /load/{place}, type: std_msgs/msg/Float64, field: data}}" for place in PLACES]
)
NUMBER = "std_msgs/msg/Float64"
LOADS_N = (60e3, 65e3, 70e3, 75e3)
LOAD_EVERY = 10
WITHIN_S = 60.0
TARGETS: dict[str, Target] = {
    f"{transport}: {what}": target
    for transport, share in (("dds", 8.0), ("ros", 12.0))
    for what, target in (
        ("median over a bare echo's", at_most(1.3)),
        ("p99 over a bare echo's", at_most(2.0)),
        ("share of a core at 50 Hz [%]", at_most(share)),
        ("memory, growth over 1 min at 100 Hz [MB]", at_most(1.0)),
        ("start to first torque, empty cache [s]", at_most(10.0)),
        ("start to first torque, filled cache [s]", at_most(3.0)),
    )
}


def environment(cache: Path | None = None) -> dict[str, str]:
    """Loopback, a domain of our own, and where asked a cache of its own."""
    from dds_echo import CONFIGURATION

    given = {**os.environ, "ROS_DOMAIN_ID": DOMAIN, "CYCLONEDDS_URI": CONFIGURATION, "RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}
    given["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "SYSTEM_DEFAULT"
    given["PYTHONPATH"] = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    return {**given, "XDG_CACHE_HOME": str(cache)} if cache else given


@contextmanager
def running(command: list[str], cache: Path | None = None) -> Iterator[subprocess.Popen[bytes]]:
    """A process while the block runs."""
    process = subprocess.Popen(
        command, env=environment(cache), stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(10.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def node(transport: str, folder: Path, rate_hz: float) -> list[str]:
    """Command of the node."""
    topics = folder / "topics.yaml"
    topics.write_text(TOPICS)
    command = [sys.executable, "-m", "trackres_ros", "live", "--transport", transport, "--quiet", "--vehicle", "xgd24d"]
    return [*command, "--topics", str(topics), "-p", "state_file:=none", "-p", f"output_rate_hz:={rate_hz}"]


class DdsClient:
    """Publishes speeds and waits for torques by Cyclone DDS."""

    def __init__(self) -> None:
        from trackres_ros.node.dds.participant import Participant, serialized
        from trackres_ros.node.dds.wire import typestore
        from trackres_ros.node.endpoints import Quality

        os.environ.update({key: value for key, value in environment().items() if key.startswith(("ROS_", "CYCLONE"))})
        self._participant = Participant("client", "/")
        self._writer = self._participant.writer(SPEED, TWIST, Quality(True, 10, 0.0))
        self._reader = self._participant.reader(TORQUE, WRENCH, Quality(True, 100, 0.0))
        self._loads = [self._participant.writer(f"/load/{place}", NUMBER, Quality(True, 10, 0.0)) for place in PLACES]
        self._participant.announce()
        self._wait = self._participant.waiter()
        self._serialized, self._types = serialized, typestore().types

    def connected(self) -> bool:
        """Whether somebody listens."""
        return self._writer.readers > 0

    def load(self) -> None:
        """Give each assembly another load."""
        for writer, load in zip(self._loads, LOADS_N, strict=True):
            writer.write(self._serialized(self._types[NUMBER](data=load), NUMBER))

    def message(self, speed: float, now: int) -> tuple[Any, Any]:
        """A message, and what its answer is known by."""
        t = self._types
        stamp = t["builtin_interfaces/msg/Time"](sec=now // 10**9, nanosec=now % 10**9)
        vector = t["geometry_msgs/msg/Vector3"]
        twist = t["geometry_msgs/msg/Twist"](linear=vector(x=speed, y=0.0, z=0.0), angular=vector(x=0.0, y=0.0, z=0.0))
        header = t["std_msgs/msg/Header"](stamp=stamp, frame_id="")
        raw = self._serialized(t[TWIST](header=header, twist=twist), TWIST)
        return raw, raw[4:12]

    def exchange(self, raw: Any, key: Any) -> float | None:
        """Time until the answer came [s], None if it did not."""
        begin = time.perf_counter()
        self._writer.write(raw)
        while time.perf_counter() - begin < 1.0:
            self._wait(100_000_000)
            if any(answer.raw[4:12] == key for answer in self._reader.take()):
                return time.perf_counter() - begin
        return None

    def close(self) -> None:
        """Leave."""
        self._participant.close()


class RosClient:
    """The same by rclpy."""

    def __init__(self) -> None:
        import rclpy
        from geometry_msgs.msg import TwistStamped, WrenchStamped
        from std_msgs.msg import Float64

        os.environ.update({key: value for key, value in environment().items() if key.startswith(("ROS_", "CYCLONE", "RMW"))})
        self._rclpy, self._kind = rclpy, TwistStamped
        rclpy.init()
        self._node = rclpy.create_node("client")
        self._publisher = self._node.create_publisher(TwistStamped, SPEED, 10)
        self._got: tuple[int, int] | None = None
        self._load_kind = Float64
        self._loads = [self._node.create_publisher(Float64, f"/load/{place}", 10) for place in PLACES]
        self._node.create_subscription(WrenchStamped, TORQUE, self._take, 100)

    def _take(self, message: Any) -> None:
        self._got = (message.header.stamp.sec, message.header.stamp.nanosec)

    def connected(self) -> bool:
        """Whether somebody listens."""
        return bool(self._publisher.get_subscription_count())

    def load(self) -> None:
        """Give each assembly another load."""
        for publisher, load in zip(self._loads, LOADS_N, strict=True):
            publisher.publish(self._load_kind(data=load))

    def message(self, speed: float, now: int) -> tuple[Any, Any]:
        """A message, and what its answer is known by."""
        message = self._kind()
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(now, 10**9)
        message.twist.linear.x = speed
        return message, divmod(now, 10**9)

    def exchange(self, message: Any, key: Any) -> float | None:
        """Time until the answer came [s], None if it did not."""
        begin = time.perf_counter()
        self._publisher.publish(message)
        while self._got != key and time.perf_counter() - begin < 1.0:
            self._rclpy.spin_once(self._node, timeout_sec=0.1)
        return time.perf_counter() - begin if self._got == key else None

    def close(self) -> None:
        """Leave."""
        self._node.destroy_node()
        self._rclpy.shutdown()


def latencies(client: Any, count: int, hz: float) -> list[float]:
    """Times of messages sent at a rate, after some to warm up [s]."""
    until = time.monotonic() + WITHIN_S
    while not client.connected() or client.exchange(*client.message(3.0, time.time_ns())) is None:
        if time.monotonic() > until:
            raise RuntimeError("nobody answers")
        time.sleep(0.05)
    times = []
    for i in range(count + WARM_UP):
        begin = time.perf_counter()
        if i % LOAD_EVERY == 0:
            client.load()
        took = client.exchange(*client.message(3.0 + 0.0005 * i, time.time_ns()))
        if took is not None and i >= WARM_UP:
            times.append(took)
        time.sleep(max(0.0, 1.0 / hz - (time.perf_counter() - begin)))
    return times


def p99(times: list[float]) -> float:
    """The time that one in a hundred exceeds."""
    return sorted(times)[int(0.99 * len(times))]


def usage(pid: int) -> tuple[float, float]:
    """CPU time [s] and resident memory [MB] of a process."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    ticks = int(fields[11]) + int(fields[12])
    return ticks / os.sysconf("SC_CLK_TCK"), int(fields[21]) * os.sysconf("SC_PAGE_SIZE") / 2**20


def measure(transport: str) -> dict[str, float]:
    """All numbers of one transport."""
    with tempfile.TemporaryDirectory() as name:
        return _measure(transport, Path(name))


def _measure(transport: str, folder: Path) -> dict[str, float]:
    found: dict[str, float] = {}
    client = DdsClient() if transport == "dds" else RosClient()
    rivals = {"echo": [sys.executable, __file__, f"echo-{transport}"], "node": node(transport, folder, 0.0)}
    times: dict[str, list[float]] = {name: [] for name in rivals}
    for _ in range(ROUNDS):
        for name, command in rivals.items():
            with running(command):
                times[name] += latencies(client, MESSAGES, HZ)
            time.sleep(1.0)  # its endpoints are gone
    found["bare echo, median [us]"] = 1e6 * statistics.median(times["echo"])
    found["bare echo, p99 [us]"] = 1e6 * p99(times["echo"])
    found["node, median [us]"] = 1e6 * statistics.median(times["node"])
    found["node, p99 [us]"] = 1e6 * p99(times["node"])
    found["median over a bare echo's"] = statistics.median(times["node"]) / statistics.median(times["echo"])
    found["p99 over a bare echo's"] = p99(times["node"]) / p99(times["echo"])
    with running(node(transport, folder, 50.0)) as process:
        latencies(client, 100, 50.0)
        before, begin = usage(process.pid)[0], time.monotonic()
        latencies(client, int(CPU_S * 50), 50.0)
        found["share of a core at 50 Hz [%]"] = 100.0 * (usage(process.pid)[0] - before) / (time.monotonic() - begin)
        memory = usage(process.pid)[1]
        latencies(client, MEMORY_MESSAGES, 100.0)
        found["memory, growth over 1 min at 100 Hz [MB]"] = usage(process.pid)[1] - memory
        found["memory [MB]"] = usage(process.pid)[1]
    time.sleep(1.0)
    for label in ("empty", "filled"):
        begin = time.monotonic()
        with running(node(transport, folder, 0.0), folder / "cache"):
            latencies(client, 1 - WARM_UP, 100.0)
            found[f"start to first torque, {label} cache [s]"] = time.monotonic() - begin
            if label == "empty":
                time.sleep(40.0)  # until it has compiled
        time.sleep(1.0)
    client.close()
    return {f"{transport}: {name}": value for name, value in found.items()}


def run() -> dict[str, float]:
    """Numbers of each transport that is there."""
    found = measure("dds")
    if importlib.util.find_spec("rclpy"):
        found |= measure("ros")
    return found


def echo_dds() -> None:
    """A bare echo in a listener, nothing on top of it."""
    from cyclonedds._clayer import ddspy_take
    from cyclonedds.core import Listener
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic

    from trackres_ros.node.dds.participant import EVERY_SAMPLE, Participant, serialized
    from trackres_ros.node.dds.wire import idl_struct, qos, typestore
    from trackres_ros.node.endpoints import Quality

    participant = Participant("echo", "/")
    writer = participant.writer(TORQUE, WRENCH, Quality(True, 10, 0.0))
    types = typestore().types
    header = types["std_msgs/msg/Header"](stamp=types["builtin_interfaces/msg/Time"](sec=0, nanosec=0), frame_id="")
    zero = types["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
    raw = bytearray(
        serialized(types[WRENCH](header=header, wrench=types["geometry_msgs/msg/Wrench"](force=zero, torque=zero)), WRENCH)
    )

    class Answering(Listener):
        def on_data_available(self, reader: Any) -> None:
            for message, _ in ddspy_take(reader._ref, EVERY_SAMPLE, 100):
                raw[4:12] = message[4:12]
                writer.write(bytes(raw))

    topic = Topic(participant.entity, f"rt{SPEED}", idl_struct(TWIST))
    listener = Answering()
    reader = DataReader(participant.subscriber, topic, qos=qos(Quality(False, 100, 0.0), b""), listener=listener)
    while reader:
        time.sleep(1.0)


def echo_ros() -> None:
    """A bare echo node on rclpy."""
    import rclpy
    from geometry_msgs.msg import TwistStamped, WrenchStamped
    from rclpy.qos import qos_profile_sensor_data

    rclpy.init()
    bare = rclpy.create_node("echo")
    publisher = bare.create_publisher(WrenchStamped, TORQUE, 10)

    def answer(message: Any) -> None:
        torque = WrenchStamped()
        torque.header.stamp = message.header.stamp
        torque.wrench.torque.y = message.twist.linear.x
        publisher.publish(torque)

    bare.create_subscription(TwistStamped, SPEED, answer, qos_profile_sensor_data)
    rclpy.spin(bare)


if __name__ == "__main__":
    {"echo-dds": echo_dds, "echo-ros": echo_ros}[sys.argv[1]]()
