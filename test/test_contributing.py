# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The steps of CONTRIBUTING.md: its code works in the named places."""

import json
import os
import re
import shutil
import subprocess
import sys

import numpy as np
import pytest

from trackres_ros.recording import opening


@pytest.fixture(scope="module")
def steps(repository):
    """Code of the page by the section it is in."""
    text = (repository / "CONTRIBUTING.md").read_text(encoding="utf-8")
    return {
        title: re.findall(r"```\w+\n(.*?)```", part, re.DOTALL)
        for title, part in re.findall(r"^### (.*?)\n(.*?)(?=^#|\Z)", text, re.DOTALL | re.MULTILINE)
    }


READ = """
import sys
import trackres_ros as tr
from trackres_ros.recording import roles
read = tr.read(sys.argv[1])
print({role: read.series[role].value.tolist() for role in sorted(read.roles)})
"""


def in_a_process(folders, *arguments, cwd):
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, folders)), "TRACKRES_INTERPRETED": "1"}
    done = subprocess.run([sys.executable, *arguments], env=env, cwd=cwd, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def read_in_a_process(path, *folders):
    return in_a_process(folders, "-c", READ, path, cwd=path.parent)


@pytest.fixture
def logged(tmp_path):
    path = tmp_path / "drive.logger"
    path.write_bytes(np.array([[0.0, 36.0, 5.0], [1.0, 72.0, 6.0]], "<f4").tobytes())
    return path


@pytest.fixture
def package(tmp_path, repository):
    """A copy of the package to change, with its surrounding files."""
    shutil.copytree(repository / "config", tmp_path / "copy" / "config")
    shutil.copytree(repository / "trackres_ros", tmp_path / "copy" / "trackres_ros", ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path / "copy"


LOGGED = "{'speed': [10.0, 20.0], 'torque': [5.0, 6.0]}"


def test_a_reader_is_one_file(steps, logged, package):
    (package / "trackres_ros" / "recording" / "readers" / "logger.py").write_text(steps["A kind of recording"][0])
    assert read_in_a_process(logged, package) == LOGGED


def test_a_reader_of_another_package_is_found_by_its_entry_point(steps, logged, tmp_path):
    code, table = steps["A kind of recording"]
    (tmp_path / "our_logger.py").write_text(code)
    info = tmp_path / "our_logger-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: our-logger\nVersion: 1.0\n")
    group, line = re.search(r'entry-points\."(.*)"\]\n(.*)', table).groups()
    assert group == opening.GROUP
    (info / "entry_points.txt").write_text(f"[{group}]\n{line.replace(chr(34), '')}\n")
    assert read_in_a_process(logged, tmp_path) == LOGGED


def test_a_role_is_one_line(steps, package, tmp_path):
    table = package / "trackres_ros" / "recording" / "roles.py"
    before = "ROLES: Mapping[str, Role] = MappingProxyType(\n    {\n"
    text = table.read_text()
    assert before in text
    table.write_text(text.replace(before, f"{before}        {steps['A role'][0]}"))
    path = tmp_path / "drive.csv"
    path.write_text("time_s,speed_mps,tension_n/left\n0,1,900\n1,2,950\n")
    assert read_in_a_process(path, package) == "{'speed': [1.0, 2.0], 'tension/left': [900.0, 950.0]}"


def test_an_effect_is_one_file(steps, package, tmp_path, good):
    (package / "trackres_ros" / "effects" / "vehicle" / "cold_band.py").write_text(steps["An effect"][0])
    good("vehicle", "new", "mine", cwd=tmp_path)
    with (tmp_path / "mine.yaml").open("a") as file:
        file.write("effects: {cold_band: {torque: 100.0, range: 30.0}}\n")
    point = ("--speed-kmh", "10", "--belt-degc", "20", "--ambient-degc", "0", "--json")
    shown = in_a_process([package], "-m", "trackres_ros", "explain", "--vehicle", "mine.yaml", *point, cwd=tmp_path)
    assert json.loads(shown)["torque_nm"]["effects"] == pytest.approx(100.0)


def test_a_command_is_one_file_and_its_entry(steps, package, tmp_path):
    code, line = steps["A command"]
    (package / "trackres_ros" / "tasks" / "stops.py").write_text(code)
    main = package / "trackres_ros" / "tasks" / "main.py"
    text, commands = main.read_text(), "COMMANDS = {\n"
    assert commands in text
    main.write_text(text.replace(commands, f"{commands}{line}"))
    (tmp_path / "drive.csv").write_text("time_s,speed_mps\n0,1\n1,0\n2,2\n3,0\n")
    run = ("-m", "trackres_ros", "stops", "drive.csv")
    assert in_a_process([package], *run, cwd=tmp_path) == "The vehicle stops 2 times."
    assert json.loads(in_a_process([package], *run, "--json", cwd=tmp_path)) == {"stops": 2}
