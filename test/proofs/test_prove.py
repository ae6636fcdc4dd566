# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The steps of the proof on one case, and how it is asked for."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import asdict
from functools import partial
from pathlib import Path

import pytest

from proofs import commands
from proofs.learned import cases as learned
from proofs.learned import generate as learned_generate
from proofs.learned import score as learned_score
from proofs.processes import call, each, show_count, write_sealed
from proofs.sealed import earlier, score
from proofs.sealed.cases import draw_cases
from proofs.sealed.oracle import LEAST_GAIN
from proofs.sealed.scored import wilson
from trackres_ros.errors import InputError
from trackres_ros.files.interpreter import python

EARLIER = """
import pathlib, sys
out, drive = sys.argv[sys.argv.index("-o") + 1], pathlib.Path(sys.argv[2])
(pathlib.Path(out) / "report.json").write_text((drive.parents[2] / "report.json").read_text())
"""
"""Stands for the checkout of an earlier version: a command line whose report is already there."""


def process(module, *arguments):
    words = [f"sealed.{module}.main", *map(str, arguments)]
    return subprocess.run(**python("proofs.processes", *words), capture_output=True, text=True, check=True).stdout


@pytest.mark.long
def test_the_labels_are_opened_only_by_the_score(tmp_path, capsys):
    said = process("generate", tmp_path, 7, 5, "outside=1")
    seal = (tmp_path / "seal.txt").read_text().strip()
    assert seal in said
    (case,) = (tmp_path / "cases").iterdir()
    assert {p.suffix for p in case.iterdir()} == {".csv", ".yaml"}
    away = tmp_path.parent / "away"
    (tmp_path / "sealed").rename(away)  # the diagnosis does without
    call("sealed.blind.main", str(tmp_path / "cases"), str(tmp_path / "results"))
    (result,) = (tmp_path / "results").iterdir()
    assert result.stem == case.name
    (tmp_path / "report.json").write_text(json.dumps(json.loads(result.read_text())["report"]))
    (tmp_path / "checkout" / "trackres_ros").mkdir(parents=True)
    for name, text in (("__init__.py", ""), ("__main__.py", EARLIER)):
        (tmp_path / "checkout" / "trackres_ros" / name).write_text(text)
    earlier.main(*(tmp_path / name for name in ("cases", "results_earlier", "checkout")))
    away.rename(tmp_path / "sealed")
    call("sealed.score.main", str(tmp_path))
    assert seal in capsys.readouterr().out
    (scores,) = json.loads((tmp_path / "scores.json").read_text())["cases"]
    assert scores["case"]["level"] == "outside"
    assert scores["answers"]["earlier"] == scores["answers"]["diagnosis"]  # the same version twice
    assert scores["known"]["gain"] > LEAST_GAIN
    assert scores["known"]["mae"] < scores["known"]["mae_base"]
    assert len(scores["learned"]) > 1
    assert min(scores["learned"].values()) > 0.0


def test_a_failed_task_stops_those_not_begun(tmp_path):
    tasks = [["false"], *(["sh", "-c", f"sleep 0.1; touch {tmp_path / str(number)}"] for number in range(20 * os.cpu_count()))]
    with pytest.raises(subprocess.CalledProcessError):
        each(partial(subprocess.run, check=True), tasks)
    assert len(list(tmp_path.iterdir())) < 10 * os.cpu_count()


@pytest.mark.parametrize(
    ("cases", "hidden", "score"),
    [
        (draw_cases({"none": 2, "single": 2}, 5), lambda drawn: {"seed": 5, "cases": drawn}, score.main),
        (learned.draw_cases(5, 1, 1), lambda drawn: [5, drawn], lambda folder: learned_score.main(folder, 0.0)),
    ],
)
def test_labels_unlike_the_seal_are_refused(tmp_path, cases, hidden, score):
    drawn = list(map(asdict, cases))
    for seed, told in ((5, [*drawn[:-1], {**drawn[-1], "seed": 1}]), (5, drawn[::-1]), (6, drawn)):
        write_sealed(tmp_path, "cases", hidden(drawn), {"seed": seed, "cases": told})
        with pytest.raises(InputError, match="not those that were sealed"):
            score(tmp_path)
    assert not (tmp_path / "scores.json").exists()


