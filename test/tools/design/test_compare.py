# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Two designs side by side."""

import json
from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
import yaml

import trackres_ros as tr
from trackres_ros.estimator.columns import Reason
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.files.documents import read_yaml
from trackres_ros.files.resources import find_vehicle
from trackres_ros.model.operating_point import explain, explain_road
from trackres_ros.tools.design.compare import compare_designs, display_names, request_of
from trackres_ros.tools.design.compare_text import designs_text, draw_designs, draw_energy, headline, is_undecided
from trackres_ros.tools.design.draws import distribution, draws, uncertain_values
from trackres_ros.tools.design.drives import estimator_of, read_cycle, run_cycle
from trackres_ros.tools.fleet.compare import draw_overlay
from trackres_ros.units import GRAVITY
from trackres_ros.vehicle import load, load_any, variants
from trackres_ros.vehicle.description import Quantity

GRID = ("--speed-kmh", "5,12", "--belt-degc", "0,60", "--draws", "16")


@pytest.fixture(scope="module")
def softer(tmp_path_factory, good):
    """The reference vehicle with half of the loss."""
    folder = tmp_path_factory.mktemp("designs")
    good("vehicle", "new", "softer", "-o", folder)
    file = folder / "softer.yaml"
    content = yaml.safe_load(file.read_text())
    content["rubber"]["loss_modulus_scale"].update(value=0.5, range=[0.4, 0.6])
    file.write_text(yaml.safe_dump(content))
    return file


def test_half_the_loss_modulus_is_half_the_hysteresis_everywhere(good, softer):
    found = json.loads(good("compare", "xgd24d", softer, *GRID, "--json"))
    (differs,) = (one for one in found["values"] if one["ratio"] is not None)
    assert (differs["path"], differs["ratio"]) == ("rubber.loss_modulus_scale", 0.5)
    (moved_one,) = (q for q in found["parameters"] if q["difference"])
    assert (moved_one["parameter"], moved_one["difference"]) == ("loss_modulus_scale", pytest.approx(-0.5))
    found = found["designs"]
    assert found["speeds_kmh"] == [5.0, 12.0]
    assert found["belts_degc"] == [0.0, 60.0]
    full, half = (np.array(design["torque_nm"]) for design in found["designs"])
    assert np.all(half < full)
    # Bearings and air are alike in both and at every temperature; the torque strains the belt a little.
    rest = 2.0 * half - full
    assert rest.std(axis=0).max() < 0.01 * full.mean()
    assert np.all(np.diff(full, axis=0) < 0.0)  # warmer rubber loses less
    drives = [design["drive"] for design in found["designs"]]
    assert drives[0]["km"] == drives[1]["km"]
    assert drives[1]["kwh_per_km"] < drives[0]["kwh_per_km"]
    assert {row["outcome"] for row in found["steady"]} == {"cold_nm", "warm_nm", "belt_degc", "kwh_per_km"}
    for row in (*found["steady"], *found["drives"]):
        (low, high), (lower, higher) = row["difference_95"], row["difference_95_with_changed"]
        assert lower < low < row["difference"] < high < 0.0
        assert higher < 0.0
        assert row["probability_less"] == row["probability_less_with_changed"] == 1.0


@pytest.mark.parametrize("max_speed", [0.5, 1.0, 5.0 / 3.6, 1.5, 10.0])
def test_without_speeds_those_of_any_vehicle_are_compared(softer, max_speed):
    content = yaml.safe_load(softer.read_text())
    content["chassis"]["max_speed"].update(value=max_speed, range=[0.5, 20.0])
    slow = softer.with_name("slow.yaml")
    slow.write_text(yaml.safe_dump(content))
    speeds = request_of((str(softer), str(slow))).speeds_kmh
    assert speeds[-1] == pytest.approx(3.6 * max_speed, abs=1e-4)
    assert speeds[0] == (5.0 if max_speed > 1.4 else pytest.approx(0.36 * max_speed, abs=1e-4))


