# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Whole commands with `--workers 2`, which Dask runs. The rival is the same command in one process without Dask. The sweep
varies the thickness of the belts, and each point needs a loss table. The fleet is analysed, and diagnosed by month.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from measuring import Row, child, compared, of_home, trackres

REPEATS = 2
SMALL = {"repeats": 1, "points": 2, "vehicles": 1, "days": 2, "minutes": 3.0}
TARGET = 0.56  # 1.8 times as fast
ONE_PROCESS = """
from contextlib import nullcontext
from trackres_ros.tools import engine
engine.engine = lambda *_: nullcontext()
engine.run_pieces = lambda _client, function, work: ((piece, function(piece)) for piece in work)
engine.dashboard = lambda _client: ""
from trackres_ros.__main__ import main
main()
"""
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")  # as in a worker


def run(repeats: int = REPEATS, points: int = 24, vehicles: int = 4, days: int = 12, minutes: float = 10.0) -> list[Row]:
    """Measure a sweep over some points, and a fleet with a recording of some minutes each third day; each in an empty home."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        asked = {"--vehicles": vehicles, "--days": days, "--every": 3, "--minutes": minutes}
        trackres("fleet", "sample", "-o", folder / "fleet", *(word for pair in asked.items() for word in pair))
        fleet = ["fleet", str(folder / "fleet" / "recordings"), "--vehicles", str(folder / "fleet" / "fleet.yaml")]
        sweep = ["sweep", "xgd24d", "--vary", f"belt.thickness=0.025:0.045:{points}"]
        rows = []
        for title, words, suffix in (("sweep", sweep, ".csv"), ("fleet", fleet, "")):
            times: tuple[list[float], list[float]] = ([], [])
            for i in range(repeats):
                for of, how in zip(times, ("two", "one"), strict=True):
                    place = folder / f"{title}_{how}_{i}"
                    given, home = [*words, "-o", f"{place}{suffix}"], folder / f"home_{title}_{how}_{i}"
                    if how == "two":
                        of.append(trackres(*given, "--workers=2", home=home).wall_s)
                    else:
                        of.append(child(["-c", ONE_PROCESS, *given], {**of_home(home), **ONE_THREAD}).wall_s)
            rows.append(compared(f"{title} [s]", *times, TARGET))
    return rows
