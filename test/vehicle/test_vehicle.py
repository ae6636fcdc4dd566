# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Vehicle files: both shipped ones, overrides, and the file of the rubber."""

import dataclasses
import math
import shutil
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from faults import Faults

from trackres_ros.effects import catalogue
from trackres_ros.effects.effect import Active
from trackres_ros.errors import InputError
from trackres_ros.files.resources import config_dir, shipped_vehicles
from trackres_ros.route.learned import SLOPE, RouteMap
from trackres_ros.vehicle import load, variants, with_surroundings
from trackres_ros.vehicle.loading import read_rubber_sweep
from trackres_ros.vehicle.writing.changes import FileChanges
from trackres_ros.vehicle.writing.vehicle_file import DIAGNOSED, write_track_vehicle

THICKNESS = "tracks.triangular.belt.thickness"


# Content of the shipped files


def test_both_vehicles_are_shipped():
    assert set(shipped_vehicles()) >= {"xgd24d", "agri3t"}
    for name, path in shipped_vehicles().items():
        vehicle = load(name)
        assert (vehicle.name, vehicle.source) == (name, path)


def test_the_reference_vehicle():
    vehicle = load("xgd24d")
    assert vehicle.weight == 272e3  # 2 x 112 + 4 x 12 kN
    assert vehicle.nominal_loads() == pytest.approx([68e3] * 4)
    assert (vehicle.hysteresis, vehicle.thermal) == ("spectral", "lumped")
    track = vehicle.tracks["triangular"]
    assert track.wrapped_wheels[1].kind == "sprocket"
    assert track.wrapped_wheels[1].radius == track.sprocket_radius
    assert vehicle.assemblies_of("rear") == (2, 3)
    assert vehicle.chassis.motor_ratio is None


def test_the_small_carrier():
    vehicle = load("agri3t")
    assert vehicle.weight == pytest.approx(3000 * 9.80665, rel=0.01)
    assert len(vehicle.assemblies) == 2
    assert len(vehicle.tracks["low"].road_wheels.positions) == 6
    assert {quantity.flag for quantity in vehicle.parameters.values()} == {"A"}
    assert vehicle.chassis.motor_ratio == 30.0


@pytest.mark.parametrize("name", ["xgd24d", "agri3t"])
def test_each_quantity_has_unit_provenance_and_a_range_around_it(name):
    for path, quantity in load(name).parameters.items():
        assert quantity.unit, path
        assert quantity.flag in "PLA", path
        assert len(quantity.reason) > 3, path
        assert (quantity.low <= np.atleast_1d(quantity.value)).all(), path
        assert (np.atleast_1d(quantity.value) <= quantity.high).all(), path
        assert quantity.standard_deviation == (quantity.high - quantity.low) / 4


def test_a_vehicle_cannot_be_changed():
    vehicle = load("xgd24d")
    for instance, name in (
        (vehicle, "name"),
        (vehicle.rubber, "density"),
        (vehicle.chassis, "ambient"),
        (vehicle.tracks["triangular"].belt, "width"),
    ):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(instance, name, 1.0)
    with pytest.raises(TypeError):
        vehicle.tracks["other"] = vehicle.tracks["triangular"]


# Overrides


def test_an_override_replaces_one_value():
    base, variant = load("xgd24d"), load("xgd24d", {THICKNESS: 0.03})
    assert variant.tracks["triangular"].belt.thickness == 0.03
    paths = [path for path in base.parameters if base.parameters[path] != variant.parameters[path]]
    assert paths == [THICKNESS]


def test_an_override_may_leave_the_files_range_but_no_limit():
    vehicle = load("xgd24d", {THICKNESS: 0.06})
    assert vehicle.parameters[THICKNESS].high == 0.06
    for value in (0.5, -1.0, math.nan, math.inf):
        with pytest.raises(InputError) as error_info:
            load("xgd24d", {THICKNESS: value})
        assert THICKNESS in error_info.value.where
        assert "0.003 to 0.3 m" in error_info.value.allowed


