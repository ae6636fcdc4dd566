# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Bags of every kind give the same as the library's own decoding; others can read the written ones."""

from __future__ import annotations

import itertools
import shutil
import sqlite3
import sys
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import trackres_ros as tr
from trackres_ros.errors import InputError, MissingExtraError
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.mcap import HEADER, MAGIC, record, text
from trackres_ros.recording.opening import open_source
from trackres_ros.recording.recording import Recording

pytest.importorskip("rosbags")

from ros_messages import build, fill, stamped, twist
from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from trackres_ros.output.mcap import BagWriter

STORE = get_typestore(Stores.LATEST)
STORE1 = get_typestore(Stores.ROS1_NOETIC)
START = 1_700_000_000 * 10**9
ODOMETRY, JOINTS, TWIST = "nav_msgs/msg/Odometry", "sensor_msgs/msg/JointState", "geometry_msgs/msg/TwistStamped"
TOPICS = Topics.parse(
    {
        "speed": {"topic": "/odom", "type": ODOMETRY, "field": "twist.twist.linear.x", "scale": 0.5, "offset": 1},
        "yaw_rate": {"topic": "odom", "type": ODOMETRY, "field": "twist.twist.angular.z", "stamp": "log"},
        "torque": {"topic": "/joints", "type": "sensor_msgs/JointState", "field": "effort[right]"},
        "load/front": {"topic": "/weight", "type": "std_msgs/msg/Float64", "field": "data"},
    },
    "topics.yaml",
)


def lines_of(*roles: str) -> dict[str, dict[str, str]]:
    return {role: {"topic": TOPICS[role].topic, "type": TOPICS[role].type, "field": TOPICS[role].field} for role in roles}


def odometry(store: Any, stamp_ns: int, number: float, frame: str = "odom") -> Any:
    header = {"seq": 7, **stamped(stamp_ns, frame)}  # of ROS 1
    return build(ODOMETRY, store, header=header, twist={"twist": {**twist(number), "angular": {"z": -number}}})


def joints(store: Any, stamp_ns: int, names: list[str], effort: list[float]) -> Any:
    return build(JOINTS, store, header=stamped(stamp_ns, ""), name=names, effort=np.array(effort))


def traffic(store: Any, count: int = 300, start_ns: int = START) -> Iterator[tuple[str, str, int, Any]]:
    """Yield topic, type, log time and message, of several topics with strings that change."""
    for row in range(count):
        stamp = start_ns + row * 20_000_000
        at_once = [("/odom", ODOMETRY, stamp + 3_000_000, odometry(store, stamp, np.sin(row), "odom" if row % 7 else "x"))]
        if row % 3 == 0:
            names = ["left", "right"] if row % 2 else ["right"]
            at_once += [("/joints", JOINTS, stamp + 3_000_000, joints(store, stamp - 1, names, [float(row)] * len(names)))]
        yield from at_once[:: 1 - 2 * (row % 2)]
        if row % 5 == 0:
            yield "/weight", "std_msgs/msg/Float64", stamp + 4_000_000, store.types["std_msgs/msg/Float64"](2e5 + row)
        yield "/chatter", "std_msgs/msg/String", stamp + 5_000_000, store.types["std_msgs/msg/String"]("x" * row)


def write(path: Path, storage: str = "sqlite3", compression: str = "", **kwargs: int) -> Path:
    writer = Writer(path, version=9, storage_plugin=StoragePlugin[storage.upper()])
    if compression:
        writer.set_compression(CompressionMode[compression.upper()], CompressionFormat.ZSTD)
    fill(writer, serialized(STORE, STORE.serialize_cdr, **kwargs), STORE)
    return path


def write1(path: Path, **kwargs: int) -> Path:
    fill(Writer1(path), serialized(STORE1, STORE1.serialize_ros1, **kwargs), STORE1)
    return path


def serialized(store: Any, serialize: Callable[[Any, str], Any], **kwargs: int) -> Iterator[tuple[str, str, int, Any]]:
    return ((topic, kind, log_ns, serialize(message, kind)) for topic, kind, log_ns, message in traffic(store, **kwargs))


