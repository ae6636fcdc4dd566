# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What `trackres live --record` writes is a recording: every message as it came, to be replayed and diagnosed as any other."""

import errno
import json
import math
import os
import random
import struct
from collections import deque
from functools import partial

import numpy as np
import pytest

rosbags = pytest.importorskip("rosbags")
from ros_messages import STORE, build, stamped, twist  # noqa: E402
from rosbags.highlevel import AnyReader  # noqa: E402

import trackres_ros as tr  # noqa: E402
from trackres_ros.estimator.columns import LOAD  # noqa: E402
from trackres_ros.node import inputs  # noqa: E402
from trackres_ros.node import record as record_room  # noqa: E402
from trackres_ros.node.inputs import Inbox, Sent  # noqa: E402
from trackres_ros.node.record import Recorder  # noqa: E402
from trackres_ros.node.transport import Peer  # noqa: E402

AT_ONCE = 1e9  # Nm/s: how the feed-forward moves from output to output hangs on when they come
START_NS, SECOND_NS = 1_700_000_000_000_000_000, 1_000_000_000
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


def made(kind, value, stamp_ns):
    """A message with one number."""
    fields = {TWIST: {"twist": twist(value)}, WRENCH: {"wrench": {"torque": {"y": value}}}, TEMPERATURE: {"temperature": value}}
    return build(kind, header=stamped(stamp_ns, "hull"), **fields.get(kind, {"data": value}))


def messages_of(bag):
    """Topic, log time and bytes of each message of the inputs in a bag."""
    with AnyReader([bag]) as reader:
        return [(c.topic, log_ns, bytes(raw)) for c, log_ns, raw in reader.messages() if not c.topic.startswith("/trackres/")]


class Wire:
    """Passes messages to an application as a transport does, and keeps them."""

    def __init__(self, desk, path, recorder=None):
        self.desk, self.sent = desk, []
        desk.record = lambda others: [STORE.generate_msgdef(item.type, ros_version=2)[0] for item in (*desk.app.inputs, *others)]
        self.recorder = recorder or Recorder(path)
        self.recorder.begin(desk.app)
        self.index = {item.name: i for i, item in enumerate(desk.app.inputs)} | {"brake": len(desk.app.inputs)}

    def send(self, name, kind, value):
        time_now, index = self.desk.now_ns(), self.index[name]
        raw = bytes(STORE.serialize_cdr(made(kind, value, time_now), kind))
        self.sent.append(("/" + name.lstrip("/"), time_now, raw))
        if index < len(self.desk.app.inputs):
            self.desk.app.messages.receive(index, STORE.deserialize_cdr(raw, kind), raw=raw)
        else:
            self.desk.app.messages.keep(index, raw)


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
            expectation = d.app.overview().values["drive_torque_nm"]
            wire.send("shaft", WRENCH, 1.3 * expectation + 20.0 * noise.standard_normal())
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
    result = messages_of(bag)
    assert {topic for topic, _, _ in result} == {"/speed", "/air", "/shaft", "/brake"}
    for topic in ("/speed", "/air", "/shaft", "/brake"):
        there, sent_message = ([(log, raw) for name, log, raw in some if name == topic] for some in (result, wire.sent))
        assert [raw for _, raw in there] == [raw for _, raw in sent_message]
        assert all(abs(log - place) <= 3 for (log, _), (place, _) in zip(there, sent_message, strict=True))
    assert "600 of /speed" in lines[0]


def in_haste(wire, depth, chance, unknown=1 / 3):
    """Passes messages on as a transport whose process pauses now and then: the middleware holds a queue for each topic.

    Of a share of them it does not know the time of sending.
    """
    app = wire.desk.app
    queues = [deque() for _ in app.inputs]

    def publish(name, kind, value):
        time_now = wire.desk.now_ns()
        raw = bytes(STORE.serialize_cdr(made(kind, value, time_now), kind))
        queues[wire.index[name]].append((raw, kind, time_now + len(wire.sent)))
        wire.sent.append((f"/{name}", time_now, raw))

    def take(queue):
        while queue:
            yield queue.popleft()
            wire.desk.steady_s += 1e-5
            wire.desk.time_s += 0.0 if wire.desk.sim_time else 1e-5  # a simulated clock stands still between its ticks

    def hand(index, message, arrived):
        raw, kind, sent_ns = message
        app.messages.receive(index, STORE.deserialize_cdr(raw, kind), Sent(sent_ns * (chance.random() >= unknown)), arrived, raw)

    inbox = Inbox([partial(take, queue) for queue in queues], hand, app.clock.arrival, app.messages.count_drop, depth)

    def work():
        inbox.collect()
        inbox.work_off(app.tick, collecting=True)

    return publish, work


