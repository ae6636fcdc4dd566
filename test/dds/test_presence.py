# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What others see of the node, and it of them; how it starts and ends where something about it is not as it should be."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import peer
import pytest
from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication, BuiltinTopicDcpsSubscription
from cyclonedds.core import InstanceState, Policy, Qos
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from ros_messages import STORE, build, fill
from rosbags.rosbag2 import StoragePlugin, Writer
from waiting import exit_code, wait_for

from trackres_ros.estimator import columns as at
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.snapshot import save
from trackres_ros.node.dds.node import CLOCK_TYPE
from trackres_ros.node.dds.player import Player
from trackres_ros.node.dds.wire import Participant, type_hash
from trackres_ros.node.transport import Quality
from trackres_ros.vehicle import load

FLOAT, TWIST = "std_msgs/msg/Float64", "geometry_msgs/msg/TwistStamped"


class Graph:
    """What anyone can see of others: their endpoints, and the nodes they say these belong to."""

    def __init__(self, wire):
        quality = Qos(
            Policy.Reliability.Reliable(duration(seconds=1)),
            Policy.Durability.TransientLocal,
            Policy.History.KeepLast(100),
            Policy.DataRepresentation(use_cdrv0_representation=True),
        )
        self._nodes_reader = DataReader(wire.participant, peer.graph_topic(wire), qos=quality)
        self._seen = [
            BuiltinDataReader(wire.participant, kind) for kind in (BuiltinTopicDcpsPublication, BuiltinTopicDcpsSubscription)
        ]
        self._endpoints = {}
        self._nodes = {}

    def update(self):
        for writes, reader in zip((True, False), self._seen, strict=True):
            for found in reader.take(N=1000):
                if found.sample_info.instance_state == InstanceState.Alive:
                    self._endpoints[found.key.bytes] = (found.topic_name, writes, found)
                else:
                    self._endpoints.pop(found.key.bytes, None)
        for message in self._nodes_reader.take(100):
            if isinstance(message, peer.ParticipantEntities):  # not the notice that a writer has gone
                self._nodes[bytes(message.gid_.data_)] = message
        return self

    def endpoints(self, below=""):
        """All endpoints by topic and whether they write."""
        return {
            (topic, writes): found
            for topic, writes, found in self.update()._endpoints.values()
            if topic.startswith(f"rt/{below}")
        }

    def keys_of(self, namespace, name):
        """Readers' and writers' keys of a node, by its announcement."""
        for message in self.update()._nodes.values():
            for node in message.node_entities_info_seq_:
                if (node.node_namespace_, node.node_name_) == (namespace, name):
                    return tuple({bytes(gid.data_) for gid in gids} for gids in (node.reader_gid_seq_, node.writer_gid_seq_))
        return set(), set()


@pytest.fixture
def graph(wire):
    return Graph(wire)


@pytest.fixture
def command(tmp_path):
    """Command of a live node with these parameters."""

    def of(*options, **parameters):
        path = tmp_path / "params.yaml"
        path.write_text(json.dumps({"vehicle": "xgd24d", "state_file": "none", **parameters}))
        return [sys.executable, "-m", "trackres_ros", "live", "--transport", "dds", "--quiet", "--params", str(path), *options]

    return of


@pytest.fixture
def start(environment):
    """A function that starts a process with its log on a pipe."""
    started = []

    def run(command, **variables):
        process = subprocess.Popen(command, env=environment | variables, stderr=subprocess.PIPE, text=True)
        started.append(process)
        return process

    yield run
    for process in started:
        process.kill()
        process.wait()
        process.stderr.close()


def notices(status):
    """Names of the last status' notices."""
    heard = status.update()
    return {pair.key: pair.value for pair in heard[-1].message.status[0].values}["remarks"].split() if heard else []


