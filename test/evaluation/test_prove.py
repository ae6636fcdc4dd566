"""The proof as three processes, on two cases."""

import json
import subprocess
import sys

import pytest
from click.testing import CliRunner

from trackres_ros.cli.main import cli
from trackres_ros.errors import InputError
from trackres_ros.evaluation.sealed.scored import wilson


def process(module, *arguments):
    command = [sys.executable, "-m", f"trackres_ros.evaluation.sealed.{module}", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


@pytest.mark.long
def test_the_labels_are_opened_only_by_the_score(tmp_path):
    said = process("generate", tmp_path, 7, 5, "none=1", "single=1")
    seal = (tmp_path / "seal.txt").read_text().strip()
    assert seal in said
    cases = sorted((tmp_path / "cases").iterdir())
    assert all({p.suffix for p in case.iterdir()} == {".csv", ".yaml"} for case in cases)
    away = tmp_path.parent / "away"
    (tmp_path / "sealed").rename(away)  # the diagnosis does without
    process("blind", tmp_path / "cases", tmp_path / "results")
    away.rename(tmp_path / "sealed")
    assert {p.stem for p in (tmp_path / "results").iterdir()} == {c.name for c in cases}
    page = process("score", tmp_path)
    assert seal in page
    scores = json.loads((tmp_path / "scores.json").read_text())
    assert sorted(c["case"]["level"] for c in scores["cases"]) == ["none", "single"]
    labels = tmp_path / "sealed" / "labels.json"
    labels.write_text(labels.read_text().replace('"level": "single"', '"level": "none"'))
    with pytest.raises(subprocess.CalledProcessError):
        process("score", tmp_path)


def test_wilson():
    assert wilson(0, 10) == pytest.approx((0.0, 0.2775), abs=1e-3)
    assert wilson(9, 10) == pytest.approx((0.5958, 0.9821), abs=1e-3)


def test_bad_input_is_refused(tmp_path):
    done = CliRunner().invoke(cli, ["prove", "--level", "easy", "-o", str(tmp_path)])
    assert isinstance(done.exception, InputError)
    (tmp_path / "results").mkdir()
    done = CliRunner().invoke(cli, ["prove", "--quick", "-o", str(tmp_path)])
    assert isinstance(done.exception, InputError)
    assert (tmp_path / "results").is_dir()
