# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A role that is the sum of several fields: aligned in time, never half, the same out of a bag and live."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

import trackres_ros as tr
from trackres_ros.errors import InputError
from trackres_ros.node.inputs import InputReader
from trackres_ros.node.transport import input_topics
from trackres_ros.recording.bindings import TopicBinding, Topics
from trackres_ros.recording.combining import Sum
from trackres_ros.recording.roles import UNITS, Conversion
from trackres_ros.recording.topics_files import correct_bindings, line_of, line_to_write

pytest.importorskip("rosbags")

from ros_messages import build, stamped, twist

START, MS = 1_700_000_000 * 10**9, 10**6
JOINTS = "sensor_msgs/msg/JointState"
SPEED = {"topic": "/speed", "type": "geometry_msgs/msg/TwistStamped", "field": "twist.linear.x"}
LEFT = {"topic": "/left", "type": JOINTS, "field": "effort[s]"}
RIGHT = {"topic": "/right", "type": JOINTS, "field": "effort[s]", "scale": 1000.0, "offset": 5.0}
TWO = Topics.parse({"speed": SPEED, "torque": {"sum": [LEFT, RIGHT], "scale": -1.0, "delay_s": 0.1}})


def write(path: Path, sides: list[tuple[str, int, dict[str, float]]]) -> Path:
    """A bag with a message of joints for each of some topics, stamps [ns] and efforts, and two speeds."""
    from trackres_ros.output.mcap import BagWriter

    with BagWriter(path) as bag:
        speed = bag.topic("/speed", SPEED["type"])
        joints = {topic: bag.topic(topic, JOINTS) for topic in dict.fromkeys(topic for topic, *_ in sides)}
        for ns in (START, START + 10**9):
            bag.write(speed, build(SPEED["type"], bag.typestore, header=stamped(ns), twist=twist(5.0)), ns, ns)
        for number, (topic, at_ns, efforts) in enumerate(sides):
            given_ = {"name": list(efforts), "effort": np.array(list(efforts.values()))}
            bag.write(joints[topic], build(JOINTS, bag.typestore, header=stamped(at_ns), **given_), at_ns, START + number)
    return path