@pytest.mark.parametrize("simulated", [False, True])
def test_inputs_sent_back_to_back_replay_as_live(desk, tmp_path, simulated):
    load = f"load: {{topic: scale, type: {NUMBER}, field: data}}\n"
    d = desk(TOPICS + load, learning="off", use_sim_time=simulated, input_depth=1000)
    wire, chance, rows = Wire(d, tmp_path / "live.mcap"), random.Random(4), {}
    record = d.app.on_estimate
    d.app.on_estimate = lambda row, stamp, arrival: (rows.update({stamp: row}), record(row, stamp, arrival))
    publish, work = in_haste(wire, 1000, chance)
    for step in range(300):
        d.forward(0.02, tick=False)
        publish("scale", NUMBER, 240e3 + 2e4 * math.sin(0.1 * step))
        publish("shaft", WRENCH, 3000.0 + 500.0 * math.sin(0.3 * step))
        publish("speed", TWIST, min(0.1 * step, 5.0))
        if chance.random() < 0.3:  # else the process pauses
            work()
    work()
    wire.recorder.end()
    replay_result = tr.replay(tmp_path / "live.mcap", "xgd24d", topics=tmp_path / "topics.yaml")
    assert replay_result["stamp_ns"].tolist() == sorted(rows) == list(rows)
    assert len(rows) > 250
    for name in ("residual_nm", "weight_n", "resistance_torque_nm", "feedforward_torque_nm"):
        live = [row[d.app.estimator.column_index[name]] for row in rows.values()]
        np.testing.assert_allclose(replay_result[name], live, rtol=1e-6, atol=1e-6, err_msg=name)
    assert sorted(raw for *_, raw in messages_of(tmp_path / "live.mcap")) == sorted(raw for *_, raw in wire.sent)
    assert list(tmp_path.glob("*.mcap*")) == [tmp_path / "live.mcap"]


def test_messages_held_in_a_pause_replay_with_their_stamps(desk, tmp_path):
    unstamped = "\n".join(f"{role}: {{topic: {role}, type: {NUMBER}, field: data}}" for role in ("ambient", "load"))
    d = desk(f"speed: {{topic: speed, type: {TWIST}, field: twist.linear.x}}\n{unstamped}\n", learning="off", input_depth=1000)
    feed, now_ns, chance, stamps = d.app.session.feed, d.app.clock.now_ns, random.Random(4), []

    def watched(channel, stamp, *others):
        if channel == LOAD:
            stamps.append(stamp)
        return feed(channel, stamp, *others)

    d.app.session.feed = watched
    d.app.clock.now_ns = lambda steady: now_ns(steady) + chance.randrange(2000)  # it is read after the steady clock
    wire = Wire(d, tmp_path / "live.mcap")
    publish, work = in_haste(wire, 1000, chance, unknown=0.0)
    for _ in range(2):
        publish("ambient", NUMBER, 12.0)  # fetched last and handled first, so all others are held
        for _ in range(20):
            d.forward(0.02, tick=False)
            publish("load", NUMBER, 240e3)
            publish("speed", TWIST, 5.0)
        work()
    wire.recorder.end()
    apart = stamps - tr.read(tmp_path / "live.mcap", topics=tmp_path / "topics.yaml").series["load"].stamp_ns
    assert (apart.reshape(2, 20) == apart[::20, None]).all()
    replay_result = tr.replay(tmp_path / "live.mcap", "xgd24d", topics=tmp_path / "topics.yaml")
    assert list(replay_result.session.counts()) == list(d.app.session.counts())


