# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What `trackres live --record` writes is a recording: every message as it came, to be replayed and diagnosed as any other."""

import math

import numpy as np
import pytest

rosbags = pytest.importorskip("rosbags")
from rosbags.highlevel import AnyReader  # noqa: E402
from rosbags.typesys import Stores, get_typestore  # noqa: E402

import trackres_ros as tr  # noqa: E402
from trackres_ros.node.record import Recorder  # noqa: E402

START_NS, SECOND_NS = 1_700_000_000_000_000_000, 1_000_000_000
STORE = get_typestore(Stores.ROS2_JAZZY)
TWIST, WRENCH, TEMPERATURE, NUMBER = (
    "geometry_msgs/msg/TwistStamped",
    "geometry_msgs/msg/WrenchStamped",
    "sensor_msgs/msg/Temperature",
    "std_msgs/msg/Float64",
)
TOPICS = f"""
speed: {{topic: speed, type: {TWIST}, field: twist.linear.x}}
ambient: {{topic: /air, type: {TEMPERATURE}, field: temperature}}
torque: {{topic: shaft, type: {WRENCH}, field: wrench.torque.y}}
brake: {{topic: brake, type: {NUMBER}, field: data, threshold: 0.5}}
"""


def vector(x=0.0, y=0.0):
    return STORE.types["geometry_msgs/msg/Vector3"](x=x, y=y, z=0.0)


def made(kind, value, stamp_ns):
    """A message with one number."""
    types = STORE.types
    time = types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, SECOND_NS))
    header = types["std_msgs/msg/Header"](stamp=time, frame_id="hull")
    return {
        TWIST: lambda: types[TWIST](header, types["geometry_msgs/msg/Twist"](vector(x=value), vector())),
        WRENCH: lambda: types[WRENCH](header, types["geometry_msgs/msg/Wrench"](vector(), vector(y=value))),
        TEMPERATURE: lambda: types[TEMPERATURE](header, value, 0.0),
        NUMBER: lambda: types[NUMBER](value),
    }[kind]()


class Wire:
    """Passes messages to an application as a transport does, and keeps them."""

    def __init__(self, desk, path):
        self.desk, self.sent = desk, []
        desk.record = lambda others: [
            STORE.generate_msgdef(given.type, ros_version=2)[0] for given in (*desk.app.inputs, *others)
        ]
        self.recorder = Recorder(path)
        self.recorder.begin(desk.app)
        self.index = {given.name: i for i, given in enumerate(desk.app.inputs)} | {"brake": len(desk.app.inputs)}

    def send(self, name, kind, value):
        now, index = self.desk.now_ns(), self.index[name]
        raw = bytes(STORE.serialize_cdr(made(kind, value, now), kind))
        self.sent.append(("/" + name.lstrip("/"), now, raw))
        self.desk.app.keep(index, raw, self.desk.app.arrival())
        if index < len(self.desk.app.inputs):
            self.desk.app.receive(index, STORE.deserialize_cdr(raw, kind))


def driven(desk, folder, seconds, speed_of, rate_hz=10.0):
    """A drive with 1.3 times the expected torque; the desk, the sent messages, the bag, and the log."""
    (folder / "topics.yaml").write_text(TOPICS)
    d = desk(topics=str(folder / "topics.yaml"), learning="off")
    wire, noise = Wire(d, folder / "live.mcap"), np.random.default_rng(5)
    for step in range(round(seconds * rate_hz)):
        d.forward(1.0 / rate_hz)
        if step % 100 == 0:
            wire.send("/air", TEMPERATURE, 12.0)
            wire.send("brake", NUMBER, 0.0)
        if d.app.overview().values:
            expected = d.app.overview().values["drive_torque_nm"]
            wire.send("shaft", WRENCH, 1.3 * expected + 20.0 * noise.standard_normal())
        wire.send("speed", TWIST, speed_of(step / rate_hz))
    lines = wire.recorder.end()
    return d, wire, folder / "live.mcap", lines