def by_library(path: Path) -> list[tuple[str, int, int, float]]:
    """Return role, stamp, log time and value of every sample, message by message, as the library decodes it."""
    rows = []
    item = path.suffix == ".bag"
    with Reader1(path) if item else Reader(path) as reader:
        for connection, log_ns, raw in reader.messages():
            kind = connection.msgtype
            message: Any = STORE1.deserialize_ros1(raw, kind) if item else STORE.deserialize_cdr(raw, kind)
            stamp = getattr(message, "header", None)
            stamp_ns = stamp.stamp.sec * 10**9 + stamp.stamp.nanosec if stamp is not None else log_ns
            for role in TOPICS:
                if TOPICS[role].topic.lstrip("/") == connection.topic.lstrip("/"):
                    when = log_ns if TOPICS[role].stamp == "log" else stamp_ns
                    rows.append((role, when, log_ns, TOPICS[role].read(message)))
    return rows


def by_blocks(source: Any, max_rows: int = 65536) -> list[tuple[str, int, int, float]]:
    rows = []
    for block in source.blocks(max_rows):
        assert 0 < len(block) <= max(max_rows, 2)
        rows += list(
            zip(
                [source.roles[index] for index in block.role],
                block.stamp_ns.tolist(),
                block.arrival_ns.tolist(),
                block.value.tolist(),
                strict=True,
            )
        )
    return rows


def in_order(rows: list[tuple[str, int, int, float]]) -> list[tuple[str, int, int, float]]:
    """Put the roles of one moment into one order; the order of moments stays."""
    return [row for _, group in itertools.groupby(rows, key=lambda row: row[2]) for row in sorted(group)]


@pytest.mark.parametrize(
    ("storage", "compression"),
    [*itertools.product(("sqlite3", "mcap"), ("", "file", "message")), ("mcap", "storage")],
)
def test_ros2_bags(tmp_path: Path, storage: str, compression: str) -> None:
    path = write(tmp_path / "bag", storage, compression)
    source = open_source([path], TOPICS)
    want = by_library(path)
    got = by_blocks(source)
    assert in_order(got) == in_order(want)
    assert len(got) == 300 * 2 + 100 + 60
    assert by_blocks(source, 3) == got
    assert by_blocks(source) == got
    assert source.findings == ()


def test_a_torque_that_comes_late_is_of_an_earlier_time(tmp_path: Path) -> None:
    joints = {"topic": "/joints", "type": "sensor_msgs/JointState", "field": "effort[right]"}
    (tmp_path / "run.csv").write_text("time_s,speed_mps,torque_nm\n" + "".join(f"{t},5.0,{100 * t}\n" for t in range(5)))
    for path, line, speed in (
        (write(tmp_path / "bag", "mcap", count=30), joints, lines_of("speed")["speed"]),
        (tmp_path / "run.csv", {"column": "torque_nm"}, {"column": "speed_mps"}),
    ):
        late, as_stamped = (
            open_source([path], Topics.parse({"speed": speed, "torque": {**line, "delay_s": delay}})) for delay in (0.25, 0.0)
        )
        shifted, torque = ([row for row in by_blocks(item) if row[0] == "torque"] for item in (late, as_stamped))
        assert len(shifted) >= 5
        assert shifted == [(role, stamp - 250_000_000, arrival, value) for role, stamp, arrival, value in torque]
        assert late.bindings["torque"].delay_s == 0.25


@pytest.mark.parametrize("name", ["run%201", "what?", "a#1"])
def test_a_database_is_read_by_any_name(tmp_path: Path, name: str) -> None:
    plain = write(tmp_path / "plain", count=20)
    shutil.copy(write(tmp_path / "other", count=10) / "other.db3", tmp_path / "run 1.db3")
    path = Path(shutil.copytree(plain, tmp_path / name))
    file = (path / "plain.db3").rename(path / f"{name}.db3")
    metadata = (path / "metadata.yaml").read_text()
    (path / "metadata.yaml").write_text(metadata.replace("plain.db3", file.name))
    want = by_blocks(open_source([plain], TOPICS))
    assert by_blocks(open_source([path], TOPICS)) == want
    assert by_blocks(open_source([Path(shutil.copy(file, tmp_path))], TOPICS)) == want


