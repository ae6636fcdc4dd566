# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Two designs side by side."""

import json
from dataclasses import replace

import numpy as np
import pytest
import yaml

import trackres_ros as tr
from trackres_ros.effects.effect import Active
from trackres_ros.effects.registry import catalogue
from trackres_ros.estimator.columns import Reason
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.files.documents import read_yaml
from trackres_ros.files.resources import find_vehicle
from trackres_ros.model.operating_point import explain, explain_road
from trackres_ros.model.track import belt_network, with_methods
from trackres_ros.tools.design.compare import compare_designs, display_names, request_of
from trackres_ros.tools.design.compare_text import designs_text, draw_designs
from trackres_ros.tools.design.drives import read_cycle, run_cycle, with_factors
from trackres_ros.tools.design.steady import FileErrors, plain_vehicle, solver, steady
from trackres_ros.tools.design.uncertain import difference_std, sensitivities, slopes_of
from trackres_ros.tools.fleet.compare import draw_overlay
from trackres_ros.units import GRAVITY
from trackres_ros.vehicle import load, load_any, variants

GRID = ("--speed-kmh", "5,12", "--belt-degc", "0,60")


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
    assert all(0.0 < row["std"] < row["std_with_changed"] for row in (*found["steady"], *found["drives"]))


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
    text = good("compare", softer, other, "--speed-kmh", "10", "--belt-degc", "20", "-o", tmp_path / "out")
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
    words = ("--speed-kmh", "8", "--belt-degc", "20", "--cycle", recording)
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


PATHS = (
    "rubber.loss_modulus_scale",
    "rubber.glass_transition",
    "chassis.bearing_friction",
    "chassis.drag_coefficient",
    "belt.thickness",
    "belt.film_offset",
    "sprocket_radius",
)


def test_a_differences_std_moves_shared_values_in_both_vehicles(good, tmp_path):
    """Each value moved by a little in both vehicles, by the exact methods; where it differs, in each by itself."""
    good("vehicle", "new", "mine", "--like", "agri3t", "-o", tmp_path)
    content = yaml.safe_load((tmp_path / "mine.yaml").read_text())
    content["rubber"]["loss_modulus_scale"].update(value=0.7, range=[0.6, 0.8])
    content["chassis"]["bearing_friction"].update(value=0.0, range=[0.0, 0.012])  # whose range counts too
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(content))
    one, other = load("agri3t"), load(tmp_path / "mine.yaml")
    speed, air = 2.0, 5.0
    paths = [path for end in PATHS for path in one.parameters if path.endswith(end)]

    def of(vehicle, by=()):
        values = {path: vehicle.parameters[path].value + step for path, step in by}
        return np.array(steady(variants(vehicle)(values), speed, air).outcomes)

    moves = []
    for vehicle in (one, other):
        found = of(vehicle)
        slopes = slopes_of(vehicle, speed, np.array([air, found[2]]))
        off = sensitivities(
            slopes, lambda by, _, of=vehicle: np.array(plain_vehicle(of, speed, air).solve(by).outcomes), [air, *[found[2]] * 3]
        )
        exact = {}
        for path in paths:
            std = vehicle.parameters[path].standard_deviation
            exact[path] = (of(vehicle, [(path, 0.1 * std)]) - found) / 0.1
            assert np.all(np.abs(off[path] - exact[path]) <= 0.1 * np.abs(exact[path]) + 1e-3 * np.abs(found)), path
        moves.append(({path: off[path] for path in paths}, exact))
    by_slopes, by_vehicles = (difference_std((one, other), both) for both in zip(*moves, strict=True))
    assert np.array(by_slopes) == pytest.approx(np.array(by_vehicles), rel=0.1)
    assert np.all(by_slopes[1] > by_slopes[0])


