# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Design commands: steady states balance, a sweep equals single vehicles, indices equal analytical ones."""

import json
import math
from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
import yaml

import trackres_ros as tr
from trackres_ros.effects import Active, Effect, Parameter, Terms, catalogue
from trackres_ros.estimator.columns import Reason
from trackres_ros.estimator.drives import by_column
from trackres_ros.estimator.energy import RESISTANCE, DriveTotals, StepTimes, energy_j, steps_of, sum_drive, summed
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.records import Steps
from trackres_ros.estimator.settings import Settings
from trackres_ros.files.documents import read_yaml
from trackres_ros.files.resources import find_vehicle
from trackres_ros.model import resistance
from trackres_ros.model.operating_point import explain, vehicle_state
from trackres_ros.model.resistance import RESISTANCE_PARTS
from trackres_ros.model.track import vehicle_constants, with_methods
from trackres_ros.tools import engine as executor
from trackres_ros.tools.design import sensitivity as sensing
from trackres_ros.tools.design.compare import wheels_compared, wheels_text
from trackres_ros.tools.design.drives import read_cycle, run_cycle
from trackres_ros.tools.design.steady import WARMEST_K, Steady, steady
from trackres_ros.tools.design.sweep import SweepRequest, SweepResult, draw, point, sweep
from trackres_ros.tools.design.values import Variation, full_paths, variation
from trackres_ros.tools.fleet.task import _replayed
from trackres_ros.units import STANDSTILL_MPS
from trackres_ros.vehicle import load

SPEED, AIR = 25.0 / 3.6, 10.0


@pytest.mark.parametrize("with_effect", [False, True])
@pytest.mark.parametrize(("name", "speed", "air"), [("xgd24d", SPEED, AIR), ("agri3t", 2.5, AIR), ("xgd24d", 0.15, -30.0)])
def test_what_heats_a_steady_belt_cools_it(name, speed, air, with_effect):
    vehicle = load(name)
    if with_effect:
        effect = catalogue()["drivetrain_drag"]
        vehicle = replace(vehicle, effects=(Active(effect, effect.values()),))
    found = steady(vehicle, speed, air)
    at = explain(vehicle, speed, found.belt_degc, air)
    assert at["heat_w"] == pytest.approx(at["cooling_w"], rel=2e-3)
    assert found.warm_nm == pytest.approx(at["torque_nm"]["resistance"], rel=1e-3)
    assert found.cold_nm == pytest.approx(explain(vehicle, speed, air, air)["torque_nm"]["resistance"], rel=1e-9)
    assert found.cold_nm > found.warm_nm
    radius = vehicle.track_of(vehicle.assemblies[0]).sprocket_radius
    assert found.kwh_per_km == pytest.approx(found.warm_nm / radius / 3600.0, rel=1e-9)


@pytest.fixture(scope="module")
def mixed(tmp_path_factory, good):
    """The reference vehicle whose rear tracks have larger sprockets and carry more."""
    folder = tmp_path_factory.mktemp("mixed")
    good("vehicle", "new", "mixed", "-o", folder)
    content = yaml.safe_load((folder / "mixed.yaml").read_text())
    content["tracks"]["large"] = deepcopy(content["tracks"]["triangular"])
    content["tracks"]["large"]["sprocket_radius"].update(value=0.45, range=[0.4, 0.5])
    content["chassis"]["axles"][1]["load"]["value"] = 140e3
    for assembly in content["assemblies"]:
        assembly["track"] = "large" if assembly["axle"] == "rear" else "triangular"
    (folder / "mixed.yaml").write_text(yaml.safe_dump(content))
    return load(folder / "mixed.yaml")


def with_effects(vehicle, *names):
    active = [Active(catalogue()[name], catalogue()[name].values()) for name in names]
    own, around = ([one for one in active if one.effect.belongs_to == owner] for owner in ("vehicle", "surroundings"))
    return replace(vehicle, effects=tuple(own), surroundings=tuple(around))


def end_of_a_drive(vehicle, speed, air):
    """Columns of the last rows of a long drive at one speed [m/s], and the totals of these rows."""
    estimator, time = Estimator(vehicle), np.arange(0.0, 40_000.0, 20.0)
    first = estimator.cold_start(estimator.inputs(speed, ambient=air))
    _, rows = estimator.run(first, time, np.full_like(time, speed), vehicle.weight, air, 0.0)
    last = by_column(estimator, rows[-3:])
    return last, sum_drive(vehicle, time[-3:], last)


SUN_AND_GROUND = "core_surface", "ground_conduction", "solar", "tension_torque"


