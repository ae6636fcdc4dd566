# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The time of a fleet's engine over that of the work, the gain of a second worker, and the memory of the client."""

from __future__ import annotations

import resource
import statistics
import tempfile
import time
from pathlib import Path

from measuring import at_least, at_most

from trackres_ros.engine.executor import done, engine
from trackres_ros.evaluation.fleet.draw import draw_fleet, write_recording
from trackres_ros.fleet.dataset import FleetDataset
from trackres_ros.fleet.recordings import FoundRecording
from trackres_ros.fleet.task import Task, analyse, broken
from trackres_ros.fleet.vehicles import one_vehicle

KILO, MEGA = 1e3, 1e6
TARGETS = {
    "engine and row over the work of a recording [%]": at_most(5),
    "time with one worker over two": at_least(1.8),
    "client memory, growth from a tenth to all recordings [MB]": at_most(10),
}


def run(recordings: int = 1000, minutes: float = 10.0, analysed: int = 24) -> dict[str, float]:
    """Measure the engine on `recordings` with next to no work in them, and the work on some that are analysed."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (vehicle,) = draw_fleet(1, analysed, 1.0, minutes, (), seed=1)
        paths = [write_recording(folder, vehicle, number, minutes) for number in range(analysed)]
        owner = one_vehicle("xgd24d", None).vehicles["xgd24d"]
        tasks = [Task(str(path), "1", owner) for path in paths]
        took = {}
        rows = [analyse(task) for task in tasks[:3]]  # compiles
        for workers in (1, 2):
            with engine("local", workers) as client:
                list(done(client, analyse, tasks[: 2 * workers]))  # each has loaded what it needs
                begin = time.perf_counter()
                rows = [row for _, row in done(client, analyse, tasks)]
                took[workers] = time.perf_counter() - begin
        work = statistics.median(row["took_s"] for row in rows)
        dataset = FleetDataset(folder / "out")
        dataset.prepare()
        memory, begin, per_one = [], 0.0, 0.0
        with engine("local", 1) as client:
            for count in (recordings // 10, recordings - recordings // 10):
                begin = time.perf_counter()
                for number, row in done(client, _nothing, range(count)):
                    dataset.put({**rows[0], **row, "url": f"{count} {number}", "vehicle": "x"}, None)
                per_one = (time.perf_counter() - begin) / count
                memory.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * KILO / MEGA)
        begin = time.perf_counter()
        dataset.index()
        indexed = (time.perf_counter() - begin) / recordings
    return {
        "a recording, analysed [ms]": KILO * work,
        "engine and row for a recording [ms]": KILO * per_one,
        "engine and row over the work of a recording [%]": 100.0 * per_one / work,
        "time with one worker over two": took[1] / took[2],
        "a row looked at by the next run [ms]": KILO * indexed,
        "client memory, growth from a tenth to all recordings [MB]": memory[1] - memory[0],
    }


def _nothing(number: int) -> dict[str, object]:
    return broken(FoundRecording(str(number), "1"), "x", "y", "")
