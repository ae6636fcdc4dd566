# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The steps of the proof on one case, and how it is asked for."""

import json
import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from proofs import pipeline
from proofs.pipeline import begin, each, show_count
from proofs.sealed import own
from proofs.sealed.scoring import LEAST_GAIN, wilson
from trackres_ros.errors import InputError
from trackres_ros.files.interpreter import python

EARLIER = """
import pathlib, sys
out, drive = sys.argv[sys.argv.index("-o") + 1], pathlib.Path(sys.argv[2])
(pathlib.Path(out) / "report.json").write_text((drive.parents[2] / "report.json").read_text())
"""
"""Stands for the checkout of an earlier version: a command line whose report is already there."""


def settings(**counts):
    """Settings of a run on the project's own cases."""
    return {"seed": 7, "minutes": 5.0, "counts": counts, "profiles": None, "followed": 8}


@pytest.mark.long
def test_the_labels_are_opened_only_by_the_score(tmp_path, capsys):
    begin("own", tmp_path, settings(outside=1))
    words = python("proofs.pipeline", "pipeline.draw", tmp_path)
    text_here = subprocess.run(**words, capture_output=True, text=True, check=True).stdout
    seal = (tmp_path / "seal.txt").read_text().strip()
    assert seal in text_here
    (case,) = (tmp_path / "cases").iterdir()
    assert {p.suffix for p in case.iterdir()} == {".csv", ".yaml"}
    distance = tmp_path.parent / "away"
    (tmp_path / "sealed").rename(distance)  # the diagnosis does without
    pipeline.call("pipeline.answer", "sealed.diagnosing.answer", str(tmp_path / "cases"), str(tmp_path / "results"))
    (result,) = (tmp_path / "results").iterdir()
    assert result.stem == case.name
    (tmp_path / "report.json").write_text(json.dumps(json.loads(result.read_text())["report"]))
    (tmp_path / "checkout" / "trackres_ros").mkdir(parents=True)
    for name, text in (("__init__.py", ""), ("__main__.py", EARLIER)):
        (tmp_path / "checkout" / "trackres_ros" / name).write_text(text)
    own.earlier(*(tmp_path / name for name in ("cases", "results_earlier", "checkout")))
    distance.rename(tmp_path / "sealed")
    pipeline.score(tmp_path)
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


LEARNING = {"seed": 5, "minutes": 1.0, "vehicles": 2, "hostile": 1}


@pytest.mark.parametrize(("proof", "options"), [("own", settings(none=2, single=2)), ("learning", LEARNING)])
def test_labels_unlike_the_seal_are_refused(tmp_path, proof, options):
    begin(proof, tmp_path, options)
    pipeline.draw(tmp_path, 0)
    labels = tmp_path / "sealed" / "labels.json"
    sealed = json.loads(labels.read_text())
    drawing = sealed["cases"]
    for other_item in ({"cases": [*drawing[:-1], {**drawing[-1], "seed": 1}]}, {"cases": drawing[::-1]}, {"seed": 6}):
        labels.write_text(json.dumps({**sealed, **other_item}))
        with pytest.raises(InputError, match="not those that were sealed"):
            pipeline.score(tmp_path)
    assert not (tmp_path / "scores.json").exists()


def test_labels_as_they_were_sealed_are_scored(tmp_path):
    begin("learning", tmp_path, LEARNING)
    pipeline.draw(tmp_path, 0)
    pipeline.score(tmp_path, 0)
    assert json.loads((tmp_path / "scores.json").read_text())["sealed"] == 3


def test_a_recording_that_was_interrupted_is_made_again(tmp_path):
    begin("groomer", tmp_path, {"seed": 7, "counts": {"none": 2}})
    pipeline.draw(tmp_path)
    broken, finished = (case / "session1.csv" for case in sorted((tmp_path / "cases").iterdir()))
    total = broken.read_bytes()
    (tmp_path / "sealed" / f"{broken.parent.name}.recorded").unlink()
    for table in (broken, finished):
        table.write_text("half")
    pipeline.draw(tmp_path)
    assert broken.read_bytes() == total
    assert finished.read_text() == "half"


