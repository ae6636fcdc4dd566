# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Bags read with the libraries of ROS 2 give what they give with rosbags, to the bit, damaged ones too; skipped without ROS 2."""

import math
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags")
pytest.importorskip("rosbag2_py", reason="needs ROS 2: rosbag2_py", exc_type=ImportError)

import rosbag2_py
from rclpy.serialization import deserialize_message, serialize_message
from rosidl_runtime_py.utilities import get_message

from trackres_ros.errors import InputError, MissingExtraError
from trackres_ros.recording.readers.bags import BagSource

TWIST, JOINTS, FLOAT = "geometry_msgs/msg/TwistStamped", "sensor_msgs/msg/JointState", "std_msgs/msg/Float64"
TOPICS = {"/speed": TWIST, "/joints": JOINTS, "/load": FLOAT}
START_NS = 1_700_000_000 * 10**9


def content(number, topic):
    """A message whose length changes from one to the next, as names do."""
    message = get_message(TOPICS[topic])()
    if topic == "/load":
        message.data = 1000.0 + number
        return serialize_message(message)
    sec, message.header.stamp.nanosec = divmod(START_NS + number * 10_000_000 - 3_000_000, 10**9)
    message.header.stamp.sec = sec
    message.header.frame_id = "base" * (number % 3)
    if topic == "/speed":
        message.twist.linear.x = 5.0 + math.sin(0.01 * number)
    else:
        message.name, message.effort = ["left", "right"], [float(number), -float(number)]
    return serialize_message(message)


def write(path, storage, count=1500, mode=None, broken=()):
    """Record with rosbag2 itself; messages of the numbers `broken` are cut off."""
    writer = rosbag2_py.SequentialWriter()
    options = rosbag2_py.StorageOptions(uri=str(path), storage_id=storage)
    converter = rosbag2_py.ConverterOptions("cdr", "cdr")
    if mode:
        choice = rosbag2_py.CompressionOptions(
            compression_format="zstd",
            compression_mode=rosbag2_py.CompressionMode.FILE if mode == "file" else rosbag2_py.CompressionMode.MESSAGE,
            compression_queue_size=0,
            compression_threads=0,
        )
        writer = rosbag2_py.SequentialCompressionWriter(choice)
    writer.open(options, converter)
    for place, (topic, kind) in enumerate(TOPICS.items()):
        writer.create_topic(rosbag2_py.TopicMetadata(id=place, name=topic, type=kind, serialization_format="cdr"))
    for number in range(count):
        for topic in TOPICS:
            raw = content(number, topic)
            writer.write(topic, raw[:-9] if number in broken else raw, START_NS + number * 10_000_000)
    if mode:
        del writer  # it has no close
    else:
        writer.close()
    return path


def read(path):
    """All content of a bag, or its error."""
    try:
        source = BagSource([path])
        blocks = list(source.blocks())
    except MissingExtraError:
        raise
    except InputError as error:
        return type(error), str(error).partition(":")[0]
    joined = [np.concatenate([getattr(block, name) for block in blocks]) for name in ("role", "stamp_ns", "arrival_ns", "value")]
    return source.roles, source.notes, [repr(item) for item in source.findings], [item.tobytes() for item in joined]


@pytest.fixture
def both(monkeypatch):
    """Read a bag with rosbags, then with ROS 2 alone: `both(path)`."""

    def both(path):
        with_rosbags = read(path)
        with monkeypatch.context() as without:
            for name in [name for name in sys.modules if name.partition(".")[0] == "rosbags"]:
                without.setitem(sys.modules, name, None)
            return with_rosbags, read(path)

    return both


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_bag_gives_the_same_with_either_library(tmp_path, both, storage, capfd):
    path = write(tmp_path / "bag", storage)
    capfd.readouterr()
    for item in (path, next(file for file in path.iterdir() if file.suffix in (".mcap", ".db3"))):
        first, second = both(item)
        assert first == second
        assert len(second[3][3]) == 8 * 1500 * len(second[0])
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize("how", [{"mode": "file"}, {"mode": "message"}, {"broken": range(50, 60)}], ids=str)
def test_so_does_one_that_is_packed_or_with_messages_cut_off(tmp_path, both, storage, how):
    first, second = both(write(tmp_path / "bag", storage, 300, **how))
    assert first == second
    assert len(second[3][3]) == 8 * 300 * len(second[0])
    assert any("malformed" in finding for finding in second[2]) is ("broken" in how)


@pytest.mark.parametrize("share", [0.2, 0.6, 0.97])
@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_so_does_a_file_that_breaks_off(tmp_path, both, storage, share):
    path = write(tmp_path / "bag", storage, 4000)
    file = next(file for file in path.iterdir() if file.suffix in (".mcap", ".db3"))
    cut = tmp_path / f"cut{file.suffix}"
    cut.write_bytes(file.read_bytes()[: int(share * file.stat().st_size)])
    first, second = both(cut)
    assert first == second


def test_both_refuse_a_folder_without_metadata_or_file(tmp_path, both):
    path = write(tmp_path / "bag", "mcap", 10)
    kept = tmp_path / "kept"
    shutil.copytree(path, kept)
    (path / "metadata.yaml").unlink()
    next(kept.glob("*.mcap")).unlink()
    for item in (path, kept):
        first, second = both(item)
        assert first == second
        assert first[0] is InputError


def test_samples_are_what_rclpy_makes_of_the_messages(tmp_path, both):
    path = write(tmp_path / "bag", "mcap", 200)
    reader = rosbag2_py.SequentialReader()
    reader.open(rosbag2_py.StorageOptions(uri=str(path), storage_id="mcap"), rosbag2_py.ConverterOptions("cdr", "cdr"))
    speeds = []
    while reader.has_next():
        topic, raw, _ = reader.read_next()[:3]
        if topic == "/speed":
            message = deserialize_message(raw, get_message(TWIST))
            speeds.append((message.header.stamp.sec * 10**9 + message.header.stamp.nanosec, message.twist.linear.x))
    roles, _, _, (role, stamp, _, value) = both(path)[1]
    mine = np.frombuffer(role, np.int16) == roles.index("speed")
    stamps, values = np.frombuffer(stamp, np.int64)[mine], np.frombuffer(value)[mine]
    assert list(zip(stamps.tolist(), values.tolist(), strict=True)) == speeds


def test_a_file_that_would_fill_the_memory_is_refused(tmp_path, both):
    """The head of a chunk says that it unpacks to 2**40 bytes."""
    path = write(tmp_path / "bag", "mcap", 10)
    file = next(path.glob("*.mcap"))
    data = bytearray(file.read_bytes())
    place = 8
    while data[place] != 6:
        place += 9 + int.from_bytes(data[place + 1 : place + 9], "little")
    data[place + 25 : place + 33] = (2**40).to_bytes(8, "little")
    huge = Path(tmp_path / "huge.mcap")
    huge.write_bytes(bytes(data))
    assert both(huge)[1][0] is InputError
