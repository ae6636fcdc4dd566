# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Position, passengers and brakes of a recording: units from the values, and keys of a topics file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

import trackres_ros as tr
from trackres_ros.recording.bindings import TopicBinding, Topics
from trackres_ros.recording.combining import PositionUnits
from trackres_ros.recording.guessing import guess
from trackres_ros.recording.samples import SampleBlock
from trackres_ros.units import GRAVITY

ROLES = ("latitude", "longitude")
BY_VALUES = {role: TopicBinding(column=role) for role in ROLES}
FIX = "sensor_msgs/msg/NavSatFix"


def block(latitude: float, longitude: float) -> SampleBlock:
    zeros = np.zeros(2, np.int64)
    return SampleBlock(np.array([0, 1], np.int16), zeros, zeros, np.array([latitude, longitude]))


def table(folder: Path, **columns: np.ndarray) -> Path:
    path = folder / "drive.csv"
    rows = np.column_stack(list(columns.values()))
    lines = [",".join("" if np.isnan(x) else repr(float(x)) for x in row) for row in rows]
    path.write_text("\n".join([",".join(columns), *lines, ""]), encoding="utf-8")
    return path


@given(st.floats(-90.0, 90.0), st.floats(-180.0, 180.0))
def test_a_position_on_land_reads_alike_in_degrees_and_radians(latitude: float, longitude: float) -> None:
    assume(abs(latitude) > 1.6 or abs(longitude) > 3.2)  # there is no land else
    assume(latitude and longitude)
    want = np.radians([latitude, longitude])
    degrees, radians = PositionUnits(BY_VALUES), PositionUnits(BY_VALUES)
    np.testing.assert_allclose(degrees.in_radians(block(latitude, longitude), ROLES).value, want, rtol=1e-12)
    np.testing.assert_array_equal(radians.in_radians(block(*want), ROLES).value, want)
    assert "degrees" in degrees.notes[0]
    assert "radians" in radians.notes[0]


def test_a_receiver_without_a_fix_says_nothing_of_the_unit() -> None:
    units = PositionUnits(BY_VALUES)
    for nothing in (block(np.nan, np.nan), block(0.0, 0.0)):
        assert np.isnan(units.in_radians(nothing, ROLES).value).all()
    assert not units.notes
    np.testing.assert_allclose(units.in_radians(block(47.4, 8.5), ROLES).value, np.radians([47.4, 8.5]))
    np.testing.assert_allclose(units.in_radians(block(1.3, 1.0), ROLES).value, np.radians([1.3, 1.0]))  # what it is, it stays


def test_one_unit_that_is_said_holds_for_both() -> None:
    units = PositionUnits({"latitude": TopicBinding(column="a", unit="deg"), "longitude": TopicBinding(column="b")})
    np.testing.assert_allclose(units.in_radians(block(0.01, 1.0), ROLES).value, [0.01, np.radians(1.0)])
    assert units.notes == ("longitude: treated as degrees, as latitude",)


def test_columns_by_name_and_by_file(tmp_path: Path) -> None:
    time, speed, latitude, longitude = np.arange(5.0), np.ones(5), np.linspace(47.40, 47.41, 5), np.linspace(8.50, 8.51, 5)
    path = table(tmp_path, time_s=time, speed_mps=speed, latitude_deg=latitude, longitude_deg=longitude, altitude_m=400.0 + time)
    read = tr.read(path)
    np.testing.assert_allclose(read.series["latitude"].value, np.radians(latitude))
    np.testing.assert_allclose(read.series["longitude"].value, np.radians(longitude))
    np.testing.assert_array_equal(read.series["altitude"].value, 400.0 + time)
    path = table(tmp_path, ms=1e3 * time, v=speed, lat=latitude, lon=longitude)
    topics = {role: {"column": column} for role, column in (("speed", "v"), ("latitude", "lat"), ("longitude", "lon"))}
    read = tr.read(path, topics={"time": {"column": "ms", "scale": 1e-3}, **topics})
    np.testing.assert_allclose(read.series["longitude"].value, np.radians(longitude))
    assert "latitude, longitude: treated as degrees, by the values" in read.notes
    np.testing.assert_allclose(read.time_s("speed"), time)


def test_a_fix_is_in_degrees() -> None:
    line = {"topic": "/gps", "type": FIX, "field": "latitude"}
    assert Topics.parse({"latitude": line})["latitude"].scale == pytest.approx(np.pi / 180.0)
    assert Topics.parse({"latitude": {**line, "unit": "rad"}})["latitude"].scale == 1.0
    topics, notes = guess({"/gps": FIX, "/odom": "nav_msgs/msg/Odometry"})
    assert topics["longitude"].scale == pytest.approx(np.pi / 180.0)
    assert topics["altitude"].scale == 1.0
    assert any(note.startswith("latitude: guessed from /gps") and "in degrees" in note for note in notes)


def test_a_brake_is_on_from_its_threshold() -> None:
    switch, pressure = np.array([0.0, 1.0, 0.0]), np.array([0.0, 900.0, 2.5e5])
    assert 0.0 < TopicBinding().brakes_from(switch) < 1.0
    assert 900.0 < TopicBinding().brakes_from(pressure) < 2.5e5
    assert TopicBinding(threshold=3e4).brakes_from(pressure) == 3e4