@pytest.mark.parametrize(
    ("thermal", "name", "share", "air", "effects"),
    [
        ("lumped", "xgd24d", 0.2, 30.0, ()), ("core_surface", "xgd24d", 0.7, -15.0, ()),
        ("lumped", "xgd24d", 0.7, 30.0, ("core_surface",)), ("core_surface", "xgd24d", 0.3, AIR, ("core_surface",)),
        ("lumped", "agri3t", 0.4, AIR, SUN_AND_GROUND), ("core_surface", "agri3t", 0.9, 30.0, SUN_AND_GROUND),
        ("core_surface", "mixed", 0.5, AIR, ()), ("lumped", "mixed", 0.7, -15.0, ("core_surface", "drivetrain_drag")),
    ],
)  # fmt: skip
def test_a_steady_state_is_where_a_long_drive_ends(mixed, thermal, name, share, air, effects):
    vehicle = with_effects(with_methods(mixed if name == "mixed" else load(name), thermal=thermal), *effects)
    speed = share * vehicle.chassis.max_speed
    found, (last, total) = steady(vehicle, speed, air), end_of_a_drive(vehicle, speed, air)
    belts = [last[f"belt_degc/{one.name}"][-1] for one in vehicle.assemblies]
    assert found.belt_degc == pytest.approx(np.mean(belts), abs=0.1)
    assert found.warm_nm == pytest.approx(last["resistance_torque_nm"][-1], rel=1e-3)
    assert found.kwh_per_km == pytest.approx(total["kwh_per_km"], rel=1e-3)
    if name != "mixed":
        point = explain(vehicle, speed, belts[0], air)
        assert point["surface_degc"] == pytest.approx(
            [last[f"surface_degc/{one.name}"][-1] for one in vehicle.assemblies], abs=0.1
        )
        for heat in ("heat_w", "cooling_w"):
            assert point[heat] == pytest.approx(last[heat][-1], rel=2e-3)


def test_energy_is_that_of_each_assembly_at_its_own_sprocket(mixed, tmp_path):
    """By part, and in any order of the assemblies; an effect of the air acts where the air acts."""
    vehicle, chassis = with_effects(mixed, "drivetrain_drag", "drivetrain_efficiency"), mixed.chassis
    turned = replace(vehicle, assemblies=vehicle.assemblies[::-1])
    (tmp_path / "drive.csv").write_text("time_s,speed_kmh\n" + "".join(f"{t},{min(t, 30)}\n" for t in range(90)))
    recording = tr.read(tmp_path / "drive.csv")
    rows = tr.replay(recording, vehicle)
    step, speed = steps_of(rows.time_s), rows["speed_mps"]
    of = {part: energy_j(vehicle, step, rows, column) for part, column in RESISTANCE_PARTS.items()}
    of |= {part: energy_j(vehicle, step, rows, f"{part}_torque_nm") for part in ("resistance", "drive")}
    drag = resistance.wind_force(speed, chassis.drag_coefficient * chassis.frontal_area, chassis.air_density)
    assert of["wind"] == pytest.approx(summed(step, speed * drag, speed))
    assert of["resistance"] == pytest.approx(sum(of[part] for part in RESISTANCE_PARTS))
    assert of["drive"] - of["resistance"] == pytest.approx(energy_j(vehicle, step, rows, "inertia_nm"))
    assert rows.as_dict()["drive"]["energy_mj"] == pytest.approx(1e-6 * of["resistance"])
    in_fleet = _replayed(recording, turned)
    assert {part: in_fleet[f"{part}_mj"] for part in of} == pytest.approx({part: 1e-6 * energy for part, energy in of.items()})
    assert steady(turned, SPEED, AIR).outcomes == pytest.approx(steady(vehicle, SPEED, AIR).outcomes)
    blown, share = tr.replay(recording, with_effects(turned, "air_drag")), catalogue()["air_drag"].values()["share"]
    assert blown["effects_nm"] == pytest.approx(share * rows["wind_nm"])
    assert energy_j(turned, step, blown, "effects_nm") == pytest.approx(share * of["wind"])
    steady_states = (with_effects(turned, "air_drag"), with_effects(turned))
    windy, calm = (vehicle_state(one, SPEED, [AIR] * 4, AIR, turned.weight).force for one in steady_states)
    wind = resistance.wind_force(SPEED, chassis.drag_coefficient * chassis.frontal_area, chassis.air_density)
    assert windy - calm == pytest.approx(share * wind, rel=5e-3)
    assert energy_j(turned, step, blown, RESISTANCE) == pytest.approx(
        sum(energy_j(turned, step, blown, column) for column in RESISTANCE_PARTS.values())
    )


