# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Every kind of refusal of a vehicle file names the file, the key, the given and the allowed values."""

import copy
import math

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from trackres_ros.effects import catalogue
from trackres_ros.errors import InputError
from trackres_ros.files.documents import read_yaml
from trackres_ros.files.resources import config_dir
from trackres_ros.recording.bindings import Topics
from trackres_ros.vehicle import load, load_any
from trackres_ros.vehicle.loading import build
from trackres_ros.vehicle.road import build_road

THICKNESS = "tracks.triangular.belt.thickness"
WHEELS = "tracks.triangular.wrapped_wheels"


def at(content, path):
    """The node at a path of keys and numbers."""
    for key in filter(None, path.split(".")):
        content = content[int(key) if key.isdigit() else key]
    return content


def put(content, path, value):
    parent, _, key = path.rpartition(".")
    at(content, parent)[int(key) if key.isdigit() else key] = value


# Files that are no vehicle files


def test_neither_a_file_nor_a_name():
    with pytest.raises(InputError) as error_info:
        load("xgd24")
    assert error_info.value.given == "xgd24"
    assert "xgd24d" in error_info.value.allowed
    assert "agri3t" in error_info.value.allowed


def test_a_folder_is_no_vehicle(tmp_path):
    with pytest.raises(InputError, match="the path of a vehicle file"):
        load(tmp_path)


# Keys and values


REQUIRED = (
    "schema", "name", "model", "model.thermal", "rubber.file", "rubber.density", "chassis.axles", "chassis.axles.0.load",
    "assemblies.1.track", "tracks.triangular.beams.front.split", f"{THICKNESS}.reason", f"{THICKNESS}.range",
    f"{WHEELS}.0.radius", "tracks.triangular.belt.film_speed_unit", "tracks.triangular.road_wheels.positions",
)  # fmt: skip
MAPPINGS = (
    "model", "rubber", "chassis", "chassis.axles.0", "assemblies.0", "tracks", "tracks.triangular", "tracks.triangular.belt",
    THICKNESS, "tracks.triangular.road_wheels", f"{WHEELS}.1", "tracks.triangular.beams.front",
)  # fmt: skip


def test_a_missing_key(refusal, shipped):
    for key in REQUIRED:
        content = copy.deepcopy(shipped)
        parent, _, name = key.rpartition(".")
        del at(content, parent)[name]
        error = refusal(content)
        assert name in error.where
        assert (error.given, error.allowed) == ("nothing", "this key is required")


def test_an_unknown_key(refusal, shipped):
    for parent in {"", "tracks.triangular.beams", *MAPPINGS} - {"tracks"}:
        content = copy.deepcopy(shipped)
        at(content, parent)["colour"] = "green"
        error = refusal(content)
        assert "colour" in error.where
        assert error.given == "colour"
        assert error.allowed.startswith("one of ")


def test_a_misspelt_key_gets_a_suggestion(refusal, content):
    belt = content["tracks"]["triangular"]["belt"]
    belt["thicknes"] = belt["thickness"]
    assert refusal(content).remedy == "did you mean thickness?"


def test_what_should_be_a_mapping_or_a_list(refusal, shipped):
    for key in MAPPINGS:
        for value in (None, 3.5, "text", [1], []):
            content = copy.deepcopy(shipped)
            put(content, key, value)
            assert key.rpartition(".")[2].rstrip("0123456789") in refusal(content).where
    for key in ("assemblies", "chassis.axles", WHEELS):
        for value in (None, [], {}, "text", 1):
            content = copy.deepcopy(shipped)
            put(content, key, value)
            error = refusal(content)
            assert key.rpartition(".")[2] in error.where
            assert error.allowed == "a list with at least one entry"