@pytest.mark.parametrize(("shaft", "set_s", "follows"), [(NUMBER, 0.3, False), (NUMBER, 2.0, False), (WRENCH, 0.9, True)])
def test_without_a_stamp_live_is_as_its_replay_until_others_jump(desk, tmp_path, shaft, set_s, follows):
    lines = f"torque: {{topic: shaft, type: {shaft}, field: {'data' if shaft == NUMBER else 'wrench.torque.y'}}}\n"
    d = desk(f"speed: {{topic: speed, type: {NUMBER}, field: data}}\n" + lines, learning="off")
    wire, now_ns, chance, stamps = Wire(d, tmp_path / "live.mcap"), d.now_ns, random.Random(4), []
    record = d.app.on_estimate
    d.app.on_estimate = lambda row, stamp, arrival: (stamps.append(stamp), record(row, stamp, arrival))
    d.now_ns = lambda: now_ns() + chance.randrange(10000)  # it is read after the steady clock

    def drive():
        for step in range(60):
            d.forward(0.02)
            wire.send("shaft", shaft, 3000.0)
            wire.send("speed", NUMBER, 5.0 + 0.01 * (step % 3))

    drive()
    d.clock_offset_s = -set_s
    drive()
    wire.recorder.end()
    replay_result = tr.replay(tmp_path / "live.mcap", "xgd24d", topics=tmp_path / "topics.yaml")["stamp_ns"].tolist()
    assert stamps[:60] == replay_result[:60]
    assert (stamps == replay_result) is not follows
    assert (replay_result[-1] - stamps[-1]) * 1e-9 == pytest.approx(set_s if follows else 0.0, abs=1e-4)
    for output in ("feedforward_torque", "resistance_torque"):
        assert d.last(output)[0] == pytest.approx(now_ns(), abs=20_000)
    assert "CLOCK_OFFSET" not in d.names()


def test_each_round_of_simulated_time_is_a_file_of_its_own(desk, tmp_path):
    d = desk(TOPICS, use_sim_time=True, learning="off")
    wire, last = Wire(d, tmp_path / "live.mcap"), []
    for _ in range(3):
        for _ in range(200):
            d.forward(0.02)
            wire.send("speed", TWIST, 8.0)
        last.append(d.app.overview().values["belt_degc/front_left"])
        d.time_s = 0.0
        d.app.time_went_back(4 * SECOND_NS)
    wire.recorder.end()
    files = [tmp_path / name for name in ("live.mcap", "live_0001.mcap", "live_0002.mcap")]
    assert sorted(tmp_path.glob("*.mcap*")) == files
    for path, belt in zip(files, last, strict=True):
        replay_result = tr.replay(path, "xgd24d", topics=tmp_path / "topics.yaml")
        assert len(replay_result["belt_degc/front_left"]) == 200
        assert replay_result["belt_degc/front_left"][-1] == pytest.approx(belt, abs=1e-6)


def test_a_restored_start_replays_as_live(desk, tmp_path, monkeypatch):
    state, bag, time_now = tmp_path / "state.json", tmp_path / "live drive.mcap", [1e9]
    monkeypatch.setattr("time.time", lambda: time_now[0])
    warm = desk(TOPICS, state_file=str(state))
    warm.drive(60.0, speed=15.0, dt=0.2)
    warm.app.close()
    topics = tmp_path / "topics.yaml"

    def recorded():
        d, rows = desk(TOPICS, state_file=str(state), learning="on"), []
        wire = Wire(d, bag)
        record = d.app.on_estimate
        d.app.on_estimate = lambda row, stamp, arrival: (rows.append(row), record(row, stamp, arrival))
        for step in range(80):
            d.forward(0.1)
            time_now[0] += 1.0  # the belts cool until the first speed
            wire.send("/air", TEMPERATURE, 12.0)
            wire.send("shaft", WRENCH, 2000.0 + 10.0 * (step % 7))
            if step > 30:
                wire.send("speed", TWIST, 5.0)
        return d.app.estimator.column_index, rows, "".join(wire.recorder.end())

    def replayed_as(column, rows, path):
        replay_result = tr.replay(path, "xgd24d", topics=topics, resume=record_room.start_of(path), learning="on")
        for name in ("belt_degc/front_left", "resistance_torque_nm", "residual_nm", "feedforward_torque_nm"):
            live = [row[column[name]] for row in rows]
            np.testing.assert_allclose(replay_result[name], live, rtol=1e-12, atol=1e-9, err_msg=name)
        return replay_result

    *live, lines = recorded()
    assert f"--resume '{record_room.start_of(bag)}'" in lines
    assert json.loads(record_room.start_of(bag).read_bytes())["saved_at"] == 1e9 + 32.0  # when the first speed came
    replay_result = replayed_as(*live, bag)
    cold = tr.replay(bag, "xgd24d", topics=topics)
    assert cold["belt_degc/front_left"][0] < replay_result["belt_degc/front_left"][0] - 1.0
    result_before, part = [path.read_bytes() for path in (bag, record_room.start_of(bag))], tmp_path / "live drive.mcap.part"
    with monkeypatch.context() as killed:
        killed.setattr(record_room.OutputBag, "__exit__", lambda one, *_: one.writer._file.close() or 1 / 0)
        *live, lines = recorded()
    assert f"--resume '{record_room.start_of(part)}'" in lines
    replayed_as(*live, part)
    assert [path.read_bytes() for path in (bag, record_room.start_of(bag))] == result_before
    Wire(desk(TOPICS), bag).recorder.end()
    assert not record_room.start_of(bag).exists()  # of the bag that was replaced
    assert record_room.start_of(part).exists()


