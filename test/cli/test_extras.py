# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Commands with an optional library missing, interrupted commands, and checks that hold under `python -O`."""

import ast
import json
import os
import signal
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import pytest
from waiting import wait_for

import trackres_ros
from trackres_ros.evaluation.sealed.cases import draw_cases, sealed

# Blocks the import of modules, then runs the command line as it is.
BLOCKED = """
import sys
for name in {modules!r}:
    sys.modules[name] = None
from trackres_ros.cli.main import main
main({arguments!r})
"""
OPTIONAL = (
    "numba",
    "rosbags",
    "pyarrow",
    "pandas",
    "xarray",
    "matplotlib",
    "jinja2",
    "ruptures",
    "sklearn",
    "pysindy",
    "cyclonedds",
    "distributed",
    "SALib",
    "fsspec",
)


def without(modules, *arguments, cwd):
    program = BLOCKED.format(modules=tuple(modules), arguments=[str(a) for a in arguments])
    environment = {**os.environ, "TRACKRES_INTERPRETED": "1"}  # nothing here is worth compiling
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=cwd, env=environment, check=False)


NEEDED = [
    (("prove", "--quick", "-o", "out"), ("sklearn", "pysindy", "matplotlib", "jinja2", "ruptures", "numba")),
    (("prove", "--quick", "--json", "-o", "out"), ("sklearn",)),
    (("prove", "paper", "-o", "out"), ("matplotlib", "ruptures")),
    (("prove", "loop", "-o", "out"), ("matplotlib",)),
    (("prove", "real", "--data", "here", "-o", "out"), ("matplotlib",)),
    (("fleet", "drive.csv", "--vehicle", "agri3t", "-o", "out"), ("distributed", "fsspec", "pyarrow", "jinja2")),
    (("trend", "here"), ("pyarrow",)),
    (("prove", "fleet", "-o", "out"), ("distributed",)),
    (("reproduce", "-o", "out"), ("matplotlib",)),
    (("sensitivity", "agri3t"), ("SALib",)),
    (("record-sample", "-o", "out.mcap"), ("rosbags",)),
    (("simulate", "--vehicle", "agri3t", "--speed-kmh", "5", "-o", "out.parquet"), ("pyarrow",)),
    (("simulate", "--vehicle", "agri3t", "--speed-kmh", "5", "-o", "out.mcap"), ("rosbags",)),
    (("replay", "drive.csv", "--vehicle", "agri3t", "-o", "out.parquet"), ("pyarrow",)),
    (("replay", "drive.csv", "--vehicle", "agri3t", "-o", "out.mcap"), ("rosbags",)),
    (("live", "--edge", "dds", "--vehicle", "agri3t"), ("cyclonedds",)),
    (("live", "--edge", "dds", "--vehicle", "agri3t", "--record", "out.mcap"), ("rosbags",)),
    (("play", "lap.mcap"), ("cyclonedds",)),
]


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "here").mkdir()
    (tmp_path / "drive.csv").write_text("time_s,speed_mps\n" + "".join(f"{i * 0.1:.1f},2.0\n" for i in range(30)))
    return tmp_path


@pytest.mark.parametrize(
    ("arguments", "module"), [(a, m) for a, modules in NEEDED for m in modules], ids=lambda v: v if isinstance(v, str) else v[0]
)
def test_a_library_that_is_missing_is_said_before_any_work(folder, arguments, module):
    before = sorted(folder.rglob("*"))
    done = without([module], *arguments, cwd=folder)
    assert done.returncode == 2, done.stderr
    said, nothing = (done.stdout, done.stderr) if "--json" in arguments else (done.stderr, done.stdout)
    assert nothing == ""
    assert said.count("\n") == 1, said
    assert "pip install" in said
    assert sorted(folder.rglob("*")) == before


WORKS = [
    ("simulate", "--vehicle", "agri3t", "--speed-kmh", "5", "--duration-s", "5", "-o", "out.csv"),
    ("replay", "drive.csv", "--vehicle", "agri3t", "-o", "out.csv"),
    ("explain", "--vehicle", "agri3t", "--speed-kmh", "5", "--belt-degc", "20"),
    ("effects",),
]