@pytest.mark.parametrize("thermal", ["lumped", "core_surface"])
def test_ranges_inside_a_belt_move_its_steady_state(thermal):
    """Conductivity and cooled area change the heat's way out alone: the loss stays."""
    whole, speed, air = with_methods(load("agri3t"), thermal=thermal), 2.0, 5.0
    paths = ["rubber.conductivity", f"tracks.{whole.assemblies[0].track}.belt.exposed_share"]
    certain = {path: replace(q, low=q.value, high=q.value) for path, q in whole.parameters.items() if path not in paths}
    vehicle = replace(whole, parameters={**whole.parameters, **certain})
    own = plain_vehicle(vehicle, speed, air)
    found, (kind,) = np.array(own.solve().outcomes), own.kinds
    slopes = slopes_of(vehicle, speed, np.array([air, found[2]]))
    off = sensitivities(slopes, lambda by, _: np.array(own.solve(by).outcomes), np.array([air, *[found[2]] * 3]))
    for path in paths:
        quantity = vehicle.parameters[path]
        network = belt_network(variants(vehicle)({path: quantity.value + 0.1 * quantity.standard_deviation}), kind.track)
        other = replace(kind, network=network, film=kind.film / kind.network.area * network.area)
        exact = (np.array(replace(own, kinds=(other,)).solve().outcomes) - found) / 0.1
        assert off[path] == pytest.approx(exact, rel=0.05, abs=1e-9)
        assert exact[2] < -0.3 or (thermal == "lumped" and path == paths[0])


def test_errors_of_a_file_act_with_its_effects():
    """With more air drag, an error of the drag area moves the torque more; those of loss and cooling as before."""
    plain, speed, air, share = load("agri3t"), 4.0, 5.0, 0.5
    vehicle = replace(plain, effects=(Active(catalogue()["air_drag"], {"share": share}),))
    solvers, track = [solver(one, speed, air) for one in (plain, vehicle)], plain.assemblies[0].track
    before = [np.array(solve(FileErrors()).outcomes) for solve in solvers]
    for change, factor in (({"loss": 1.1}, 1.0), ({"film": 1.1}, 1.0), ({"drag_area": 1.0}, 1.0 + share)):
        one, other = (solve(FileErrors(track, **change)).outcomes - at for solve, at in zip(solvers, before, strict=True))
        assert np.abs(one).max() > 1.0
        assert other[[0, 1, 3]] == pytest.approx(factor * one[[0, 1, 3]], rel=0.02, abs=1e-3)
        assert other[2] == pytest.approx(one[2], rel=0.02, abs=0.1)
        assert solvers[1](FileErrors("another", **change | {"drag_area": 0.0})).outcomes == tuple(before[1])


def test_a_radius_error_moves_energy_by_torques_of_effects():
    """On a drive: their force along the way is smaller with a larger sprocket. The belt's loss is a force already."""
    plain, radius = load("agri3t"), 1.25
    dragged = replace(plain, effects=(Active(catalogue()["drivetrain_drag"], {"drag": 20.0}),))
    totals = [
        [
            run_cycle(with_factors(Estimator(one), FileErrors(radius=r)), read_cycle("laps", 3.0), None, 5.0)[0]
            for r in (1.0, radius)
        ]
        for one in (plain, dragged)
    ]
    for name, factor in (("kwh_per_km", 1.0 / radius), ("mean_resistance_nm", 1.0)):
        (bare, barer), (first, last) = ([total[name] for total in pair] for pair in totals)
        assert last - barer == pytest.approx(factor * (first - bare), rel=1e-3)
        assert barer == pytest.approx(bare * (radius if name.endswith("_nm") else 1.0), rel=1e-3)


def test_the_same_design_twice_is_the_same(good, softer):
    """However narrow a range is in one of the files."""
    content, known = yaml.safe_load(softer.read_text()), softer.with_name("known.yaml")
    content["rubber"]["loss_modulus_scale"].update(range=[0.49, 0.51])
    drag = content["chassis"]["drag_coefficient"]
    drag.update(range=[drag["value"]] * 2)
    known.write_text(yaml.safe_dump(content))
    same = json.loads(good("compare", softer, known, "--speed-kmh", "10", "--belt-degc", "20", "--json"))
    for row in (*same["designs"]["steady"], *same["designs"]["drives"]):
        assert row["difference"] == 0.0
        assert row["std"] == row["std_with_changed"] < 1e-4 * row["one"]
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
    conditions = {"speed_kmh": "50", "belt_degc": str(degc), "ambient_degc": str(degc), "cycle": (str(tmp_path / "drive.csv"),)}
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
