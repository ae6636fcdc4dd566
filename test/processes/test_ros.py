# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The node as a person on ROS 2 meets it: by `ros2 run`'s executable, the command line, launch, lifecycle, bags."""

import json
import os
import re
import signal
import sys
from pathlib import Path

import pytest
from conftest import why_not
from peer import Wire
from ros_shell import DOMAIN, ROS2, wait
from waiting import exit_code, wait_for

if why_not("ros"):
    pytest.skip(why_not("ros"), allow_module_level=True)
if not ROS2:
    pytest.skip("the command ros2 is not on the PATH", allow_module_level=True)
PLAYER = "/rosbag2_player"


def stamp_of(message):
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


@pytest.fixture
def wire():
    """In the domain of these tests."""
    made = Wire(int(DOMAIN))
    yield made
    made.close()


NUMBER = ["/trackres/feedforward_torque_nm", "std_msgs/msg/Float64"]
SPEED = ["/speed", "geometry_msgs/msg/TwistStamped", "{header: auto, twist: {linear: {x: 8.0}}}", "-r", "50"]


def test_topics_parameters_services_and_lifecycle_as_typed(cyclone, wire):
    shell, node = cyclone, cyclone.estimator()
    shell.start(ROS2, "topic", "pub", *SPEED)
    topics = shell.ros2("topic", "list", "-t", "--no-daemon")
    for line in (
        "/trackres/feedforward_torque [geometry_msgs/msg/WrenchStamped]",
        "/trackres/feedforward_torque_nm [std_msgs/msg/Float64]",
        "/trackres/resistance_torque [sensor_msgs/msg/JointState]",
        "/trackres/track_temperature/front_left [sensor_msgs/msg/Temperature]",
        "/trackres/status [diagnostic_msgs/msg/DiagnosticArray]",
        "/diagnostics [diagnostic_msgs/msg/DiagnosticArray]",
    ):
        assert line in topics
    info = shell.ros2("topic", "info", "-v", "/trackres/feedforward_torque", "--no-daemon")
    assert "Reliability: RELIABLE" in info
    assert "Deadline: 200000000 nanoseconds" in info
    echoed = shell.ros2("topic", "echo", "--once", "/trackres/resistance_torque")
    assert "- hysteresis/rear_right" in echoed
    assert "frame_id: base_link" in echoed
    assert float(shell.ros2("topic", "echo", "--once", "--field", "data", "/trackres/feedforward_torque_nm").split()[0]) > 1000.0

    assert "gap_s" in shell.ros2("param", "list", "/trackres")
    described = shell.ros2("param", "describe", "/trackres", "gap_s")
    assert "a longer pause in the speed is reported as a gap [s]" in described
    assert "Max value: 60.0" in described
    assert "successful" in shell.ros2("param", "set", "/trackres", "gap_s", "2")
    assert "2" in shell.ros2("param", "get", "/trackres", "gap_s")
    for name, value, said in (
        ("gap_s", "-1.0", "0.05"),
        ("vehicle", "agri3t", "reconfigure the node"),
        ("gap_s", ".nan", "0.05"),
    ):
        assert said in shell.ros2("param", "set", "/trackres", name, value, check=False)
    assert "feedforward_parts" in shell.ros2("param", "dump", "/trackres")

    assert "success=True" in shell.ros2("service", "call", "/trackres/reset", "std_srvs/srv/Trigger")
    assert "success=False" in shell.ros2("service", "call", "/trackres/save_state", "std_srvs/srv/Trigger")

    assert "active" in shell.ros2("lifecycle", "get", "/trackres")
    fed, said = wire.subscribe(*NUMBER), wire.subscribe("/trackres/status", "diagnostic_msgs/msg/DiagnosticArray")
    for transition in ("deactivate", "activate", "deactivate", "cleanup", "configure", "activate", "shutdown"):
        if transition in ("deactivate", "shutdown"):
            wait(lambda: fed.update() and fed.heard[-1].message.data > 1000.0, node)
        assert "successful" in shell.ros2("lifecycle", "set", "/trackres", transition)
        if transition in ("deactivate", "shutdown"):
            wait(lambda: fed.update() and fed.heard[-1].message.data == 0.0, node)
            wait(lambda: "the node is deactivated or ends" in said.update()[-1].message.status[0].message, node)
    assert "Traceback" not in node.said()
    assert shell.end(node) == 0