@pytest.fixture(scope="module")
def drive(standing_desk, tmp_path_factory):
    """A minute's drive, with a second of speeds that are no numbers."""
    speed = lambda s: math.nan if 5.0 < s < 6.0 else 6.0 + 3.0 * math.sin(s / 20.0)  # noqa: E731
    return driven(standing_desk, tmp_path_factory.mktemp("drive"), 60.0, speed)


def test_every_message_is_recorded_unchanged_under_its_topic(drive):
    _, wire, bag, lines = drive
    with AnyReader([bag]) as reader:
        found = [(c.topic, log, bytes(raw)) for c, log, raw in reader.messages() if not c.topic.startswith("/trackres/")]
    assert {topic for topic, _, _ in found} == {"/speed", "/air", "/shaft", "/brake"}
    for topic in ("/speed", "/air", "/shaft", "/brake"):
        there, sent = ([(log, raw) for name, log, raw in some if name == topic] for some in (found, wire.sent))
        assert [raw for _, raw in there] == [raw for _, raw in sent]
        assert all(abs(log - at) <= 1 for (log, _), (at, _) in zip(there, sent, strict=True))
    assert "600 of /speed" in lines[0]


def test_replayed_with_the_same_topics_it_gives_the_same_torque(drive):
    d, _, bag, _ = drive
    live = {stamp: -values[0] for name, stamp, values in d.published if name == "resistance_torque"}
    replayed = tr.replay(bag, "xgd24d", topics=bag.with_name("topics.yaml"))
    assert len(replayed["resistance_torque_nm"]) == len(live) == 591
    np.testing.assert_allclose(replayed["resistance_torque_nm"], [torque for _, torque in sorted(live.items())], rtol=1e-6)
    series = tr.read(bag, topics=bag.with_name("topics.yaml")).series
    assert len(series["torque"]) == 599
    assert float(np.mean(series["torque"].value) / np.mean(replayed["drive_torque_nm"])) == pytest.approx(1.3, abs=0.05)


def test_each_round_of_simulated_time_is_a_file_of_its_own(desk, tmp_path):
    (tmp_path / "topics.yaml").write_text(TOPICS)
    d = desk(topics=str(tmp_path / "topics.yaml"), use_sim_time=True, learning="off")
    wire, last = Wire(d, tmp_path / "live.mcap"), []
    for _ in range(3):
        for _ in range(200):
            d.forward(0.02)
            wire.send("speed", TWIST, 8.0)
        last.append(d.app.overview().values["belt_degc/front_left"])
        d.time_s = 0.0
        d.app.time_went_back()
    wire.recorder.end()
    files = [tmp_path / name for name in ("live.mcap", "live_0001.mcap", "live_0002.mcap")]
    assert sorted(tmp_path.glob("*.mcap*")) == files
    for path, belt in zip(files, last, strict=True):
        replayed = tr.replay(path, "xgd24d", topics=tmp_path / "topics.yaml")
        assert len(replayed["belt_degc/front_left"]) == 200
        assert replayed["belt_degc/front_left"][-1] == pytest.approx(belt, abs=1e-6)


def test_messages_before_the_sim_clock_get_its_first_time(desk, tmp_path):
    (tmp_path / "topics.yaml").write_text(TOPICS)
    d = desk(topics=str(tmp_path / "topics.yaml"), use_sim_time=True)
    wire, clock = Wire(d, tmp_path / "live.mcap"), d.now_ns
    d.now_ns = lambda: 0
    d.app.keep(wire.index["speed"], bytes(STORE.serialize_cdr(made(TWIST, 8.0, START_NS), TWIST)), d.app.arrival())
    d.now_ns = clock
    d.forward(1.0)
    wire.send("speed", TWIST, 8.0)
    wire.recorder.end()
    with AnyReader([tmp_path / "live.mcap"]) as reader:
        times = [log for c, log, _ in reader.messages() if c.topic == "/speed"]
    assert times == [START_NS + SECOND_NS, START_NS + SECOND_NS + 1]
