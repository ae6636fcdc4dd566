# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Every reader on damaged files of its format: nothing but one line, no hang, no flood, no row lost without a word."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

pytest.importorskip("rosbags")
pytest.importorskip("mcap")
pytest.importorskip("pyarrow")
pytest.importorskip("openpyxl")
pytest.importorskip("asammdf")
pytest.importorskip("cantools")
pytest.importorskip("h5py")

import run
from formats import FORMATS, Damaged, outcome_of

MUTATIONS = 300


@pytest.mark.parametrize("name", FORMATS)
def test_the_whole_file_is_read_whole(tmp_path, name):
    FORMATS[name].write(tmp_path)
    path = tmp_path / FORMATS[name].file
    form = FORMATS[name]
    result = outcome_of(Damaged(path, path, path.read_bytes() if path.is_file() else b"", form))
    assert result["outcome"] in ("alike", "remarks" if form.file.startswith("bus") else "alike")  # frames that say nothing
    assert f"of {dict(form.expected)}; " in result["text"]
    assert Counter(ast.literal_eval(result["text"].partition(" of ")[0])) == form.expected


@pytest.mark.long
@pytest.mark.parametrize("name", FORMATS)
def test_damaged_files(name):
    result = run.fuzzed(name, MUTATIONS, seed=1)
    assert result.outcomes.total() == MUTATIONS
    assert not result.faults
    assert not any(result.outcomes[fault] for fault in run.FAULTS)
    assert f"| {name} | {MUTATIONS} |" in run.table({name: result})


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