@pytest.mark.parametrize("step_s", [0.1, 1.0, 4.0, 20.0])
@pytest.mark.parametrize("end_mps", [0.0, -10.0])
def test_totals_of_a_drive_do_not_depend_on_its_step(step_s, end_mps):
    """Which may turn back within a step."""
    vehicle, time = load("xgd24d"), np.arange(0.0, 60.0 + step_s / 2.0, step_s)
    speed = np.interp(time, [0.0, 20.0, 40.0, 60.0], [0.0, 10.0, 10.0, end_mps])
    radius, torque = vehicle_constants(vehicle).radius, 1000.0
    found = sum_drive(
        vehicle, time, {"speed_mps": speed, RESISTANCE: torque * np.sign(np.where(np.abs(speed) < 1e-9, 0.0, speed))}
    )
    assert found["distance_m"] == pytest.approx(400.0)
    assert found["under_way_s"] == pytest.approx(60.0 - 2.0 * STANDSTILL_MPS / 0.5)
    assert found["energy_mj"] == pytest.approx(1e-6 * torque / radius * 400.0)
    assert found["mean_resistance_nm"] == pytest.approx(torque)


@pytest.mark.parametrize("name", ["xgd24d", "mixed"])
def test_totals_of_a_drive_do_not_depend_on_its_blocks(mixed, name):
    vehicle, random = mixed if name == "mixed" else load(name), np.random.default_rng(1)
    step, columns = np.r_[0.0, random.random(999)], Estimator(vehicle).columns
    of = {column: random.normal(0.0, 1.0, 1000) for column in columns}
    of["speed_mps"][[0, 300, 301, 999]] = np.nan
    whole, parts = DriveTotals(vehicle), DriveTotals(vehicle)
    whole.add(step, of)
    for rows in np.split(np.arange(1000), [1, 2, 300, 301, 302, 999]):
        parts.add(step[rows], {column: values[rows] for column, values in of.items()})
    assert parts.as_dict() == whole.as_dict()


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_long_replay_has_the_totals_of_all_its_rows(tmp_path, way):
    """Not of every second one, as drawn; gaps that the estimate bridges count, longer ones do not."""
    time = np.r_[np.arange(0.0, 8_600.0), np.arange(8_612.0, 16_000.0), np.arange(17_000.0, 18_000.0)]
    speed = np.where(time % 8 < 4, 2.0, 0.0)
    np.savetxt(tmp_path / "long.csv", np.c_[time, way * speed], delimiter=",", header="time_s,speed_mps", comments="")
    rows = tr.replay(tmp_path / "long.csv", "xgd24d")
    step, found = steps_of(time, 30.0), rows.as_dict()["drive"]
    assert step.sum() == rows.duration_s == 16_998.0 > 16_000.0
    assert "1 long gap left out" in repr(rows).splitlines()[0]
    assert found["distance_m"] == pytest.approx(summed(step, speed, speed))
    assert found["under_way_s"] < 0.7 * rows.duration_s
    assert found["largest_resistance_nm"] == np.abs(rows["resistance_torque_nm"]).max()
    assert rows.as_dict()["resistance_torque_nm"]["largest"] == found["largest_resistance_nm"]


def test_where_stamps_jump_a_step_has_the_time_of_arrival():
    arrival = np.arange(40) * 10**8
    stamp = arrival + np.repeat([0, 259_200, -5_000, 20], 10) * 10**9
    given = Steps(stamp, arrival, np.empty((40, 0)))
    of_blocks = StepTimes(Settings())
    blocks = (Steps(stamp[rows], arrival[rows], given.rows[rows]) for rows in (slice(25), slice(25, 40)))
    assert np.concatenate([of_blocks.step_times(block) for block in blocks]) == pytest.approx([0.0] + [0.1] * 39)
    assert StepTimes(Settings()).step_times(Steps(stamp, stamp, given.rows)).sum() == pytest.approx(3.6)


def test_what_waited_in_a_queue_adds_no_time_to_a_replay():
    stamp = np.concatenate([np.arange(50), np.arange(1000, 1100)]) * 20_000_000 + 10**18
    arrival = np.where(np.arange(150) < 25, stamp, np.maximum(stamp, stamp[50]))
    steps = Estimator(load("agri3t")).session().handle_block(np.zeros(150, np.int16), stamp, arrival, np.full(150, 2.0))
    assert StepTimes(Settings()).step_times(steps).sum() == pytest.approx((stamp[-1] - stamp[0]) * 1e-9)


def test_an_effect_may_cool_a_belt_below_the_air():
    class Cellar(Effect):
        name, acts_on, belongs_to, text, needs = "cellar", "cooling", "surroundings", "cold ground", ()
        parameters = (Parameter("conductance", "W/K", 0.0, 1e5, 1e4, "to it", off=0.0),)

        def terms(self, at, p):
            return Terms(conductance=p.conductance, sink=AIR - 40.0)

    effect = Cellar()
    vehicle = replace(load("agri3t"), surroundings=(Active(effect, effect.values()),))
    found = steady(vehicle, 2.5, AIR)
    point = explain(vehicle, 2.5, found.belt_degc, AIR)
    assert found.belt_degc < AIR
    assert point["heat_w"] == pytest.approx(point["cooling_w"], abs=1e-3 * 1e4)


