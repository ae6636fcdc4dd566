# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Decoding many messages at once gives what decoding each of them gives."""

from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trackres_ros.errors import InputError

pytest.importorskip("rosbags")

from ros_messages import build, stamped
from rosbags.typesys import Stores, get_typestore

from trackres_ros.recording.bindings import TopicBinding
from trackres_ros.recording.cdr import NUMBERS, Encoding, FieldReader, MalformedError, Template, layout_of
from trackres_ros.recording.message_types import Field, definitions

STORE = get_typestore(Stores.LATEST)
STORE1 = get_typestore(Stores.ROS1_NOETIC)
TWIST = "geometry_msgs/msg/TwistStamped"
CASES = {
    "nav_msgs/msg/Odometry": ["twist.twist.linear.x", "pose.covariance[7]", "pose.pose.orientation.w"],
    "geometry_msgs/msg/TwistStamped": ["twist.linear.x", "twist.angular.z"],
    "geometry_msgs/msg/TwistWithCovarianceStamped": ["twist.twist.linear.x", "twist.covariance[35]"],
    "std_msgs/msg/Float64": ["data"],
    "std_msgs/msg/Float32": ["data"],
    "std_msgs/msg/Bool": ["data"],
    "std_msgs/msg/Float64MultiArray": ["data[2]", "layout.dim[1].stride", "layout.data_offset"],
    "geometry_msgs/msg/WrenchStamped": ["wrench.force.z", "wrench.torque.y"],
    "sensor_msgs/msg/JointState": ["effort[left]", "velocity[1]", "position[left]"],
    "sensor_msgs/msg/Temperature": ["temperature", "variance"],
    "sensor_msgs/msg/Imu": ["angular_velocity.z", "linear_acceleration.x", "orientation_covariance[0]"],
    "sensor_msgs/msg/NavSatFix": ["altitude", "status.service", "position_covariance_type"],
    "sensor_msgs/msg/BatteryState": ["voltage", "cell_voltage[0]", "percentage"],
    "tf2_msgs/msg/TFMessage": ["transforms[0].transform.translation.x"],
}
NAMES = st.sampled_from(["left", "right", "", "é", "a longer name"])
FLOATS = {32: st.floats(width=32), 64: st.floats()}


def messages(store: Any, msgtype: str) -> st.SearchStrategy[Any]:
    """Return messages of a type with random strings, sequence lengths and numbers."""
    fields = definitions(store.fielddefs, msgtype)[msgtype]

    def one(kind: str) -> st.SearchStrategy[Any]:
        if kind == "string":
            return NAMES
        if kind not in NUMBERS:
            return messages(store, kind)
        if kind == "bool":
            return st.booleans()
        if kind.startswith("float"):
            return FLOATS[int(kind[5:])]
        low, high = np.iinfo(NUMBERS[kind]).min, np.iinfo(NUMBERS[kind]).max
        return st.integers(int(low), int(high))

    def many(kind: str, size: tuple[int, int]) -> st.SearchStrategy[Any]:
        listed = st.lists(one(kind), min_size=size[0], max_size=size[1])
        return listed.map(lambda values: np.array(values, NUMBERS[kind])) if kind in NUMBERS else listed

    parts = {}
    for field in fields:
        size = (field.count, field.count) if field.multiplicity == "array" else (0, 3)
        parts[field.name] = one(field.type) if field.multiplicity == "one" else many(field.type, size)
    return st.builds(store.types[msgtype], **parts)


def expected(message: Any, field: str) -> float:
    """Return the live node's value of the decoded message; NaN without such an element."""
    try:
        return TopicBinding("/t", "x/msg/Y", field).read(message)
    except (LookupError, IndexError):
        return math.nan


def stamp_of(message: Any) -> int:
    header = getattr(message, "header", None)
    return header.stamp.sec * 10**9 + header.stamp.nanosec if header is not None else 0


@pytest.mark.parametrize("msgtype", CASES)
@settings(max_examples=15, deadline=None)
@given(data=st.data())
def test_equals_decoding_each_message(msgtype: str, data: st.DataObject) -> None:
    sent_message = data.draw(st.lists(messages(STORE, msgtype), min_size=1, max_size=12))
    sent_message = [message for message in sent_message for _ in range(data.draw(st.integers(1, 3)))]
    little = data.draw(st.lists(st.booleans(), min_size=len(sent_message), max_size=len(sent_message)))
    padding = data.draw(st.lists(st.integers(0, 3), min_size=len(sent_message), max_size=len(sent_message)))
    raws = [
        bytes(STORE.serialize_cdr(message, msgtype, little_endian=side)) + b"\0" * pad
        for message, side, pad in zip(sent_message, little, padding, strict=True)
    ]
    reader = FieldReader(definitions(STORE.fielddefs, msgtype), msgtype, CASES[msgtype])
    check(reader.decode(raws), [STORE.deserialize_cdr(raw, msgtype) for raw in raws], CASES[msgtype])


