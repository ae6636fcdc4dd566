# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A node in a process of its own on either transport, and an independent participant that talks with it."""

import importlib.util
import json
import math
import os
import shutil
import signal
import subprocess
import sys
import time
from functools import cached_property
from pathlib import Path

import pytest
from waiting import PATIENCE_S, Pace, exit_code, wait_for

if not importlib.util.find_spec("cyclonedds"):
    collect_ignore_glob = ["test_*.py"]
else:
    import peer
    from ros_messages import stamped
    from ros_shell import Shell

    from trackres_ros.files.resources import shipped_topics
    from trackres_ros.vehicle import load_any

    DOMAIN = peer.domain_of_worker(71)
    DEFAULT_TOPICS = shipped_topics()["default"].read_text()

FEEDFORWARD_LIMIT_NM = 0.1 * 272000 * 0.4
WRENCH, JOINTS = "geometry_msgs/msg/WrenchStamped", "sensor_msgs/msg/JointState"
TWIST, FLOAT, TEMPERATURE = "geometry_msgs/msg/TwistStamped", "std_msgs/msg/Float64", "sensor_msgs/msg/Temperature"
ESTIMATE = "control_msgs/msg/DynamicInterfaceGroupValues"
ARRAY = "diagnostic_msgs/msg/DiagnosticArray"
FAST_PROFILE = """<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"><profiles>
<transport_descriptors><transport_descriptor><transport_id>lo</transport_id><type>UDPv4</type>
<interfaceWhiteList><address>127.0.0.1</address></interfaceWhiteList></transport_descriptor></transport_descriptors>
<participant profile_name="lo" is_default_profile="true"><rtps><userTransports><transport_id>lo</transport_id></userTransports>
<useBuiltinTransports>false</useBuiltinTransports><builtin><initialPeersList><locator><udpv4><address>127.0.0.1</address></udpv4>
</locator></initialPeersList></builtin></rtps></participant></profiles></dds>
"""


def why_not(transport):
    """Why a transport cannot run here; empty if it can."""
    if transport == "dds":
        return ""
    try:
        importlib.import_module("rclpy")
    except ImportError as error:
        return f"rclpy does not import here: {error}"
    if transport == "fast":
        prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
        if not any((Path(prefix) / "lib" / "librmw_fastrtps_cpp.so").exists() for prefix in prefixes if prefix):
            return "rmw_fastrtps_cpp is not installed"
    return ""


