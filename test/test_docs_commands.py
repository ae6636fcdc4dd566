# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Every command that a page shows is taken: it runs, in a folder with the files that it names, until it ends or is interrupted.

The pages of first steps and the examples are run to their end by other tests.
"""

import json
import os
import re
import shlex
import shutil
from importlib import import_module
from itertools import pairwise
from pathlib import Path

import click
import numpy as np
import pytest
import yaml
from drive_files import write
from fleet_rows import REPORT, row
from interrupted import interrupted

import trackres_ros as tr
from proofs.commands import proofs
from trackres_ros.files.resources import config_dir
from trackres_ros.node.parameters import make_parameters
from trackres_ros.recording.bindings import Topics
from trackres_ros.tasks.main import cli
from trackres_ros.tools.fleet.dataset import FleetDataset

ROOT = Path(__file__).resolve().parents[1]
pytest.importorskip("distributed")
pytest.importorskip("rosbags")
pytest.importorskip("asammdf")
pytest.importorskip("cantools")

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
SHOWN = re.compile(
    r"`((?:trackres|ros2|python -m proofs) [^`\n]+)`|^\s*((?:trackres|ros2|python -m proofs) [^`|\n]+)$", re.MULTILINE
)
PROGRAMS = {"trackres": cli, "proofs": proofs}
BINDING = re.compile(r"^ +(\w+: \{topic: .*\})$", re.MULTILINE)
RUN_ELSEWHERE = ("export", "first-controller", "first-designer", "first-tester", "own-effect")
LONGEST_S = 0.15
TOOLS = "design.compare", "coastdown.fitted", "fleet.run"
TASKS = "diagnose", "replay", "simulate", "vehicle"
IMPORTED = "diagnosis.pipeline", "output.plots", *(f"tools.{name}" for name in TOOLS), *(f"tasks.{name}" for name in TASKS)
ELSEWHERE = ("://", "CHECKOUT", "DATA", "CASES")
"""What only another machine or an earlier version has."""


def shown():
    """Page and command of all that pages show; a comment behind it is not part of it."""
    for page in PAGES:
        for match in SHOWN.finditer(page.read_text(encoding="utf-8")):
            words = shlex.split((match[1] or match[2]).strip().removeprefix("python -m "), comments=True)
            if words[-1] != "..." and not any(word[-1:] == "=" for word in words):
                yield page.stem, words


def is_whole(words):
    """Whether a command is complete; else a page only mentions it."""
    command, path, rest = command_of(words)
    if (path == ["live"] and "--vehicle" not in rest) or (path == ["own"] and "-o" not in rest):
        return False
    try:
        command.make_context(" ".join(path), list(rest))
    except (click.MissingParameter, click.BadOptionUsage):  # `replay -o` is a mention
        return False
    return not any(part in word for word in words for part in ELSEWHERE)


def command_of(words):
    """The click command of words, its path, and the words behind."""
    command, path = PROGRAMS[words[0]], []
    for word in words[1:]:
        if not isinstance(command, click.Group) or word not in command.list_commands(None):
            break
        command = command.get_command(None, word)
        path.append(word)
    if isinstance(command, click.Group) and "run" in command.commands:  # `fleet` is short for `fleet run`
        command = command.commands["run"]
    return command, path, words[1 + len(path) :]


COMMANDS = sorted({tuple(words) for _, words in shown() if words[0] in PROGRAMS and len(words) > 1})
RUN_HERE = {tuple(words) for page, words in shown() if page not in RUN_ELSEWHERE}


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_each_option_shown_is_one_of_its_command(words):
    command, path, rest = command_of(words)
    assert path, words
    known = {name for parameter in command.params for name in (*parameter.opts, *parameter.secondary_opts)} | {"--help"}
    assert {word.split("=")[0] for word in rest if re.match(r"--?[a-z]", word)} <= known


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A folder with a file of each name that pages use; what commands import is there before their time begins."""
    for module in ("matplotlib.figure", "distributed", *(f"trackres_ros.{name}" for name in IMPORTED)):
        import_module(module)
    folder = tmp_path_factory.mktemp("files")
    for name in ("my_vehicle", "mine", "my", "bus", "my_design", "report/vehicle", "compound/sweep"):
        path = folder / f"{name}.yaml"
        path.parent.mkdir(exist_ok=True)
        text = (config_dir() / "xgd24d.yaml").read_text(encoding="utf-8")
        path.write_text(text.replace("rubber/nr", f"{config_dir()}/rubber/nr"), encoding="utf-8")
    shutil.copy(folder / "mine.yaml", folder / "FILE")
    (folder / "report" / "surroundings.yaml").write_text("schema: 1\nvehicle: xgd24d\neffects: {grade: {grade: 0.01}}\n")
    shutil.copy(config_dir() / "topics" / "sample.yaml", folder / "topics.yaml")
    shutil.copy(config_dir() / "trackres.yaml", folder / "P.yaml")
    for name in ("sweep.csv", "sweep.txt"):
        shutil.copy(config_dir() / "rubber" / "nr_sbr_10hz.csv", folder / name)
    shutil.copytree(config_dir(), folder / "config")
    time = np.arange(0.0, 400.0, 0.1)
    speed = 3.0 + 2.0 * np.sin(time / 15.0)
    torque = 1500.0 + 30.0 * np.random.default_rng(1).standard_normal(len(time))
    for name, driven in (("drive.csv", speed), ("roll_1.csv", speed), ("roll_2.csv", speed[::-1])):
        rows = "".join(f"{t:.1f},{v:.4f},{q:.1f}\n" for t, v, q in zip(time, driven, torque, strict=True))
        (folder / name).write_text("time_s,speed_mps,torque_nm\n" + rows)
    columns = [b["column"] for b in yaml.safe_load((config_dir() / "topics" / "ztbus.yaml").read_text(encoding="utf-8")).values()]
    bus = np.full((len(time), len(columns)), 0.8)
    force = torque + 20500.0 * np.gradient(speed, time)
    known = {"time_unix": 1.6e9 + time, "odometry_vehicleSpeed": speed, "traction_tractionForce": force}
    for name, values in {**known, "temperature_ambient": 288.0}.items():
        bus[:, columns.index(name)] = values
    for name in ("bus.csv", "mission_first.csv", "mission_rest.csv"):
        np.savetxt(folder / name, bus, delimiter=",", header=",".join(columns), comments="", fmt="%.3f")
    (folder / "tour.csv").write_text(
        "time_s,speed_mps\n" + "".join(f"{t:.1f},{v:.4f}\n" for t, v in zip(time, speed, strict=True))
    )
    for depot in (folder, folder / "try"):
        (depot / "recordings" / "truck-03").mkdir(parents=True)
        for number in (1, 2):
            shutil.copy(folder / "drive.csv", depot / "recordings" / "truck-03" / f"{number}.csv")
        (depot / "fleet.yaml").write_text("vehicles: {truck-03: xgd24d}\n")
    for month in ("2025-06", "2025-08"):
        for number in range(3):
            FleetDataset(folder / "results").put(row(number, "truck-03", month), None)
    for kind in ("MF4", "BLF"):
        write(kind, folder)
    tr.record_sample(folder / "lap.mcap", laps=1)
    for name in ("drive", "out"):
        (folder / f"{name}.mcap.part").write_bytes((folder / "lap.mcap").read_bytes()[:-5000])
    for name in ("report_may", "report_june"):
        (folder / name).mkdir()
        (folder / name / "report.json").write_text(json.dumps(REPORT))
    for name in ("drive", "day1", "day2", "monday", "tuesday", "wednesday", "out"):
        shutil.copy(folder / "lap.mcap", folder / f"{name}.mcap")
    return folder