def test_the_next_application_is_recorded_in_the_next_file(desk, tmp_path, monkeypatch):
    recorder, last = Recorder(tmp_path / "live.mcap"), []
    for vehicle in ("xgd24d", "agri3t"):
        d = desk(TOPICS, vehicle=vehicle, learning="off")
        wire = Wire(d, None, recorder)
        for _ in range(100):
            d.forward(0.02)
            wire.send("speed", TWIST, 2.0)
        last.append(d.app.overview().values[f"belt_degc/{d.app.estimator.assemblies[0]}"])
        d.app.close()
    lines = recorder.end()
    assert f"{tmp_path / 'live.mcap'} to {tmp_path / 'live_0001.mcap'}: 200 estimates" in lines[0]
    assert "200 of /speed" in lines[0]
    for name, vehicle, belt in zip(("live", "live_0001"), ("xgd24d", "agri3t"), last, strict=True):
        replay_result = tr.replay(tmp_path / f"{name}.mcap", vehicle, topics=tmp_path / "topics.yaml")
        assert replay_result[f"belt_degc/{tr.Estimator(vehicle).assemblies[0]}"][-1] == pytest.approx(belt, abs=1e-6)


def test_messages_before_the_sim_clock_get_its_first_time(desk, tmp_path):
    d = desk(TOPICS, use_sim_time=True)
    wire, clock = Wire(d, tmp_path / "live.mcap"), d.now_ns
    d.now_ns = lambda: 0
    wire.send("speed", TWIST, 8.0)
    d.now_ns = clock
    d.forward(1.0)
    wire.send("speed", TWIST, 8.0)
    wire.recorder.end()
    times = [log for topic, log, _ in messages_of(tmp_path / "live.mcap") if topic == "/speed"]
    assert times == [
        START_NS + SECOND_NS,
        START_NS + SECOND_NS + 1,
    ]


@pytest.mark.parametrize("most", [0, 1, 10])
def test_no_message_is_lost_where_no_clock_ever_comes(desk, tmp_path, monkeypatch, most):
    monkeypatch.setattr(inputs, "MOST_BEFORE_CLOCK", most)
    d = desk(TOPICS, use_sim_time=True)
    wire = Wire(d, tmp_path / "live.mcap")
    d.now_ns = lambda: 0
    for speed in (7.0, 8.0, 9.0):
        wire.send("speed", TWIST, speed)
    d.app.close()
    wire.recorder.end()
    assert {raw for *_, raw in messages_of(tmp_path / "live.mcap")} == {raw for *_, raw in wire.sent}


