# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The gain of each way that was tried: ratios of the present program, without a kept way, and with a rejected one."""

from __future__ import annotations

import argparse
import gc
import itertools
import json
import os
import shutil
import statistics
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import bench_reading
import numpy as np
from bench_recording import by_run, by_session, roads
from measuring import ROOT, alternated, child, median_ratio, seconds
from rivals import limit, plain
from rosbags.rosbag2 import Reader, StoragePlugin

from trackres_ros.building.kernel_source import built_in
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.vehicle import load

PACKAGE = "trackres_ros"
STEP, READING = "step", "reading"
DURATION_S, REPEATS, MESSAGES, CALLS = 600.0, 40, 100_000, 20_000

Array = np.ndarray[Any, np.dtype[np.float64]]


@dataclass(frozen=True)
class Way:
    """Something that was tried; `changes` are made to a copy of the sources: file, text as it is, text instead."""

    name: str
    kept: bool
    of: str
    changes: tuple[tuple[str, str, str], ...]


WAYS = (
    Way(
        "the direction of travel reckoned once a step", False, STEP,
        (("estimator/road.py", "    number = k.number\n", "    number, sign = k.number, direction(speed)\n"),
         ("estimator/road.py", "        direction(speed),\n", "        sign,\n"),
         ("estimator/road.py", "bearing_force(speed, weight, rolling)", "rolling * weight * sign"),
         ("estimator/kernel.py", "abs(direction(speed))", "abs(road.sign)")),
    ),
    Way(
        "the logarithm of a load kept while the load is the same", False, STEP,
        (("estimator/columns.py",
          "    twin = Real()  # the assembly that it is computed as\n",
          "    twin = Real()\n    load = Real()\n    log_load = Real()\n"),
         ("estimator/constants.py", "np.empty(parts_and_belts)", "np.full(parts_and_belts, np.nan)"),
         ("estimator/assembly_step.py",
          "    share, log_load, reasons, mean = load / road.weight, math.log(load), 0, Belt(belt[0])\n",
          "    share, reasons, mean = load / road.weight, 0, Belt(belt[0])\n"
          "    if part.load != load:\n"
          "        part.load, part.log_load = load, math.log(load)\n"
          "    log_load = part.log_load\n")),
    ),
    Way(
        "reasons counted only where there are any", False, STEP,
        (("estimator/entry_points.py",
          "    for bit in range(memory.reasons.shape[0]):\n",
          "    for bit in range(memory.reasons.shape[0] if found else 0):\n"),),
    ),
    Way(
        "functions of a step made parts of their callers", True, STEP,
        (("kernels/compiler.py", '*INLINING, ', ""),),
    ),
    Way(
        "the compiler optimising more (-O3)", True, STEP,
        (("kernels/compiler.py", '"-O3", ', '"-O2", '),),
    ),
    Way(
        "code for this processor alone (-march=native)", False, STEP,
        (("kernels/compiler.py", '"-O3", ', '"-O3", "-march=native", '),),
    ),
    Way(
        "sums in any order, reciprocals, and products joined with sums (-ffast-math, but for what is not a number)", False, STEP,
        (("kernels/compiler.py",
          '"-ffp-contract=off", ',
          '"-fassociative-math", "-freciprocal-math", "-fno-signed-zeros", "-fno-trapping-math", "-ffp-contract=fast", '),),
    ),
    Way(
        "a batch of messages decoded column by column", True, READING,
        (("recording/rosbag.py",
          "stamps, raws = [one[1] for one in batch], [one[2] for one in batch]",
          "_, stamps, raws = zip(*batch, strict=True)"),),
    ),
    Way(
        "the files of a bag read one by one, past what joins them", True, READING,
        (("recording/bag_opening.py", "[*files] if files else [(reader, wanted)]", "[(reader, wanted)]"),),
    ),
    Way(
        "batches of 512 messages", False, READING,
        (("recording/rosbag.py", "BATCH_ROWS, BATCH_BYTES = 2048,", "BATCH_ROWS, BATCH_BYTES = 512,"),),
    ),
    Way(
        "batches of 8192 messages", False, READING,
        (("recording/rosbag.py", "BATCH_ROWS, BATCH_BYTES = 2048,", "BATCH_ROWS, BATCH_BYTES = 8192,"),),
    ),
)  # fmt: skip


