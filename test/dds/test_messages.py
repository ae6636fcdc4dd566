# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Outputs filled in place and inputs read at known places are what a full encoding and decoding give."""

import math
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ros_messages import build, stamped

from trackres_ros.errors import InputError
from trackres_ros.node.dds.wire import CdrInput, clock_ns, diagnostic_array, prepare_message, typestore
from trackres_ros.node.transport import InputTopic, Level, Status, live_topics
from trackres_ros.output.topics import ESTIMATE_TOPIC
from trackres_ros.recording.bindings import TopicBinding, Topics
from trackres_ros.recording.cdr import MalformedError
from trackres_ros.recording.combining import Reading
from trackres_ros.vehicle import load

STAMP_NS = 1_700_000_000_123_456_789
TWIST, JOINTS = "geometry_msgs/msg/TwistStamped", "sensor_msgs/msg/JointState"
FIX = "sensor_msgs/msg/NavSatFix"


def all_outputs(tmp_path):
    path = tmp_path / "topics.yaml"
    path.write_text(
        "speed: {topic: speed, type: std_msgs/msg/Float64, field: data}\n"
        "torque: {topic: torque, type: std_msgs/msg/Float64, field: data}\n"
    )
    return live_topics(load("xgd24d"), Topics.load(path))


def numbers_of(message, kind):
    if kind == "joints":
        return list(message.effort)
    if kind == "wrench":
        return [message.wrench.torque.y]
    return [message.temperature, message.variance] if kind == "temperature" else [message.data]


def test_filled_outputs_decode_to_stamp_and_numbers(tmp_path):
    kinds = set()
    for topic in all_outputs(tmp_path):
        if topic.kind in ("status", "estimate"):
            continue
        kinds.add(topic.kind)
        fill = prepare_message(topic, "hull")
        fill(1, [9.0] * len(topic.columns), ())
        values = [1.5 * i - 2.0 for i in range(len(topic.columns))]
        raw = fill(STAMP_NS, values, ())
        assert len(raw) % 4 == 0
        message = typestore().deserialize_cdr(raw, topic.type)
        assert numbers_of(message, topic.kind) == values
        if topic.kind != "number":
            assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == STAMP_NS
            assert message.header.frame_id == "hull"
        if topic.kind == "joints":
            assert tuple(message.name) == topic.names
    assert kinds == {"joints", "wrench", "temperature", "number"}


REASONS = [(), (("SPEED_OLD", Level.STALE),), (("SPEED_OLD", Level.STALE), ("LOAD_NOMINAL", Level.WARN)), ()]


def test_an_estimate_message_is_independent_of_the_one_before():
    fill = prepare_message(ESTIMATE_TOPIC, "hull")
    for count, reasons in enumerate(REASONS):
        values = [count + 0.5, -2.0, 3.0, float(max((level for _, level in reasons), default=0))]
        raw = fill(STAMP_NS + count, values, reasons)
        assert len(raw) % 4 == 0
        message = typestore().deserialize_cdr(raw, ESTIMATE_TOPIC.type)
        assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == STAMP_NS + count
        assert message.interface_groups == ["vehicle", "reasons"]
        vehicle, why = message.interface_values
        assert dict(zip(vehicle.interface_names, vehicle.values, strict=True)) == dict(
            zip(ESTIMATE_TOPIC.names, values, strict=True)
        )
        assert list(zip(why.interface_names, why.values, strict=True)) == list(reasons)


def test_a_diagnostic_array():
    statuses = [
        Status(Level.STALE, "trackres: estimate", "no speed yet", "xgd24d", (("a", "1"), ("b", ""))),
        Status(Level.OK, "x", "", ""),
    ]
    raw = diagnostic_array(STAMP_NS, statuses, "hull")
    message = typestore().deserialize_cdr(raw, "diagnostic_msgs/msg/DiagnosticArray")
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == divmod(STAMP_NS, 10**9)
    first, second = message.status
    assert (first.level, first.name, first.message, first.hardware_id) == (3, "trackres: estimate", "no speed yet", "xgd24d")
    assert [(pair.key, pair.value) for pair in first.values] == [("a", "1"), ("b", "")]
    assert (second.level, second.values) == (0, [])


def reader(kind, *fields, scale=1.0, offset=0.0):
    roles = tuple(["speed", "torque"][: len(fields)])
    bindings = (TopicBinding("/t", kind, field, scale=scale, offset=offset) for field in fields)
    readings = tuple(Reading(role, None, binding) for role, binding in zip(roles, bindings, strict=True))
    return CdrInput(InputTopic("/t", kind, readings), "topics.yaml")