def test_a_value_that_is_not_plausible(refusal, content):
    for value in (math.nan, math.inf, 0.05, 0.02, "thick", True, None, {}, 10**400, [0.03, 0.035], []):
        put(content, f"{THICKNESS}.value", value)
        error = refusal(content)
        assert f"{THICKNESS}.value" in error.where
        assert ("one number" if isinstance(value, list) else "0.025 to 0.045 m") in error.allowed
        if isinstance(value, float) and math.isfinite(value):
            assert error.given == value
            assert "widen its range" in error.remedy


def test_a_range_that_is_none(refusal, content):
    cases = {
        "two numbers": (None, [0.02], [0.02, 0.03, 0.04], "0.02"),
        "low <= high": ([0.045, 0.025],),
        "0.003 to 0.3 m": ([0.001, 0.045], [0.025, 0.9], [math.nan, 0.045], [0.025, [0.045]]),
    }
    for allowed, ranges in cases.items():
        for bounds in ranges:
            put(content, f"{THICKNESS}.range", bounds)
            error = refusal(content)
            assert f"{THICKNESS}.range" in error.where
            assert allowed in error.allowed


def test_only_the_top_beam_splits_the_own_weight_otherwise(refusal, content):
    beams = content["tracks"]["triangular"]["beams"]
    beams["front"]["own_weight_split"] = beams["split"]
    error = refusal(content)
    assert "beams.front.own_weight_split" in error.where
    assert error.allowed == "this key of the top beam alone"


def test_another_unit_is_not_converted(refusal, content):
    put(content, f"{THICKNESS}.unit", "mm")
    error = refusal(content)
    assert f"{THICKNESS}.unit" in error.where
    assert (error.given, error.allowed, error.remedy) == ("mm", "m", "convert the value to this unit")


CHOICES = (
    ("schema", 2, "1"),
    (f"{THICKNESS}.flag", "X", "one of P, L, A, F"),
    (f"{THICKNESS}.flag", None, "one of P, L, A, F"),
    (f"{THICKNESS}.reason", " ", "a text that is not empty"),
    (f"{THICKNESS}.reason", 5, "a text that is not empty"),
    ("name", "", "a text that is not empty"),
    ("title", ["x"], "a text that is not empty"),
    ("model.hysteresis", "exact", "one of spectral, rainflow"),
    ("model.thermal", 1, "one of lumped, core_surface"),
    ("tracks.triangular.belt.film_speed_unit", "mph", "one of m/s, km/h"),
    (f"{WHEELS}.0.kind", "roller", "one of sprocket, tensioner, guide"),
    ("assemblies.0.axle", "middle", "one of front, rear"),
    ("assemblies.0.track", "round", "one of triangular"),
    ("rubber.file", None, "a text that is not empty"),
)


def test_a_choice_that_is_none(refusal, shipped):
    for key, value, allowed in CHOICES:
        content = copy.deepcopy(shipped)
        put(content, key, value)
        error = refusal(content)
        assert all(part in error.where for part in key.replace(".0", "").split("."))
        assert error.given == value
        assert allowed == error.allowed


@pytest.mark.parametrize("name", ["front-left", "1", "a b", "vorne_ä", "a.b", "a/b", "a\n", "_a"])
def test_a_name_that_topics_cannot_have_is_refused(refusal, content, name):
    content["assemblies"][0]["name"] = name
    assert refusal(content).where.endswith("assemblies[0].name")


@pytest.mark.parametrize("name", ["front-left", "1", "a b", "vorne_ä", "a.b", "a/b", "a\n", "_a"])
def test_an_axle_is_named_as_a_topics_file_can_name_it(refusal, loaded, content, name):
    content["chassis"]["axles"][0]["name"] = content["assemblies"][0]["axle"] = content["assemblies"][1]["axle"] = name
    try:
        assert loaded(content).axles[0].name == name
    except InputError:
        assert refusal(content).where.endswith("chassis.axles[0].name")
    else:
        assert f"load/{name}" in Topics.parse({f"load/{name}": {"column": "load_n"}})


# What only the whole can show


