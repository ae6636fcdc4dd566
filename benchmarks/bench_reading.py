# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Time to read a bag over that of its raw messages, time of the estimate on top of reading, and growth of memory."""

from __future__ import annotations

import statistics
import sys
import tempfile
import time
import tracemalloc
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from unittest import mock

import numpy as np
import yaml
from measuring import START_NS, at_most, child
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from trackres_ros.estimator.estimator import Estimator
from trackres_ros.offline.replay import replay
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.cdr import Template
from trackres_ros.recording.message_types import definitions
from trackres_ros.recording.recording import Recording
from trackres_ros.recording.rosbag import BagSource
from trackres_ros.vehicle import load

SPEED_MESSAGES = 250_000
LOAD_EVERY = 10
REPEATS = 5
BLOCK_ROWS = 8192
TOPICS_YAML = """\
speed: {topic: /vehicle/speed, type: geometry_msgs/msg/TwistStamped, field: twist.linear.x}
load: {topic: /vehicle/load, type: geometry_msgs/msg/WrenchStamped, field: wrench.force.z}
"""
STORAGES = ("mcap", "sqlite3")
TARGETS = {
    **{f"{name}: Recording over raw": at_most(1.2) for name in STORAGES},
    **{f"{name}: estimate on top of reading, wall time [%]": at_most(10.0) for name in STORAGES},
    **{f"{name}: peak memory, 10 times the length": at_most(1.2) for name in STORAGES},
    "mcap: replay to a bag, peak resident memory, 10 times the length": at_most(1.2),
}
STORE = get_typestore(Stores.LATEST)
TOPICS = Topics.parse(yaml.safe_load(TOPICS_YAML))