def live(topics: Topics, sides: list[tuple[str, int, dict[str, float]]]) -> list[tuple[int, float]]:
    """Torques that the live node makes of these messages: stamps [ns] and values."""
    inputs = input_topics(topics)
    taken = InputReader(inputs, ("speed", "torque"), topics.bindings)
    index = {given_values.name: number for number, given_values in enumerate(inputs)}
    results = []
    for number, (topic, stamp, efforts) in enumerate(sides):
        place = SimpleNamespace(sec=stamp // 10**9, nanosec=stamp % 10**9)
        message = SimpleNamespace(header=SimpleNamespace(stamp=place), name=list(efforts), effort=list(efforts.values()))
        results += taken.samples(index[topic], *taken.read(index[topic], message), START + number)
    return [(stamp, value) for _, stamp, value in results]


def test_sides_are_added_at_the_times_of_the_first(tmp_path):
    remainders = [("/left", START + 100 * i * MS, {"s": 10.0 * i}) for i in range(8)]
    right = [("/right", START + (100 * i + 50) * MS, {"s": 1.0 * i}) for i in range(8) if i not in (5, 6, 7)]
    result = tr.read(write(tmp_path / "run.mcap", sorted(remainders + right, key=lambda one: one[1])), topics=TWO)
    torque = result.series["torque"]
    assert ((torque.stamp_ns - START) / MS).tolist() == [
        0.0,
        100.0,
        200.0,
        300.0,
    ]  # late by 100 ms
    np.testing.assert_allclose(torque.value, [-(10.0 * i + 1000.0 * (i - 0.5) + 5.0) for i in range(1, 5)])
    assert [(one.role, one.kind) for one in result.findings if one.kind == "part"] == [("torque", "part")]
    assert "torque: sum at the times of /left; /right interpolated between samples at most 0.5 s apart" in result.notes


def test_a_gap_of_one_side_is_a_gap_of_the_sum(tmp_path):
    remainders = [("/left", START + 100 * i * MS, {"s": 1.0}) for i in range(31)]
    right = [("/right", START + 100 * i * MS, {"s": 1.0}) for i in range(31) if not 10 < i < 20]
    result = tr.read(write(tmp_path / "run.mcap", sorted(remainders + right, key=lambda one: one[1])), topics=TWO)
    given_at = ((result.series["torque"].stamp_ns - START) / MS / 100 + 1).round().astype(int).tolist()
    assert given_at == [i for i in range(31) if not 10 < i < 20]
    assert set(result.series["torque"].value.tolist()) == {-1006.0}


def test_fields_of_one_message_belong_together(tmp_path):
    topics = {"speed": SPEED, "torque": {"sum": [{**LEFT, "field": "effort[l]"}, {**LEFT, "field": "effort[r]", "scale": 2.0}]}}
    sides = [("/left", START + i * MS, {"l": 1.0 * i, "r": 10.0} if i % 3 else {"l": 7.0}) for i in range(1, 9)]
    result = tr.read(write(tmp_path / "run.mcap", sides), topics=topics)
    assert result.series["torque"].value.tolist() == [20.0 + i for i in range(1, 9) if i % 3]
    assert any(finding.kind == "part" and finding.count == 2 for finding in result.findings)
    assert live(Topics.parse(topics), sides) == [(START + i * MS, 20.0 + i) for i in range(1, 9) if i % 3]


def test_no_part_is_added_twice_in_messages_of_one_time():
    """As where the log has the time of a simulation, and one of two publishers leaves out a field."""
    item = Sum("torque", Topics.parse({"torque": {"sum": [{**LEFT, "field": "effort[l]"}, LEFT]}})["torque"])
    results = [item.add(part, START, START, value) for part, value in ((0, 1.0), (0, 2.0), (1, 10.0))]
    assert results == [[], [], [(START, 12.0)]]
    assert item.lone_samples == 1


STEPS = st.lists(st.tuples(st.booleans(), st.integers(-20, 700), st.floats(-1e3, 1e3)), min_size=1, max_size=25)


def messages(steps: list[tuple[bool, int, float]]) -> list[tuple[str, int, dict[str, float]]]:
    sides, place = [], START
    for remainder, step, value in steps:
        place += step * MS
        sides.append(("/left" if remainder else "/right", place, {"s": 1e6 if remainder else value}))
    return sides


@given(STEPS)
def test_a_sum_is_never_half_and_at_a_time_of_the_first(steps):
    sides = messages(steps)
    sums = live(TWO, sides)
    assert all(abs(value + 1e6 + 5.0) <= 1e6 + 1.0 and value != -1e6 for _, value in sums)
    assert {stamp + 100 * MS for stamp, _ in sums} <= {stamp for topic, stamp, _ in sides if topic == "/left"}


@settings(max_examples=20)
@given(STEPS)
def test_live_adds_as_a_bag_does(tmp_path_factory, steps):
    sides = messages([(True, 0, 1.0), (False, 0, 1.0), *steps])
    result = tr.read(write(tmp_path_factory.mktemp("t") / "run.mcap", sides), topics=TWO).series["torque"]
    assert list(zip(result.stamp_ns.tolist(), result.value.tolist(), strict=True)) == live(TWO, sides)


def test_a_bag_without_torque_names_the_topics_that_may_hold_it(tmp_path, trackres):
    path = write(tmp_path / "run.mcap", [("/left", START, {"s": 1.0}), ("/right", START, {"s": 1.0})])
    result = tr.read(path, topics={"speed": SPEED})
    assert "no torque channel is in use; candidates: /left, /right" in result.notes
    with pytest.raises(tr.InputError, match=r"/left, /right: .*: torque: \{topic: NAME, type: TYPE.*\[\{topic: \.\.\."):
        tr.diagnose(result, "agri3t")
    with pytest.raises(tr.InputError, match=r"topics file: torque: \{topic: NAME, type: TYPE, field: FIELD\}$"):
        tr.diagnose(replace(result, torque_candidates=()), "agri3t")
    (tmp_path / "topics.yaml").write_text(yaml.safe_dump({"speed": SPEED}))
    outcome = trackres("diagnose", path, "--topics", tmp_path / "topics.yaml", "--vehicle", "xgd24d", "-o", tmp_path / "report")
    assert outcome.returncode == 2
    assert (
        "it may be in /left, /right: give it in a topics file: torque: {topic: NAME, type: TYPE, field: FIELD}" in outcome.stderr
    )


def of_line(**line):
    return Topics.parse({"torque": line})["torque"]


@pytest.mark.parametrize("by", [Conversion(2.0), Conversion(1e-3), Conversion(-1.0, 7.0), Conversion(offset=-8.0)])
@pytest.mark.parametrize(
    "before",
    [
        TWO["torque"],
        TopicBinding(column="a", scale=1000.0, unit="kNm"),  # the unit is the file's
        of_line(column="a", scale=1.0, offset=5.0),  # without its scale it would be in the file's unit
        *(of_line(column="a", unit=unit, scale=3.0, offset=0.5) for unit in UNITS["Nm"]),
    ],
    ids=str,
)
def test_a_corrected_line_converts_the_values_read_with_the_old(before, by):
    (result_after,) = correct_bindings("torque", by, {"torque": before}).values()
    read = Topics.parse(yaml.safe_load(line_of("torque", result_after)))["torque"]
    assert read.converts
    assert replace(read, scale=1.0, offset=0.0, unit="", converts=False) == replace(
        before, scale=1.0, offset=0.0, unit="", converts=False
    )
    for raw in (0.0, 40.0):
        value = before.scale * raw + before.offset
        assert read.scale * raw + read.offset == pytest.approx(by.scale * value + by.offset, rel=1e-4)


def test_an_offset_is_divided_among_the_parts_of_a_role():
    given_valuess = {"torque/left": TopicBinding(column="l"), "torque/right": TopicBinding(column="r", offset=3.0)}
    assert [binding.offset for binding in correct_bindings("torque", Conversion(offset=-8.0), given_valuess).values()] == [
        -4.0,
        -1.0,
    ]
    other = {"torque": TopicBinding(column="c")}
    texts = [
        line_to_write("torque", Conversion(-1.0), *item) for item in ((other,), (given_valuess,), (other, given_valuess, other))
    ]
    assert texts[2].split(" should be ")[1] == ", for other recordings ".join(
        entry.split(" should be ")[1] for entry in texts[:2]
    )


PART = {"column": "a"}


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ({"sum": [PART]}, "a list of 2 to 16 parts"),
        ({"sum": PART}, "a list of 2 to 16 parts"),
        ({"sum": [PART, 3]}, "part 2: given 3"),
        ({"sum": [PART, PART]}, "the same part twice"),
        ({"sum": [PART, {"column": "b", "delay_s": 0.1}]}, "part 2: delay_s: given 'delay_s'"),
        ({"sum": [PART, {"sum": [PART, PART]}]}, "part 2: sum: given 'sum'"),
        ({"sum": [PART, LEFT]}, "columns and topics"),
        ({"sum": [PART, {"column": "b", "scale": 0}]}, "part 2: scale"),
        ({"sum": [PART, {"column": "b"}], "column": "c"}, "column in a part of the sum"),
        ({"sum": [LEFT, {**LEFT, "field": "effort[t]", "stamp": "log"}]}, "one stamp for all parts of a topic"),
        ({"sum": [LEFT, {**LEFT, "topic": ""}]}, "part 2: topic"),
    ],
)
def test_a_sum_that_is_none_is_refused(line, says):
    with pytest.raises(InputError) as error_info:
        Topics.parse({"torque": line}, "topics.yaml")
    assert says in str(error_info.value)
    assert "topics.yaml: torque" in str(error_info.value)
    with pytest.raises(InputError, match="not an angle"):
        Topics.parse({"heading": {"sum": [PART, {"column": "b"}]}})