def length(folder):
    """Stands for an answer: what is in the folder of a case, and an array."""
    return {"files": len(list(folder.iterdir()))}, {"numbers": np.arange(3.0)}


def test_the_first_cases_without_an_answer_get_one(tmp_path):
    for name in "abcd":
        (tmp_path / "cases" / name).mkdir(parents=True)
    results = tmp_path / "results"
    results.mkdir()
    (results / "b.json").write_text("kept")
    pipeline.answer_all(length, tmp_path / "cases", results, 3)
    assert {path.name for path in results.iterdir()} == {"a.json", "a.npz", "b.json", "c.json", "c.npz"}
    assert (results / "b.json").read_text() == "kept"
    assert json.loads((results / "c.json").read_text()) == {"files": 0}
    assert np.load(results / "c.npz")["numbers"].tolist() == [0.0, 1.0, 2.0]


def test_wilson():
    assert wilson(0, 10) == pytest.approx((0.0, 0.2775), abs=1e-3)
    assert wilson(9, 10) == pytest.approx((0.5958, 0.9821), abs=1e-3)


LEVELS = "easy", "easy=3", "outside=", "outside=0", "outside=some", "outside=-1"


@pytest.mark.parametrize("words", [("--profiles", "."), *(("--level", level) for level in LEVELS)])
def test_a_level_or_folder_of_speeds_that_is_none_is_refused(refused, tmp_path, words):
    shown_text = refused("proofs", "own", *words, "-o", "out", cwd=tmp_path)
    assert all(word in shown_text for word in words)
    assert not list(tmp_path.iterdir())


def test_a_run_takes_cases_by_level_and_resumes_where_it_stopped(good, trackres, tmp_path, monkeypatch):
    started = []
    monkeypatch.setattr(pipeline, "run_step", lambda step, _as_json: started.append(step))
    begun = "proofs", "own", "--level", "outside=18", "--level", "none", "--cases", "6", "--seed", "31", "-o", tmp_path
    good(*begun)
    assert [step[0] for step in started] == [
        "pipeline.draw", "pipeline.answer", "sealed.own.follow", "pipeline.answer", "pipeline.score",
    ]  # fmt: skip
    noted = json.loads((tmp_path / "settings.json").read_text())
    assert (noted["seed"], noted["minutes"], noted["counts"]) == (31, 15.0, {"outside": 18, "none": 6})
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "one.json").touch()
    good(*begun)
    assert trackres(*begun, "--quick").returncode == 2
    assert (tmp_path / "results" / "one.json").exists()
    good(*begun, "--fresh")
    assert not (tmp_path / "results").exists()


@pytest.mark.parametrize("total", [1, 7, 118, 1000])
def test_progress_in_a_log_is_at_most_ten_lines_and_the_last(total, capsys):
    for outcome in range(1, total + 1):
        show_count("diagnosed", outcome, total)
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
    code = (
        "import sys; from proofs.pipeline import run_process; run_process('work', args=[sys.executable, 'working.py', 'workers'])"
    )
    command = subprocess.Popen([sys.executable, "-c", code], cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(repository)})
    until(lambda: (tmp_path / "workers").exists() and (tmp_path / "workers").read_text().count(" "))
    workers = (tmp_path / "workers").read_text().split()
    command.terminate()
    assert command.wait(20.0) == 128 + signal.SIGTERM
    until(lambda: not any(Path(f"/proc/{worker}").exists() for worker in workers))


def test_an_earlier_version_is_a_checkout(tmp_path):
    with pytest.raises(InputError, match="--earlier"):
        own.earlier(tmp_path, tmp_path / "results", tmp_path)


def test_a_folder_of_something_else_is_refused(trackres, tmp_path):
    (tmp_path / "results").mkdir()
    assert trackres("proofs", "own", "--quick", "-o", tmp_path).returncode == 2
    assert (tmp_path / "results").is_dir()