@pytest.mark.parametrize("mode", ["wal", "persist"])
def test_a_database_that_was_not_closed_is_refused(tmp_path: Path, mode: str) -> None:
    """The remedy makes it readable, with all that was written."""
    file = write(tmp_path / "bag", count=100) / "bag.db3"
    broken = Path(shutil.copytree(file.parent, tmp_path / "broken")) / "bag.db3"
    with closing(sqlite3.connect(file)) as database:
        database.execute("PRAGMA cache_size = 1")
        database.execute(f"PRAGMA journal_mode = {mode}")
        database.execute("UPDATE messages SET timestamp = timestamp + 1")
        if mode == "wal":
            database.commit()
        for item in file.parent.iterdir():
            shutil.copy(item, broken.parent)  # as after a kill
        database.rollback()
    for path in (broken, broken.parent):
        with pytest.raises(InputError, match=r"changes in bag\.db3-.*pragma journal_mode=delete"):
            open_source([path], TOPICS)
    with closing(sqlite3.connect(broken)) as database:
        database.execute("pragma journal_mode=delete")
    want = by_blocks(open_source([file], TOPICS))
    assert by_blocks(open_source([broken], TOPICS)) == by_blocks(open_source([broken.parent], TOPICS)) == want


def test_a_ros1_bag(tmp_path: Path) -> None:
    path = write1(tmp_path / "run.bag")
    got = by_blocks(open_source([path], TOPICS))
    assert in_order(got) == in_order(by_library(path))
    assert len(got) == 760
    assert got == by_blocks(open_source([write(tmp_path / "bag", "mcap")], TOPICS))  # in this order too


def test_bags_one_after_another(tmp_path: Path) -> None:
    first = write(tmp_path / "first", "mcap", count=30)
    second = write(tmp_path / "second", "sqlite3", count=30, start_ns=START + 10**10)
    third = write1(tmp_path / "third.bag", count=30, start_ns=START + 2 * 10**10)
    got = by_blocks(open_source([first, second, third], TOPICS))
    want = [by_blocks(open_source([path], TOPICS)) for path in (first, second, third)]
    assert got == [*want[0], *want[1], *want[2]]


def test_bags_in_the_wrong_order_last_as_long(tmp_path: Path) -> None:
    kind, lines = "std_msgs/msg/Float64", {"speed": {"topic": "/speed", "type": "std_msgs/msg/Float64", "field": "data"}}
    paths = [tmp_path / "first.mcap", tmp_path / "second.mcap"]
    for path, begin_ns in zip(paths, (START, START + 10 * 10**9), strict=True):
        with BagWriter(path) as bag:
            topic, number = bag.topic("/speed", kind), bag.typestore.types[kind]
            for at_ns in range(begin_ns, begin_ns + 10 * 10**9, 10**8):
                bag.write(topic, number(5.0), at_ns, at_ns)
    there, back = (tr.replay(order, "xgd24d", topics=lines) for order in (paths, paths[::-1]))
    assert there.duration_s == pytest.approx(19.9)
    assert back.duration_s == pytest.approx(2 * 9.9)


def test_a_bag_split_into_files(tmp_path: Path) -> None:
    path = write(tmp_path / "bag", count=40)
    other = write(tmp_path / "other", count=40, start_ns=START + 10**10)
    want = by_blocks(open_source([path, other], TOPICS))
    shutil.copy(other / "other.db3", path / "other.db3")
    metadata = (path / "metadata.yaml").read_text()
    assert metadata.count("- bag.db3") == 1
    (path / "metadata.yaml").write_text(metadata.replace("- bag.db3", "- bag.db3\n  - other.db3"))
    source = open_source([path], TOPICS)
    assert by_blocks(source) == want


def test_notes_say_what_is_read_and_which_stamps(tmp_path: Path) -> None:
    notes = open_source([write(tmp_path / "bag", count=3)], TOPICS).notes
    assert f"speed: /odom ({ODOMETRY}, twist.twist.linear.x), header stamps" in notes
    assert any(note.startswith("yaw_rate") and note.endswith("log time, as the topics file says") for note in notes)
    assert any(note.startswith("load/front") and note.endswith("std_msgs/msg/Float64 has no stamp") for note in notes)