def test_a_bad_start_ends_with_code_2_or_waits_to_be_configured(cyclone):
    bad = cyclone.begin_estimator(vehicle="nonsense")
    assert exit_code(bad) == 2
    assert "one of agri3t, xgd24d" in bad.said() or "xgd24d" in bad.said()
    assert "Traceback" not in bad.said()
    for name, value in (("gap_s", "1e9"), ("qos_overrides./speed.subscription.reliability", "perhaps")):
        bad = cyclone.begin_estimator("-p", f"{name}:={value}")
        assert exit_code(bad) == 2
        assert name in bad.said()
        assert "allowed: " in bad.said()
        assert "Traceback" not in bad.said()
    waiting = cyclone.begin_estimator("-p", "autostart:=false", vehicle="nonsense")
    wait(lambda: "/trackres" in cyclone.ros2("node", "list", "--no-daemon"))
    assert "successful" not in cyclone.ros2("lifecycle", "set", "/trackres", "configure", check=False)
    assert "successful" in cyclone.ros2("param", "set", "/trackres", "vehicle", "xgd24d")
    assert "successful" in cyclone.ros2("lifecycle", "set", "/trackres", "configure")
    assert "inactive" in cyclone.ros2("lifecycle", "get", "/trackres")
    assert cyclone.end(waiting, signal.SIGTERM) == 0


@pytest.mark.long
def test_a_bag_played_live_gives_the_offline_replays_numbers(cyclone, repository, wire):
    from trackres_ros.estimator.estimator import Estimator
    from trackres_ros.recording.bindings import Topics
    from trackres_ros.recording.opening import open_source
    from trackres_ros.tasks.record_sample import write_sample
    from trackres_ros.tasks.replay_run import replay
    from trackres_ros.vehicle import load

    bag, topics = cyclone.folder / "laps.mcap", repository / "config" / "topics" / "sample.yaml"
    vehicle = load("xgd24d")
    write_sample(bag, vehicle, speed_kmh=40.0, laps_driven=1)
    rows, estimator = {}, Estimator(vehicle)
    offline = replay(
        open_source([bag], Topics.load(topics)),
        estimator,
        lambda steps: rows.update(zip(steps.stamp_ns.tolist(), steps.rows, strict=True)),
    )
    sent, last = {role: number for role, _, number in offline.session.counts()}, max(rows)
    ours = wire.subscribe("/trackres/resistance_torque", "sensor_msgs/msg/JointState")
    given = {"topics": topics, "use_sim_time": "true", "output_rate_hz": 0.0}
    given |= {"input_reliability": "reliable", "input_depth": 10000.0, "output_depth": 10000.0}
    index = estimator.column_index["resistance_torque_nm"]
    # Until the player and the machine lose nothing, and no topic overtakes another, of which no middleware gives a promise: the
    # belts remember every message.
    for attempt in range(4):
        node = cyclone.estimator(*(word for name, value in given.items() for word in ("-p", f"{name}:={value}")))
        out = cyclone.folder / f"out{attempt}"
        record = cyclone.start(ROS2, "bag", "record", "-s", "mcap", "-o", str(out), "/trackres/resistance_torque")
        wait(lambda: "Subscribed to topic '/trackres/resistance_torque'" in record.said(), record)  # noqa: B023
        # Paused, not delayed: in a delay the player's clock runs on, to jump back when it ends, and the estimate starts anew.
        paused = ["--clock", "100", "--rate", "5", "--start-paused", "--disable-keyboard-controls"]
        play = cyclone.start(ROS2, "bag", "play", str(bag), *paused)
        wait(lambda: PLAYER in cyclone.ros2("node", "list"), play)
        cyclone.ros2("service", "call", f"{PLAYER}/resume", "rosbag2_interfaces/srv/Resume")
        assert exit_code(play, 120.0) == 0
        # Where messages were lost the last may be among them, and the bag is played once more.
        wait_for(lambda: ours.update() and stamp_of(ours.heard[-1].message) == last, patience_s=5.0)
        assert cyclone.end(record) == 0
        assert cyclone.end(node) == 0
        off = [abs(torque - rows[stamp][index]) / max(1.0, abs(torque)) for stamp, torque in recorded(out)]
        whole = all(f"{role} accepted {number}" in node.said() for role, number in sent.items())
        if whole and len(off) > 0.99 * len(rows) and max(off) <= 1e-9:
            break
    else:
        pytest.fail(f"off by {max(off, default=1.0):g}, {len(off)} of {len(rows)}; {node.said()}")