def set_values(**values):
    """Change belt or road-wheel values, with their ranges."""

    def change(content):
        for name, value in values.items():
            track = content["tracks"]["triangular"]
            entry = track["belt" if name in track["belt"] else "road_wheels"][name]
            entry["value"], entry["range"] = value, [value, value] if not isinstance(value, list) else [min(value), max(value)]

    return change


def set_at(key, value):
    return lambda content: put(content, key, value)


def second_sprocket(content):
    wheels = content["tracks"]["triangular"]["wrapped_wheels"]
    wheels[0]["kind"] = "sprocket"
    del wheels[0]["radius"]


def sprocket_with_radius(content):
    wheels = content["tracks"]["triangular"]["wrapped_wheels"]
    wheels[1]["radius"] = wheels[0]["radius"]


def no_sprocket(content):
    sprocket_with_radius(content)
    content["tracks"]["triangular"]["wrapped_wheels"][1]["kind"] = "guide"


def open_loop(content):
    wheel = content["tracks"]["triangular"]["wrapped_wheels"][0]["wrap_angle"]
    wheel["value"], wheel["range"] = 2.0, [2.0, 2.6]


def half_a_motor(content):
    content["chassis"]["motor_ratio"] = {"value": 30.0, "unit": "1", "flag": "A", "range": [20.0, 40.0], "reason": "a guess"}


def spare_track(content):
    content["tracks"]["spare"] = copy.deepcopy(content["tracks"]["triangular"])


def second_axle_idle(content):
    for assembly in content["assemblies"]:
        assembly["axle"] = "front"


@pytest.mark.parametrize(
    ("change", "key", "allowed"),
    [
        (set_values(positions=[0.15, 0.5, 0.5, 1.2]), "road_wheels.positions", "rising positions"),
        (set_values(positions=[0.5, 0.15, 0.85, 1.2]), "road_wheels.positions", "rising positions"),
        (set_values(positions=[0.15, 0.5, 0.85, 1.4]), "road_wheels.positions", "on the ground run of 1.35 m"),
        (set_at("tracks.triangular.road_wheels.positions.value", []), "road_wheels.positions", ""),
        (set_values(positions=[0.15, 0.5, 0.85]), "beams", "each road wheel 1 to 3"),
        (set_at("tracks.triangular.beams.front.rear", 3), "beams", "each road wheel 1 to 4 on exactly one beam end"),
        (set_at("tracks.triangular.beams.front.rear", 0), "beams", "each road wheel 1 to 4"),
        (set_at("tracks.triangular.beams", 1), "beams", "each road wheel 1 to 4"),
        (set_at("tracks.triangular.beams.front", "1"), "beams.front", "a mapping"),
        (set_values(cord_height=0.035), "belt.cord_height", "less than the thickness"),
        (set_values(contact_length=0.7), "road_wheels.contact_length", "at most the belt width"),
        (set_values(lug_section=0.001), "belt.lug_section", "at least the tread bars"),
        (set_values(cord_section=0.02), "belt.cord_section", "less than half the belt section"),
        (set_values(loop_length=2.9), "belt.loop_length", "more than the ground run and the wraps"),
        (open_loop, "wrapped_wheels", "a closed loop"),
        (second_sprocket, "wrapped_wheels", "exactly one sprocket"),
        (no_sprocket, "wrapped_wheels", "exactly one sprocket"),
        (sprocket_with_radius, "wrapped_wheels.sprocket.radius", "no radius of a sprocket"),
        (half_a_motor, "chassis.motor_ratio", "both or neither"),
        (second_axle_idle, "assemblies", "at least one assembly an axle"),
        (set_at("assemblies.1.name", "front_left"), "assemblies", "unique names"),
        (set_at("assemblies.1.name", "front"), "assemblies", "unique names"),
        (set_at("chassis.axles.1.name", "front"), "chassis.axles", "unique names"),
        (set_at("tracks", {}), "tracks", "a mapping with at least one entry"),
        (spare_track, "assemblies", "at least one assembly a kind of track"),
    ],
)
def test_parts_that_do_not_fit_each_other(refusal, content, change, key, allowed):
    change(content)
    error = refusal(content)
    assert key in error.where
    assert allowed in error.allowed