@pytest.mark.parametrize(
    ("role", "change", "says"),
    [
        (
            "speed",
            {"topic": "/odm"},
            ["topics.yaml: speed: topic", "/odm", "/chatter (std_msgs/msg/String)", "/odom", "did you mean /odom?"],
        ),
        ("speed", {"field": "twist.linear.x"}, ["speed: field", "fields of geometry_msgs/msg/TwistWithCovariance: twist"]),
        ("speed", {"type": "geometry_msgs/msg/Twist"}, ["speed: type", ODOMETRY]),
        ("load/front", {"stamp": "header"}, ["load/front: stamp", "std_msgs/msg/Float64 has no stamp"]),
        ("torque", {"field": "effort"}, ["torque: field", "an index, as effort[0]"]),
        ("speed", None, ["topics.yaml: speed", "add a line for it"]),
    ],
)
def test_refused_with_what_is_there(tmp_path: Path, role: str, change: dict[str, str] | None, says: list[str]) -> None:
    lines = lines_of(*TOPICS)
    lines[role] |= change or {}
    lines = lines if change else {"load/front": lines["load/front"]}
    with pytest.raises(InputError) as error_info:
        open_source([write(tmp_path / "bag", count=3)], Topics.parse(lines, "topics.yaml"))
    for part in says:
        assert part in str(error_info.value)


MINE = f"uint8 id\nmy_msgs/Inner[2] inner\n{'=' * 80}\nMSG: my_msgs/Inner\nstring note\nfloat32 speed\n"


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_types_that_only_the_bag_knows(tmp_path: Path, storage: str) -> None:
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(MINE, "my_msgs/msg/Mine"))
    inner, mine = store.types["my_msgs/msg/Inner"], store.types["my_msgs/msg/Mine"]
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin[storage.upper()]) as writer:
        topic = writer.add_connection("/mine", "my_msgs/msg/Mine", typestore=store)
        for row in range(20):
            message = mine(1, [inner("a" * row, 0.0), inner("", row / 4)])
            writer.write(topic, START + row, store.serialize_cdr(message, "my_msgs/msg/Mine"))
    line = {"topic": "/mine", "type": "my_msgs/msg/Mine", "field": "inner[1].speed"}
    rows = by_blocks(open_source([tmp_path / "bag"], Topics.parse({"speed": line})))
    assert [value for *_, value in rows] == [row / 4 for row in range(20)]


def test_damaged_and_odd_messages_are_counted_and_kept(tmp_path: Path) -> None:
    with Writer(tmp_path / "bag", version=9) as writer:
        odom = writer.add_connection("/odom", ODOMETRY, typestore=STORE)
        joint = writer.add_connection("/joints", JOINTS, typestore=STORE)
        writer.write(joint, START - 10**9, STORE.serialize_cdr(joints(STORE, START - 10**9, ["right"], [1.0]), JOINTS))
        for row in range(50):
            raw = bytes(STORE.serialize_cdr(odometry(STORE, START + (row or 7), float(row)), ODOMETRY))
            writer.write(odom, START + row, raw[:40] if row == 20 else raw)
            names = ["left"] if row < 5 else ["right"]
            efforts = [] if row == 49 else [1.0]
            writer.write(joint, START + row, STORE.serialize_cdr(joints(STORE, START + row, names, efforts), JOINTS))
    recording = Recording.from_source(open_source([tmp_path / "bag"], Topics.parse(lines_of("speed", "torque"))))
    assert np.flatnonzero(np.isnan(recording.series["speed"].value)).tolist() == [20]
    assert recording.series["speed"].stamp_ns[20] == START + 20
    assert len(recording.series["torque"]) == 45
    counts = {(finding.role, finding.kind): finding.count for finding in recording.findings}
    places = {(finding.role, finding.kind): finding.first_time_s for finding in recording.findings}
    assert (places["speed", "malformed"], places["speed", "non_finite"]) == (20e-9, 13e-9)  # of log and stamp
    assert counts["speed", "malformed"] == 1
    assert counts["speed", "non_finite"] == 1
    assert counts["torque", "absent"] == 6
    reasons = "its names are left, or the array effort has no elements"
    assert any(f"6 messages do not have effort[right]: {reasons};" in finding.text for finding in recording.findings)