@pytest.mark.parametrize("arguments", WORKS, ids=lambda a: a[0])
def test_without_any_of_them_the_rest_works(folder, arguments):
    done = without(OPTIONAL, *arguments, cwd=folder)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr


def test_an_interrupted_command_lists_the_files_it_has_written(tmp_path):
    pytest.importorskip("matplotlib")
    command = [sys.executable, "-m", "trackres_ros", "reproduce", "-o", str(tmp_path / "figures")]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert wait_for(lambda: list(tmp_path.rglob("*.csv")) or process.poll() is not None, working=process.pid)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=120)
    assert process.returncode == 130
    assert "written so far" in said
    first = sorted(path for path in (tmp_path / "figures").rglob("*") if path.is_file())[0]
    assert str(first) in said


SWALLOWED = """
import os, signal, threading, weakref
from trackres_ros.cli import entry
entry.AGAIN_S = 0.2
entry.insist()
class Some: pass
def callback(_):  # what is raised in here goes nowhere
    os.kill(os.getpid(), signal.SIGINT)
    for _ in range(1000):  # until the signal is handled
        pass
some = Some()
watched = weakref.ref(some, callback)
del some
try:
    threading.Event().wait(60.0)
except KeyboardInterrupt:
    entry.interrupt_handled()
    os.kill(os.getpid(), signal.SIGINT)
    print("taken")
"""


def test_a_swallowed_interrupt_is_raised_again_until_handled():
    done = subprocess.run([sys.executable, "-c", SWALLOWED], capture_output=True, text=True, check=True, timeout=50)
    assert done.stdout == "taken\n"
    assert "Exception ignored" in done.stderr


MET_IN_A_STRING = """
import sys
from trackres_ros.cli import entry
entry.insist()
try:
    exec("import os, signal, threading; os.kill(os.getpid(), signal.SIGINT); threading.Event().wait(60.0)")
except KeyboardInterrupt:
    entry.interrupt_handled()
    sys.exit(entry.INTERRUPTED)
"""


def test_an_interrupt_during_eval_of_a_string_exits_with_130(tmp_path):
    (tmp_path / "interrupted.py").write_text(MET_IN_A_STRING)
    done = subprocess.run([sys.executable, "-m", "interrupted"], cwd=tmp_path, timeout=50, capture_output=True)
    assert done.returncode == 130


def test_a_command_interrupted_before_it_wrote_says_so(tmp_path, monkeypatch, capsys):
    from trackres_ros.cli import main as cli_main

    def stop(*_args, **_kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr(cli_main.cli, "main", stop)
    with pytest.raises(SystemExit) as ended:
        cli_main.main(["simulate"])
    assert ended.value.code == 130
    assert "nothing was written" in capsys.readouterr().err


@pytest.mark.parametrize("flags", [(), ("-O",)])
def test_labels_unlike_the_seal_are_refused_without_asserts_too(tmp_path, flags):
    cases = draw_cases({"none": 2, "single": 2}, 5)
    (tmp_path / "seal.txt").write_text(sealed(5, cases) + "\n")
    (tmp_path / "sealed").mkdir()
    labels = {"seed": 5, "cases": [asdict(case) for case in cases]}
    labels["cases"][0]["level"] = "single" if labels["cases"][0]["level"] == "none" else "none"
    (tmp_path / "sealed" / "labels.json").write_text(json.dumps(labels))
    command = [sys.executable, *flags, "-m", "trackres_ros.evaluation.sealed.score", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode
    assert done.stderr.startswith("trackres: error: ")
    assert "not those that were sealed" in done.stderr
    assert not (tmp_path / "scores.json").exists()


def _says_only_a_type(test):
    if isinstance(test, ast.Call):
        return isinstance(test.func, ast.Name) and test.func.id == "isinstance"
    if isinstance(test, ast.Compare):
        return all(isinstance(op, ast.IsNot) for op in test.ops) and isinstance(test.comparators[0], ast.Constant)
    return isinstance(test, ast.Name | ast.Attribute)


def test_no_assert_of_the_package_guards_more_than_a_type():
    for path in Path(trackres_ros.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Assert):
                assert _says_only_a_type(node.test), f"{path}:{node.lineno} is gone under python -O"