KINDS = {"agri3t": (True, True), "bmw_i3": (False, True), "emps": (False, False)}  # whether it has belts, and rolls


@pytest.mark.parametrize("vehicle", KINDS)
def test_only_effects_with_a_meaning_for_a_vehicle_are_listed(configuration, vehicle):
    path, (belts, rolls) = configuration / f"{vehicle}.yaml", KINDS[vehicle]
    content, loaded_vehicle = read_yaml(path), load_any(vehicle)
    quantities = {effect_values.effect.name for effect_values in loaded_vehicle.active}
    for effect in catalogue(size=loaded_vehicle.size, on_tyres=not belts).values():
        if effect.belongs_to != "vehicle":
            continue
        path.write_text(yaml.safe_dump({**content, "effects": {effect.name: effect.values()}}))
        has_meaning = effect.only_of in ("", "rolls" if rolls else "slides") and (belts or not effect.belt_only)
        if has_meaning and effect.name not in quantities:
            assert effect.name in [effect_values.effect.name for effect_values in load_any(path).active]
            continue
        with pytest.raises(InputError, match=f"'{effect.name}'") as error_info:
            load_any(path)
        assert effect.name not in error_info.value.allowed.removeprefix("one of ").split(", ")


@pytest.mark.parametrize(
    ("key", "value", "allowed"),
    [
        ("schema", 99, "1"),
        ("effects", {"latch_of_belt_temperature": {"off": 20.0, "on": 30.0, "x1": 0.0, "x2": 60.0, "y1": 20.0}}, "warmup"),
        ("road_load.rolling_rise", {"value": -0.0003, "range": [-0.001, 0.0]}, "at least -rolling_coefficient / max_speed"),
    ],
)
def test_a_road_file_without_a_meaning_is_refused(configuration, key, value, allowed):
    content = read_yaml(configuration / "bmw_i3.yaml")
    put(content, key, {**at(content, key), **value} if "." in key else value)
    with pytest.raises(InputError) as error_info:
        build_road(configuration / "bmw_i3.yaml", content)
    assert key in error_info.value.where
    assert allowed in error_info.value.allowed


@pytest.mark.parametrize("share", [0.0, 0.5, 0.999])
def test_rolling_resistance_may_fall_but_not_below_zero(configuration, share):
    content = read_yaml(configuration / "bmw_i3.yaml")
    least_rise = -content["road_load"]["rolling_coefficient"]["value"] / content["road_load"]["max_speed"]["value"]
    content["road_load"]["rolling_rise"].update(value=share * least_rise, range=[least_rise, 0.0])
    v = build_road(configuration / "bmw_i3.yaml", content).values
    assert v["rolling_coefficient"] + v["rolling_rise"] * v["max_speed"] > 0.0


def nodes(content, path=()):
    """Paths of all nodes below the top."""
    children = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    return [p for key, entry in children for p in ((*path, key), *nodes(entry, (*path, key)))]


anything = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda child: st.lists(child, max_size=3) | st.dictionaries(st.text(max_size=5) | st.integers(), child, max_size=3),
)


@settings(deadline=None, derandomize=True, max_examples=150, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_whatever_stands_in_a_file_it_is_loaded_or_refused(shipped, data):
    """No content ends in anything but a vehicle or the one error that says where and what."""
    content, path = copy.deepcopy(shipped), data.draw(st.sampled_from(nodes(shipped)))
    parent = content
    for key in path[:-1]:
        parent = parent[key]
    parent[path[-1]] = data.draw(anything)
    try:
        vehicle = build(config_dir() / "xgd24d.yaml", content)
    except InputError:
        return
    assert all(np.isfinite(quantity.value).all() for quantity in vehicle.parameters.values())
