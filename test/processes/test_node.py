# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A node process and independent peers: it gives the same as an offline session, and keeps it over restarts."""

import itertools
import json
import random
import resource
import shutil
import signal
import time
from pathlib import Path

import numpy as np
import pytest
from conftest import DEFAULT_TOPICS, Node
from ros_messages import STORE, build, fill, stamped
from rosbags.rosbag2 import StoragePlugin, Writer
from waiting import exit_code

from trackres_ros.estimator import columns as at
from trackres_ros.estimator.columns import Belt
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.settings import Settings, settings_for
from trackres_ros.estimator.snapshot import after_time_off
from trackres_ros.output.topics import output_topics, values_of
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.opening import open_source
from trackres_ros.route.learned import SLOPE, TORQUE, RouteMap
from trackres_ros.route.table import write_route
from trackres_ros.route.track import Frame
from trackres_ros.tasks.replay_run import replay
from trackres_ros.vehicle import load, load_any, with_surroundings

SECOND_NS = 1_000_000_000
START_NS = 1_700_000_000 * SECOND_NS
AT_ONCE = 1e9  # Nm/s: how the feed-forward moves from output to output hangs on when they come
FIX, WRENCH = "sensor_msgs/msg/NavSatFix", "geometry_msgs/msg/WrenchStamped"


