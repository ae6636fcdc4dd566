"""How much reading a bag into a Recording costs over reading its raw messages, and whether memory grows."""

from __future__ import annotations

import statistics
import tempfile
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from trackres_ros.bags import BagSource
from trackres_ros.cdr import Template
from trackres_ros.message_types import definitions
from trackres_ros.recording import Recording
from trackres_ros.topics import Topics

SPEED_MESSAGES = 250_000
LOAD_EVERY = 10
REPEATS = 5
BLOCK_ROWS = 8192
STORE = get_typestore(Stores.LATEST)
TOPICS = Topics.parse({
    "speed": {"topic": "/vehicle/speed", "type": "geometry_msgs/msg/TwistStamped", "field": "twist.linear.x"},
    "load": {"topic": "/vehicle/load", "type": "geometry_msgs/msg/WrenchStamped", "field": "wrench.force.z"},
})


def write_bag(path: Path, storage: StoragePlugin, messages: int) -> None:
    """Write speed at 100 Hz and load at a tenth of that, with the library's own writer."""
    types = STORE.types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](0, 0), "base_link")
    vector = types["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    stamp_ns = 1_700_000_000_000_000_000 + 10_000_000 * np.arange(messages)
    speed = 10.0 + np.sin(np.arange(messages) / 500.0) + np.random.default_rng(1).normal(0.0, 0.01, messages)
    rows = {}
    for name, inner, field, value in (("TwistStamped", "Twist", "twist.linear.x", speed),
                                      ("WrenchStamped", "Wrench", "wrench.force.z", 272e3 + 100.0 * speed)):
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


def seconds(run: Callable[[Path], int], path: Path) -> float:
    """Time one run [s]."""
    begin = time.perf_counter()
    run(path)
    return time.perf_counter() - begin


def peak_bytes(run: Callable[[Path], int], path: Path) -> int:
    """Return the peak of memory that Python allocated during a run [bytes]."""
    tracemalloc.start()
    try:
        run(path)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def run(messages: int = SPEED_MESSAGES, repeats: int = REPEATS) -> dict[str, float]:
    """Measure.

    Parameters
    ----------
    messages : int
        Messages of speed in the bag.
    repeats : int
        Runs of each kind, alternated; the median counts.

    Returns
    -------
    dict of str to float
        By storage: time of the raw messages and of the Recording a message [us], their ratio, and the peak of memory
        of a bag ten times as long over that of the short one, when only iterating blocks.
    """
    result = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, storage in (("mcap", StoragePlugin.MCAP), ("sqlite3", StoragePlugin.SQLITE3)):
            path, short, long = (Path(folder, f"{name}_{length}") for length in ("bag", "short", "long"))
            write_bag(path, storage, messages)
            write_bag(short, storage, 2 * messages // 5)
            write_bag(long, storage, 4 * messages)
            count = read_recording(path)
            if count != read_raw(path):
                raise RuntimeError("not every message became a sample")
            times = [(seconds(read_raw, path), seconds(read_recording, path)) for _ in range(repeats)]
            raw, recording = (statistics.median(column) for column in zip(*times, strict=True))
            result[f"{name}: raw messages [us a message]"] = 1e6 * raw / count
            result[f"{name}: Recording [us a message]"] = 1e6 * recording / count
            result[f"{name}: Recording over raw"] = statistics.median(ours / theirs for theirs, ours in times)
            result[f"{name}: peak memory, 10 times the length"] = (
                peak_bytes(iterate_blocks, long) / peak_bytes(iterate_blocks, short))
    return result


def main() -> None:
    """Print the table."""
    for name, value in run().items():
        print(f"{name:45} {value:8.2f}")


if __name__ == "__main__":
    main()