@pytest.mark.parametrize("msgtype", [msgtype for msgtype in CASES if msgtype in STORE1.fielddefs])
@settings(max_examples=10, deadline=None)
@given(data=st.data())
def test_equals_decoding_each_ros1_message(msgtype: str, data: st.DataObject) -> None:
    sent_message = data.draw(st.lists(messages(STORE1, msgtype), min_size=1, max_size=6))
    raws = [bytes(STORE1.serialize_ros1(message, msgtype)) for message in sent_message]
    reader = FieldReader(definitions(STORE1.fielddefs, msgtype), msgtype, CASES[msgtype], Encoding.ROS1)
    check(reader.decode(raws), [STORE1.deserialize_ros1(raw, msgtype) for raw in raws], CASES[msgtype])


WIDE_TYPES = {
    "x/msg/Y": (
        Field("name", "wstring", "one", 1), Field("gear", "uint8", "one", 1), Field("notes", "wstring", "sequence", 1),
        Field("speed", "float64", "one", 1), Field("both", "wstring", "array", 2), Field("torque", "float32", "one", 1),
    )
}  # fmt: skip
LONG = "a text that is long enough to show the size of its units"
WIDE_TEXTS = st.text(st.characters(exclude_categories=("Cs",), exclude_characters="\0"), max_size=4)


def wide_message(parts: tuple[Any, ...], unit_bytes: int, counts_bytes: bool, order: str) -> bytes:
    """A message of `WIDE_TYPES` as CDR, with texts in units of two or four bytes."""
    raw = bytearray()

    def add(code: str, number: float) -> None:
        size = struct.calcsize(code)
        raw.extend(b"\0" * (-len(raw) % size) + struct.pack(order + code, number))

    def add_text(text: str) -> None:
        units = np.frombuffer(text.encode("utf-16-le"), "<u2")
        add("I", 2 * len(units) if counts_bytes else len(units))
        raw.extend(units.astype(f"{order}u{unit_bytes}").tobytes())

    name, gear, notes, speed, both, torque = parts
    add_text(name)
    add("B", gear)
    add("I", len(notes))
    for text in notes:
        add_text(text)
    add("d", speed)
    for text in both:
        add_text(text)
    add("f", torque)
    return (b"\0\1\0\0" if order == "<" else b"\0\0\0\0") + bytes(raw)


@pytest.mark.parametrize("form", [(2, False), (4, False), (2, True)], ids=["two bytes", "four bytes", "counted bytes"])
@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_wide_texts_are_read_in_the_units_of_any_writer(form: tuple[int, bool], data: st.DataObject) -> None:
    pair = st.tuples(WIDE_TEXTS, WIDE_TEXTS)
    part = st.tuples(WIDE_TEXTS, st.integers(0, 255), st.lists(WIDE_TEXTS, max_size=3), st.floats(), pair, st.floats(width=32))
    sent = [("", 1, [], 0.5, (LONG, LONG), 0.5), *data.draw(st.lists(part, max_size=8))]
    order = data.draw(st.sampled_from("<>"))
    raws = [wide_message(parts, *form, order) for parts in sent]
    reader = FieldReader(WIDE_TYPES, "x/msg/Y", ["speed", "torque", "gear"])
    decoded = reader.decode([*raws[1:], raws[0]])
    assert not decoded.is_malformed.any()
    np.testing.assert_array_equal(decoded.value, [[parts[3], parts[5], parts[1]] for parts in [*sent[1:], sent[0]]])


@pytest.mark.parametrize("first", [6, 7, 8, 9, 10, 11])
def test_messages_in_xcdr2_say_so(first: int) -> None:
    reader = FieldReader(WIDE_TYPES, "x/msg/Y", ["speed"])
    assert reader.decode([bytes([0, first, 0, 0]) + b"\0" * 32]).is_malformed.all()
    assert reader.representation.startswith("XCDR2")


def check(decoded: Any, sent: list[Any], fields: list[str]) -> None:
    want = np.array([[expected(message, field) for field in fields] for message in sent])
    np.testing.assert_array_equal(decoded.value, want)
    np.testing.assert_array_equal(decoded.stamp_ns, [stamp_of(message) for message in sent])
    assert not decoded.is_malformed.any()
    assert not (decoded.is_absent & ~np.isnan(want)).any()


def twist(number: float, frame: str = "base_link") -> bytes:
    message = build(TWIST, STORE, header=stamped(10**9 + 2, frame), twist={"linear": {"x": number}})
    return bytes(STORE.serialize_cdr(message, TWIST))


def twist_reader(*fields: str) -> FieldReader:
    return FieldReader(definitions(STORE.fielddefs, TWIST), TWIST, fields or ["twist.linear.x"])


def test_same_length_other_layout() -> None:
    """Frames of other lengths whose padding makes the messages equally long must not share a layout."""
    raws = [twist(1.0, "abc"), twist(2.0, "ab"), twist(3.0, ""), twist(4.0, "abc")]
    assert len({len(raw) for raw in raws}) == 1
    np.testing.assert_array_equal(twist_reader().decode(raws).value[:, 0], [1.0, 2.0, 3.0, 4.0])


