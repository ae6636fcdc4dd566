# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The loss table: time to build it and to load it from the cache, and its error against the exact method. Then the first
estimate of a process and the first replay on a machine.
"""

from __future__ import annotations

import statistics
import tempfile
from pathlib import Path

import numpy as np
from measuring import at_most, child, median_ratio, seconds

from trackres_ros.export.exporting import Request, export_c
from trackres_ros.kernels.compiler import compiled
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
SCRIPT = Path(__file__).with_name("plain_replay.py")
SCRIPTED, FIRST, WARM = "a plain script", "a first replay, in an empty home", "a replay with its tables there"
IN_PYTHON = "the same in plain Python"
TARGETS = {
    "spectral: building [s]": at_most(3.0),
    "rainflow: building [s]": at_most(3.0),
    "spectral: largest interpolation error [%]": at_most(0.3),
    "rainflow: largest interpolation error [%]": at_most(0.3),
    f"{FIRST} over {SCRIPTED}": at_most(1.5),
    f"{WARM} over {SCRIPTED}": at_most(1.5),
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
    """The command on a recording of 13 minutes over a plain script: in an empty home, with tables there, in plain Python."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        child(["-c", SAMPLE, str(folder / "sample.mcap")])
        export_c(Request("xgd24d"), folder / "c")
        library = compiled((folder / "c" / "trackres.c").read_text(encoding="utf-8"), f"-I{folder / 'c'}")
        if library is None:
            return {}
        (folder / "step.so").write_bytes(library)
        replay = [
            "-m",
            "trackres_ros",
            "replay",
            str(folder / "sample.mcap"),
            "--vehicle",
            "xgd24d",
            "-o",
            str(folder / "out.csv"),
        ]
        script = [str(SCRIPT), str(folder / "step.so"), str(folder / "sample.mcap"), str(folder / "plain.csv")]

        def took(home: str, command: list[str], **more: str) -> float:
            places = {"HOME": str(folder / home), "XDG_CACHE_HOME": str(folder / home / "cache"), **more}
            return child(command, places).processor_s

        took("warm", replay), took("plain", script)
        times: dict[str, list[float]] = {SCRIPTED: [], FIRST: [], WARM: [], IN_PYTHON: []}
        for i in range(repeats):
            times[SCRIPTED].append(took("plain", script))
            times[FIRST].append(took(f"first_{i}", replay))
            times[WARM].append(took("warm", replay))
            times[IN_PYTHON].append(took("warm", replay, TRACKRES_INTERPRETED="1"))
        found = {f"{name}, processor time [s]": statistics.median(of) for name, of in times.items()}
        ratios = {f"{name} over {SCRIPTED}": median_ratio(of, times[SCRIPTED]) for name, of in times.items() if name != SCRIPTED}
        return found | ratios