def test_a_belt_that_finds_no_balance_has_no_steady_state():
    vehicle = load("xgd24d", {"tracks.triangular.belt.film_offset": 1.0, "tracks.triangular.belt.film_slope": 0.0})
    found = steady(vehicle, SPEED, AIR)
    assert math.isnan(found.belt_degc)
    assert math.isnan(found.warm_nm)
    assert found.cold_nm > 0.0
    assert explain(vehicle, SPEED, AIR + WARMEST_K, AIR)["heat_w"] > explain(vehicle, SPEED, AIR + WARMEST_K, AIR)["cooling_w"]


@pytest.mark.parametrize(
    "vary", ["loss_modulus_scale=1,1.2", "chassis.ambient=-60,20", "axles.load=+20%", "tracks.low.own_weight=2000,3000"]
)
@pytest.mark.parametrize("own_air", [True, False])
def test_a_sweep_drives_as_recorded_unless_told_otherwise(tmp_path, vary, own_air):
    """In the air and with the load of the recording; a varied value and an option replace them."""
    profile, paths = tmp_path / "p.csv", variation(load("agri3t"), vary)
    profile.write_text("time_s,speed_kmh,ambient_degc,weight_n\n0,0,-20,40e3\n20,8,-20,40e3\n60,8,-20,40e3\n")
    asked = SweepRequest("agri3t", (paths,), 2.5, AIR, str(profile), own_air)
    if "ambient" in vary and not own_air:
        with pytest.raises(tr.InputError, match="leave out --ambient-degc"):
            sweep(asked)
        return
    for number, values in enumerate(asked.points):
        vehicle = load("agri3t", values)
        air = values.get("chassis.ambient", None if own_air else AIR)
        state = steady(vehicle, 2.5, vehicle.chassis.ambient if own_air else AIR)
        cycle, weight = read_cycle(str(profile), 5.0), vehicle.weight if "load" in vary or "weight" in vary else None
        total, _ = run_cycle(Estimator(vehicle), cycle, weight, air)
        found, remarks, notes = point(asked, (number, values))
        assert found == (*state.outcomes, total["kwh_per_km"])
        assert notes == list(cycle.notes)
        assert any("a belt is at -60 degC" in text for text in remarks) == (values.get("chassis.ambient") == -60.0)


@pytest.mark.long
def test_the_engine_gives_what_one_process_gives(tmp_path):
    pytest.importorskip("distributed")
    profile = tmp_path / "p.csv"
    profile.write_text("time_s,speed_kmh\n0,0\n20,8\n120,8\n")
    asked = SweepRequest("agri3t", (variation(load("agri3t"), "loss_modulus_scale=0.8,1.2"),), 2.5, AIR)
    alone, engine = sweep(asked), sweep(replace(asked, cycle=str(profile)), workers=1)
    for name in alone.columns:
        np.testing.assert_array_equal(alone.columns[name], engine.columns[name])
    driven = engine.columns["drive_kwh_per_km"]
    assert driven[0] < driven[1]
    assert np.all(driven > engine.columns["kwh_per_km"])  # cold, and faster than where it is steady


def test_indices_of_a_sum_are_the_shares_of_its_terms():
    pytest.importorskip("SALib")
    factors, bounds = np.array([3.0, 2.0, 1.0, 0.0]), [(-1.0, 1.0)] * 4
    given = ["a", "b", "c", "none"], bounds, lambda rows: (rows @ factors)[:, np.newaxis], 1024, 3
    (found, drawn), (again, _) = sensing.sobol(*given), sensing.sobol(*given)
    assert found.by_outcome == again.by_outcome
    assert drawn == 1024 * 6
    shares = factors**2 / (factors**2).sum()
    assert found.std[0] == pytest.approx(math.sqrt((factors**2).sum() / 3.0), rel=0.01)
    for name, share in zip(["a", "b", "c", "none"], shares, strict=True):
        first, first_pm, total, total_pm = found.by_outcome[0][name]
        assert abs(first - share) <= max(first_pm, 1e-3)
        assert abs(total - share) <= max(total_pm, 1e-3)
    assert found.by_outcome[0]["none"][2] == 0.0


def test_what_cannot_be_gives_no_value_an_effect():
    pytest.importorskip("SALib")

    def model(rows):
        return np.where(rows[:, 1] + rows[:, 2] > 1.95, np.nan, 100.0 + rows[:, 0])[:, np.newaxis]

    found, _ = sensing.sobol(["a", "b", "c"], [(-1.0, 1.0)] * 3, model, 1024, 1)
    assert found.by_outcome[0]["a"][2] == pytest.approx(1.0, abs=found.by_outcome[0]["a"][3])
    assert found.by_outcome[0]["b"][2] == found.by_outcome[0]["c"][2] == 0.0


