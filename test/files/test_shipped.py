# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Shipped vehicles and topics files: listed, and taken by their names wherever a path is."""

from __future__ import annotations

import json
from pathlib import Path

import click
import pytest

import trackres_ros as tr
from trackres_ros.errors import InputError
from trackres_ros.files.resources import config_dir, find_vehicle, shipped_road_vehicles, shipped_topics, shipped_vehicles
from trackres_ros.node.parameters import make_parameters, read_setup
from trackres_ros.recording.bindings import Topics
from trackres_ros.tasks.main import cli
from trackres_ros.tools.fleet.vehicles import one_vehicle, read_fleet

NAMES = {"topics": shipped_topics(), "vehicle": shipped_vehicles() | shipped_road_vehicles()}


def options(command: click.Command, path: str = "trackres"):
    """Every option of every command, with the path of the command."""
    if isinstance(command, click.Group):
        for name in command.list_commands(None):
            yield from options(command.get_command(None, name), f"{path} {name}")
    yield from ((path, param) for param in command.params if isinstance(param, click.Option))


@pytest.mark.parametrize("what", NAMES)
def test_every_option_says_that_it_takes_names(what):
    results = [(path, value) for path, value in options(cli) if f"--{what}" in value.opts]
    assert len(results) >= 5
    for path, option in results:
        assert option.metavar == "FILE|NAME", path
        assert not isinstance(option.type, click.Path) or not option.type.exists, path


def test_the_lists_name_every_shipped_file(good):
    assert {item["name"] for item in json.loads(good("vehicle", "list", "--json"))["vehicles"]} == set(NAMES["vehicle"])
    listed = json.loads(good("topics", "list", "--json"))["topics"]
    assert {item["name"]: Path(item["file"]) for item in listed} == NAMES["topics"]
    assert all(name in good("topics", "list") for name in NAMES["topics"])


def test_commands_functions_node_and_fleet_find_topics_by_name(tmp_path, good):
    sample = tr.record_sample(tmp_path / "lap.mcap", laps=1)
    by_name = tr.read(sample.path, topics="sample")
    assert by_name.roles == tr.read(sample.path, topics=sample.topics).roles
    good("replay", sample.path, "--vehicle", "xgd24d", "--topics", "sample", "-o", tmp_path / "o.csv")
    live = read_setup(make_parameters({"vehicle": "xgd24d", "topics": "sample"})).topics
    assert dict(live.bindings) == dict(by_name.topics.bindings)
    (tmp_path / "fleet.yaml").write_text("vehicles: {one: {file: ztbus_hess19, topics: ztbus}}")
    (item,) = read_fleet(tmp_path / "fleet.yaml").vehicles.values()
    (other,) = one_vehicle("ztbus_hess19", "ztbus").vehicles.values()
    assert item.topics == other.topics == (config_dir() / "topics" / "ztbus.yaml").resolve()
    assert item.topics_sha == other.topics_sha != ""


def test_a_shipped_name_is_no_file_of_the_current_folder(tmp_path, monkeypatch):
    """Such a file may have come with recordings, and a vehicle file can lead to code."""
    monkeypatch.chdir(tmp_path)
    shipped = Topics.load("sample")
    Path("sample").write_text("speed: {column: v}")
    Path("xgd24d").write_text("nonsense")
    assert Topics.load("sample") == shipped
    assert Topics.load("./sample")["speed"].column == "v"
    assert find_vehicle("xgd24d") == shipped_vehicles()["xgd24d"]
    assert find_vehicle("./xgd24d").samefile("xgd24d")


def test_another_name_is_refused_with_the_nearest(tmp_path, trackres):
    with pytest.raises(InputError, match=r"topics: given 'smple'.*one of default, emps, sample, ztbus; did you mean sample\?"):
        Topics.load("smple")
    outcome = trackres("replay", tmp_path / "x.csv", "--vehicle", "xgd24", "-o", tmp_path / "o.csv")
    assert outcome.returncode == 2
    assert "did you mean xgd24d?" in outcome.stderr
