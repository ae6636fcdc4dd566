# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Peak resident memory of `trackres replay`, picture included, of a bag with speed at 20 Hz. Measured is a recording of ten
hours, the rival is one of one hour.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from bags import TOPICS, write_bag
from measuring import Row, compared, trackres
from rosbags.rosbag2 import StoragePlugin

RATE_HZ = 20.0
SMALL = {"hours": 0.01}
TIMES = 10
FORMATS = (".parquet", ".csv", ".csv.gz", ".mf4", ".mcap")
TARGET = 1.2


def run(hours: float = 1.0) -> list[Row]:
    """Measure a recording of some hours, and one ten times as long, for each format of the output."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        topics = folder / "topics.yaml"
        topics.write_text(TOPICS, encoding="utf-8")
        bags = [folder / "long", folder / "short"]
        for bag, times in zip(bags, (TIMES, 1), strict=True):
            write_bag(bag, StoragePlugin.MCAP, int(3600.0 * times * hours * RATE_HZ), RATE_HZ)

        def peak(bag: Path, suffix: str) -> float:
            out = folder / f"out{suffix}"
            found = trackres("replay", bag, "--vehicle", "xgd24d", "--topics", topics, "-o", out).peak_bytes
            out.unlink()
            return 1e-6 * found

        return [compared(f"{suffix} [MB]", *([peak(bag, suffix)] for bag in bags), TARGET) for suffix in FORMATS]
