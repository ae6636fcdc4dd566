# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Vehicle files to choose from, to begin with, and side by side."""

import json

import pytest
import yaml

import trackres_ros as tr
from trackres_ros.files.resources import shipped_road_vehicles, shipped_vehicles

ALL = [*shipped_vehicles(), *shipped_road_vehicles()]


def test_all_shipped_vehicles_are_listed_with_what_they_are_for(good):
    listed = {v["name"]: v for v in json.loads(good("vehicle", "list", "--json"))["vehicles"]}
    assert sorted(listed) == sorted(ALL)
    assert listed["xgd24d"]["model"] == "tracks"
    assert listed["husky"]["model"] == "road_load"
    text = good("vehicle", "list")
    assert all(name in text and listed[name]["title"] in text for name in ALL)


@pytest.mark.parametrize("like", ALL)
def test_a_new_vehicle_is_its_model_under_another_name(good, tmp_path, like):
    written = json.loads(good("vehicle", "new", "truck7", "--like", like, "-o", tmp_path / "mine", "--json"))["written"]
    assert written[0] == str(tmp_path / "mine" / "truck7.yaml")
    assert json.loads(good("vehicle", "diff", like, written[0], "--json"))["differences"] == [
        {"path": "name", "unit": "", "one": like, "other": "truck7", "ratio": None, "ranges": None, "flags": None}
    ]
    if like in shipped_vehicles():
        vehicle = tr.load_vehicle(written[0])
        assert vehicle.name == "truck7"
        assert str(vehicle.rubber_source) == written[1]


def test_one_that_is_there_is_not_written_over(good, refused, tmp_path):
    good("vehicle", "new", "truck7", "-o", tmp_path)
    (tmp_path / "truck7.yaml").write_text("mine")
    assert "already exists" in refused("vehicle", "new", "truck7", "-o", tmp_path)
    assert (tmp_path / "truck7.yaml").read_text() == "mine"


def test_a_new_vehicle_leaves_an_edited_rubber_file_as_it_is(good, tmp_path):
    rubber = tmp_path / "rubber" / "nr_sbr_10hz.csv"
    good("vehicle", "new", "mine", "-o", tmp_path)
    edited = rubber.read_text() + "# edited\n"
    rubber.write_text(edited)
    for name in ("other", "third"):  # which share a rubber file
        _, copy = json.loads(good("vehicle", "new", name, "-o", tmp_path, "--json"))["written"]
        assert copy == str(tmp_path / "rubber" / "nr_sbr_10hz_2.csv")
        assert str(tr.load_vehicle(tmp_path / f"{name}.yaml").rubber_source) == copy
    assert rubber.read_text() == edited


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (("new", "../x"), "a letter and at most 63"),
        (("new", "x", "--like", "xgd24"), "did you mean xgd24d"),
        (("diff", "xgd24d", "nothing.yaml"), "nothing.yaml"),
    ],
)
def test_what_cannot_be_is_one_line(refused, tmp_path, words, part):
    assert part in refused("vehicle", *words, *(("-o", tmp_path / "x") if words[0] == "new" else ()))
    assert not (tmp_path / "x").exists()


def test_where_two_differ(good, tmp_path):
    good("vehicle", "new", "stiffer", "-o", tmp_path)
    file = tmp_path / "stiffer.yaml"
    content = yaml.safe_load(file.read_text())
    content["chassis"]["bearing_friction"].update(value=0.006, range=[0.005, 0.007])
    content["chassis"]["axles"][1]["load"]["value"] = 120000.0
    content["chassis"]["ambient"]["value"] = 20.0
    content["model"]["thermal"] = "core_surface"
    file.write_text(yaml.safe_dump(content))
    results = {d["path"]: d for d in json.loads(good("vehicle", "diff", "xgd24d", file, "--json"))["differences"]}
    assert set(results) == {"name", "model.thermal", "chassis.bearing_friction", "chassis.axles.rear.load", "chassis.ambient"}
    assert results["chassis.ambient"]["ratio"] is None  # a share of degC says nothing
    assert results["chassis.bearing_friction"]["ratio"] == pytest.approx(0.8)
    assert results["chassis.bearing_friction"]["ranges"] == [[0.004, 0.012], [0.005, 0.007]]
    text = good("vehicle", "diff", "xgd24d", file)
    assert "-20.0 %" in text
    assert good("vehicle", "diff", "agri3t", "agri3t").strip() == "They have the same values."


def test_files_that_alter_the_results_are_not_the_same(good, tmp_path):
    for folder in ("a", "b"):
        good("vehicle", "new", "mine", "-o", tmp_path / folder)
    files, rubber = [tmp_path / folder / "mine.yaml" for folder in "ab"], tmp_path / "b" / "rubber" / "nr_sbr_10hz.csv"

    def paths():
        return [d["path"] for d in json.loads(good("vehicle", "diff", *files, "--json"))["differences"]]

    assert not paths()
    rubber.write_text(rubber.read_text() + "90.0,5.0,0.5\n")
    assert paths() == ["content of rubber.file"]
    content = yaml.safe_load(files[1].read_text())
    content["rubber"]["loss_modulus_scale"]["flag"] = "F"  # then the ranges of thickness and moduli add no uncertainty
    content["chassis"]["bearing_friction"]["flag"] = "P"
    files[1].write_text(yaml.safe_dump(content))
    assert paths() == ["rubber.loss_modulus_scale", "content of rubber.file"]
    assert "(F)" in good("vehicle", "diff", *files)