def environment(transport, folder):
    """Environment of a process on a transport: loopback, a domain and a home of its own."""
    chosen = {
        **os.environ,
        "ROS_DOMAIN_ID": str(DOMAIN),
        "XDG_STATE_HOME": str(folder / "state"),
        "ROS_HOME": str(folder / "ros"),
        "PYTHONFAULTHANDLER": "1",  # see `waiting.exit_code`
    }
    chosen["CYCLONEDDS_URI"] = peer.LOOPBACK
    chosen["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "SYSTEM_DEFAULT"
    chosen.pop("ROS_LOCALHOST_ONLY", None)
    if transport == "fast":
        profile = folder / "fast.xml"
        profile.write_text(FAST_PROFILE)
        chosen |= {"RMW_IMPLEMENTATION": "rmw_fastrtps_cpp", "FASTRTPS_DEFAULT_PROFILES_FILE": str(profile)}
    elif transport == "ros":
        chosen["RMW_IMPLEMENTATION"] = "rmw_cyclonedds_cpp"
    return chosen


class Node:
    """The node under test, and our side of the wire."""

    def __init__(
        self,
        transport,
        folder,
        wire,
        name="trackres",
        namespace="/",
        preexec=None,
        topics=None,
        program=None,
        options=(),
        **given,
    ):
        self.transport, self.folder, self.wire, self.name = transport, folder, wire, name
        self.base = f"{namespace.rstrip('/')}/{name}"
        self.parameters = {"vehicle": "xgd24d", "state_file": "none", **given}
        if topics:
            (folder / "topics.yaml").write_text(topics)
            self.parameters["topics"] = str(folder / "topics.yaml")
        params = folder / f"{name}.json"
        params.write_text(json.dumps({"/**": {"ros__parameters": self.parameters}}))  # JSON is YAML
        self.log_path = folder / f"{name}-{time.monotonic_ns()}.log"
        command = [
            sys.executable,
            *(["-c", program] if program else ["-m", "trackres_ros"]),
            "live",
            "--quiet",
            *map(str, options),
        ]
        command += [
            "--transport",
            "dds" if transport == "dds" else "ros",
            "--params",
            str(params),
            "--name",
            name,
            "--namespace",
            namespace,
        ]
        self.out = {
            "feedforward": wire.subscribe(f"{self.base}/feedforward_torque", WRENCH),
            "resistance": wire.subscribe(f"{self.base}/resistance_torque", JOINTS),
            "estimate": wire.subscribe(f"{self.base}/estimate", ESTIMATE),
            "belt": wire.subscribe(f"{self.base}/track_temperature/front_left", TEMPERATURE),
            "status": wire.subscribe(f"{self.base}/status", ARRAY),
            "diagnostics": wire.subscribe("/diagnostics", ARRAY),
        }
        prefix = namespace.rstrip("/")
        self.inputs = {
            "speed": wire.publisher(f"{prefix}/speed", TWIST),
            "load": wire.publisher(f"{prefix}/load", FLOAT),
            "ambient": wire.publisher(f"{prefix}/ambient", TEMPERATURE),
        }
        # Last: what fails above leaves no process behind.
        with self.log_path.open("w") as log:
            self.process = subprocess.Popen(
                command, env=environment(transport, folder), stdout=log, stderr=log, stdin=subprocess.DEVNULL, preexec_fn=preexec
            )

    @cached_property
    def has_belts(self):
        """Whether its vehicle has belts, whose temperatures are published last."""
        return bool(load_any(self.parameters["vehicle"]).assemblies)

    @property
    def log(self):
        """Its log so far."""
        return self.log_path.read_text()

    def started(self):
        """Wait until it talks and listens."""
        connected = lambda: self.statuses() and all(given.matched for given in self.inputs.values())  # noqa: E731
        self.until(connected, "the node to start", working=True)
        return self

    def sees_its_publishers(self, tell_time):
        """Wait until the node has seen all publishers and the simulated clock: earlier messages are not kept for it."""
        self.until(lambda: not {"NO_PUBLISHER", "NO_CLOCK"} & self.last_remarks(), "the node to see all", meanwhile=tell_time)

    def until(self, holds, what, patience_s=PATIENCE_S, meanwhile=None, working=False):
        """Wait until something holds, doing something meanwhile; if `working`, as long as the node computes."""

        def decided():
            return holds() or self.process.poll() is not None

        found = wait_for(decided, patience_s, self.process.pid if working else None, meanwhile)
        assert self.process.poll() is None, f"the node has ended with {self.process.returncode}:\n{self.log}"
        assert found, f"waited in vain for {what}; the last status: {self.status()}\n{self.log}"

    def send(self, role, value, stamp_ns=None):
        """Publish a value of a role, stamped now or as given."""
        header = stamped(time.time_ns() if stamp_ns is None else stamp_ns)
        if role == "speed":
            self.inputs[role].publish(header=header, twist={"linear": {"x": float(value), "y": 0.0, "z": 0.0}})
        elif role == "ambient":
            self.inputs[role].publish(header=header, temperature=float(value))
        else:
            self.inputs[role].publish(data=float(value))

    def drive(self, seconds, hz=50.0, speed=8.0, load=272e3, ambient=15.0, stamps=lambda: None):
        """Publish all inputs for a while; `speed` is a number or a function that gives one."""
        begin, count, pace = time.monotonic(), 0, Pace(hz)
        while time.monotonic() - begin < seconds:
            if load is not None and count % 5 == 0:
                self.send("load", load)
            if ambient is not None and count % 25 == 0:
                self.send("ambient", ambient)
            value = speed() if callable(speed) else speed + 0.01 * (count % 7)
            if value is not None:
                self.send("speed", value, stamps())
            count += 1
            self.out["feedforward"].update()
            pace.next()

    def silent(self, seconds):
        """Send nothing until the node has published as often as it does in so many seconds; at its own rate of 50 Hz."""
        last = len(self.torques()) + int(50.0 * seconds)
        self.until(lambda: len(self.torques()) >= last, f"{seconds} s of outputs")

    def healthy(self):
        """Drive until nothing is to be noticed."""
        self.drive(0.3)
        self.until(lambda: self.status() and self.level() == 0, "a good status", meanwhile=lambda: self.drive(0.3))
        return self

    def statuses(self):
        """All statuses of the node so far."""
        return [heard.message.status[0] for heard in self.out["status"].update()]

    def status(self):
        """The last status, or None."""
        found = self.statuses()
        return found[-1] if found else None

    def level(self):
        """Level of the last status."""
        return int(self.status().level)

    def notices(self, since=0):
        """Names of everything that was noticed since so many statuses."""
        return {name for status in self.statuses()[since:] for name in _values(status)["remarks"].split()}

    def last_remarks(self):
        """Names of the notices in the last status."""
        return set(_values(self.status())["remarks"].split())

    def noticed(self, name, meanwhile=None):
        """Wait until a notice is made."""
        since = len(self.statuses())
        self.until(lambda: name in self.notices(since), f"the notice {name}", meanwhile=meanwhile)

    def values(self, entry):
        """Keys and values of an entry of the last diagnostics, such as `input speed`."""
        heard = self.out["diagnostics"].update()
        for found in reversed(heard):
            for status in found.message.status:
                if status.name == f"{self.base.lstrip('/')}: {entry}":
                    return _values(status)
        return {}

    def torques(self):
        """Feed-forward torques so far, in order."""
        return [heard.message.wrench.torque.y for heard in self.out["feedforward"].update()]

    def check_outputs(self):
        """No output was ever out of bounds or not a number."""
        for torque in self.torques():
            assert math.isfinite(torque), "the feed-forward is not finite"
            assert abs(torque) <= FEEDFORWARD_LIMIT_NM, f"the feed-forward is {torque}"
        for heard in self.out["estimate"].update():
            vehicle, reasons = (
                dict(zip(group.interface_names, group.values, strict=True)) for group in heard.message.interface_values
            )
            assert abs(vehicle["feedforward_torque_nm"]) <= FEEDFORWARD_LIMIT_NM
            assert vehicle["resistance_std_nm"] > 0.0
            assert vehicle["level"] == max(reasons.values(), default=0.0)
        for heard in self.out["resistance"].update():
            assert all(math.isfinite(effort) for effort in heard.message.effort)
            assert abs(heard.message.effort[0]) < 20000.0
        for heard in self.out["belt"].update():
            assert -60.0 < heard.message.temperature < 150.0
            assert 0.0 < heard.message.variance < 1e4

    def stop(self, how=signal.SIGINT):
        """End it; its exit code."""
        if self.process.poll() is None:
            self.process.send_signal(how)
            exit_code(self.process)
        return self.process.returncode

    def close(self):
        """End it, and our side."""
        self.stop()
        for given in self.inputs.values():
            given.close()


def _values(status):
    return {pair.key: pair.value for pair in status.values}


TRANSPORTS = [
    pytest.param(transport, marks=pytest.mark.skipif(bool(why_not(transport)), reason=why_not(transport) or "-"))
    for transport in ("dds", "ros")
]
FAST = pytest.param("fast", marks=pytest.mark.skipif(bool(why_not("fast")), reason=why_not("fast") or "-"))


@pytest.fixture
def wire():
    made = peer.Wire(DOMAIN)
    yield made
    made.close()


@pytest.fixture(params=TRANSPORTS)
def transport(request):
    return request.param


@pytest.fixture
def node(transport, tmp_path, wire):
    """A function that starts a node on the transport."""
    nodes = []

    def start(**given):
        given.setdefault("namespace", "/alone")  # away from the node that runs through all scenarios
        nodes.append(Node(transport, tmp_path, wire, **given))
        return nodes[-1].started()

    yield start
    try:
        for made in nodes:
            made.check_outputs()
    finally:
        for made in nodes:
            made.close()


@pytest.fixture(scope="module")
def standing_nodes(tmp_path_factory):
    """A function that gives the one node of a transport that runs through all scenarios of a module."""
    nodes = {}

    def of(transport):
        if transport not in nodes:
            close()  # one at a time: they share their topics
            wire = peer.Wire(DOMAIN)
            nodes[transport] = Node(transport, tmp_path_factory.mktemp("standing"), wire).started()
        return nodes[transport]

    def close():
        for transport, made in list(nodes.items()):
            del nodes[transport]
            try:
                made.check_outputs()
            finally:
                code = made.stop()
                made.close()
                made.wire.close()
            assert code == 0, made.log

    yield of
    close()


@pytest.fixture(params=TRANSPORTS, scope="module")
def standing(request, standing_nodes):
    return standing_nodes(request.param)


@pytest.fixture(params=[*TRANSPORTS, FAST], scope="module")
def anywhere(request, standing_nodes):
    """As `standing`, and on Fast DDS too, for behaviour that depends on the middleware."""
    return standing_nodes(request.param)


@pytest.fixture(params=["ros", FAST])
def shell(request, tmp_path):
    """Commands of ROS 2, on each middleware that is there."""
    made = Shell(tmp_path, environment(request.param, tmp_path))
    yield made
    made.close()


@pytest.fixture
def cyclone(tmp_path):
    """Commands of ROS 2 on Cyclone DDS."""
    made = Shell(tmp_path, environment("ros", tmp_path))
    yield made
    made.close()


@pytest.fixture
def launcher(cyclone, workspace):
    """The same in a workspace that the package is built into."""
    cyclone.environment = {**workspace, **{k: v for k, v in cyclone.environment.items() if os.environ.get(k) != v}}
    return cyclone


@pytest.fixture(scope="session")
def workspace(tmp_path_factory, repository):
    """Environment of a workspace that the package is built into as a user builds it."""
    if not importlib.util.find_spec("colcon_ros"):
        pytest.skip("colcon is not installed for this Python: pip install colcon-common-extensions")
    folder = tmp_path_factory.mktemp("workspace")
    left = ("[.]*", "build", "install", "log", "out", "docs", "*.egg-info", "__pycache__")
    shutil.copytree(repository, folder / "src" / "trackres_ros", ignore=shutil.ignore_patterns(*left))
    program = "import sys; from colcon_core.command import main; sys.exit(main())"
    build = [sys.executable, "-W", "ignore", "-c", program, "build", "--packages-select", "trackres_ros"]
    done = subprocess.run(build, cwd=folder, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    sourced = f"source {folder}/install/setup.bash && env -0"
    said = subprocess.run(["bash", "-c", sourced], capture_output=True, text=True, check=True).stdout
    return dict(line.split("=", 1) for line in said.split("\0") if "=" in line)