class Constants(NamedTuple):
    """Six of the arrays that a call hands over."""

    first: Array
    second: Array
    third: Array
    fourth: Array
    fifth: Array
    sixth: Array


def of_record(given: Constants, value: float) -> float:
    """A kernel that takes a record."""
    return given.first[0] + given.sixth[0] + value


def of_arrays(first: Array, second: Array, third: Array, fourth: Array, fifth: Array, sixth: Array, value: float) -> float:
    """A kernel that takes its arrays."""
    given = Constants(first, second, third, fourth, fifth, sixth)
    return given.first[0] + given.sixth[0] + value


def of_steps(duration_s: float, repeats: int) -> dict[str, float]:
    """Run and session over the limit, on the package that is imported."""
    estimator = Estimator(load("xgd24d"))
    road = roads(estimator, duration_s)["laps"]
    p = plain(estimator)
    rivals: dict[str, Callable[[], object]] = {
        "run": lambda: by_run(estimator, road),
        "session": lambda: by_session(estimator, road),
        "limit": lambda: limit(p, road),
    }
    for rival in rivals.values():
        rival()
    times = alternated(rivals, repeats)
    return {f"{name} over the limit": median_ratio(times[name], times["limit"]) for name in ("run", "session")}


def of_reading(messages: int, repeats: int) -> dict[str, float]:
    """A recording over its raw messages, by storage, on the package that is imported."""
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        for name in bench_reading.STORAGES:
            path = Path(folder, name)
            bench_reading.write_bag(path, StoragePlugin[name.upper()], messages)
            ways = {way.__name__: partial(way, path) for way in (bench_reading.read_raw, bench_reading.read_recording)}
            for way in ways.values():
                way()
            raw, recording = alternated(ways, repeats).values()
            found[f"{name} over raw messages"] = median_ratio(recording, raw)
    return found