def test_defects_have_times_where_no_speed_is_valid(tmp_path: Path) -> None:
    with Writer(tmp_path / "bag", version=9) as writer:
        odom = writer.add_connection("/odom", ODOMETRY, typestore=STORE)
        for row in range(50):
            raw = bytes(STORE.serialize_cdr(odometry(STORE, START + row * 10**8, float(row)), ODOMETRY))
            writer.write(odom, START + row * 10**8, raw[:40])
    recording = Recording.from_source(open_source([tmp_path / "bag"], Topics.parse(lines_of("speed"))))
    assert {finding.first_time_s for finding in recording.findings if finding.kind == "malformed"} == {0.0}
    assert all(not finding.first_time_s > 5.0 for finding in recording.findings)


def test_messages_the_metadata_promises(tmp_path: Path) -> None:
    path = write(tmp_path / "bag", count=5)
    metadata = (path / "metadata.yaml").read_text()
    (path / "metadata.yaml").write_text(metadata.replace("message_count: 5", "message_count: 8"))
    recording = Recording.from_source(open_source([path]))
    assert {(finding.kind, finding.count) for finding in recording.findings if finding.role == "speed"} >= {("missing", 3)}


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
@pytest.mark.parametrize("keep", [0.0, 0.3, 0.8])
def test_a_file_that_was_cut_off(tmp_path: Path, storage: str, keep: float) -> None:
    path = write(tmp_path / "bag", storage)
    file = next(item for item in path.iterdir() if item.suffix in (".db3", ".mcap"))
    raw = file.read_bytes()
    file.write_bytes(raw[: int(len(raw) * keep)])
    with pytest.raises(InputError, match="bag") as error_info:
        by_blocks(open_source([file], TOPICS))
    assert "\n" not in str(error_info.value)


def test_paths_that_are_no_recording(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "files").mkdir()
    (tmp_path / "files" / "run_0.mcap").touch()
    (tmp_path / "run.txt").touch()
    (tmp_path / "run.csv").touch()
    (tmp_path / "bad.bag").write_bytes(b"#ROSBAG V2.0\n")
    (tmp_path / "whole.mcap").write_bytes(MAGIC + record(HEADER, text("") + text("a library")))
    for paths, says in [
        ([], "no path"),
        (["none.mcap"], "no such file or folder"),
        (["empty"], "without metadata.yaml"),
        (["files"], "run_0.mcap"),
        (["run.txt"], r"\.txt"),
        (["run.csv", "run.csv"], "give them one at a time"),
        (["bad.bag"], "rosbag reindex"),
        (["whole.mcap"], "of another profile, or of none"),
    ]:
        with pytest.raises(InputError, match=says):
            open_source([tmp_path / path for path in paths])


def test_without_the_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path / "bag", count=3)
    for name in [name for name in sys.modules if name.partition(".")[0] == "rosbags"]:
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setitem(sys.modules, "rosbag2_py", None)  # with ROS 2, its libraries read the bag
    with pytest.raises(MissingExtraError, match="pip install rosbags"):
        open_source([path])


def test_memory_does_not_grow_with_the_bag(tmp_path: Path, peak_of: Any) -> None:
    peaks = []
    for count in (20_000, 60_000):  # both of many chunks, of which a reader holds a few
        path = tmp_path / f"{count}.mcap"
        write_outputs(path, count)
        source = open_source([path])
        read, peak = peak_of(lambda source=source: sum(map(len, source.blocks(512))))
        assert read == count
        peaks.append(peak)
    assert peaks[1] < 1.1 * peaks[0], peaks


def write_outputs(path: Path, count: int, at_once: int = 256) -> None:
    """Write torques and a speed, in blocks, as a replay does."""
    with BagWriter(path) as writer:
        store = writer.typestore
        torque = writer.topic(
            "/trackres/resistance_torque",
            JOINTS,
            joints(store, 0, ["total", "wind"], [0.0, 0.0]),
            ["effort[total]", "effort[wind]"],
        )
        speed = writer.topic("/vehicle/speed", TWIST, build(TWIST, store, header=stamped(0)), ["twist.linear.x"])
        note = writer.topic("/trackres/status", "std_msgs/msg/String")
        for start in range(0, count, at_once):
            row = np.arange(start, min(start + at_once, count))
            stamp = START + 10_000_000 * row
            writer.write_block(torque, stamp, stamp + 5, np.stack([row * 1.5, -row], axis=1))
            writer.write_block(speed, stamp, stamp + 5, row[:, None] / 8)
            writer.write(note, store.types["std_msgs/msg/String"](f"from {start}"), 0, int(stamp[0]))