def test_what_is_not_handled_is_recorded_too(desk, tmp_path):
    d = desk(TOPICS)
    wire = Wire(d, tmp_path / "live.mcap")
    d.app.messages.reader.read = lambda *_: 1 / 0
    wire.send("speed", TWIST, 8.0)
    earlier = d.app.clock.arrival()
    d.forward(2.0)
    wire.send("brake", NUMBER, 1.0)
    d.app.messages.receive_values(wire.index["speed"], None, None, arrival=earlier, raw=b"no message!!")
    d.app.messages.receive_values(wire.index["shaft"], d.now_ns(), [3000.0], origin=Sent(1), raw=b"waits for a speed")
    d.app.close()
    wire.recorder.end()
    results = [raw for *_, raw in messages_of(tmp_path / "live.mcap")]
    assert results == [
        wire.sent[0][2],
        b"no message!!",
        wire.sent[1][2],
        b"waits for a speed",
    ]


def test_a_recording_that_cannot_begin_is_refused(desk, tmp_path, monkeypatch):
    def full(_bag):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(record_room.OutputBag, "__enter__", full)
    with pytest.raises(tr.InputError, match=r"--record: given .*No space left"):
        Recorder(tmp_path / "live.mcap").begin(desk().app)


def estimates_in(bag):
    """Stamp [ns] and bytes of each `~/estimate` of a bag."""
    with AnyReader([bag]) as reader:
        kept = [bytes(raw) for c, _, raw in reader.messages() if c.topic == "/trackres/estimate"]
    return [(seconds * SECOND_NS + rest, raw) for raw in kept for seconds, rest in [struct.unpack_from("<iI", raw, 4)]]


def values_in(raw):
    """Numbers of the first group of an estimate."""
    from trackres_ros.node.dds.wire import typestore

    return typestore().deserialize_cdr(raw, "control_msgs/msg/DynamicInterfaceGroupValues").interface_values[0].values.tolist()


def test_the_estimate_is_the_same_live_recorded_and_replayed(desk, tmp_path, good):
    pytest.importorskip("cyclonedds")
    from trackres_ros.node.dds.wire import DdsEstimate

    topics = tmp_path / "topics.yaml"
    topics.write_text("".join(line + "\n" for line in TOPICS.splitlines() if not line.startswith("torque")))
    (tmp_path / "params.yaml").write_text(f"feedforward_rate: {AT_ONCE}\n")  # else the torque goes on between two steps
    d = desk(topics=str(topics), learning="off", feedforward_rate=AT_ONCE)
    d.found_peers = {given_valuess.name: (Peer(given_valuess.type, True),) for given_valuess in d.app.inputs}
    wire = Wire(d, tmp_path / "live.mcap")
    for step in range(600):  # no ambient temperature at first, then one, that later grows old
        d.forward(0.1)
        d.forward(0.1)  # the torque is where the step before wants it
        if 100 <= step < 200:
            wire.send("/air", TEMPERATURE, 12.0)
        wire.send("speed", TWIST, 6.0 + 3.0 * math.sin(step / 50.0))
    d.forward(0.1)
    d.forward(0.1)
    wire.recorder.end()
    message, remainder = DdsEstimate("base_link"), [item for item in d.published if item[0] == "estimate"]
    published = [
        (stamp, message.fill(stamp, values, tuple(reasons.items())))
        for (_, stamp, values), reasons in zip(remainder, d.reasons, strict=True)
    ]
    given_valuess = ("--vehicle", "xgd24d", "--topics", topics, "--params", tmp_path / "params.yaml")
    good("replay", tmp_path / "live.mcap", *given_valuess, "-o", tmp_path / "again.mcap")
    recorded, replay_result = (estimates_in(tmp_path / name) for name in ("live.mcap", "again.mcap"))
    assert recorded == published
    last = dict(published)  # of each stamp, before the next speed
    assert len(replay_result) == 600
    numbers = slice(0, published[0][1].index(b"reasons"))  # stamp and groups; the numbers follow the names
    alike = 0
    for stamp, raw in replay_result[1:]:  # in the first step there is no time for the torque to move
        assert raw[numbers] == last[stamp][numbers]
        assert values_in(raw)[:3] == values_in(last[stamp])[:3]  # to the last bit
        alike += raw == last[stamp]
    # A node shows a reason for a second after its last step; in all other messages every byte is the same.
    assert alike >= 500
    assert len({tuple(item) for item in d.reasons}) > 1