def recorded(bag):
    """Stamp and resistance torque [Nm] of each estimate in a recorded bag, the first of a stamp."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    found = {}
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            found.setdefault(stamp_of(message), -message.effort[0])
    return found.items()


def test_launch_starts_it(launcher):
    assert "trackres_ros" in launcher.ros2("pkg", "list")
    assert {"estimator", "trackres"} <= set(launcher.ros2("pkg", "executables", "trackres_ros").split())
    launch = launcher.start(
        ROS2, "launch", "trackres_ros", "trackres.launch.py", "vehicle:=xgd24d", "namespace:=left", "use_sim_time:=true"
    )
    wait(lambda: "24 t chassis" in launch.said(), launch)
    assert "/left/trackres" in launcher.ros2("node", "list", "--no-daemon")


def test_launch_testing_finds_it_well_while_it_runs_and_after(launcher):
    pytest.importorskip("launch_testing", reason="ros-jazzy-launch-testing or lark is not installed")
    tests = Path(__file__).with_name("launched.py")
    program = "import sys; from launch_testing.launch_test import main; sys.exit(main())"
    run = launcher.start(sys.executable, "-c", program, str(tests))
    assert exit_code(run, 400.0) == 0, run.said()
    assert "OK" in run.said()


def test_the_edge_without_ros_is_seen_by_ros(shell):
    params = shell.folder / "p.yaml"
    params.write_text(json.dumps({"vehicle": "xgd24d", "state_file": "none"}))
    node = shell.without_ros("--params", str(params))
    shell.start(ROS2, "topic", "pub", *SPEED)
    wait(lambda: "/trackres" in shell.ros2("node", "list", "--no-daemon"))
    wait(lambda: "/trackres/resistance_torque [sensor_msgs/msg/JointState]" in shell.ros2("topic", "list", "-t", "--no-daemon"))
    assert float(shell.ros2("topic", "echo", "--once", "--field", "data", *NUMBER).split()[0]) > 1000.0
    hz = shell.start(ROS2, "topic", "hz", "/trackres/feedforward_torque")
    wait(lambda: "average rate" in hz.said(), hz)
    assert 25.0 < float(hz.said().split("average rate:")[1].split()[0]) < 75.0
    assert shell.end(node) == 0


# What `ros2 topic info -v` says of each topic, in one process for all: of the node's endpoints, once they are all there.
OFFERED = """
import json, sys, rclpy
from waiting import wait_for
rclpy.init()
node = rclpy.create_node("looker")
def look():
    found.clear()
    for topic, kinds in node.get_topic_names_and_types():
        ends = [*node.get_publishers_info_by_topic(topic), *node.get_subscriptions_info_by_topic(topic)]
        mine = [end for end in ends if end.node_name == "trackres"]
        if ("/trackres/" in topic or topic in ("/speed", "/load", "/ambient")) and "transition_event" not in topic and mine:
            said = [(e.endpoint_type, e.topic_type_hash, e.qos_profile) for e in mine]
            found[f"{topic} {kinds}"] = sorted(
                f"{end.name} {hash} {q.reliability.name} {q.history.name} {q.durability.name} {q.deadline.nanoseconds}"
                for end, hash, q in said
            )
    return len(found) >= int(sys.argv[1])