def test_it_comes_with_all_its_endpoints_and_goes_at_once(graph, wire, command, start, environment):
    node = start(command("--namespace", "/left", input_reliability="reliable"))
    below = "left/trackres/"
    assert wait_for(lambda: len(graph.endpoints(below)) == 9, working=node.pid)
    assert wait_for(lambda: len(graph.keys_of("/left", "trackres")[1]) == 10)  # its own and /diagnostics
    said_readers, said_writers = graph.keys_of("/left", "trackres")
    endpoints = graph.endpoints()
    assert {found.key.bytes for (_, writes), found in endpoints.items() if writes} == said_writers
    assert {found.key.bytes for (_, writes), found in endpoints.items() if not writes} == said_readers
    torque = endpoints["rt/left/trackres/feedforward_torque", True]
    assert torque.type_name == "geometry_msgs::msg::dds_::WrenchStamped_"
    assert torque.qos[Policy.Userdata].data == type_hash("geometry_msgs/msg/WrenchStamped")
    assert isinstance(torque.qos[Policy.Reliability], Policy.Reliability.Reliable)
    assert torque.qos[Policy.Durability] == Policy.Durability.Volatile
    assert torque.qos[Policy.Deadline] == Policy.Deadline(duration(seconds=0.2))
    assert endpoints["rt/left/trackres/status", True].qos[Policy.Deadline] != Policy.Deadline(duration(seconds=0.2))
    speed = endpoints["rt/left/speed", False]
    assert speed.type_name == "geometry_msgs::msg::dds_::TwistStamped_"
    assert isinstance(speed.qos[Policy.Reliability], Policy.Reliability.Reliable)
    status = wire.subscribe("/left/trackres/status", "diagnostic_msgs/msg/DiagnosticArray")
    publisher = wire.publisher("/left/speed", TWIST)
    assert wait_for(lambda: publisher.matched and len(status.update()) > 2)  # one a second
    assert "INCOMPATIBLE_QOS" not in notices(status)
    less = wire.publisher("/left/speed", TWIST, reliable=False)
    assert wait_for(lambda: "INCOMPATIBLE_QOS" in notices(status) and not less.matched, working=node.pid)
    node.send_signal(signal.SIGTERM)
    ours = {("rt/left/trackres/status", False)}
    assert wait_for(lambda: graph.endpoints(below).keys() == ours, patience_s=5.0)  # a lease would take 10 s to run out
    assert exit_code(node) == 0
    where = f"in domain {environment['ROS_DOMAIN_ID']}, on this machine only"
    assert f"Cyclone DDS {where}: topics and presence" in node.stderr.read()


def test_no_thread_outlives_the_last_participant(environment, monkeypatch):
    monkeypatch.delenv("CYCLONEDDS_URI", raising=False)
    for name in ("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE"):
        monkeypatch.setenv(name, environment[name])
    threads = Path("/proc/self/task")
    before = len(list(threads.iterdir()))
    mine = Participant("watcher", "/")
    assert len(list(threads.iterdir())) > before
    mine.close()
    assert wait_for(lambda: len(list(threads.iterdir())) <= before)


def test_publishers_are_seen_with_their_fit_until_they_leave(wire):
    mine = Participant("watcher", "/")
    reader = mine.reader("/a", FLOAT, Quality(reliable=True, depth=1, deadline_s=1.0))
    others = [
        wire.publisher("/a", FLOAT, reliable=True, deadline_s=0.5),
        wire.publisher("/a", FLOAT, reliable=True),
        wire.publisher("/a", FLOAT, reliable=False, deadline_s=0.5),
        wire.publisher("/a", FLOAT, reliable=True, deadline_s=0.5, struct=peer.stranger(FLOAT)),
        wire.publisher("/a", TWIST),
    ]
    _without_prefix = DataWriter(wire.participant, Topic(wire.participant, "a", peer.struct_of(FLOAT)))

    def seen():
        found = [one for one in mine.publications() if one.topic == "/a"]
        return sorted((one.type, one.handle in reader.connections) for one in found)

    try:
        assert wait_for(lambda: seen() == sorted([(FLOAT, True), (FLOAT, False), (FLOAT, False), (FLOAT, False), (TWIST, False)]))
        for other in others[1:]:
            other.close()
        own = mine.writer("/a", TWIST, Quality(reliable=True, depth=1, deadline_s=0.5))
        assert wait_for(lambda: seen() == sorted([(FLOAT, True), (TWIST, False)]))
        assert own.readers == 0
    finally:
        mine.close()