def test_a_product_counts_with_others():
    pytest.importorskip("SALib")
    found, _ = sensing.sobol(["a", "b"], [(-1.0, 1.0)] * 2, lambda rows: rows.prod(axis=1, keepdims=True), 512, 1)
    for name in ("a", "b"):
        first, first_pm, total, total_pm = found.by_outcome[0][name]
        assert abs(first) <= first_pm
        assert abs(total - 1.0) <= total_pm


@pytest.fixture
def vary(monkeypatch):
    """Has a sensitivity analysis vary these values alone, in this process: an engine takes longer to begin."""
    pytest.importorskip("SALib")
    monkeypatch.setattr(executor, "find_spec", lambda _name: None)
    return lambda *paths: monkeypatch.setattr(sensing, "scalars", lambda _: paths)


def test_incompatible_ranges_are_refused_with_a_reason(monkeypatch, vary):
    pair = ["tracks.triangular.belt.width", "tracks.triangular.road_wheels.contact_length"]
    vehicle = load("xgd24d")
    narrow = {pair[0]: replace(vehicle.parameters[pair[0]], low=0.2), pair[1]: vehicle.parameters[pair[1]]}
    changed = replace(vehicle, parameters={**vehicle.parameters, **narrow})
    vary(*pair)
    monkeypatch.setattr(sensing, "load", lambda _: changed)
    # At either end by itself each is all right only if the other allows it: the wheel's contact is no wider than the belt.
    monkeypatch.setattr(sensing, "_ends", lambda *_: (dict.fromkeys(pair, ((1.0,) * 4, (2.0,) * 4)), {}))
    with pytest.raises(tr.InputError, match=r"draws give an impossible vehicle, because .*contact_length"):
        sensing.sensitivity("xgd24d", SPEED, AIR, 8)


def test_a_value_that_ends_the_balance_is_varied(monkeypatch, vary):
    hot, light = "rubber.conductivity", "rubber.density"
    lowest = load("agri3t").parameters[hot].low

    def outcomes(_make, values, _speed, _air):
        """Warm ones move by the loss modulus alone; there is no balance at the low end of the conductivity."""
        warm = 2.0 + values.get("rubber.loss_modulus_scale", 1.0)
        return 5.0, *[math.nan if values.get(hot) == lowest else warm] * 3

    vary("rubber.loss_modulus_scale", hot, light)
    monkeypatch.setattr(sensing, "_outcomes", outcomes)
    found = sensing.sensitivity("agri3t", 2.5, AIR, 8)
    assert list(found.fixed) == [light]
    assert hot in found.indices["belt_degc"]


@pytest.mark.parametrize(("air", "outside"), [(AIR, 0), (125.0, 24)])
def test_sensitivity_counts_the_vehicles_that_extrapolate(vary, air, outside):
    vary("rubber.loss_modulus_scale")
    found = sensing.sensitivity("agri3t", 2.5, air, 8)
    drawn = [text for text in found.remarks if text.startswith(f"{outside} of {found.row_count} drawn vehicles")]
    assert len(found.remarks) == 3 * len(drawn) == (3 if outside else 0)  # of the file's, cold and settled, and of those
    assert (
        list(found.remarks)
        == found.as_dict()["remarks"]
        == [x[4:] for x in found.text("warm_nm").splitlines() if x[:4] == "  ! "]
    )


@pytest.mark.parametrize(("speed", "air", "outside"), [(14.0, 60.0, [1, 2]), (16.0, -60.0, [0, 1, 2]), (6.0, 15.0, [])])
def test_a_point_extrapolates_where_explain_says_so(speed, air, outside):
    swept = sweep(SweepRequest("xgd24d", (variation(load("xgd24d"), "axles.load=-10%,+100%,+150%"),), speed, air))
    assert list(swept.remarks) == np.flatnonzero(swept.columns["beyond_data"]).tolist() == outside
    assert list(swept.as_dict()["remarks"]) == [str(number) for number in outside]
    for number, values in enumerate(swept.request.points):
        belts = air, swept.columns["belt_degc"][number]
        told = [text for belt in belts for text in explain(load("xgd24d", values), speed, belt, air)["remarks"]]
        assert swept.remarks.get(number, []) == list(dict.fromkeys(told))
    rows = swept.text().splitlines()[2:5]
    assert [number for number, row in enumerate(rows) if row.endswith("!")] == outside


