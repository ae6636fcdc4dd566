# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The proof as three processes, on two cases."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from trackres_ros.cli import prove
from trackres_ros.cli.main import cli
from trackres_ros.errors import InputError
from trackres_ros.evaluation.sealed import earlier
from trackres_ros.evaluation.sealed.oracle import LEAST_GAIN
from trackres_ros.evaluation.sealed.scored import wilson


def process(module, *arguments):
    command = [sys.executable, "-m", f"trackres_ros.evaluation.sealed.{module}", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


@pytest.mark.long
def test_the_labels_are_opened_only_by_the_score(tmp_path):
    said = process("generate", tmp_path, 7, 5, "outside=1", "single=1")
    seal = (tmp_path / "seal.txt").read_text().strip()
    assert seal in said
    cases = sorted((tmp_path / "cases").iterdir())
    assert all({p.suffix for p in case.iterdir()} == {".csv", ".yaml"} for case in cases)
    away = tmp_path.parent / "away"
    (tmp_path / "sealed").rename(away)  # the diagnosis does without
    process("blind", tmp_path / "cases", tmp_path / "results")
    process("earlier", tmp_path / "cases", tmp_path / "results_earlier", Path(__file__).parents[2])
    away.rename(tmp_path / "sealed")
    assert {p.stem for p in (tmp_path / "results").iterdir()} == {c.name for c in cases}
    page = process("score", tmp_path)
    assert seal in page
    scores = json.loads((tmp_path / "scores.json").read_text())
    assert sorted(c["case"]["level"] for c in scores["cases"]) == ["outside", "single"]
    assert all(c["answers"]["earlier"] == c["answers"]["diagnosis"] for c in scores["cases"])  # the same version twice
    (outside,) = [c for c in scores["cases"] if c["case"]["level"] == "outside"]
    assert outside["known"]["gain"] > LEAST_GAIN
    assert outside["known"]["mae"] < outside["known"]["mae_base"]
    assert all(len(c["learned"]) > 1 and min(c["learned"].values()) > 0.0 for c in scores["cases"])
    labels = tmp_path / "sealed" / "labels.json"
    labels.write_text(labels.read_text().replace('"level": "single"', '"level": "none"'))
    with pytest.raises(subprocess.CalledProcessError):
        process("score", tmp_path)


def test_wilson():
    assert wilson(0, 10) == pytest.approx((0.0, 0.2775), abs=1e-3)
    assert wilson(9, 10) == pytest.approx((0.5958, 0.9821), abs=1e-3)


@pytest.mark.parametrize("level", ["easy", "easy=3", "outside=", "outside=0", "outside=some", "outside=-1"])
def test_a_level_that_is_none_is_refused(tmp_path, level):
    done = CliRunner().invoke(cli, ["prove", "--level", level, "-o", str(tmp_path)])
    assert isinstance(done.exception, InputError)
    assert level in str(done.exception)
    assert not list(tmp_path.iterdir())


def test_a_run_takes_cases_by_level_and_resumes_where_it_stopped(tmp_path, monkeypatch):
    started = []
    monkeypatch.setattr(prove, "_process", lambda _stream, module, *arguments: started.append((module, arguments)))
    begun = ["prove", "--level", "outside=18", "--level", "none", "--cases", "6", "--seed", "31", "-o", str(tmp_path)]
    assert CliRunner().invoke(cli, begun).exit_code == 0
    assert started[0] == ("generate", (str(tmp_path), "31", "15", "outside=18", "none=6"))
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "one.json").touch()
    assert CliRunner().invoke(cli, begun).exit_code == 0
    assert (tmp_path / "results" / "one.json").exists()
    assert CliRunner().invoke(cli, [*begun, "--fresh"]).exit_code == 0
    assert not (tmp_path / "results").exists()


def test_an_earlier_version_is_a_checkout(tmp_path):
    with pytest.raises(InputError, match="--earlier"):
        earlier.main([str(tmp_path), str(tmp_path / "results"), str(tmp_path)])


def test_a_folder_of_something_else_is_refused(tmp_path):
    (tmp_path / "results").mkdir()
    done = CliRunner().invoke(cli, ["prove", "--quick", "-o", str(tmp_path)])
    assert isinstance(done.exception, InputError)
    assert (tmp_path / "results").is_dir()
