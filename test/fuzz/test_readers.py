# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Every reader on damaged files of its format: nothing but one line, no hang, no flood, no row lost without a word."""

from __future__ import annotations

import ast
import json
import resource
import signal
import subprocess
import sys
from collections import Counter
from contextlib import contextmanager
from pathlib import Path

import pytest

pytest.importorskip("rosbags")
pytest.importorskip("mcap")
pytest.importorskip("pyarrow")
pytest.importorskip("openpyxl")
pytest.importorskip("asammdf")
pytest.importorskip("cantools")
pytest.importorskip("h5py")
pytest.importorskip("pyulog")

import run
from formats import FORMATS, Damaged, damaged, outcome_of

MUTATIONS, HANG_S = 100, 60.0


@pytest.mark.parametrize("name", FORMATS)
def test_the_whole_file_is_read_whole(tmp_path, name):
    FORMATS[name].write(tmp_path)
    path = tmp_path / FORMATS[name].file
    form = FORMATS[name]
    result = outcome_of(Damaged(path, path, path.read_bytes() if path.is_file() else b"", form))
    assert result["outcome"] in ("alike", "remarks" if form.file.startswith("bus") else "alike")  # frames that say nothing
    assert f"of {dict(form.expected)}; " in result["text"]
    assert Counter(ast.literal_eval(result["text"].partition(" of ")[0])) == form.expected


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # the timer may hit a callback, and comes again
@pytest.mark.long
@pytest.mark.parametrize("name", FORMATS)
def test_damaged_files(name, tmp_path, bounded):
    for number, one in enumerate(damaged(FORMATS[name], tmp_path, MUTATIONS, seed=1)):
        with bounded():
            result = outcome_of(one)
        assert result["outcome"] not in run.FAULTS, f"mutation {number}: {result['text']}"


@pytest.mark.parametrize("number", [2214, 3558])
def test_a_damaged_parquet_column_ends_no_process(number, tmp_path):  # of those that are not read
    for one in damaged(FORMATS["parquet"], tmp_path, number + 1, seed=2, start=number):
        assert outcome_of(one)["outcome"] not in run.FAULTS


@pytest.fixture
def bounded():
    """`with bounded():` ends what hangs, and finds that and what takes a gigabyte: a reader refuses both as damage."""
    begun, late = run.peak_bytes(), []

    def hangs(*_):
        late.append(True)
        raise TimeoutError

    @contextmanager
    def watched():
        signal.setitimer(signal.ITIMER_REAL, HANG_S)
        yield
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        assert not late
        assert run.peak_bytes() < begun + run.MOST_BYTES

    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limits, handler = resource.getrlimit(resource.RLIMIT_AS), signal.signal(signal.SIGALRM, hangs)
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + run.LIMIT_BYTES, limits[1]))
    yield watched
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    signal.signal(signal.SIGALRM, handler)
    resource.setrlimit(resource.RLIMIT_AS, limits)


LARGE = """
import subprocess, sys
filled = b"x" * 300_000_000
subprocess.run([sys.executable, "-c", "import run; print(run.peak_bytes())"], check=True)
"""


def test_memory_of_whoever_starts_a_worker_is_not_counted():
    done = subprocess.run([sys.executable, "-c", LARGE], cwd=Path(__file__).parent, capture_output=True, check=True)
    assert 0 < int(done.stdout) < 200_000_000


def test_the_command_prints_counts():
    script = Path(__file__).with_name("run.py")
    command = [sys.executable, str(script), "--count", "3", "--format", "csv", "--json"]
    done = subprocess.run(command, capture_output=True, check=True)
    counts = json.loads(done.stdout)["csv"]
    assert counts.pop("faults") == []
    assert sum(counts.values()) == 3
    assert "| csv | 2 |" in run.table({"csv": run.Result(Counter(alike=2))})


WORKER = """
import json, os, sys, time
for number in range(int(sys.argv[sys.argv.index("--start") + 1]), 4):
    print(json.dumps({"begin": number}), flush=True)
    outcome = "alike"
    if number == 1:
        FAULT
    print(json.dumps({"number": number, "outcome": outcome, "text": ""}), flush=True)
    if outcome == "memory":
        break
"""


@pytest.mark.parametrize(("fault", "outcome"), [
    ("outcome = 'traceback'", "traceback"), ("raise ZeroDivisionError", "traceback"), ("os.abort()", "traceback"),
    ("os._exit(0)", "traceback"), ("time.sleep(60)", "hang"), ("outcome = 'memory'", "memory"), ("outcome = 'lost'", "lost"),
])  # fmt: skip
def test_the_watch_sees_every_fault_and_goes_on(tmp_path, monkeypatch, fault, outcome):
    monkeypatch.setattr(run, "HANG_S", 2.0)
    script = tmp_path / "worker.py"
    script.write_text(WORKER.replace("FAULT", fault))
    result = run.fuzzed("csv", 4, seed=1, script=script)
    assert result.outcomes == {"alike": 3, outcome: 1}
    assert [(one["number"], one["outcome"]) for one in result.faults] == [(1, outcome)]