def test_more_layouts_than_are_kept() -> None:
    msgtype = "sensor_msgs/msg/JointState"
    raws = []
    for number in range(60):
        names = [f"{number:02d}", "left"] if number % 2 else ["left", f"{number:02d}"]
        effort = np.array([-1.0, number] if number % 2 else [number, -1.0], np.float64)
        message = build(msgtype, STORE, header=stamped(1, ""), name=names, effort=effort)
        raws.append(bytes(STORE.serialize_cdr(message, msgtype)))
    reader = FieldReader(definitions(STORE.fielddefs, msgtype), msgtype, ["effort[left]", "effort[gone]"])
    for _ in range(2):
        decoded = reader.decode(raws)
        np.testing.assert_array_equal(decoded.value[:, 0], np.arange(60.0))
        assert decoded.is_absent[:, 1].all()
        assert not decoded.is_absent[:, 0].any()


@settings(max_examples=200, deadline=None)
@given(cut=st.integers(0, 79), extra=st.binary(max_size=6), at=st.integers(0, 30), byte=st.integers(0, 255))
def test_damaged_messages_are_seen_as_the_full_decoder_sees_them(cut: int, extra: bytes, at: int, byte: int) -> None:
    total = twist(5.0)
    broken = bytearray(total)
    broken[at] = byte
    raws = [total, total[:cut], total + extra, bytes(broken), total]
    decoded = twist_reader().decode(raws)
    for raw, malformed, value in zip(raws, decoded.is_malformed, decoded.value[:, 0], strict=True):
        error, read = "", math.nan
        try:
            read = STORE.deserialize_cdr(raw, TWIST).twist.linear.x  # type: ignore[attr-defined]
        except Exception as caught_error:
            error = str(caught_error)
        # numbers do not depend on the text of the frame: text that is not UTF-8 does not cost the message
        assert malformed == (bool(error) and "codec" not in error)
        assert value == read or math.isnan(read)
        assert not malformed or math.isnan(value)


def test_no_messages_and_empty_ones() -> None:
    assert twist_reader().decode([]).value.shape == (0, 1)
    decoded = twist_reader().decode([b"", twist(1.0), b""])
    assert decoded.is_malformed.tolist() == [True, False, True]


@pytest.mark.parametrize(
    ("msgtype", "field", "says"),
    [
        (TWIST, "twist.linera.x", "linear, angular; did you mean linear?"),
        (TWIST, "twst.linear.x", "fields of geometry_msgs/msg/TwistStamped: header, twist; did you mean twist?"),
        (TWIST, "twist.linear", "a number, not geometry_msgs/msg/Vector3; it holds x, y, z"),
        (TWIST, "twist.linear.x.y", "nothing after x, which is float64"),
        (TWIST, "twist[0].linear.x", "no index: twist is no array"),
        (TWIST, "header.frame_id", "a number, not string"),
        ("nav_msgs/msg/Odometry", "pose.covariance", "an index, as covariance[0]"),
        ("nav_msgs/msg/Odometry", "pose.covariance[36]", "an index below 36"),
        ("nav_msgs/msg/Odometry", "pose.covariance[a]", "only with a field string[] name"),
        ("sensor_msgs/msg/JointState", "name[0]", "a number, not string"),
    ],
)
def test_a_field_that_is_no_number_is_refused(msgtype: str, field: str, says: str) -> None:
    with pytest.raises(InputError) as error_info:
        FieldReader(definitions(STORE.fielddefs, msgtype), msgtype, [field])
    assert says in str(error_info.value)
    assert field in str(error_info.value)


def test_layout_of_another_type() -> None:
    types = definitions(STORE.fielddefs, "nav_msgs/msg/Odometry")
    with pytest.raises(MalformedError):
        layout_of(twist(1.0), types, "nav_msgs/msg/Odometry", [])


@given(stamps=st.lists(st.integers(0, 2**31 * 10**9 - 1), min_size=1, max_size=5), value=st.floats())
def test_a_template_gives_what_serialising_gives(stamps: list[int], value: float) -> None:
    types = definitions(STORE.fielddefs, TWIST)
    raw = twist(0.0, "odd")
    template = Template(raw, types, TWIST, ["twist.linear.x", "twist.angular.z"])
    output = np.full((len(stamps), 3 + len(raw)), 7, np.uint8)
    template.fill(output, 3, np.array(stamps), np.array([[value, row] for row in range(len(stamps))], np.float64))
    assert (output[:, :3] == 7).all()
    for row, stamp in enumerate(stamps):
        message: Any = STORE.deserialize_cdr(output[row, 3:].tobytes(), TWIST)
        assert stamp_of(message) == stamp
        assert message.header.frame_id == "odd"
        assert message.twist.linear.x == value or math.isnan(value)
        assert message.twist.angular.z == row


def test_a_template_without_the_element() -> None:
    msgtype = "std_msgs/msg/Float64MultiArray"
    raw = bytes(STORE.serialize_cdr(build(msgtype, STORE, data=np.zeros(2)), msgtype))
    with pytest.raises(InputError, match="an element that the template message has"):
        Template(raw, definitions(STORE.fielddefs, msgtype), msgtype, ["data[2]"])
