# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Every example runs unchanged, in an empty folder, and prints its expected output."""

import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rosbags")

EXAMPLES = sorted((Path(__file__).resolve().parents[1] / "examples").glob("[0-9]*.py"))
SAYS = {
    "01_simulate.py": "as shipped",
    "02_replay.py": "written to estimate.csv",
    "03_live_loop.py": "speed: non_finite 1",
    "04_own_vehicle.py": "Refused: own.yaml",
    "05_snapshot.py": "without a stop: True",
    "06_diagnose.py": "turning_scrub: friction",
    "07_controller.py": "a fault                       0 Nm of 3000 Nm",
    "09_without_belts.py": "60 passengers more",
    "10_file_formats.py": "drive_7_3.mat  3000 steps",
    "08_without_ros.py": "the deadline was missed: True\nthe node goes on: the feed-forward is back",
}


def test_each_example_is_listed():
    assert [example.name for example in EXAMPLES] == sorted(SAYS)


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_runs(example, tmp_path, monkeypatch, capfd):
    if "ros" in example.stem:  # sets the environment of a middleware, which is loaded once a process
        pytest.importorskip("cyclonedds", reason="cyclonedds is not installed: pip install trackres_ros[dds]")
        environment = {**os.environ, "PYTHONPATH": str(example.parents[1])}
        subprocess.run([sys.executable, str(example)], cwd=tmp_path, env=environment, check=True)
    else:
        monkeypatch.chdir(tmp_path)
        runpy.run_path(str(example), run_name="__main__")
    printed = capfd.readouterr().out
    assert SAYS[example.name] in printed
    assert not re.search(r"\bnan\b", printed)