def test_belts_without_a_balance_are_outside_of_the_data():
    swept = sweep(SweepRequest("xgd24d", (variation(load("xgd24d"), "axles.load=+100%,+300%"),), 14.0, 60.0))
    assert np.isnan(swept.columns["belt_degc"]).tolist() == [False, True]
    assert list(swept.remarks) == [0, 1]


LOSS, FILM, DRAG = "rubber.loss_modulus_scale", "tracks.low.belt.film_offset", "chassis.drag_coefficient"
THICKNESS, EXPOSED, AREA = "tracks.low.belt.thickness", "tracks.low.belt.exposed_share", "chassis.frontal_area"


@pytest.mark.parametrize(
    ("fitted", "by"),
    [
        ((), {}), ((LOSS,), {THICKNESS: LOSS}), ((FILM, DRAG), {EXPOSED: FILM, AREA: DRAG}),
        ((LOSS, FILM, "rubber.heat_capacity"), {THICKNESS: LOSS, EXPOSED: FILM}),
    ],
)  # fmt: skip
def test_a_value_that_a_fit_has_absorbed_is_held(monkeypatch, fitted, by):
    paths, vehicle = [LOSS, FILM, DRAG, THICKNESS, EXPOSED, AREA], load("agri3t")
    flagged = {path: replace(q, flag="F" if path in fitted else "A") for path, q in vehicle.parameters.items()}
    monkeypatch.setattr(sensing, "scalars", lambda _: paths)
    monkeypatch.setattr(sensing, "_outcomes", lambda *_: (1.0,) * 4)
    ends, held = sensing._ends(replace(vehicle, parameters=flagged), 2.5, AIR, lambda *_: lambda _: None)
    assert held == {path: f"the fit of {fit} has absorbed its error" for path, fit in by.items()}
    assert {*ends, *held} == {*paths}


@pytest.mark.parametrize(
    ("given", "path"),
    [
        ("tracks.triangular.belt.thickness", "tracks.triangular.belt.thickness"),
        ("track.belt_thickness", "tracks.triangular.belt.thickness"),
        ("thickness", "tracks.triangular.belt.thickness"),
        ("wheels.radius.road", None),
        ("axles.load", ("chassis.axles.front.load", "chassis.axles.rear.load")),
        ("road_wheels.radius", "tracks.triangular.road_wheels.radius"),
        ("load", ("chassis.axles.front.load", "chassis.axles.rear.load")),
        ("radius", None),
        ("beams.split", None),
        ("thicknes", None),
        ("road_wheels.positions", None),
        ("", None),
    ],
)
def test_a_value_is_named_by_as_many_words_as_it_takes(given, path):
    vehicle = load("xgd24d")
    if path:
        assert full_paths(vehicle, given) == ((path,) if isinstance(path, str) else path)
        return
    with pytest.raises(tr.InputError, match=r"--vary.*allowed: (one of|a single number)"):
        full_paths(vehicle, given)


@pytest.mark.parametrize(
    "values",
    ["1:2:1", "1:2:2001", "1:x:3", "nan", "inf:2:3", "", "1,,2", "1:2:3:4", "+20%,3", "%", "1%:2", "1:2%", "nan%"],
)
def test_values_that_are_none_are_refused(values):
    with pytest.raises(tr.InputError, match="PATH=A:B:N"):
        variation(load("xgd24d"), f"thickness={values}")


def test_a_percentage_scales_file_values_and_moves_tied_ones():
    vehicle = load("xgd24d", {"chassis.axles.rear.load": 120000.0})
    both = ("chassis.axles.front.load", "chassis.axles.rear.load")
    found = variation(vehicle, "axles.load=-25%:+25%:3")
    assert found.points == [dict(zip(both, at, strict=True)) for at in ((84e3, 90e3), (112e3, 120e3), (140e3, 150e3))]
    assert variation(vehicle, "axles.load=90000").points == [dict.fromkeys(both, 90000.0)]
    assert variation(vehicle, "belt.thickness=+20%").values == ((0.035, 0.042),)
    assert variation(vehicle, "load=-10%,+10%").values == ((100800.0, 123200.0), (108000.0, 132000.0))
    (low, high) = variation(vehicle, "load").values
    assert (low[0], high[-1]) == (80000.0, 150000.0)
    with pytest.raises(tr.InputError, match="percentage"):
        variation(vehicle, "glass_transition=+20%")
    found = sweep(SweepRequest("xgd24d", (variation(load("xgd24d"), "load=+20%"),), SPEED, AIR))
    assert list(found.columns)[:2] == list(both)
    heavier = explain(load("xgd24d", dict.fromkeys(both, 134400.0)), SPEED, AIR, AIR)
    assert found.columns["cold_nm"][1] == pytest.approx(heavier["torque_nm"]["resistance"], rel=1e-9)
    with pytest.raises(tr.InputError, match="each value once"):
        sweep(
            SweepRequest("xgd24d", tuple(variation(load("xgd24d"), one) for one in ("load=+20%", "front.load=+10%")), SPEED, AIR)
        )