def test_the_tables_and_the_picture(good, softer, tmp_path):
    other = softer.with_name("wider.yaml")  # another version of the same name: it goes by its file
    other.write_text(softer.read_text().replace("value: 0.5", "value: 0.55"))
    text = good("compare", softer, other, "--speed-kmh", "10", "--belt-degc", "20", "--draws", "8", "-o", tmp_path / "out")
    places = [softer.parent / folder / "same.yaml" for folder in "ab"]
    assert display_names([replace(load(softer), source=place) for place in places]) == list(map(str, places))
    values, _, rest = text.partition("Steady")
    assert "rubber.loss_modulus_scale" in values
    assert "+10.0 %" in values
    assert "wider takes" in values
    assert "None of these parameters differs" not in text
    for part in ("belt temperature", "Resistance [Nm] of softer", "Resistance [Nm] of wider", "change from softer to wider"):
        assert part in rest
    assert (tmp_path / "out" / "designs.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


def test_each_load_air_speed_and_drive_has_its_rows(good, softer, tmp_path):
    recording = tmp_path / "drive.csv"
    recording.write_text(
        "time_s,speed_kmh,torque_nm,weight_n,ambient_degc\n0,0,0,250000,5\n30,9,900,250000,5\n300,9,900,250000,5\n"
    )
    words = ("--speed-kmh", "8", "--belt-degc", "20", "--draws", "8", "--cycle", recording)
    listed = ("--weight-kn", "240,300", "--ambient-degc", "-10:20:2")
    found = json.loads(good("compare", "xgd24d", softer, *words, *listed, "--json"))["designs"]
    assert len(found["steady"]) == 2 * 2 * 4
    assert len(found["drives"]) == 2 * 2 * 3
    text = designs_text(found)
    assert f"On the drive {found['drives'][0]['cycle']}, air -10 degC, 240 kN " in text
    assert text.count(", air -10 degC, 240 kN: ") == 2
    assert all(f"Resistance [Nm] of {name}, air -10 degC, 240 kN\n" in text for name in ("xgd24d", "softer"))
    assert "to softer, air -10 degC, 240 kN [%]" in text
    cold = {(r["speed_kmh"], r["ambient_degc"], r["weight_kn"][0]): r for r in found["steady"] if r["outcome"] == "cold_nm"}
    assert cold[8.0, -10.0, 240.0]["one"] > cold[8.0, 20.0, 240.0]["one"]
    assert cold[8.0, 20.0, 300.0]["one"] > cold[8.0, 20.0, 240.0]["one"]
    exact = explain(load("xgd24d"), 8.0 / 3.6, 20.0, 20.0, 300e3)["torque_nm"]["resistance"]
    assert cold[8.0, 20.0, 300.0]["one"] == pytest.approx(exact)
    assert "not torque" in found["notes"][0]
    own = json.loads(good("compare", "xgd24d", softer, *words, "--cycle", "laps", "--json"))["designs"]
    assert [row["recorded"] for row in own["drives"][::3]] == [["load", "ambient"], []]
    plain = tmp_path / "plain.csv"
    plain.write_text("time_s,speed_kmh,weight_n,ambient_degc\n0,0,250000,5\n30,9,250000,5\n300,9,250000,5\n")
    simulated = tr.simulate("xgd24d", profile=plain, dt=0.5)
    assert own["drives"][0]["one"] == pytest.approx(simulated.drive["kwh_per_km"])
    each_tonne = 1e3 * simulated.drive["kwh_per_km"] / (250.0 / GRAVITY)  # of the recorded load
    assert own["designs"][0]["drive"]["wh_per_km_and_t"] == pytest.approx(each_tonne)
    assert "load and air as recorded" in designs_text(own)


LOSS, FRICTION = "rubber.loss_modulus_scale", "chassis.bearing_friction"


def changed(folder, name, like="agri3t", **values):
    """A file of a shipped vehicle with other values and ranges by path."""
    file = folder / f"{name}.yaml"
    content = deepcopy(read_yaml(find_vehicle(like)))
    for path, (value, low, high) in values.items():
        section, key = path.split("__")
        content[section][key].update(value=value, range=[low, high])
    content["rubber"]["file"] = str(find_vehicle(like).parent / content["rubber"]["file"])
    content["name"] = name
    file.write_text(yaml.safe_dump(content))
    return str(file)


def drawn_comparison(*files, draws=16):
    return compare_designs(request_of(files, speed_kmh="8", belt_degc="20", cycle=("laps",), draws=draws))


def test_swapped_designs_give_the_complement(tmp_path):
    """And the difference has the other sign."""
    other = changed(tmp_path, "other", chassis__bearing_friction=(0.011, 0.005, 0.02))
    there, back = drawn_comparison("agri3t", other), drawn_comparison(other, "agri3t")
    for row, mirrored in zip(there["steady"] + there["drives"], back["steady"] + back["drives"], strict=True):
        for end in ("", "_with_changed"):
            assert row[f"probability_less{end}"] == 1.0 - mirrored[f"probability_less{end}"]
            low, high = mirrored[f"difference_95{end}"]
            assert row[f"difference_95{end}"] == pytest.approx([-high, -low], abs=1e-9)
        assert (row["one_95"], row["other_95"]) == (mirrored["other_95"], mirrored["one_95"])
    energy = there["drives"][0]
    assert energy["probability_less"] == 0.0  # more friction, all else alike
    assert 0.0 < energy["probability_less_with_changed"] < 0.5


def test_a_dominated_design_has_a_probability_near_zero(tmp_path):
    """Also where a shared value moves both by far more than they differ."""
    other = changed(tmp_path, "other", rubber__loss_modulus_scale=(1.3, 1.29, 1.31))
    one = changed(tmp_path, "one", rubber__loss_modulus_scale=(1.2, 1.19, 1.21))
    energy = drawn_comparison(one, other)["drives"][0]
    assert energy["probability_less"] == energy["probability_less_with_changed"] == 0.0
    (low, high), (least, most) = energy["difference_95"], energy["one_95"]
    assert 0.0 < low < energy["difference"] < high
    assert most - least > 5.0 * energy["difference"]


def test_an_overlap_of_changed_ranges_is_undecided(tmp_path):
    """The headline says that it is these ranges; where it is all, it says that too."""
    other = changed(tmp_path, "other", chassis__bearing_friction=(0.0101, 0.005, 0.02))
    found = drawn_comparison("agri3t", other)
    row = found["drives"][0]
    assert row["probability_less"] == 0.0
    assert is_undecided(row["probability_less_with_changed"])
    names = ("agri3t", "other")
    assert "so narrow them to what you can build." in headline(row, names)
    assert "do not decide which takes more." in headline({**row, "probability_less": 0.4}, names)
    sure = headline({**row, "probability_less_with_changed": 0.004}, names)
    assert sure.endswith("less is < 1 %, and < 1 % with the ranges of the changed values.")


def test_equal_values_are_drawn_once_in_the_narrowest_range():
    one = {LOSS: Quantity(1.0, "1", "A", 0.8, 1.2, ""), FRICTION: Quantity(0.01, "1", "A", 0.0, 0.02, "")}
    other = {LOSS: Quantity(1.0, "1", "A", 0.9, 1.1, ""), FRICTION: Quantity(0.011, "1", "A", 0.0, 0.02, "")}
    pairs = draws([one, other], 400, 1)
    losses, frictions = (np.array([[values[path] for values in pair] for pair in pairs]) for path in (LOSS, FRICTION))
    assert np.array_equal(losses[:, 0], losses[:, 1])
    assert abs(np.corrcoef(frictions.T)[0, 1]) < 0.15
    assert 0.9 <= losses.min() < 0.905 < 1.095 < losses.max() <= 1.1
    assert losses.mean() == pytest.approx(1.0, abs=1e-3)
    assert losses.std() == pytest.approx(0.05 * 0.88, rel=0.02)  # a normal distribution cut at two standard deviations
    assert draws([other, one], 400, 1) == [(second, first) for first, second in pairs]
    assert draws([one, other], 400, 2) != pairs


def test_values_that_cannot_be_drawn_are_held():
    vehicle = load("xgd24d")
    paths = set(uncertain_values(vehicle, 8.0, 15.0))
    assert {LOSS, FRICTION, "tracks.triangular.belt.thickness", "chassis.air_density"} <= paths
    assert not any(path.endswith((".load", ".own_weight", "ambient", "max_speed", "wrap_angle")) for path in paths)


def test_lost_draws_leave_an_interval_until_they_are_many():
    one, other = np.arange(100.0), np.arange(100.0) + 1.0
    one[:25] = np.nan
    found = distribution(one, other)
    assert (found.less, found.difference) == (0.0, (1.0, 1.0))
    assert found.one == pytest.approx((26.85, 97.15))
    one[25] = np.nan
    assert distribution(one, other).less is distribution(one, other).difference is None
    assert distribution(other, other).less == 0.5


@pytest.mark.parametrize("name", ["xgd24d", "agri3t"])
def test_a_drawn_estimator_drives_as_a_new_one(name):
    """By its quick table within 0.1 %."""
    values = {LOSS: 1.15, FRICTION: 0.009, "rubber.glass_transition": -55.0}
    vehicle, base = variants(load(name))(values), Estimator(name)
    cycle = read_cycle("laps", vehicle.chassis.max_speed)
    (drawn, _), (new, _) = (run_cycle(each, cycle, None, 5.0) for each in (estimator_of(vehicle, base), Estimator(vehicle)))
    assert drawn == pytest.approx(new, rel=1e-3)
    assert drawn["kwh_per_km"] != pytest.approx(run_cycle(base, cycle, None, 5.0)[0]["kwh_per_km"], rel=1e-2)


def test_the_same_design_twice_is_the_same(good, softer):
    """However narrow a range is in one of the files."""
    content, known = yaml.safe_load(softer.read_text()), softer.with_name("known.yaml")
    content["rubber"]["loss_modulus_scale"].update(range=[0.49, 0.51])
    drag = content["chassis"]["drag_coefficient"]
    drag.update(range=[drag["value"]] * 2)
    known.write_text(yaml.safe_dump(content))
    same = json.loads(good("compare", softer, known, "--speed-kmh", "10", "--belt-degc", "20", "--draws", "8", "--json"))
    for row in (*same["designs"]["steady"], *same["designs"]["drives"]):
        assert row["difference"] == 0.0
        assert row["probability_less"] == row["probability_less_with_changed"] == 0.5
        assert row["difference_95"] == row["difference_95_with_changed"] == [0.0, 0.0]
        assert row["one_95"] == row["other_95"]
    one, other = same["designs"]["designs"]
    assert {**one, "vehicle": "known"} == other
    assert [value["ratio"] for value in same["values"]] == [1.0, 1.0]
    assert not any(q["difference_std"] or q["differs"] for q in same["parameters"])
    assert "both take the same energy" in designs_text(same["designs"])


@pytest.mark.parametrize(
    ("given", "part"),
    [
        (("xgd24d", "agri3t", "--speed-kmh", "20:10"), "A < B"),
        (("xgd24d", "agri3t", "--speed-kmh", "5:10:99"), "at most 25 numbers"),
        (("xgd24d", "agri3t", "--ambient-degc", "nan"), "--ambient-degc"),
        (("xgd24d", "agri3t", "--weight-kn", "272"), "kN for agri3t"),
        (("husky", "husky", "--weight-kn", "1"), "only with two vehicle files with tracks"),
        (("xgd24d", "agri3t", "--cycle", "stagess"), "did you mean stages"),
        (
            ("xgd24d", "agri3t", "--cycle", "heavy.csv"),
            "--cycle heavy.csv: load: given 9000000.0; allowed: 27200 to 680000 N for a vehicle",
        ),
        (("xgd24d", "agri3t", "--speed-kmh", "5:50"), "--speed-kmh"),
        (("xgd24d", "agri3t", "--belt-degc", "warm"), "A:B"),
    ],
)
def test_what_cannot_be_is_one_line(tmp_path, refused, given, part):
    (tmp_path / "heavy.csv").write_text("time_s,speed_kmh,weight_n\n0,8,270000\n9,8,9000000\n")
    assert part in refused("compare", *given, cwd=tmp_path)


@pytest.mark.parametrize(("degc", "outside"), [(-60, True), (10, False)])
def test_each_part_of_a_comparison_says_what_it_lacks(tmp_path, degc, outside):
    """Rubber data, and the yaw rate of an effect."""
    scrub = {**read_yaml(find_vehicle("xgd24d")), "effects": {"turning_scrub": {"friction": 0.5}}}
    (tmp_path / "scrub.yaml").write_text(yaml.safe_dump(scrub))
    (tmp_path / "drive.csv").write_text("time_s,speed_kmh\n0,50\n9,50\n")
    conditions = {
        "speed_kmh": "50",
        "belt_degc": str(degc),
        "ambient_degc": str(degc),
        "cycle": (str(tmp_path / "drive.csv"),),
        "draws": 8,
    }
    found = compare_designs(request_of(("xgd24d", str(tmp_path / "scrub.yaml")), **conditions))
    parts = [f"{name}{of}" for name in ("xgd24d", "scrub") for of in ("", ", table of resistance", " on drive.csv") if outside]
    assert {text.partition(": track")[0] for text in found["remarks"] if ": track" in text} == set(parts)
    assert [text for text in found["remarks"] if ": track" not in text] == [f"scrub on drive.csv: {Reason.EFFECT_LEFT_OUT.text}"]
    assert [note.partition(": inactive")[0] for note in found["notes"]] == [
        "steady states and table of resistance of scrub: turning_scrub"
    ]
    assert all(f"  ! {text}" in designs_text(found) for text in found["remarks"])


def test_vehicles_without_belts_compare_resistance_and_energy(good):
    done = good("compare", "bmw_i3", "ztbus_hess19", "--json")
    rows = json.loads(done)["wheels"]
    for row in rows:
        for which, name in enumerate(("bmw_i3", "ztbus_hess19")):
            resisting = explain_road(load_any(name), row["speed_kmh"] / 3.6)["torque_nm"]["resistance"]
            assert row["resistance_nm"][which] == pytest.approx(resisting)
            assert row["kwh_per_km"][which] == pytest.approx(row["force_n"][which] / 3600.0)
    assert all(np.all(np.diff([row["force_n"][which] for row in rows]) > 0.0) for which in (0, 1))


def test_in_the_picture_two_equal_values_have_equal_bars(drawn, tmp_path):
    """Of any size and unit; names are drawn as they are, and values without a bar are named."""
    equal = [{"parameter": f"p{i}", "unit": "Pa", "one": x, "one_std": 0.1 * x, "other": x, "other_std": 0.1 * x,
              "difference": 0.0, "difference_std": 0.0, "differs": False} for i, x in enumerate((1e-6, 1.0, 1e9))]  # fmt: skip
    values = [{"path": "chassis.p0"}, {"path": "tracks.belt.width"}]
    found = {"one": "a $x$ $", "other": r"$\b$", "parameters": equal, "values": values}
    draw_overlay(found, tmp_path / "compare.png")
    (figure,) = drawn.figures
    assert not drawn.faults(figure)
    (axes,) = figure.axes
    ends = [c.get_segments()[0][:, 0] for c in axes.collections]
    np.testing.assert_allclose(ends, [[-1.96 / np.sqrt(2.0), 1.96 / np.sqrt(2.0)]] * 6)
    assert axes.get_xlabel().endswith("different in the files: tracks.belt.width")


def test_designs_of_any_name_are_drawn(drawn, tmp_path):
    designs = [{"vehicle": name, "weight_n": 2e5, "coefficient": [[0.03, 0.02]]} for name in ("a $x$ $", r"$\b$")]
    draw_designs({"designs": designs, "speeds_kmh": [9.0, 5.0], "belts_degc": [20.0]}, tmp_path / "designs.png")
    assert [axes.get_title(loc="left") for axes in drawn.figures[0].axes] == ["a $x$ $, 200 kN", r"$\b$, 200 kN"]
    np.testing.assert_allclose([axes.lines[0].get_xydata() for axes in drawn.figures[0].axes], [[[5.0, 2.0], [9.0, 3.0]]] * 2)


def test_the_energy_of_both_designs_is_drawn_over_the_air(drawn, tmp_path):
    """In the order of the air, with all intervals; a missing one is a gap."""
    row = {"outcome": "kwh_per_km", "cycle": "stages", "weight_kn": [200.0, 200.0], "one": 2.0, "other": 1.5, "difference": -0.5}
    ends = {
        "one_95": [1.5, 2.5],
        "other_95": [1.2, 1.9],
        "difference_95": [-0.6, -0.4],
        "difference_95_with_changed": [-1.0, 0.1],
    }
    sure = {**row, **ends, "probability_less_with_changed": 0.96}
    unknown = {**row, **dict.fromkeys(ends), "probability_less_with_changed": None}
    rows = [{**unknown, "ambient_degc": 30.0}, {**sure, "ambient_degc": -10.0}, {**sure, "cycle": "laps", "ambient_degc": 0.0}]
    designs = [{"vehicle": name} for name in ("a $x$ $", r"$\b$")]
    draw_energy({"designs": designs, "drives": rows}, tmp_path / "energy.png")
    (figure,) = drawn.figures
    assert not drawn.faults(figure)
    energy, difference = figure.axes
    assert [text.get_text() for text in energy.get_legend().get_texts()] == ["a $x$ $", r"$\b$"]
    assert [text.get_text() for text in difference.texts] == ["96 %", "-"]
    np.testing.assert_allclose(difference.lines[0].get_xydata(), [[-10.0, -0.5], [30.0, -0.5]])
    bars = [bar.get_segments()[0][:, 1].tolist() for axes in figure.axes for bar in axes.collections]
    assert bars == [ends["one_95"], ends["other_95"], ends["difference_95_with_changed"], ends["difference_95"]]