NEW = {("vehicle", "new"), ("fleet", "sample")}
"""What makes its files itself, and wants no others in its folder."""
AS_FAR = {"diagnose": "a measured torque", "coastdown": "coast-down", "fleet": "--vehicles"}
"""How far a command comes with these recordings, which have no torque, or in which nothing rolls out."""


@pytest.mark.parametrize("words", [words for words in COMMANDS if words in RUN_HERE and is_whole(words)], ids=" ".join)
def test_a_command_shown_is_not_refused(words, files, trackres, tmp_path):
    _, path, _ = command_of(words)
    if path[0] in ("live", "play"):
        peer = pytest.importorskip("peer")
        pytest.importorskip("cyclonedds")
    folder = tmp_path
    (folder / "docs").mkdir()
    if words[0] == "trackres" and tuple(path[:2]) not in NEW:
        folder = tmp_path / "files"
        shutil.copytree(files, folder, copy_function=os.link)  # no command changes a file in place
    for option, name in pairwise(words):
        if option == "-o" and (folder / name).is_file():  # nothing is written over
            (folder / name).unlink()
    environment = {"XDG_STATE_HOME": str(tmp_path / "state")}
    if path[0] in ("live", "play"):
        environment |= {"CYCLONEDDS_URI": peer.LOOPBACK, "ROS_DOMAIN_ID": str(peer.domain_of_worker(73))}
    code, said = interrupted(trackres, words[words[0] == "trackres" :], folder, LONGEST_S, environment)
    assert code in (0, 130) or AS_FAR.get(path[0], "\0") in said, said


def test_each_parameter_of_a_command_of_ros_is_one_of_the_node():
    launch = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "launch").glob("*.py"))
    named = set()
    for _, words in shown():
        parameters = {}
        for before, word in pairwise(words):
            name, is_parameter, value = word.partition(":=")
            if is_parameter and words[:2] == ["ros2", "launch"]:
                assert f'"{name}"' in launch, words
            elif is_parameter and before == "-p":
                parameters[name] = yaml.safe_load(value)
        make_parameters(parameters)
        named |= parameters.keys()
    assert {"vehicle", "learning"} <= named


def test_each_binding_of_a_topic_shown_is_read():
    found = [line for page in PAGES for line in BINDING.findall(page.read_text(encoding="utf-8"))]
    assert len(found) > 3
    for line in found:
        assert Topics.parse(yaml.safe_load(line), "a page").bindings