def raw_of(kind, big=False, **fields):
    return bytes(typestore().serialize_cdr(build(kind, **fields), kind, little_endian=not big))


@pytest.mark.parametrize("big", [False, True])
def test_a_number_is_read_whatever_the_frame_is_called(big):
    speed = reader(TWIST, "twist.linear.x", scale=2.0, offset=1.0)
    for frame, value in (("base_link", 1.25), ("", -3.0), ("base_link", 7.0), ("hull", math.inf)):
        header = {**stamped(STAMP_NS), "frame_id": frame}
        raw = raw_of(TWIST, big, header=header, twist={"linear": {"x": value, "y": 5.0, "z": 5.0}})
        assert speed.read(raw) == (STAMP_NS, [2.0 * value + 1.0])


def test_big_and_little_ends_may_alternate():
    speed = reader("std_msgs/msg/Float64", "data")
    for big in (True, False, True):
        assert speed.read(raw_of("std_msgs/msg/Float64", big, data=1.25)) == (None, [1.25])


@pytest.mark.parametrize("status", [-2, -1, 0, 2])
def test_a_receiver_without_a_fix_says_nothing(status):
    both = reader(FIX, "latitude", "altitude", scale=2.0)
    raw = raw_of(FIX, header=stamped(STAMP_NS), status={"status": status, "service": 1}, latitude=47.0, altitude=400.0)
    found = [math.nan, math.nan] if status == -1 else [94.0, 800.0]
    stamp, numbers = both.read(raw)
    assert stamp == STAMP_NS
    np.testing.assert_array_equal(numbers, found)


def test_a_joint_is_found_by_name_wherever_it_stands():
    both = reader(JOINTS, "velocity[left]", "effort[left]")
    for names, velocity, effort, found in (
        (["left", "right"], [1.0, 2.0], [3.0, 4.0], [1.0, 3.0]),
        (["tfel", "left_"], [1.0, 2.0], [3.0, 4.0], ["its names are tfel, left_"] * 2),
        (["rght", "left"], [1.0, 2.0], [3.0, 4.0], [2.0, 4.0]),
        (["left", "rght"], [1.0, 2.0], [], [1.0, "the array effort has no elements"]),
        ([], [], [], ["its names are none"] * 2),
    ):
        message = {"name": names, "velocity": np.array(velocity), "effort": np.array(effort)}
        assert both.read(raw_of(JOINTS, header=stamped(5), **message)) == (5, found), names


@given(st.binary(max_size=120))
def test_bytes_that_are_no_message_are_refused_and_nothing_else(raw):
    for each in (reader(TWIST, "twist.linear.x"), reader(JOINTS, "effort[left]"), reader("std_msgs/msg/Float64", "data")):
        for given_bytes in (raw, b"\0\1\0\0" + raw):
            try:
                stamp, values = each.read(given_bytes)
            except MalformedError:
                continue
            assert stamp is None or isinstance(stamp, int)
            assert all(isinstance(value, float | str) for value in values)


@pytest.mark.parametrize("kind", [TWIST, "std_msgs/msg/Float64"])
def test_a_message_cut_short_is_refused_and_the_next_one_read(kind):
    whole = raw_of(kind)
    each = reader(kind, "data" if kind.endswith("Float64") else "twist.linear.x")
    for length in range(len(whole)):
        with pytest.raises(MalformedError):
            each.read(whole[:length])
        assert each.read(whole)[1] == [0.0]


@pytest.mark.parametrize(
    ("kind", "field", "said"),
    [
        ("track_msgs/msg/Speed", "data", "the only ones known without ROS"),
        (TWIST, "twist.linear.w", "fields of geometry_msgs/msg/Vector3: x, y, z"),
        (TWIST, "twist.linear", "a number, not geometry_msgs/msg/Vector3"),
        (JOINTS, "effort", "an index"),
    ],
)
def test_what_cannot_be_read_is_said_at_the_start(kind, field, said):
    with pytest.raises(InputError, match=r"topics\.yaml: speed") as caught:
        reader(kind, field)
    assert said in str(caught.value)


def test_the_clock():
    assert clock_ns(struct.pack("<4siI", b"\0\1\0\0", 17, 5)) == 17 * 10**9 + 5
    assert clock_ns(struct.pack(">4siI", b"\0\0\0\0", 17, 5)) == 17 * 10**9 + 5
    for raw in (b"", b"\0\1\0\0", b"\0\1\0\0" + b"\xff" * 7):
        with pytest.raises(MalformedError):
            clock_ns(raw)
