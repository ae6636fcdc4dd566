# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Every benchmark runs, on tiny sizes; no time is judged here."""

import importlib
import math
import shutil
import sys
from types import SimpleNamespace
from unittest.mock import create_autospec

import pytest

pytest.importorskip("rosbags")

SIZES = {
    "bench_step": {"steps": 60, "messages": 200},
    "bench_route": {"steps": 200},
    "bench_recording": {"duration_s": 20.0, "repeats": 1, "exact_samples": 2, "restarted": 10},
    "bench_reading": {"messages": 500, "repeats": 1},
    "bench_table": {"repeats": 1, "points": 5, "replays": 0},
    "bench_ways": {"duration_s": 5.0, "repeats": 1, "messages": 500, "calls": 10, "ways": 0},
    "bench_learning": {"seconds": 2.0, "rounds": 1},
    "bench_fleet": {"recordings": 10, "minutes": 3.0, "analysed": 1},
    "bench_controller": {"steps": 200},
    "bench_export": {"steps": 100, "rounds": 1, "hours": 0.02},
    "bench_diagnosis": {"minutes": 6.0, "step_s": 0.5},
}
SIGNED = ("growth", "on top of reading", "saved")  # these may be zero or negative


@pytest.fixture
def benchmark_module(repository, monkeypatch):
    monkeypatch.syspath_prepend(str(repository / "benchmarks"))

    def import_it(name):
        return importlib.import_module(name)

    yield import_it
    for name in (*SIZES, "measuring", "rivals", "dds_echo", "bench_live", "run"):
        sys.modules.pop(name, None)


def of_stages_alone(_recordings, _base, options):
    """Stands for a diagnosis: what the benchmark looks at of it."""
    for stage in ("re-fit of the base", "missing physics: warmup"):
        options.on_stage(stage)
    return SimpleNamespace(verdict=SimpleNamespace(sentence="nothing is missing"))


@pytest.fixture
def lightened(monkeypatch, in_this_process, good):
    """Takes from a benchmark what costs time and tells a test nothing: processes, optimisation, a diagnosis."""

    def change(name, module):
        if name == "bench_ways":  # one kind by a process on a copy of the sources, the others here
            apart, here = module.measured, lambda of, _way, sizes: module.MEASURES[of](**sizes)
            monkeypatch.setattr(module, "measured", lambda of, *more: (apart if of == module.STEP else here)(of, *more))
        elif name == "bench_fleet":
            in_this_process(module)
        elif name == "bench_reading":
            monkeypatch.setattr(module, "child", lambda words: good(*words[2:]) and SimpleNamespace(peak_bytes=1))
        elif name == "bench_export":
            monkeypatch.setattr(module, "FLAGS", ("-std=c99", "-O0"))
        elif name == "bench_diagnosis":
            monkeypatch.setattr(module, "diagnose", create_autospec(module.diagnose, side_effect=of_stages_alone))
        return module

    return change


@pytest.mark.long
@pytest.mark.parametrize("name", SIZES)
def test_gives_finite_positive_numbers(name, benchmark_module, lightened):
    if name == "bench_controller" and not (shutil.which("cc") and shutil.which("c++")):
        pytest.skip("no C and C++ compiler")
    module = lightened(name, benchmark_module(name))
    results = module.run(**SIZES[name])
    assert results
    if name == "bench_recording":
        assert module.TARGETS.keys() <= results.keys()
    for what, value in results.items():
        assert math.isfinite(value), what
        assert value > 0.0 or any(word in what for word in SIGNED), what


def test_every_way_that_was_tried_can_be_tried_again(benchmark_module, tmp_path):
    ways = benchmark_module("bench_ways")
    for number, way in enumerate(ways.WAYS):
        ways.changed(tmp_path / str(number), way)  # raises where the sources have moved on


def test_a_part_of_the_page_stays_where_another_is_measured(benchmark_module):
    run = benchmark_module("run")
    kept = run.kept()
    assert "One step" in kept
    assert kept["One step"].startswith("## One step\n")
    assert all(text.count("## ") == 1 for text in kept.values())


def test_table_says_which_targets_are_missed(benchmark_module):
    run, measuring = benchmark_module("run"), benchmark_module("measuring")
    lines = run.rows(
        {"slow": 2.0, "fast": 40.0, "free": 1.0},
        {"slow": measuring.at_most(1.0), "fast": measuring.at_least(30), "left out": measuring.at_most(1.0)},
    )
    assert lines[2:] == [
        "| slow | 2 | at most 1 | **no** |",
        "| fast | 40 | at least 30 | yes |",
        "| free | 1 |  |  |",
        "| left out | not measured | at most 1 | |",
    ]