found = {}
wait_for(look)
print(json.dumps(found))
"""


def test_both_edges_offer_the_same(cyclone):
    cyclone.environment["PYTHONPATH"] = os.pathsep.join([str(Path(__file__).parent), cyclone.environment.get("PYTHONPATH", "")])

    def offered(process):
        looked = cyclone.start(sys.executable, "-c", OFFERED, "12")
        assert exit_code(looked) == 0, looked.said()
        assert process.poll() is None
        return json.loads(looked.said().splitlines()[-1])

    ros = cyclone.estimator()
    on_ros = offered(ros)
    cyclone.end(ros)
    dds = cyclone.without_ros("--vehicle", "xgd24d", "-p", "state_file:=none")
    assert offered(dds) == on_ros
    assert len(on_ros) == 12
    assert all("RIHS01" in said for ends in on_ros.values() for said in ends)


ORDERS = """
import rclpy
from lifecycle_msgs.srv import ChangeState
from trackres_ros.node.parameters import make_parameters
from trackres_ros.node.ros.node import EstimatorNode
rclpy.init()
node = EstimatorNode(make_parameters({"vehicle": "xgd24d", "state_file": "none"}))
made = []
node.configured = made.append
serve = next(service.callback for service in node.services if service.srv_type is ChangeState)
def ask(transition):
    request = ChangeState.Request()
    request.transition.id = transition
    return serve(request, ChangeState.Response()).success
print(*map(ask, [3, 99, 1, 1, 3, 1, 2, 4, 4, 2, 2]))
def fail():
    raise OSError("no disk")
ask(1)
node.application.activate = fail
print(ask(3), node.failure)
print(len(set(made)), "applications are handed over")
"""


def test_a_lifecycle_request_out_of_order_is_refused(cyclone):
    asked = cyclone.start(sys.executable, "-c", ORDERS)
    assert exit_code(asked) == 0, asked.said()
    in_order = "False False True False True False False True False True False"
    assert in_order in asked.said()
    assert "False OSError: no disk" in asked.said()
    assert "2 applications are handed over" in asked.said()


def test_two_nodes_in_one_process(cyclone):
    program = """
import rclpy
from rclpy.executors import SingleThreadedExecutor
from trackres_ros.node.parameters import make_parameters
from trackres_ros.node.ros.node import EstimatorNode
rclpy.init()
executor = SingleThreadedExecutor()
values = make_parameters({"vehicle": "xgd24d", "state_file": "none"})
nodes = [EstimatorNode(values, namespace=name) for name in ("left", "right")]
for node in nodes:
    executor.add_node(node)
    node.trigger_configure()
    node.trigger_activate()
print("both are there", flush=True)
executor.spin()
"""
    process = cyclone.start(sys.executable, "-c", program)
    wait(lambda: "both are there" in process.said(), process)
    cyclone.start(ROS2, "topic", "pub", "/left/speed", *SPEED[1:])
    assert "y: " in cyclone.ros2("topic", "echo", "--once", "/left/trackres/feedforward_torque")
    topics = cyclone.ros2("topic", "list", "--no-daemon")
    assert "/left/trackres/status" in topics
    assert "/right/trackres/status" in topics


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_the_example_of_the_docs_ends_at_zero_torque_and_saves(cyclone, repository, wire, how):
    (example,) = re.findall(r"```python\n(.+?)```", (repository / "docs" / "node.md").read_text(), re.DOTALL)
    fed = wire.subscribe(*NUMBER)
    node = cyclone.start(sys.executable, "-c", example)
    cyclone.start(ROS2, "topic", "pub", *SPEED)
    wait(lambda: fed.update() and fed.heard[-1].message.data > 1000.0, node)
    assert cyclone.end(node, how) == 0, node.said()
    wait(lambda: fed.update()[-1].message.data == 0.0)
    assert "state saved in " in node.said()


def test_a_node_destroyed_after_rclpy_is_shut_down_saves(cyclone):
    program = """
import rclpy
from trackres_ros.node.parameters import make_parameters
from trackres_ros.node.ros.node import EstimatorNode
rclpy.init()
node = EstimatorNode(make_parameters({"vehicle": "xgd24d"}))
node.trigger_configure()
node.trigger_activate()
node.application.messages.receive_values(len(node.application.inputs) - 1, None, [8.0])  # the speed
rclpy.shutdown()
node.destroy_node()
node.destroy_node()
"""
    process = cyclone.start(sys.executable, "-c", program)
    assert exit_code(process) == 0, process.said()
    assert "state saved in " in process.said()