def changed(folder: Path, way: Way | None) -> Path:
    """A copy of the package, with the changes of a way.

    Raises
    ------
    ValueError
        Its text is not in the sources, or more than once.
    """
    copy = folder / PACKAGE
    shutil.copytree(ROOT / PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(ROOT / "config", folder / "config")
    for name, now, instead in way.changes if way else ():
        text = (copy / name).read_text(encoding="utf-8")
        if text.count(now) != 1:
            raise ValueError(f"{way.name if way else ''}: {name} has {text.count(now)} times {now!r}")
        (copy / name).write_text(text.replace(now, instead), encoding="utf-8")
    return folder


BUILDING = """
import sysconfig
from pathlib import Path
from trackres_ros.building import kernel_source
from trackres_ros.kernels.compiler import compiled
text = kernel_source.source("built", kernel_source.all_entries())
built = compiled(text, "-I" + sysconfig.get_paths()["include"])
(Path(kernel_source.__file__).parents[1] / "kernels" / "built.abi3.so").write_bytes(built)
"""
MEASURES: dict[str, Callable[..., dict[str, float]]] = {STEP: of_steps, READING: of_reading}


def measured(of: str, way: Way | None, sizes: Mapping[str, Any]) -> dict[str, float]:
    """Ratios of a changed copy, by a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        path = os.pathsep.join([str(changed(Path(folder), way)), str(Path(__file__).parent)])
        environment = {"PYTHONPATH": path, "XDG_CACHE_HOME": str(Path(folder, "cache")), "PYTHONDONTWRITEBYTECODE": "1"}
        if of == STEP:
            child(["-P", "-c", BUILDING], {**environment, "TRACKRES_INTERPRETED": "1"})
        found: dict[str, float] = child([__file__, of, json.dumps(sizes)], environment).json()
    return found


def in_one_process(messages: int, calls: int, repeats: int) -> dict[str, float]:
    """What needs no other sources."""
    arrays = [np.ones(3) for _ in Constants._fields]
    record = Constants(*arrays)
    with tempfile.TemporaryDirectory() as folder:
        module = built_in(Path(folder), {"of_record": of_record, "of_arrays": of_arrays})
    bound = module.bind_constants(record)

    def often(call: Callable[[], object]) -> float:
        call()
        return 1e6 / calls * statistics.median(seconds(lambda: [call() for _ in range(calls)]) for _ in range(repeats))

    found = {
        "a call that hands over six arrays [us]": often(lambda: module.of_arrays(*arrays, 1.0)),
        "a call that hands over a named record of them [us]": often(lambda: module.of_record(record, 1.0)),
        "a call that hands over a bound record of them [us]": often(lambda: module.of_record(bound, 1.0)),
    }
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "bag")
        bench_reading.write_bag(path, StoragePlugin.SQLITE3, messages)
        with Reader(path) as reader:
            database = reader.storage.storages[0].dbconn
            ids = [one.id for one in reader.connections]
            each = ", ".join("count(*) FILTER (WHERE topic_id = ?)" for _ in ids)
            rows = "SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN (?, ?) ORDER BY timestamp"

            def through(rows: Any) -> int:
                return sum(1 for _ in iter(lambda: len(list(itertools.islice(rows, 2048))), 0))

            ways = {
                "library": lambda: through(reader.messages()),
                "database": lambda: through(iter(database.execute(rows, ids))),
                "grouped": lambda: list(
                    database.execute("SELECT topic_id, count(*) FROM messages NOT INDEXED GROUP BY topic_id")
                ),
                "filtered": lambda: list(database.execute(f"SELECT {each} FROM messages NOT INDEXED", ids)),
            }
            times = alternated(ways, repeats)
        per_message = {name: 1e6 * statistics.median(of) / (messages * 1.1) for name, of in times.items()}
        found |= {
            "sqlite3, not kept: rows straight from the database, saved [us a message]": per_message["library"]
            - per_message["database"],
            "sqlite3, not kept: two topics counted in one pass, saved [us a message]": per_message["grouped"]
            - per_message["filtered"],
        }
        bench_reading.read_recording(path)
        with_collector = [seconds(lambda: bench_reading.read_recording(path)) for _ in range(repeats)]
        gc.disable()
        try:
            without = [seconds(lambda: bench_reading.read_recording(path)) for _ in range(repeats)]
        finally:
            gc.enable()
        found["sqlite3, not kept: no garbage collection, time with it over without"] = median_ratio(without, with_collector)
    return found


def run(
    duration_s: float = DURATION_S, repeats: int = REPEATS, messages: int = MESSAGES, calls: int = CALLS, ways: int = len(WAYS)
) -> dict[str, float]:
    """Measure all, or the first so many ways."""
    sizes: dict[str, dict[str, Any]] = {
        STEP: {"duration_s": duration_s, "repeats": repeats},
        READING: {"messages": messages, "repeats": max(1, repeats // 2)},
    }
    found: dict[str, float] = {}
    for of, size in sizes.items():
        for way in (None, *(way for way in WAYS[:ways] if way.of == of)):
            variant = "as it is" if way is None else f"{'without' if way.kept else 'with, not kept'}: {way.name}"
            found |= {f"{what}, {variant}": ratio for what, ratio in measured(of, way, size).items()}
    return found | in_one_process(messages, calls, max(1, repeats // 4))


TARGETS: dict[str, Any] = {}


def main() -> None:
    """Measure one kind of ratio of the package that is imported; print it as JSON."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("of", choices=tuple(MEASURES))
    parser.add_argument("sizes", type=json.loads)
    given = parser.parse_args()
    print(json.dumps(MEASURES[given.of](**given.sizes)))


if __name__ == "__main__":
    main()
