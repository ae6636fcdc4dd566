# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Layouts name only published topics, for any vehicle under any name, and the bag of a replay has them."""

import json
import xml.etree.ElementTree as ET

import pytest

from trackres_ros.files.resources import shipped_road_vehicles, shipped_vehicles
from trackres_ros.output.topics import output_topics
from trackres_ros.vehicle import load_any


def curves_of(folder):
    """Names of the curves in PlotJuggler, and paths in Foxglove, in their order."""
    curves = [curve.attrib["name"] for curve in ET.parse(folder / "plotjuggler.xml").getroot().iter("curve")]
    layout = json.loads((folder / "foxglove.json").read_text())
    return curves, [path["value"] for panel in layout["configById"].values() for path in panel.get("paths", ())]


@pytest.mark.parametrize("name", [*shipped_vehicles(), *shipped_road_vehicles()])
@pytest.mark.parametrize("node", [(), ("--namespace", "/left", "--name", "tracks")])
def test_layouts_name_only_what_is_published(good, tmp_path, name, node):
    written = json.loads(good("layouts", "--vehicle", name, *node, "-o", tmp_path / "layouts", "--json"))["written"]
    assert sorted(path.rpartition("/")[2] for path in written) == ["foxglove.json", "plotjuggler.xml"]
    vehicle, base = load_any(name), "/left/tracks" if node else "/trackres"
    topics = {f"{base}/{topic.name}": topic for topic in output_topics(vehicle)}
    curves, paths = curves_of(tmp_path / "layouts")
    assert len(curves) == len(paths) > 9
    shown = set()
    for curve, path in zip(curves, paths, strict=True):
        topic = max((name for name in topics if curve.startswith(f"{name}/")), key=len)
        shown.add(topic)
        assert path.startswith(f"{topic}.")
        if topics[topic].kind == "joints":
            joint = curve.removeprefix(f"{topic}/").removesuffix("/effort")
            assert path == f"{topic}.effort[{topics[topic].names.index(joint)}]"
    belts = {f"{base}/track_temperature/{assembly.name}" for assembly in vehicle.assemblies}
    assert belts < shown
    assert bool(belts) == bool(vehicle.assemblies)


def test_the_shipped_layouts_are_those_of_the_reference_vehicle(good, repository, tmp_path):
    good("layouts", "--vehicle", "xgd24d", "-o", tmp_path)
    for name in ("plotjuggler.xml", "foxglove.json"):
        assert (tmp_path / name).read_text() == (repository / "config" / name).read_text()


@pytest.mark.usefixtures("undrawn")
def test_a_replays_bag_has_every_topic_that_is_shown(good, tmp_path):
    rosbags = pytest.importorskip("rosbags.highlevel")
    good("record-sample", "--laps", 1, "--speed-kmh", 30, "-o", tmp_path / "lap.mcap")
    good("replay", tmp_path / "lap.mcap", "--vehicle", "agri3t", "-o", tmp_path / "out.mcap")
    good("layouts", "--vehicle", "agri3t", "-o", tmp_path)
    with rosbags.AnyReader([tmp_path / "out.mcap"]) as reader:
        there = {connection.topic for connection in reader.connections}
    assert {path.partition(".")[0] for path in curves_of(tmp_path)[1]} <= there


def test_a_name_that_no_node_can_have_is_refused(trackres, tmp_path):
    outcome = trackres("layouts", "--vehicle", "xgd24d", "--name", "a b", "-o", tmp_path)
    assert outcome.returncode == 2
    assert "a b" in outcome.stderr
    assert not list(tmp_path.iterdir())
