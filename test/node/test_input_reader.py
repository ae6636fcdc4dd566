# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""From messages to samples: which topic feeds which role, in which order, with which stamp."""

import math
from types import SimpleNamespace

import pytest

from trackres_ros.errors import InputError
from trackres_ros.node.inputs import InputReader
from trackres_ros.node.transport import Level, full_name, input_name, input_topics
from trackres_ros.recording.bindings import Topics
from trackres_ros.tasks.replay_run import channel_indices

CHANNELS = ("speed", "load", "torque", "ambient", "load/front")
JOINTS = {"topic": "/drive", "type": "sensor_msgs/msg/JointState"}


def reader(**roles):
    topics = Topics.parse(roles)
    inputs = input_topics(topics)
    return InputReader(inputs, CHANNELS, topics.bindings), inputs


def stamp(ns):
    return SimpleNamespace(stamp=SimpleNamespace(sec=ns // 10**9, nanosec=ns % 10**9))


def samples(taken, message, now_ns):
    return taken.samples(0, *taken.read(0, message), now_ns)


def joint_state(ns, **joints):
    return SimpleNamespace(header=stamp(ns), name=list(joints), effort=list(joints.values()), velocity=list(joints.values()))


def test_the_speed_topic_is_last_and_speed_is_its_last_field():
    line = {"topic": "/a", "type": "std_msgs/Float64", "field": "data"}
    inputs = input_topics(Topics.parse({"speed": line, "load": {**line, "topic": "/b"}, "torque": line}))
    assert [input.valued for input in inputs] == [("load",), ("torque", "speed")]


def test_elements_scale_offset_and_header_stamp():
    taken, _ = reader(
        speed={**JOINTS, "field": "velocity[left]", "scale": 0.5, "offset": 1.0}, torque={**JOINTS, "field": "effort[right]"}
    )
    assert samples(taken, joint_state(7, left=4.0, right=9.0), 99) == [(2, 7, 9.0), (0, 7, 3.0)]


def test_a_missing_element_gives_no_sample_and_is_counted():
    taken, _ = reader(speed={**JOINTS, "field": "velocity[left]"}, torque={**JOINTS, "field": "effort[right]"})
    assert samples(taken, joint_state(7, left=4.0), 99) == [(0, 7, 4.0)]
    assert taken.absence_counts[2] == 1
    assert taken.message_counts == [1]


def test_stamps_log_none_and_never_set():
    line = {"topic": "/t", "type": "sensor_msgs/msg/Temperature", "field": "temperature"}
    by_log, _ = reader(speed=line, ambient={**line, "stamp": "log"})
    message = SimpleNamespace(header=stamp(0), temperature=20.0)
    assert {(channel, place) for channel, place, _ in samples(by_log, message, 99)} == {(0, 0), (3, 99)}
    bare, _ = reader(speed={"topic": "/s", "type": "std_msgs/msg/Float64", "field": "data"})
    assert samples(bare, SimpleNamespace(data=1.0), 99) == [(0, 99, 1.0)]


def test_what_is_no_number_counts_as_not_a_number():
    taken, _ = reader(speed={"topic": "/s", "type": "std_msgs/msg/Float64", "field": "data"})
    for now_ns, message in ((100, SimpleNamespace(data=None)), (101, object())):
        ((channel, place, value),) = samples(taken, message, now_ns)
        assert (channel, place) == (0, now_ns)
        assert math.isnan(value)


def test_a_role_that_the_vehicle_does_not_have_is_refused():
    line = {"topic": "/s", "type": "std_msgs/msg/Float64", "field": "data"}
    with pytest.raises(InputError, match=r"load/middle.*load/front"):
        reader(speed=line, **{"load/middle": line})


def test_a_torque_of_an_assembly_is_refused_and_sum_is_named(reference):
    line = {"topic": "/s", "type": "std_msgs/msg/Float64", "field": "data"}
    with pytest.raises(InputError, match=r"torque/front_left.*allowed: for this vehicle torque; torque: \{sum: "):
        reader(speed=line, **{"torque/front_left": line})
    with pytest.raises(InputError, match=r"torque/front_left.*allowed: for this vehicle torque; torque: \{sum: "):
        channel_indices(reference.session(), ["torque/front_left"])


@pytest.mark.parametrize(
    ("name", "node", "namespace", "full"),
    [("status", "n", "/", "/n/status"), ("status", "n", "/a/b", "/a/b/n/status"), ("/diagnostics", "n", "/a", "/diagnostics")],
)
def test_names_of_outputs(name, node, namespace, full):
    assert full_name(name, node, namespace) == full


def test_names_of_inputs():
    assert [input_name("speed", "/"), input_name("speed", "/a"), input_name("/speed", "/a")] == ["/speed", "/a/speed", "/speed"]


@pytest.mark.parametrize(("ns", "joints"), [(10**20, {"a": 1.0, "b": 2.0}), (7, {"c": 1.0})])
def test_a_message_with_all_parts_of_a_sum_counts_once(ns, joints):
    parts = [{**JOINTS, "field": f"effort[{name}]"} for name in "ab"]
    taken, _ = reader(torque={"sum": parts}, speed={**JOINTS, "topic": "/s", "field": "velocity[a]"})
    for _ in range(10):
        assert samples(taken, joint_state(ns, **joints), 99) == []
    assert taken.absence_counts[2] + taken.bad_stamp[2] == 10


def test_the_torque_delay_shifts_its_stamp_but_not_a_zero_stamp():
    taken, _ = reader(torque={**JOINTS, "field": "effort[a]", "delay_s": 0.25}, speed={**JOINTS, "field": "velocity[a]"})
    for header, shifted in ((5 * 10**9, 5 * 10**9 - 250_000_000), (0, 0)):
        (_, torque_stamp, _), (_, speed_stamp, _) = samples(taken, joint_state(header, a=3.0), 9 * 10**9)
        assert (torque_stamp, speed_stamp) == (shifted, header)


def test_parts_of_a_sum_without_the_other_are_said_and_counted(desk):
    part = "{{topic: {0}, type: std_msgs/msg/Float64, field: data}}"
    d = desk(f"speed: {{sum: [{part.format('left')}, {part.format('right')}]}}\n")
    remainder = next(i for i, given_values in enumerate(d.app.inputs) if given_values.name == "left")
    for _ in range(150):
        d.forward(0.02)
        d.app.messages.receive(remainder, SimpleNamespace(data=4.0))
    assert any("without_other_part" in notice.text for notice in d.app.notices() if notice.name == "REFUSED")
    rates = {state.topic: state.rate_hz for state in d.app.overview().inputs}
    assert rates == {"/left": pytest.approx(50.0, abs=2.0), "/right": 0.0}


def test_an_input_whose_messages_all_lack_the_element_warns(desk):
    d = desk("speed: {topic: js, type: sensor_msgs/msg/JointState, field: 'velocity[wheel]'}\n")

    def told(**joints):
        for _ in range(120):
            d.forward(0.02)
            for name, value in joints.items():  # each joint has its own publisher
                d.app.messages.receive(0, joint_state(d.now_ns(), **{name: value}))
        (result,) = d.app.overview().inputs
        assert result.rate_hz == pytest.approx(50.0 * len(joints), abs=2.0)
        _, shown, *_ = next(entries for topic, entries in reversed(d.statuses) if topic == "/diagnostics")
        return [notice.text for notice in d.app.notices() if notice.name == "REFUSED"], shown.level

    texts, level = told(wheels=8.0)
    reason = "50 absent (the messages do not have velocity[wheel]: its names are wheels)"
    assert texts == [f"speed: rejected in the last second: {reason}"]
    assert level is Level.STALE
    assert told(wheels=8.0, wheel=8.0) == ([], Level.OK)
    assert told(wheels=8.0)[1] is Level.STALE  # the last one that had it is too old
    d.app.close()
    assert "messages: speed accepted 120, speed absent 360" in [text for _, text in d.logged]


def test_a_role_with_two_fields_of_a_topic_is_named_once(desk):
    part = "{{topic: js, type: sensor_msgs/msg/JointState, field: 'velocity[{0}]'}}"
    d = desk(f"speed: {{sum: [{part.format('a')}, {part.format('b')}]}}\n")
    d.forward(1.0)
    assert "speed: nobody publishes sensor_msgs/msg/JointState on /js" in [notice.text for notice in d.app.notices()]
