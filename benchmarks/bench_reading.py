# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A bag with speed at 100 Hz, read into a `Recording`. The rival takes the raw messages of the same bag from rosbags, without
decoding.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import yaml
from bags import TOPICS, write_bag
from measuring import Row, alternated, compared
from rosbags.rosbag2 import Reader, StoragePlugin

from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.readers.bags import BagSource
from trackres_ros.recording.recording import Recording

SMALL = {"messages": 500, "repeats": 1}
RATE_HZ = 100.0
STORAGES = ("mcap", "sqlite3")
TARGET = 1.2


def read_raw(path: Path) -> int:
    """Read all raw messages, as the library gives them."""
    with Reader(path) as reader:
        return sum(1 for _ in reader.messages())


def read_recording(path: Path) -> int:
    """Read the same into a Recording."""
    recording = Recording.from_source(BagSource([path], Topics.parse(yaml.safe_load(TOPICS))))
    return sum(map(len, recording.series.values()))


def run(messages: int = 250_000, repeats: int = 7) -> list[Row]:
    """Measure bags with so many messages of speed, by storage."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for name in STORAGES:
            path = Path(folder, name)
            write_bag(path, StoragePlugin[name.upper()], messages, RATE_HZ)
            counts = {read_raw(path), read_recording(path)}
            if len(counts) != 1:
                raise RuntimeError(f"not every message became a sample: {counts}")
            times = alternated({"ours": lambda p=path: read_recording(p), "raw": lambda p=path: read_raw(p)}, repeats)
            rows.append(compared(f"{name} [us a message]", times["ours"], times["raw"], TARGET, 1e6 / counts.pop()))
    return rows