def write_bag(path: Path, storage: StoragePlugin, messages: int) -> None:
    """Write speed at 100 Hz and load at a tenth of that, with the library's own writer."""
    types = STORE.types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](0, 0), "base_link")
    vector = types["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    stamp_ns = START_NS + 10_000_000 * np.arange(messages)
    speed = 10.0 + np.sin(np.arange(messages) / 500.0) + np.random.default_rng(1).normal(0.0, 0.01, messages)
    rows = {}
    for name, inner, field, value in (
        ("TwistStamped", "Twist", "twist.linear.x", speed),
        ("WrenchStamped", "Wrench", "wrench.force.z", 272e3 + 100.0 * speed),
    ):
        msgtype = f"geometry_msgs/msg/{name}"
        message = types[msgtype](header, types[f"geometry_msgs/msg/{inner}"](vector, vector))
        raw = bytes(STORE.serialize_cdr(message, msgtype))
        rows[name] = np.empty((messages, len(raw)), np.uint8)
        template = Template(raw, definitions(STORE.fielddefs, msgtype), msgtype, [field])
        template.fill(rows[name], 0, stamp_ns, value[:, None])
    with Writer(path, version=9, storage_plugin=storage) as writer:
        twist = writer.add_connection("/vehicle/speed", "geometry_msgs/msg/TwistStamped", typestore=STORE)
        wrench = writer.add_connection("/vehicle/load", "geometry_msgs/msg/WrenchStamped", typestore=STORE)
        for row, log_ns in enumerate((stamp_ns + 2_000_000).tolist()):
            writer.write(twist, log_ns, rows["TwistStamped"][row].tobytes())
            if row % LOAD_EVERY == 0:
                writer.write(wrench, log_ns, rows["WrenchStamped"][row].tobytes())


def read_raw(path: Path) -> int:
    """Read all raw messages, as the library gives them."""
    count = 0
    with Reader(path) as reader:
        for _ in reader.messages():
            count += 1
    return count


def read_recording(path: Path) -> int:
    """Read the same into a Recording."""
    recording = Recording.from_source(BagSource([path], TOPICS))
    return sum(map(len, recording.series.values()))


def iterate_blocks(path: Path) -> int:
    """Read the same in blocks and keep none."""
    return sum(map(len, BagSource([path], TOPICS).blocks(BLOCK_ROWS)))


def reading(path: Path) -> int:
    """Read in the blocks that a replay takes, and keep none."""
    return sum(map(len, BagSource([path], TOPICS).blocks()))


def reading_with_ros(path: Path) -> int:
    """Read in the same blocks with rosbag2_py, as where rosbags is not installed."""
    hidden = [name for name in sys.modules if name.partition(".")[0] == "rosbags"]
    with mock.patch.dict(sys.modules, dict.fromkeys(hidden)):
        return reading(path)


def seconds(run: Callable[[Path], int], path: Path) -> tuple[float, float]:
    """Wall and CPU time of one run [s]."""
    wall, cpu = time.perf_counter(), time.process_time()
    run(path)
    return time.perf_counter() - wall, time.process_time() - cpu


def peak_bytes(run: Callable[[Path], int], path: Path) -> int:
    """Return the peak of memory that Python allocated during a run [bytes]."""
    tracemalloc.start()
    try:
        run(path)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def replay_peak(bag: Path, topics: Path, out: Path) -> int:
    """Peak resident memory of `trackres replay` with a bag as output [bytes]."""
    arguments = ["-m", "trackres_ros", "replay", str(bag), "--vehicle", "xgd24d", "--topics", str(topics), "-o", str(out)]
    return child(arguments).peak_bytes


def _timed(path: Path, estimator: Estimator, name: str, repeats: int) -> dict[str, float]:
    """Reading raw, into a Recording, in blocks, and with the estimate; alternated."""

    def estimated(bag: Path) -> int:
        return replay(BagSource([bag], TOPICS), estimator).messages

    ways = [read_raw, read_recording, reading, estimated]
    if find_spec("rosbag2_py"):
        ways.append(reading_with_ros)
    counts = {way(path) for way in ways}
    if len(counts) != 1:
        raise RuntimeError(f"not every message became a sample: {counts}")
    count = counts.pop()
    rounds = np.array([[seconds(way, path) for way in ways] for _ in range(repeats)])  # (repeats, ways, wall and CPU)
    raw, recording, blocks, replayed, *ros = (1e6 * statistics.median(rounds[:, i, 0]) / count for i in range(len(ways)))
    on_top = 100.0 * np.median(rounds[:, 3] / rounds[:, 2] - 1.0, axis=0)
    result = {
        f"{name}: raw messages [us a message]": raw,
        f"{name}: Recording [us a message]": recording,
        f"{name}: Recording over raw": statistics.median(rounds[:, 1, 0] / rounds[:, 0, 0]),
        f"{name}: blocks of a replay [us a message]": blocks,
        f"{name}: replay [us a message]": replayed,
        f"{name}: estimate on top of reading, wall time [%]": float(on_top[0]),
        f"{name}: estimate on top of reading, CPU time [%]": float(on_top[1]),
    }
    if ros:
        result[f"{name}: blocks of a replay with rosbag2_py [us a message]"] = ros[0]
        result[f"{name}: rosbag2_py over rosbags"] = statistics.median(rounds[:, 4, 0] / rounds[:, 2, 0])
    return result


def run(messages: int = SPEED_MESSAGES, repeats: int = REPEATS) -> dict[str, float]:
    """Measure, by storage, on a bag with so many messages of speed; the median of repeats counts."""
    result = {}
    estimator = Estimator(load("xgd24d"))
    with tempfile.TemporaryDirectory() as folder:
        topics = Path(folder, "topics.yaml")
        topics.write_text(TOPICS_YAML, encoding="utf-8")
        for name in STORAGES:
            storage = StoragePlugin[name.upper()]
            path, short, long = (Path(folder, f"{name}_{length}") for length in ("bag", "short", "long"))
            write_bag(path, storage, messages)
            write_bag(short, storage, 2 * messages // 5)
            write_bag(long, storage, 4 * messages)
            result |= _timed(path, estimator, name, repeats)
            growth = peak_bytes(iterate_blocks, long) / peak_bytes(iterate_blocks, short)
            result[f"{name}: peak memory, 10 times the length"] = growth
            if name == "mcap":
                peaks = [replay_peak(bag, topics, Path(folder, f"{bag.name}.mcap")) for bag in (short, long)]
                result["mcap: replay to a bag, peak resident memory, 10 times the length"] = peaks[1] / peaks[0]
                result["mcap: replay to a bag, peak resident memory [MB]"] = peaks[0] / 1e6
    return result