class Simulated:
    """Simulated time: a clock that we set, and messages stamped with it."""

    def __init__(self, node):
        self.node, self.now_ns, self.sent = node, START_NS, []
        self.clock = node.wire.publisher("/clock", "rosgraph_msgs/msg/Clock")
        node.until(lambda: self.clock.matched, "the clock to connect")
        node.sees_its_publishers(lambda: self.to(START_NS))

    def to(self, now_ns):
        """Set the clock."""
        self.now_ns = now_ns
        self.clock.publish(clock={"sec": now_ns // SECOND_NS, "nanosec": now_ns % SECOND_NS})

    def drive(self, steps, speed=8.0, dt_ns=SECOND_NS // 10):
        """Speeds every dt, loads and ambient temperatures between them, at half a step's distance; each speed is worked off."""
        for step in range(steps):
            self.to(self.now_ns + dt_ns // 2)
            if step % 5 == 0:
                self.message("load", 272e3 + 1e3 * (step % 3))
                self.message("ambient", 15.0 + step % 2)
            self.to(self.now_ns + dt_ns // 2)
            self.message("speed", speed + 0.1 * (step % 11))
            self.worked_off()

    def message(self, role, value):
        """A message at the time of the clock."""
        self.sent.append((role, self.now_ns, value))
        self.node.send(role, value, self.now_ns)

    def worked_off(self):
        """Wait until the speed sent last has made an output: then all that was sent before is worked off too."""
        heard = self.node.out["belt" if self.node.has_belts else "resistance"]  # what comes last
        self.node.until(lambda: heard.update() and stamp_ns(heard.heard[-1].message) == self.now_ns, "the output of a speed")


def stamp_ns(message):
    return message.header.stamp.sec * SECOND_NS + message.header.stamp.nanosec


@pytest.fixture
def simulated(node):
    def start(**given):
        return Simulated(node(use_sim_time=True, output_rate_hz=0.0, **given))

    return start


MEASURED = DEFAULT_TOPICS + "torque: {topic: torque, type: geometry_msgs/msg/WrenchStamped, field: wrench.torque.y}\n"
TOPICS_ON_ROUTE = MEASURED + "position: {topic: fix, type: sensor_msgs/msg/NavSatFix, max_age_s: 7.3}\n"
STREET_M, LATITUDE, LONGITUDE = 1200.0, 0.827, 0.1486
LOST, ASIDE = range(10, 20), range(48, 56)  # seconds without a fix, and off the street


def a_street(folder, vehicle):
    """Surroundings with a street to the east: hills, and soft ground on a part of it."""
    way = np.arange(0.0, STREET_M + 1.0, 20.0)
    latitude, longitude = Frame(LATITUDE, LONGITUDE).position(way, np.zeros_like(way))
    slope, soft = 0.03 * np.sin(way / 80.0), np.where((way > 250.0) & (way < 700.0), 800.0, 0.0)
    pose, passes = (latitude, longitude, np.zeros_like(way)), np.full(len(way), 4)
    both = [
        RouteMap(SLOPE, *pose, np.stack([slope, -slope], axis=1), np.full((len(way), 2), 0.002), passes),
        RouteMap(TORQUE, *pose, np.stack([soft, soft], axis=1), np.full((len(way), 2), 60.0), passes),
    ]
    write_route(folder / "route.csv", both)
    path = folder / "surroundings.yaml"
    path.write_text(f"schema: 1\nvehicle: {vehicle}\nroute: route.csv\neffects: {{}}\n")
    return path


def along_the_street(seconds):
    """Topic, type and fields of each message of a drive, and when it is sent [ns]: two speeds a second, and a position."""
    for half in range(2 * seconds):
        now, way, second = START_NS + half * SECOND_NS // 2, 8.0 * 0.5 * half, half // 2
        header = stamped(now)
        if half % 2 == 0:
            aside = 300.0 if second in ASIDE else 4.0 * np.sin(0.2 * second)
            latitude, longitude = np.degrees(Frame(LATITUDE, LONGITUDE).position(way, aside))
            fix = {"status": -1 if second in LOST else 0, "service": 1}
            yield now, "fix", FIX, {"header": header, "status": fix, "latitude": float(latitude), "longitude": float(longitude)}
            yield now, "load", "std_msgs/msg/Float64", {"data": 272e3}
        torque = {"torque": {"x": 0.0, "y": 3000.0, "z": 0.0}}
        yield now, "torque", "geometry_msgs/msg/WrenchStamped", {"header": header, "wrench": torque}
        twist = {"linear": {"x": 8.0 + 0.01 * (half % 7), "y": 0.0, "z": 0.0}}
        yield now, "speed", "geometry_msgs/msg/TwistStamped", {"header": header, "twist": twist}


def recorded(path, messages, namespace):
    """A bag of messages."""
    rows = (
        (f"{namespace}/{topic}", kind, now + i, bytes(STORE.serialize_cdr(build(kind, **fields), kind)))
        for i, (now, topic, kind, fields) in enumerate(messages)
    )
    fill(Writer(path, version=9, storage_plugin=StoragePlugin.MCAP), rows)
    return path


def outputs_of(vehicle):
    """The node's subscriptions that a vehicle has, the topic of each, and the numbers of a message."""
    numbers = {
        "feedforward_torque": ("feedforward", lambda m: [m.wrench.torque.y]),
        "resistance_torque": ("resistance", lambda m: m.effort),
        "track_temperature/front_left": ("belt", lambda m: [m.temperature, m.variance]),
    }
    return [(numbers[t.name][0], t, numbers[t.name][1]) for t in output_topics(vehicle) if t.name in numbers]


@pytest.mark.parametrize("vehicle", ["xgd24d", "ztbus_hess19"])
def test_a_drive_with_positions_gives_the_same_live_and_replayed(node, tmp_path, repository, vehicle):
    surroundings, messages = a_street(tmp_path, vehicle), list(along_the_street(60))
    tracked = vehicle == "xgd24d"
    if tracked:  # with what a diagnosis has found
        text = (repository / "config" / "xgd24d.yaml").read_text().replace("rubber/", f"{repository}/config/rubber/")
        vehicle = str(tmp_path / "found.yaml")
        Path(vehicle).write_text(f"{text}\neffects:\n  vibration: {{torque: 650.0, speed: 8.0, width: 1.5}}\n")
    bag = recorded(tmp_path / "bag", messages, "/alone")
    topics = tmp_path / "of_the_bag.yaml"
    lines = [line for line in TOPICS_ON_ROUTE.splitlines() if not line.startswith("ambient")]  # which is not recorded
    topics.write_text("\n".join(lines).replace("topic: ", "topic: /alone/"))
    read = Topics.load(topics)
    settings = settings_for(Settings(feedforward_rate=AT_ONCE), read)
    estimator, rows = Estimator(with_surroundings(load_any(vehicle), surroundings), settings), {}
    replay(
        open_source([bag], read),
        estimator,
        lambda steps: rows.update(zip(steps.stamp_ns.tolist(), steps.rows.copy(), strict=True)),
    )
    reasons = np.array([int(row[at.Results.reasons]) for row in rows.values()])
    effects = np.array([row[at.Results.effects_nm] for row in rows.values()])
    gears = 0.0 if tracked else max(row[at.Results.drive_torque_nm] for row in rows.values()) * 0.05
    assert 799.0 + 640.0 * tracked < effects.max() < 801.0 + 650.0 * tracked + gears  # the drive has all there is to see
    assert 0.1 < np.mean(reasons & at.Reason.OFF_ROUTE > 0) < 0.6
    assert 0.05 < np.mean(reasons & at.Reason.PLACE_UNKNOWN > 0) < 0.5

    given = {"topics": TOPICS_ON_ROUTE, "surroundings": str(surroundings), "feedforward_rate": AT_ONCE, "vehicle": vehicle}
    n = node(use_sim_time=True, output_rate_hz=0.0, input_reliability="reliable", **given)
    more = {name: n.wire.publisher(f"/alone/{name}", kind) for name, kind in (("fix", FIX), ("torque", WRENCH))}
    residual = n.wire.subscribe(f"{n.base}/torque_residual", "sensor_msgs/msg/JointState")
    n.until(lambda: all(one.matched for one in more.values()) and residual.matched, "fix and torque to connect")
    sim = Simulated(n)
    publishers, notices = {**n.inputs, **more}, set()
    for now, topic, _, fields in messages:
        sim.to(now)
        publishers[topic].publish(**fields)
        if topic == "speed":
            sim.worked_off()
            notices |= n.last_remarks()
        else:
            publishers[topic].delivered()  # no middleware promises that one topic overtakes no other
    n.until(lambda: stamp_ns(residual.update()[-1].message) == sim.now_ns, "the last residual")
    for out, about, numbers in outputs_of(estimator.vehicle):
        heard = {stamp_ns(h.message): numbers(h.message) for h in reversed(n.out[out].update())}  # the first of each
        assert len(set(heard) & set(rows)) >= len(rows) - 1
        for stamp, found in heard.items():
            wanted = values_of(about, rows[stamp][np.newaxis], estimator.column_index)[0]
            np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-9)
        if out == "resistance":
            assert tuple(n.out[out].heard[-1].message.name) == about.names
    for stamp, torque in {stamp_ns(h.message): h.message.effort[1] for h in residual.heard}.items():
        assert torque == pytest.approx(rows[stamp][at.Results.drive_torque_nm], rel=1e-9)
    assert {"SURROUNDINGS", "OFF_ROUTE", "PLACE_UNKNOWN"} <= notices
    assert int(n.values("input latitude")["non_finite"]) > 0.5 * len(LOST)


def test_a_bag_that_loops_starts_anew_each_time(simulated):
    sim = simulated()
    node = sim.node
    for _ in range(2):
        sim.now_ns = START_NS
        sim.drive(50, dt_ns=2 * SECOND_NS // 5)
    node.until(lambda: "TIME_RESET" in node.notices(), "the notice")
    stamps = [stamp_ns(h.message) for h in node.out["belt"].update()]
    assert sum(b < a for a, b in itertools.pairwise(stamps)) == 1
    rounds = np.split(np.array([h.message.temperature for h in node.out["belt"].heard]), [int(np.argmin(np.diff(stamps))) + 1])
    assert rounds[1][0] == pytest.approx(rounds[0][0], abs=0.05)
    assert rounds[1][-1] == pytest.approx(rounds[0][-1], rel=1e-3)


def test_belts_outlive_a_restart(simulated, tmp_path):
    state = tmp_path / "state.json"
    sim = simulated(state_file=str(state))
    sim.drive(150, speed=15.0, dt_ns=2 * SECOND_NS // 5)
    belt = sim.node.out["belt"].update()[-1].message.temperature
    assert belt > 16.0  # the air has 15 degC at the start
    assert sim.node.stop(signal.SIGTERM) == 0
    sim.node.close()
    kept = tmp_path / "kept.json"
    shutil.copy(state, kept)
    begun = time.time()
    again = simulated(state_file=str(state))
    again.node.until(lambda: "belts restored from" in again.node.log, "the restart")
    warmest, coolest = (cooled(kept, moment) for moment in (begun, time.time()))  # the machine may take its time to start it
    assert coolest <= warmest <= belt + 0.05
    again.node.until(lambda: again.node.out["belt"].update(), "a temperature", meanwhile=lambda: again.drive(1))
    assert coolest - 0.05 < again.node.out["belt"].update()[-1].message.temperature < warmest + 0.3  # it has driven a little


def cooled(state, now):
    """Temperature [degC] of the first belt at a time [s since 1970] after the file of its state was written."""
    session, _ = after_time_off(Estimator(load("xgd24d")), state, now)
    return float(session.belts[0, 0, Belt.temperature])


def test_killed_at_any_moment_the_state_file_is_whole_and_used(node, tmp_path):
    state = tmp_path / "state.json"
    state.write_text('{"format": "trackres-state", "ver')
    n = node(state_file=str(state), save_period_s=1.0)
    n.until(lambda: "damaged" in n.log, "the reason")
    n.noticed("STATE_NOT_USED")
    n.drive(1.2 + random.Random(3).random())
    n.until(lambda: '"vehicle"' in state.read_text(), "a saved state")
    n.stop(signal.SIGKILL)
    n.close()
    assert json.loads(state.read_text())["vehicle"] == "xgd24d"
    n = node(state_file=str(state))
    n.until(lambda: "belts restored from" in n.log, "the restart")
    assert not list(tmp_path.glob("state.json*.part"))


def test_a_disk_that_takes_no_more_is_said_and_stops_nothing(node, tmp_path):
    state = tmp_path / "state.json"
    n = node(state_file=str(state), save_period_s=1.0, preexec=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (3000, 3000)))
    n.noticed("STATE_NOT_SAVED", meanwhile=lambda: n.drive(0.3))
    count = len(n.torques())
    n.until(lambda: len(n.torques()) > count, "torques going on", meanwhile=lambda: n.drive(0.3))


def test_a_parameter_out_of_range_ends_it_with_one_line(transport, tmp_path, wire):
    n = Node(transport, tmp_path, wire, gap_s=1e9)
    assert exit_code(n.process) == 2
    assert "gap_s" in n.log
    assert "a number from 0.05 to 60 s" in n.log
    assert "Traceback" not in n.log
    n.close()


def test_a_measured_torque_gives_residual_and_mismatch(node):
    n = node(topics=MEASURED, use_sim_time=True, output_rate_hz=0.0, mismatch_hold_s=20.0)
    torque = n.wire.publisher("/alone/torque", "geometry_msgs/msg/WrenchStamped")
    residual = n.wire.subscribe(f"{n.base}/torque_residual", "sensor_msgs/msg/JointState")
    n.until(lambda: torque.matched and residual.matched, "the torque to connect")
    sim = Simulated(n)
    noise = random.Random(1)
    for step in range(300):
        sim.to(sim.now_ns + 2 * SECOND_NS // 5)
        torque.publish(
            header=stamped(sim.now_ns),
            wrench={
                "torque": {"x": 0.0, "y": 4500.0 + noise.gauss(0.0, 100.0), "z": 0.0},
                "force": {"x": 0.0, "y": 0.0, "z": 0.0},
            },
        )
        if step % 5 == 0:
            sim.message("load", 272e3)
            sim.message("ambient", 15.0)
        sim.message("speed", 8.0 + 0.001 * (step % 5))
        sim.worked_off()
    n.noticed("MISMATCH", meanwhile=lambda: sim.drive(5))
    status = next(s for s in reversed(n.statuses()) if "above the expected" in s.message)
    assert "trackres diagnose RECORDING --vehicle xgd24d" in status.message
    parted = lambda: n.values("comparison").get("parted") == "true"  # noqa: E731
    n.until(parted, "the mismatch in the diagnostics, once a second", meanwhile=lambda: sim.drive(5))
    last = residual.update()[-1].message
    measured, expected, difference = last.effort
    assert list(last.name) == ["measured", "expected", "residual"]
    assert difference == pytest.approx(measured - expected)


def test_without_ros_its_parameter_file_is_watched(tmp_path, wire):
    n = Node("dds", tmp_path, wire).started()
    try:
        n.drive(0.3)
        n.until(lambda: n.torques()[-1] > 1000.0, "the feed-forward", meanwhile=lambda: n.drive(0.3))
        file = tmp_path / "trackres.json"
        for share, bound in ((0.001, 0.001 * 272e3 * 0.36), (0.1, None)):
            file.write_text(json.dumps({**n.parameters, "feedforward_share": share, "stuck_s": 60.0}))
            n.until(lambda share=share: f"-> {share:g}" in n.log, "the change", meanwhile=lambda: n.drive(0.3))
            if bound:
                n.until(lambda bound=bound: n.torques()[-1] <= bound + 1e-6, "the bound", meanwhile=lambda: n.drive(0.3))
                count = len(n.torques())
                n.drive(0.5)
                assert all(torque <= bound + 1e-6 for torque in n.torques()[count:])
        n.check_outputs()
        # On and off are true and false in YAML. A line that is refused is reported and stops no other.
        refused = {"vehicle": "agri3t", "gap_s": -1.0, "gap": 2.0}
        file.write_text(json.dumps({**n.parameters, **refused, "learning": True, "feedforward_share": 0.002}))
        n.until(lambda: "-> 0.002" in n.log, "the change")
        assert "learning watch -> on" in n.log
        assert all(f"refused, and left as it was: parameter {name}" in n.log for name in ("vehicle", "gap_s"))
        assert "did you mean gap_s?" in n.log
        assert n.stop() == 0
    finally:
        n.close()


UNSIGNED = """
speed: {topic: speed, type: geometry_msgs/msg/TwistStamped, field: twist.linear.x,
  valid: {topic: sound, type: std_msgs/msg/Bool, field: data}}
direction: {topic: gear, type: std_msgs/msg/UInt8, field: data, values: {forward: [1, 2], reverse: 9, neutral: 0}}
load: {topic: load, type: std_msgs/msg/Float64, field: data}
ambient: {topic: ambient, type: sensor_msgs/msg/Temperature, field: temperature}
"""


def test_an_unsigned_speed_in_reverse_is_fed_backwards(node, wire):
    n = node(topics=UNSIGNED)
    gear, sound = wire.publisher("/alone/gear", "std_msgs/msg/UInt8"), wire.publisher("/alone/sound", "std_msgs/msg/Bool")
    n.until(lambda: gear.matched and sound.matched, "both to connect")

    def drive(flag, holds):
        gear.publish(data=flag)
        sound.publish(data=holds)
        n.drive(0.2)

    n.until(lambda: min(n.torques(), default=0.0) < -2000.0, "a torque backwards", meanwhile=lambda: drive(9, True))
    assert max(n.torques()) <= 0.0
    n.until(lambda: n.torques()[-1] == 0.0, "no torque", meanwhile=lambda: drive(9, False))
    assert "invalid" in n.values("input speed")
    n.until(lambda: n.torques()[-1] > 2000.0, "a torque forward", meanwhile=lambda: drive(2, True))
