# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Wall time of `trackres replay` of the sample recording. The rival is a plain script, `plain_replay.py`. It reads the same bag
with rosbags, steps the exported C, and writes the same table and picture. Its first run compiles that C, ours builds loss
tables.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from measuring import HERE, Row, c_compiler, child, compared, of_home, trackres
from pyarrow import parquet

REPEATS = 7
SMALL = {"repeats": 1, "laps": 1}
TARGET = 1.5
AGREES = 1e-5  # of the largest torque: both tables are in single precision


def run(repeats: int = REPEATS, laps: int = 3) -> list[Row]:
    """Measure the sample of some laps, in an empty home and again; empty without a C compiler."""
    if c_compiler() is None:
        return []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bag, source, plain_out = folder / "sample.mcap", folder / "c", folder / "plain.parquet"
        trackres("record-sample", "--laps", laps, "-o", bag)
        trackres("export", "c", "xgd24d", "-o", source)

        def ours(home: Path) -> float:
            return trackres("replay", bag.name, "--vehicle", "xgd24d", home=home, cwd=folder).wall_s

        def plain(home: Path) -> float:
            return child([str(HERE / "plain_replay.py"), str(source), str(bag), str(plain_out)], of_home(home)).wall_s

        times: dict[str, list[tuple[float, float]]] = {"first": [], "again": []}
        for i in range(repeats):
            homes = folder / f"ours_{i}", folder / f"plain_{i}"
            for of in times.values():
                of.append((ours(homes[0]), plain(homes[1])))
        _check(folder / "sample_replay.parquet", plain_out)
    return [
        compared(title, *zip(*times[of], strict=True), TARGET)
        for of, title in (("first", "first run, empty home [s]"), ("again", "next run [s]"))
    ]


def _check(ours: Path, plain: Path) -> None:
    """Raises RuntimeError if the two did not compute the same."""
    one, other = (parquet.read_table(path)["resistance_torque_nm"].to_numpy() for path in (ours, plain))
    if len(one) != len(other) or np.abs(one - other).max() > AGREES * np.abs(one).max():
        raise RuntimeError("the plain script computes other torques")