@pytest.mark.parametrize("path", ["tracks.triangular.belt.thicknes", "thickness", "tracks.triangular.road_wheels.positions", ""])
def test_an_override_of_what_is_not_there_is_refused(path):
    with pytest.raises(InputError, match="the path of a scalar quantity") as error_info:
        load("xgd24d", {path: 0.03})
    assert error_info.value.given == path
    assert (f"did you mean {THICKNESS}" in error_info.value.remedy) == ("belt" in path)


def test_variants_are_the_vehicle_with_its_methods():
    base = dataclasses.replace(load("xgd24d"), hysteresis="rainflow", thermal="core_surface")
    variant = variants(base)({"chassis.drag_coefficient": 1.1})
    assert (variant.hysteresis, variant.thermal) == ("rainflow", "core_surface")
    assert variant.chassis.drag_coefficient == 1.1
    assert variants(base)({}).parameters == base.parameters


def test_a_variant_keeps_nothing_of_the_one_before():
    build, values = variants(load("xgd24d")), {THICKNESS: 0.03, "rubber.heat_capacity": 2000.0}
    for overrides in (values, {"rubber.heat_capacity": 1900.0}, {}, values):
        variant, expected = build(overrides), load("xgd24d", overrides)
        assert variant.parameters == expected.parameters
        assert variant.tracks == expected.tracks


def test_wheels_of_one_name_keep_their_own_values_in_a_variant(content, loaded):
    wheels = content["tracks"]["triangular"]["wrapped_wheels"]
    idlers = [wheel for wheel in wheels if wheel["kind"] != "sprocket"]
    idlers[1]["name"] = idlers[0]["name"]
    idlers[1]["radius"] = {**idlers[1]["radius"], "value": idlers[0]["radius"]["value"] + 0.005}
    base = loaded(content)
    build = variants(base)
    assert [build({}).tracks["triangular"].wrapped_wheels for _ in range(2)] == [base.tracks["triangular"].wrapped_wheels] * 2


# The rubber file

SWEEP = "T_degC,E_storage_MPa_10Hz,E_loss_MPa_10Hz\n-50,700,300\n0,14,2.5\n50,8,1\n100,7,0.6\n"


def test_a_sweep_may_have_comments_and_plain_names(tmp_path):
    path = tmp_path / "sweep.csv"
    path.write_text(f"# of a test\n{SWEEP}", encoding="utf-8")
    plain_path = tmp_path / "plain.csv"
    plain_path.write_text(SWEEP.replace("_10Hz", "").replace("\n0,", "\n# between\n\n0,"), encoding="utf-8")
    for column, plain_column in zip(read_rubber_sweep(path), read_rubber_sweep(plain_path), strict=True):
        assert np.array_equal(column, plain_column)
    path.write_text(f"# of a test\n{SWEEP}".replace("2.5", "x"), encoding="utf-8")
    with pytest.raises(InputError, match=r"row 4, E_loss_MPa_10Hz"):
        read_rubber_sweep(path)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (SWEEP.replace("T_degC", "T"), "T_degC"),
        ("", "at least four rows"),
        (SWEEP.rsplit("100", 1)[0], "3 rows"),
        (SWEEP.replace("2.5", "x"), "row 3, E_loss_MPa_10Hz"),
        (SWEEP.replace(",2.5", ""), "row 3"),
        (SWEEP.replace("2.5", "nan"), "finite"),
        (SWEEP.replace("\n50,", "\n0,"), "do not increase"),
        (SWEEP.replace("\n50,", "\n-80,"), "do not increase"),
        (SWEEP.replace("14", "0"), "E_storage_MPa_10Hz"),
        (SWEEP.replace("2.5", "-2.5"), "E_loss_MPa_10Hz"),
        (SWEEP.replace("2.5", "2500"), "loss over storage modulus"),
        ("T_degC,E_storage_MPa_10Hz,E_loss_MPa_10Hz\n223,700,300\n273,14,2.5\n323,8,1\n373,7,0.6\n", "kelvin"),
        (SWEEP.replace("8,1", "2000,1").replace("7,0.6", "1900,1"), "storage modulus at 100 degC"),
    ],
)
def test_a_sweep_that_is_refused(tmp_path, text, said):
    path = tmp_path / "sweep.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as error_info:
        read_rubber_sweep(path)
    assert str(path) in error_info.value.where
    assert said in str(error_info.value)


