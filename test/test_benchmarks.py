# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Every benchmark runs, on tiny sizes; no time is judged here."""

import importlib
import math
import sys

import pytest

for needed in ("rosbags", "pyarrow", "matplotlib"):
    pytest.importorskip(needed)

NAMES = ("bench_replay", "bench_step", "bench_live", "bench_diagnosis", "bench_engine", "bench_memory", "bench_reading")
HELPERS = ("bags", "measuring", "dds_echo", "run")
DASK = "--workers=2"
SHORTER = {"diagnose": ("--quick", "--no-page"), "fleet": ("--period=none",)}


@pytest.fixture
def benchmark_module(repository, monkeypatch):
    monkeypatch.syspath_prepend(str(repository / "benchmarks"))

    def import_it(name):
        return importlib.import_module(name)

    yield import_it
    for name in (*NAMES, *HELPERS):
        sys.modules.pop(name, None)


@pytest.fixture
def lightened(benchmark_module, monkeypatch, good, undrawn, in_this_process):
    """A benchmark whose commands run in this process, without Dask and long searches, and all end with the same numbers."""
    measuring = benchmark_module("measuring")
    for name in ("run", "periods"):
        in_this_process(importlib.import_module(f"trackres_ros.tools.fleet.{name}"))

    def command(*words, home=None, cwd=None):
        good(*(word for word in words if word != DASK), *(SHORTER.get(words[0], ()) if words[1] != "sample" else ()), cwd=cwd)
        return measuring.Ended("", 1.0, 1_000_000)

    def change(name):
        module = benchmark_module(name)
        if hasattr(module, "trackres"):
            monkeypatch.setattr(module, "trackres", command)
        if name == "bench_engine":
            monkeypatch.setattr(module, "child", lambda words, _environment: command(*words[2:]))
        return module

    return change


@pytest.mark.long
@pytest.mark.parametrize("name", NAMES)
def test_gives_finite_positive_numbers(name, lightened):
    module = lightened(name)
    rows = module.run(**module.SMALL)
    if not rows:
        pytest.skip("no C compiler, or no cyclonedds")
    for row in rows:
        assert math.isfinite(row.measured), row
        assert row.measured > 0.0 or "for each hour" in row.name, row
        assert row.rival is None or row.ratio > 0.0, row


def test_a_part_of_the_page_stays_where_another_is_measured(benchmark_module):
    run = benchmark_module("run")
    kept = run.kept()
    assert all(text.startswith(f"## {title}\n") and text.count("## ") == 1 for title, text in kept.items())
    assert kept.keys() == run.BENCHMARKS.keys()


def test_table_says_which_targets_are_missed(benchmark_module):
    run, measuring = benchmark_module("run"), benchmark_module("measuring")
    rows = [
        measuring.compared("slow", [4.0, 6.0], [2.0, 2.0], 1.5),
        measuring.compared("fast", [1.0], [2.0], 1.5),
        measuring.alone("heavy", 200.0, 110.0),
        measuring.alone("free", 1.0),
    ]
    assert run.table(rows)[2:] == [
        "| slow | 5 | 2 | 2.5 | **1.5** |",
        "| fast | 1 | 2 | 0.5 | 1.5 |",
        "| heavy | 200 |  |  | **110** |",
        "| free | 1 |  |  |  |",
    ]
