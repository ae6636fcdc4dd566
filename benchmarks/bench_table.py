# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The loss table: time to build it and to load it from the cache, and its error against the exact method. Then the first
estimate of a process and the first replay on a machine.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from pathlib import Path

import numpy as np
from measuring import at_most, child, seconds

from trackres_ros.jit.compiled import HAVE_NUMBA
from trackres_ros.model.loss_table import interpolation_error, loss_table
from trackres_ros.model.track import load_range, track_model, with_methods
from trackres_ros.vehicle import load

REPEATS = 3
POINTS = 400
FIRST_ESTIMATE = """
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.vehicle import load
session = Estimator(load("xgd24d")).session()
assert session.handle(session.channel("speed"), 1, 1, 10.0) is not None
"""
SAMPLE = """
import sys
import trackres_ros as tr
tr.record_sample(sys.argv[1])
"""
WAITED = "a first replay over the same in plain Python alone: waited for the compiler [s]"
TARGETS = {
    "spectral: building [s]": at_most(3.0),
    "rainflow: building [s]": at_most(3.0),
    "spectral: largest interpolation error [%]": at_most(0.3),
    "rainflow: largest interpolation error [%]": at_most(0.3),
    WAITED: at_most(5.0),
}


def run(repeats: int = REPEATS, points: int = POINTS, replays: int = REPEATS) -> dict[str, float]:
    """Measure builds and starts, the median of repeats, the error at random points of the whole range, and first replays."""
    result = {}
    for method in ("spectral", "rainflow"):
        vehicle = with_methods(load("xgd24d"), method)
        name = next(iter(vehicle.tracks))
        loads = load_range(vehicle, name)
        built, cached = [], []
        for _ in range(repeats):
            with tempfile.TemporaryDirectory() as folder:
                built.append(seconds(lambda v=vehicle, t=name, f=folder: loss_table(v, t, Path(f))))
                cached.append(seconds(lambda v=vehicle, t=name, f=folder: loss_table(v, t, Path(f))))
                table = loss_table(vehicle, name, Path(folder))
        error = interpolation_error(track_model(vehicle, name), table, loads, vehicle.chassis.max_speed, points)
        result[f"{method}: building [s]"] = statistics.median(built)
        result[f"{method}: from the cache [s]"] = statistics.median(cached)
        result[f"{method}: largest interpolation error [%]"] = float(100.0 * np.abs(error).max())
    with tempfile.TemporaryDirectory() as folder:
        environment = {"XDG_CACHE_HOME": folder}
        result["process to first estimate, empty cache [s]"] = child(["-c", FIRST_ESTIMATE], environment).wall_s
        warm = [child(["-c", FIRST_ESTIMATE], environment).wall_s for _ in range(repeats)]
        result["process to first estimate, filled cache [s]"] = statistics.median(warm)
    return {**result, **(first_replay(replays) if replays else {})}


def first_replay(repeats: int) -> dict[str, float]:
    """The command on a recording of 13 minutes: with nothing in the cache, with all, and in plain Python."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        child(["-c", SAMPLE, str(folder / "sample.mcap")])
        replay = ["-m", "trackres_ros", "replay", str(folder / "sample.mcap"), "--vehicle", "xgd24d"]

        def took(cache: str, **more: str) -> float:
            return child([*replay, "-o", str(folder / "out.csv")], {"XDG_CACHE_HOME": str(folder / cache), **more}).wall_s

        first, plain = [], []
        for i in range(repeats):
            plain.append(took(f"plain_{i}", TRACKRES_INTERPRETED="1"))
            first.append(took(f"first_{i}"))
            cache = folder / f"first_{i}"  # it goes on compiling for the next one
            while HAVE_NUMBA and not list(cache.rglob("*feed_all.entry*")):
                time.sleep(0.2)
        compiling = child(["-m", "trackres_ros.estimator.warm_up"], {"XDG_CACHE_HOME": str(folder / "all")})
        warm = [took("all") for _ in range(repeats)]
        return {
            "compiling for all kinds of work, once [s]": compiling.wall_s,
            "a first replay, nothing compiled [s]": statistics.median(first),
            "the same in plain Python alone [s]": statistics.median(plain),
            WAITED: statistics.median(first) - statistics.median(plain),
            "the same, all compiled [s]": statistics.median(warm),
        }