def test_labels_as_they_were_sealed_are_scored(tmp_path):
    learned_generate.main(tmp_path, 5, 1.0, 2, 1, first=0)
    learned_score.main(tmp_path, 0.0)
    assert json.loads((tmp_path / "scores.json").read_text())["sealed"] == 3


def test_wilson():
    assert wilson(0, 10) == pytest.approx((0.0, 0.2775), abs=1e-3)
    assert wilson(9, 10) == pytest.approx((0.5958, 0.9821), abs=1e-3)


LEVELS = "easy", "easy=3", "outside=", "outside=0", "outside=some", "outside=-1"


@pytest.mark.parametrize("words", [("--profiles", "."), *(("--level", level) for level in LEVELS)])
def test_a_level_or_folder_of_speeds_that_is_none_is_refused(refused, tmp_path, words):
    shown = refused("proofs", "own", *words, "-o", "out", cwd=tmp_path)
    assert all(word in shown for word in words)
    assert not list(tmp_path.iterdir())


def test_a_run_takes_cases_by_level_and_resumes_where_it_stopped(good, tmp_path, monkeypatch):
    started = []
    monkeypatch.setattr(commands, "_process", lambda _as_json, step: started.append(tuple(map(str, step))))
    begun = "proofs", "own", "--level", "outside=18", "--level", "none", "--cases", "6", "--seed", "31", "-o", tmp_path
    good(*begun)
    assert started[0] == ("sealed.generate.main", str(tmp_path), "31", "15", "outside=18", "none=6")
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "one.json").touch()
    good(*begun)
    assert (tmp_path / "results" / "one.json").exists()
    good(*begun, "--fresh")
    assert not (tmp_path / "results").exists()


@pytest.mark.parametrize("total", [1, 7, 118, 1000])
def test_progress_in_a_log_is_at_most_ten_lines_and_the_last(total, capsys):
    for done in range(1, total + 1):
        show_count("diagnosed", done, total)
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == min(total, 10)
    assert lines[-1] == f"diagnosed {total} of {total}"


WORKING = """
import pathlib, sys, time
from concurrent.futures import ProcessPoolExecutor
with ProcessPoolExecutor(2) as pool:
    list(pool.map(time.sleep, [0.0, 0.0]))
    pathlib.Path(sys.argv[1]).write_text(" ".join(map(str, pool._processes)))
    time.sleep(60.0)
"""
"""Stands for a step of a proof: it names its workers, and goes on."""


def until(holds, patience_s=20.0):
    end = time.monotonic() + patience_s
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_ended_by_a_signal_it_leaves_no_process(repository, tmp_path):
    (tmp_path / "working.py").write_text(WORKING)
    begin = "import sys; from proofs.commands import _run; _run('work', args=[sys.executable, 'working.py', 'workers'])"
    command = subprocess.Popen([sys.executable, "-c", begin], cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(repository)})
    until(lambda: (tmp_path / "workers").exists() and (tmp_path / "workers").read_text().count(" "))
    workers = (tmp_path / "workers").read_text().split()
    command.terminate()
    assert command.wait(20.0) == 128 + signal.SIGTERM
    until(lambda: not any(Path(f"/proc/{worker}").exists() for worker in workers))


def test_an_earlier_version_is_a_checkout(tmp_path):
    with pytest.raises(InputError, match="--earlier"):
        earlier.main(tmp_path, tmp_path / "results", tmp_path)


def test_a_folder_of_something_else_is_refused(trackres, tmp_path):
    (tmp_path / "results").mkdir()
    assert trackres("proofs", "own", "--quick", "-o", tmp_path).returncode == 2
    assert (tmp_path / "results").is_dir()