def test_messages_come_in_order_with_the_time_they_were_sent(wire):
    mine = Participant("listener", "/")
    try:
        reader = mine.reader("/b", FLOAT, Quality(reliable=True, depth=100, deadline_s=0.0))
        publisher = wire.publisher("/b", FLOAT)
        assert wait_for(lambda: publisher.matched)
        before = time.time_ns()
        for number in range(20):
            publisher.publish(data=float(number))
        wait = mine.waiter()
        taken = []
        assert wait_for(lambda: wait(10**8) is not None and taken.extend(reader.take()) is None and len(taken) == 20)
        assert [STORE.deserialize_cdr(one.raw, FLOAT).data for one in taken] == list(range(20))
        sent = [one.sent_ns for one in taken]
        assert sent == sorted(sent)
        assert before <= sent[0] <= sent[-1] <= time.time_ns()
        assert wait(1) == 0
    finally:
        mine.close()


@pytest.mark.parametrize("simulated_s", [(), (3, 4, 5)])
def test_a_bag_is_played_with_one_clock_its_own_if_it_has_one(wire, tmp_path, simulated_s):
    log_s = (1000, 1001, 1002)
    rows = [("/c", FLOAT, log * 10**9, bytes(STORE.serialize_cdr(build(FLOAT), FLOAT))) for log in log_s]
    rows.append(("/clock", CLOCK_TYPE, 0, None))
    for log, now in zip(log_s, simulated_s, strict=False):
        clock = build(CLOCK_TYPE, clock={"sec": now})
        rows.append(("/clock", CLOCK_TYPE, log * 10**9, bytes(STORE.serialize_cdr(clock, CLOCK_TYPE))))
    fill(Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP), rows)
    heard, player = wire.subscribe("/clock", CLOCK_TYPE), Player(tmp_path / "bag", 20.0)
    try:
        assert wait_for(lambda: (player._clock or player._writers["/clock"]).readers)
        player.play(lambda _: None, lambda: True)
        assert wait_for(lambda: len(heard.update()) >= 3)
        times = {one.message.clock.sec for one in heard.update()}
        assert times == set(simulated_s) if simulated_s else times <= set(log_s)
    finally:
        player.close()


def test_it_runs_in_the_last_domain_without_a_reader_of_its_log(command, start, tmp_path):
    state, session = tmp_path / "state.json", Estimator(load("xgd24d")).session()
    session.handle(at.SPEED, 1, 1, 8.0)
    save(session, state, time.time())
    before = state.read_bytes()
    node = start(command(state_file=str(state)), ROS_DOMAIN_ID="232")
    said = [node.stderr.readline()]
    while "nobody publishes" not in said[-1]:
        assert said[-1], "".join(said)
        said.append(node.stderr.readline())
    assert "failed" not in "".join(said)
    node.stderr.close()
    other = peer.Wire(232)
    speed = other.publisher("/speed", TWIST, reliable=False)
    assert wait_for(lambda: speed.matched, working=node.pid)  # inputs are best effort by default
    other.close()
    node.send_signal(signal.SIGUSR1)
    assert wait_for(lambda: state.read_bytes() != before, working=node.pid)  # and then says so
    node.send_signal(signal.SIGTERM)
    assert exit_code(node) == 0


def test_an_environment_it_cannot_start_in_is_said_in_one_line(command, start):
    node = start(command(), CYCLONEDDS_URI="<Cyclone")
    assert exit_code(node) == 2
    log = node.stderr.read()
    assert "environment CYCLONEDDS_URI: given '<Cyclone'" in log.splitlines()[-1]
    assert "Traceback" not in log


@pytest.mark.parametrize("missing", ["cyclonedds", "rosbags"])
def test_what_is_not_installed_is_said_with_how_to_install_it(environment, missing):
    program = f"import sys; sys.modules[{missing!r}] = None; from trackres_ros.tasks.main import main; main(sys.argv[1:])"
    done = subprocess.run(
        [sys.executable, "-c", program, "live", "--transport", "dds", "--vehicle", "xgd24d"],
        env=environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2
    assert done.stderr.startswith(f"trackres: error: running without ROS 2: given 'no Python module {missing}'")
    assert f"pip install {missing}" in done.stderr
    assert ("3.10 to 3.13 on x86-64 Linux" in done.stderr) == (missing == "cyclonedds")
    assert len(done.stderr.splitlines()) == 1


def test_peer_and_node_share_nothing():
    done = subprocess.run(
        [sys.executable, "-c", "import peer, sys; print(any(name.startswith('trackres_ros') for name in sys.modules))"],
        cwd=Path(peer.__file__).parent,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "False\n"