def test_passengers_add_weight_in_a_replay_that_has_positions(tmp_path: Path) -> None:
    time = np.arange(120.0)
    count = np.full(120, np.nan)
    count[[30, 60]] = 10.0, 25.0
    speed = np.full(120, 5.0)
    position = {"latitude_deg": 47.0 + 1e-6 * time, "longitude_deg": 8.0 + 1e-6 * time, "brake_pa": 0.0 * time}
    path = table(tmp_path, time_s=time, speed_mps=speed, passengers=count, **position)
    topics = {"passengers": {"column": "passengers", "kg_each": 80.0}}
    weight = tr.replay(path, "xgd24d", topics=topics)["weight_n"]
    of_each = 80.0 * GRAVITY
    np.testing.assert_allclose(weight[35] - weight[20], 10.0 * of_each, rtol=1e-9)
    np.testing.assert_allclose(weight[-1] - weight[20], 25.0 * of_each, rtol=1e-9)
    loaded = table(tmp_path, time_s=time, speed_mps=speed, passengers=count, weight_n=np.full(120, 250e3))
    np.testing.assert_allclose(tr.replay(loaded, "xgd24d")["weight_n"], 250e3)


def test_one_line_names_both_halves_of_a_position() -> None:
    topics = Topics.parse({"position": {"topic": "/gps", "type": "sensor_msgs/NavSatFix", "max_age_s": 3.0}})
    assert set(topics) == {"latitude", "longitude"}
    for role in topics:
        assert (topics[role].topic, topics[role].type, topics[role].field) == ("/gps", FIX, role)
        assert topics[role].scale == pytest.approx(np.pi / 180.0)
        assert topics[role].max_age_s == 3.0
    assert Topics.parse({"position": {"topic": "/gps"}}).bindings == {
        **Topics.parse({role: {"topic": "/gps", "type": FIX, "field": role} for role in ROLES}).bindings
    }
    pose = {"topic": "/pose", "type": "geographic_msgs/msg/GeoPoseStamped", "field": "pose.position", "unit": "deg"}
    assert Topics.parse({"position": pose})["longitude"].field == "pose.position.longitude"


UNKNOWN, NO_FIX, FIXED, AUGMENTED = -2, -1, 0, 2  # NavSatStatus.msg
STATES = (FIXED, NO_FIX, AUGMENTED, NO_FIX, UNKNOWN, FIXED)


def fixes(store: Any) -> list[Any]:
    """Messages of a receiver that loses its fix and repeats the last one."""
    from ros_messages import build, stamped

    return [
        build(
            FIX, store, header=stamped((1_700_000_000 + i) * 10**9, "gps"), status={"status": status, "service": 1},
            latitude=47.0 + 0.001 * i, longitude=8.0 + 0.002 * i, altitude=400.0 + i,
        )
        for i, status in enumerate(STATES)
    ]  # fmt: skip


def test_without_a_fix_there_is_no_position_live_nor_in_a_bag(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    from trackres_ros.estimator.columns import CHANNELS
    from trackres_ros.node.inputs import InputReader
    from trackres_ros.node.transport import input_topics

    store = get_typestore(Stores.ROS2_JAZZY)
    speed = {"topic": "/speed", "type": "std_msgs/msg/Float64", "field": "data"}
    topics = Topics.parse({"position": {"topic": "/gps"}, "speed": speed})
    number = store.types["std_msgs/msg/Float64"]
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        item = {t: writer.add_connection(t, k, typestore=store) for t, k in (("/gps", FIX), ("/speed", "std_msgs/msg/Float64"))}
        for i, fix in enumerate(fixes(store)):
            writer.write(item["/gps"], (1_700_000_000 + i) * 10**9, store.serialize_cdr(fix, FIX))
            writer.write(
                item["/speed"], (1_700_000_000 + i) * 10**9 + 1, store.serialize_cdr(number(5.0), "std_msgs/msg/Float64")
            )
    there = np.array([status != NO_FIX for status in STATES])
    want = {"latitude": np.radians(47.0 + 0.001 * np.arange(6)), "longitude": np.radians(8.0 + 0.002 * np.arange(6))}
    read = tr.read(tmp_path / "bag", topics=topics)
    reader = InputReader(input_topics(topics, on_route=True)[:1], CHANNELS, topics.bindings)
    live = np.array([reader.read(0, fix)[1] for fix in fixes(store)])
    for column, (role, values) in enumerate(want.items()):
        shown = np.where(there, values, np.nan)
        np.testing.assert_allclose(read.series[role].value, shown)
        np.testing.assert_allclose(live[:, column], shown)


def test_a_vehicle_without_a_route_listens_to_no_position() -> None:
    from trackres_ros.node.transport import input_topics

    topics = Topics.parse({"position": {"topic": "/gps"}, "speed": {"topic": "/s", "type": "std_msgs/Float64", "field": "data"}})
    assert [topic.name for topic in input_topics(topics)] == ["/s"]
    assert [topic.valued for topic in input_topics(topics, on_route=True)] == [("latitude", "longitude"), ("speed",)]