@pytest.mark.parametrize(("points", "count"), [(3, 0), (3, 2), (3, 11), (9, 9)])
def test_a_sweep_of_any_lines_can_be_read(drawn, tmp_path, points, count):
    """With large numbers, in any order, and its conditions and units; lines that are not drawn are counted. Many are a map."""
    order = np.random.default_rng(1).permutation(points)
    loads = Variation(("axles.front.load",), "N", (tuple(112000.0 + 1000.0 * order),))
    widths = Variation(("belt.width",), "m", (tuple(0.6 + 0.001 * i for i in range(count)),))
    asked = SweepRequest("a $x$ b.yaml", (loads, *([widths] if count else [])), 50.0 / 3.6, 15.0)
    outcome = np.repeat(loads.values[0], max(count, 1))
    draw(SweepResult(asked, dict.fromkeys(("cold_nm", "warm_nm", "belt_degc", "kwh_per_km"), outcome), {}), tmp_path / "s.png")
    (figure,) = drawn.figures
    assert not drawn.faults(figure)
    assert "a $x$ b.yaml: steady at 50 km/h, air 15 degC" in (figure.get_suptitle(), figure.axes[0].get_title(loc="left"))
    for shades in figure.axes[0].collections:
        assert np.allclose(shades.get_array()[:, 0], np.sort(loads.values[0]))
        assert np.allclose(figure.axes[0].get_ylim(), (111500.0, 120500.0))
    for line in (line for axes in figure.axes for line in axes.lines):
        np.testing.assert_array_equal(line.get_xydata(), np.repeat(np.sort(loads.values[0]), 2).reshape(-1, 2))
    legends = [axes.get_legend() for axes in figure.axes if axes.get_legend()]
    assert len(legends) == (0 < count != points)
    for legend in legends:
        assert legend.get_texts()[0].get_text() == "belt.width 0.6 m"
        assert legend.get_title().get_text() == ("(and 3 more)" if count == 11 else "")


def test_the_command_sweeps_says_what_cannot_be_and_draws(good, tmp_path, monkeypatch):
    pytest.importorskip("matplotlib")
    monkeypatch.chdir(tmp_path)
    shown = good("sweep", "xgd24d", "--vary", "belt.thickness=0.03,0.04,5.0", "-o", "sweep.csv")
    assert "skipped: belt.thickness 5" in shown
    assert "Written: sweep.csv, sweep.png" in shown
    assert (tmp_path / "sweep.png").stat().st_size > 10000
    lines = (tmp_path / "sweep.csv").read_text().splitlines()
    assert lines[0] == "tracks.triangular.belt.thickness,cold_nm,warm_nm,belt_degc,kwh_per_km,beyond_data"
    assert lines[3] == "5.0,,,,,"


def test_a_sweep_over_the_air_says_so(good):
    words = "sweep", "agri3t", "--vary", "chassis.ambient=0,20"
    assert "air as varied" in good(*words)
    told = json.loads(good(*words, "--json"))
    assert told["ambient_degc"] is None
    assert told["columns"]["cold_nm"][0] > told["columns"]["cold_nm"][1]


@pytest.mark.parametrize("words", [("--ambient-degc", "-10,30"), ("--ambient-degc=-10,30",)])
def test_several_air_temperatures_are_rows_of_a_sweep(good, words):
    """As if varied, and with a drive in that air; one alone is a condition."""
    swept = json.loads(good("sweep", "agri3t", *words, "--cycle", "laps", "--json"))
    assert swept["ambient_degc"] is None
    columns = swept["columns"]
    assert columns["chassis.ambient"] == [-10.0, 30.0]
    for row, air in enumerate((-10, 30)):
        alone = json.loads(
            good("sweep", "agri3t", "--vary", "belt.width=+0%", "--ambient-degc", air, "--cycle", "laps", "--json")
        )
        assert alone["ambient_degc"] == air
        for outcome in ("cold_nm", "warm_nm", "belt_degc", "kwh_per_km", "drive_kwh_per_km"):
            assert alone["columns"][outcome][0] == columns[outcome][row]


@pytest.mark.parametrize(
    ("words", "part"),
    [
        ((), "several --ambient-degc"),
        (("--ambient-degc", "-10"), "several --ambient-degc"),
        (("--ambient-degc", "-100,3"), "numbers from -60 to 60"),
        (("--vary", "chassis.ambient=1,2", "--ambient-degc", "-10,30"), "each value once"),
        (("--vary", "chassis.ambient=1,2", "--ambient-degc", "-10"), "leave out --ambient-degc"),
    ],
)
def test_a_sweep_without_a_varied_value_is_refused(refused, words, part):
    assert part in refused("sweep", "agri3t", *words)