@pytest.mark.parametrize("factors", [(1e6, 1e6), (1e3, 1e3), (1e-3, 1e-3), (1e6, 1.0), (1.0, 1e6), (1e-3, 1.0), (1.0, 1e3)])
def test_moduli_in_another_unit_than_the_header_says_are_refused(tmp_path, factors):
    """The shipped sweep, one column or both a thousand or a million times too large or too small."""
    text = (config_dir() / "rubber" / "nr_sbr_10hz.csv").read_text(encoding="utf-8").splitlines()
    path = tmp_path / "sweep.csv"
    rows = [line.split(",") for line in text[1:]]
    lines = [f"{row[0]},{float(row[1]) * factors[0]},{float(row[2]) * factors[1]}" for row in rows]
    path.write_text("\n".join([",".join(text[0].split(",")[:3]), *lines]), encoding="utf-8")
    with pytest.raises(InputError, match=r"MPa|in one unit"):
        read_rubber_sweep(path)


def test_a_copied_vehicle_file_logs_that_it_uses_shipped_rubber(tmp_path, caplog):
    path = Path(shutil.copy(config_dir() / "xgd24d.yaml", tmp_path / "mine.yaml"))
    vehicle = load(path)
    assert vehicle.rubber_source == config_dir() / "rubber" / "nr_sbr_10hz.csv"
    assert np.array_equal(vehicle.rubber.loss_pa, load("xgd24d").rubber.loss_pa)
    assert len(caplog.records) == 1
    assert str(vehicle.rubber_source) in caplog.records[0].getMessage()
    load(path)
    assert len(caplog.records) == 1
    (tmp_path / "rubber").mkdir()
    (tmp_path / "rubber" / "nr_sbr_10hz.csv").write_text(SWEEP, encoding="utf-8")
    assert load(path).rubber_source == tmp_path / "rubber" / "nr_sbr_10hz.csv"


def test_overlapping_road_wheels_are_refused_unless_side_by_side(refusal, loaded, content):
    wheels = content["tracks"]["triangular"]["road_wheels"]
    wheels["radius"].update(value=0.26, range=[0.1, 0.3])  # the diameter for the radius
    assert "overlap along the track" in refusal(content).given
    wheels["contact_length"].update(value=0.3, range=[0.1, 0.635])  # interleaved, two rows on a belt of 0.635 m
    assert loaded(content).tracks["triangular"].road_wheels.radius == 0.26
    wheels["radius"].update(value=0.36, range=[0.1, 0.5])  # three of 0.3 m do not fit in a row
    assert refusal(content).given.startswith("3 wheels")


def test_a_sweep_that_is_not_there(refusal, content):
    content["rubber"]["file"] = "rubber/none.csv"
    error = refusal(content)
    assert error.where.endswith("given.yaml: rubber.file")
    assert "none.csv" in error.given
    assert "a readable CSV" in error.allowed


def test_a_sweep_is_read_in_pascal_beside_its_vehicle_file(configuration, loaded, content):
    (configuration / "own.csv").write_text(SWEEP, encoding="utf-8")
    content["rubber"]["file"] = "own.csv"
    rubber = loaded(content).rubber
    assert rubber.sweep_degc == pytest.approx([-50, 0, 50, 100])
    assert rubber.storage_pa == pytest.approx([7e8, 1.4e7, 8e6, 7e6])
    content["rubber"]["file"] = str(configuration / "own.csv")
    assert loaded(content).rubber.loss_pa == pytest.approx(rubber.loss_pa)


# Written files

PLACES = np.array([0.9]), np.array([0.1]), np.zeros(1), np.full((1, 2), 0.01), np.full((1, 2), 0.001), np.ones(1, np.int64)
ROUTE = (RouteMap(SLOPE, *PLACES),)