def check_outputs(rows: list[tuple[str, int, Any]], count: int) -> None:
    torques = [(log, message) for topic, log, message in rows if topic == "/trackres/resistance_torque"]
    assert [log for log, _ in torques] == [START + 10_000_000 * row + 5 for row in range(count)]
    assert all(list(message.name) == ["total", "wind"] for _, message in torques)
    assert [list(message.effort) for _, message in torques] == [[row * 1.5, -row] for row in range(count)]
    assert [message.header.stamp.sec * 10**9 + message.header.stamp.nanosec for _, message in torques] == [
        START + 10_000_000 * row for row in range(count)
    ]
    assert all(message.header.frame_id == "base_link" for topic, _, message in rows if topic == "/vehicle/speed")
    assert [message.data for topic, _, message in rows if topic == "/trackres/status"] == [
        f"from {start}" for start in range(0, count, 256)
    ]


@pytest.mark.parametrize("count", [0, 1, 300, 12_000])
def test_what_is_written_the_library_reads(tmp_path: Path, count: int) -> None:
    path = tmp_path / "out.mcap"
    path.write_text("old")
    write_outputs(path, count)
    assert [item.name for item in tmp_path.iterdir()] == ["out.mcap"]
    with Reader(path) as reader:
        assert reader.message_count == 2 * count + -(-count // 256)
        assert {item.topic for item in reader.connections} == {
            "/trackres/resistance_torque",
            "/vehicle/speed",
            "/trackres/status",
        }
        if count:
            assert (reader.start_time, reader.end_time) == (START, START + 10_000_000 * (count - 1) + 6)
        rows = [(item.topic, log, STORE.deserialize_cdr(raw, item.msgtype)) for item, log, raw in reader.messages()]
    assert [log for _, log, _ in rows] == sorted(log for _, log, _ in rows)
    check_outputs(rows, count)
    first = path.read_bytes()
    write_outputs(path, count)
    assert path.read_bytes() == first


def test_what_is_written_another_library_reads(tmp_path: Path) -> None:
    """The reference implementation of the format reads the file by its index and from front to end."""
    reader = pytest.importorskip("mcap.reader")
    path = tmp_path / "out.mcap"
    write_outputs(path, 1000)
    for make in (reader.make_reader, lambda file: reader.NonSeekingReader(file, validate_crcs=True)):
        with path.open("rb") as file:
            read = make(file)
            rows = []
            for schema, channel, message in read.iter_messages(log_time_order=True):
                assert (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr")
                assert schema.data.decode() == STORE.generate_msgdef(schema.name, ros_version=2)[0]
                rows.append((channel.topic, message.log_time, STORE.deserialize_cdr(message.data, schema.name)))
        check_outputs(rows, 1000)


def test_nothing_is_left_or_lost_when_writing_fails(tmp_path: Path) -> None:
    path = tmp_path / "out.mcap"
    path.write_text("old")
    with pytest.raises(InputError, match="unknown"), BagWriter(path) as writer:
        writer.topic("/a", "unknown/msg/Type")
    assert [file.name for file in tmp_path.iterdir()] == ["out.mcap"]
    assert path.read_text() == "old"


def test_what_a_writer_refuses(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "out.mcap") as writer:
        message = writer.typestore.types["std_msgs/msg/Float64"](0.0)
        with pytest.raises(InputError, match=r"datum.*did you mean data\?"):
            writer.topic("/a", "std_msgs/msg/Float64", message, ["datum"])
        topic = writer.topic("/a", "std_msgs/msg/Float64", message, ["data"])
        bare = writer.topic("/b", "std_msgs/msg/Float64")
        time_now = np.array([5])
        with pytest.raises(InputError, match=r"and \(n, 1\)"):
            writer.write_block(topic, time_now, time_now, np.zeros((1, 2)))
        with pytest.raises(InputError, match="no template"):
            writer.write_block(bare, time_now, time_now, np.zeros((1, 0)))
        with pytest.raises(InputError, match="0 ns or later"):
            writer.write_block(topic, time_now, -time_now, np.zeros((1, 1)))