def test_the_command_says_what_to_measure_first(good, tmp_path, vary):
    pytest.importorskip("matplotlib")
    vary("rubber.loss_modulus_scale", "chassis.bearing_friction", "rubber.density")
    found = sensing.sensitivity("agri3t", 2.5, AIR, 16, 2)
    text = found.text("warm_nm")
    of = found.indices["warm_nm"]
    first, second = sorted(of, key=lambda path: -abs(of[path].high - of[path].low))
    assert f"Measure {first} first, then {second}." in text or f"Measure {first} or {second} first" in text
    assert "rubber.density: it moves nothing" in text
    assert json.loads(json.dumps(found.as_dict()))["drawn"] == 16 * 4
    assert sensing.draw_tornado(found, "warm_nm", tmp_path / "t.png").stat().st_size > 10000
    apart = replace(found.indices["warm_nm"][first], total=0.9, total_pm=0.01)
    settled = replace(found, indices={**found.indices, "warm_nm": {**found.indices["warm_nm"], first: apart}})
    assert f"Measure {first} first, then {second}." in settled.text("warm_nm")
    with pytest.raises(tr.InputError, match="power of two"):
        sensing.sensitivity("agri3t", 2.5, AIR, 12)


def test_one_value_with_a_range_is_measured_and_none_is_refused(vary):
    vary("rubber.loss_modulus_scale")
    found = sensing.sensitivity("agri3t", 2.5, AIR, 8)
    assert "Measure rubber.loss_modulus_scale: no other value with a range moves it." in found.text("warm_nm")
    vary()
    with pytest.raises(tr.InputError, match="no value with a range"):
        sensing.sensitivity("agri3t", 2.5, AIR, 8)


def test_design_commands_name_effects_that_they_leave_out(monkeypatch, tmp_path, vary):
    files = {}
    for name in ("agri3t", "bmw_i3"):
        effects = {"turning_scrub": {"friction": 0.5}, "drivetrain_drag": {"drag": {"value": 10.0, "range": [0.0, 20.0]}}}
        files[name] = tmp_path / f"{name}.yaml"
        files[name].write_text(yaml.safe_dump({**read_yaml(find_vehicle(name)), "effects": effects}))
    tracks, wheels = str(files["agri3t"]), (str(files["bmw_i3"]), "bmw_i3")
    for module in ("sweep", "sensitivity"):  # the numbers do not matter here
        monkeypatch.setattr(
            f"trackres_ros.tools.design.{module}.steady", lambda v, *_: Steady(*[v.rubber.loss_modulus_scale] * 4)
        )
    (tmp_path / "drive.csv").write_text("time_s,speed_kmh,torque_nm\n0,9,1\n9,9,1\n")
    for cycle, on in ((None, []), (str(tmp_path / "drive.csv"), ["not torque", Reason.EFFECT_LEFT_OUT.text])):
        swept = sweep(SweepRequest(tracks, (variation(load(tracks), "bearing_friction=0.01,0.02"),), 2.5, AIR, cycle))
        assert swept.as_dict()["effects_left_out"] == ["turning_scrub"]
        assert swept.text().splitlines()[-1].startswith("turning_scrub: inactive")
        assert all(note.endswith(end) for note, end in zip(swept.as_dict()["notes"], on, strict=True))
        assert all(f"drive: {note}\n" in swept.text() for note in swept.notes)
        assert Reason.EFFECT_LEFT_OUT.text not in str(swept.remarks)
        assert "; effects that warm up are warm in both\n" in swept.text()
    assert f"turning_scrub of {wheels[0]}: inactive" in wheels_text(wheels_compared(wheels), wheels)
    vary("rubber.loss_modulus_scale")
    held = sensing.sensitivity(tracks, 2.5, AIR, 8).fixed
    assert held["effects.drivetrain_drag"] == "the size of an effect is taken as known"
    assert "inactive" in held["effects.turning_scrub"]


@pytest.mark.parametrize(
    "words",
    [("sweep", "agri3t", "--vary", "loss_modulus_scale=0.8,1.2"), ("explain", "--vehicle", "agri3t", "--belt-degc", "20")],
)
def test_a_vehicle_is_no_faster_than_it_is(refused, good, words):
    shown = refused(*words, "--speed-kmh", "100")
    assert "speed: given '100 km/h'; allowed: up to 1.2 times the vehicle file's max_speed, 18.144 km/h" in shown
    if words[0] == "sweep":
        fastest = load("agri3t").chassis.max_speed
        assert json.loads(good(*words, "--json"))["speed_mps"] == fastest