@pytest.mark.parametrize("there", ["rubber/nr_sbr_10hz.csv", "effects/squeak.py", "surroundings.yaml", "route.csv"])
def test_a_written_vehicle_changes_no_other_file(tmp_path, own, there):
    effects = catalogue(own)
    effects_added = tuple(
        Active(effects[name], {q.name: q.start for q in effects[name].parameters}) for name in ("squeak", "grade")
    )
    changes, file = FileChanges(None, effects_added, {}, route=ROUTE), tmp_path / "new.yaml"
    (tmp_path / there).parent.mkdir(exist_ok=True)
    (tmp_path / there).write_text("edited by hand\n", encoding="utf-8")
    for _ in range(2):  # the second time into the files of the first
        _, site_file, *_ = write_track_vehicle(load("xgd24d"), file, changes, "Written by trackres diagnose.")
        assert (tmp_path / there).read_text(encoding="utf-8") == "edited by hand\n"
        vehicle = with_surroundings(load(file), site_file)
        assert np.array_equal(vehicle.rubber.loss_pa, load("xgd24d").rubber.loss_pa)
        assert [effect_values.effect.name for effect_values in vehicle.active] == ["squeak", "grade"]
        assert len(vehicle.route) == 1
    paths = sorted(path for path in tmp_path.rglob("*") if path.is_file() and path.parent != own and "__" not in str(path))
    assert len(paths) == 6


@pytest.mark.parametrize("surrounded", [False, True])
@pytest.mark.parametrize("by", ["trackres replay", "trackres coastdown", "trackres compound"])
def test_only_a_diagnosis_touches_surroundings(tmp_path, own, by, surrounded):
    def contents():
        return {path: path.read_bytes() for path in tmp_path.rglob("*.*") if path.is_file() and path.parent != own}

    effects = catalogue(own)
    squeak, grade = (Active(effects[name], {q.name: q.start for q in effects[name].parameters}) for name in ("squeak", "grade"))
    paths = tmp_path / "vehicle.yaml", tmp_path / "surroundings.yaml"
    write_track_vehicle(load("xgd24d"), paths[0], FileChanges(None, (squeak, grade), {}, route=ROUTE), DIAGNOSED)
    old_contents, vehicle = contents(), with_surroundings(load(paths[0]), paths[1]) if surrounded else load(paths[0])
    for configuration in (tmp_path, tmp_path / "other"):
        configuration.mkdir(exist_ok=True)
        files = write_track_vehicle(
            vehicle, configuration / "car.yaml", FileChanges(None, (), {}, command=by), f"Written by {by}."
        )
        new_contents = contents()
        assert {path: new_contents[path] for path in old_contents} == old_contents
        assert new_contents.keys() - old_contents.keys() <= set(files) <= new_contents.keys()
        assert not configuration.joinpath("other", "surroundings.yaml").exists()
        old_contents = new_contents


def raised(action):
    """The OSError of a call, or None."""
    try:
        action()
    except OSError as error:
        return error
    return None


def test_a_full_disk_leaves_all_files_of_a_vehicle_unchanged(tmp_path):
    vehicle, other_route = load("xgd24d"), tuple(route_map.times(2.0) for route_map in ROUTE)

    def write(route, text):
        write_track_vehicle(vehicle, tmp_path / "new.yaml", FileChanges(None, (), {}, route=route), f"{DIAGNOSED} from {text}")
        return contents()

    def contents():
        return {path.name: path.read_text(encoding="utf-8") for path in tmp_path.rglob("[!.]*.*")}

    old_contents = write(ROUTE, "first")
    new_contents = write(other_route, "then")
    assert sum(new_contents[name] != old_contents[name] for name in old_contents) == 3
    for call in count(1):
        write(ROUTE, "first")
        with Faults(tmp_path, call, call) as faults:
            error = raised(lambda: write(other_route, "then"))
        if not faults.hit:
            break
        assert contents() == (old_contents if error else new_contents), faults.calls
        assert error is None or Path(error.filename).is_relative_to(tmp_path), faults.calls
    assert call > 40
