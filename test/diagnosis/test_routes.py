# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What goes by place is found by positions, told for a slope where it is one, and nothing is found on a route driven once."""

import json
from dataclasses import replace

import numpy as np
import pytest
from streets import LAP_M, autoregression, drive, learned_by, position_of, slope_at

import trackres_ros as tr
from trackres_ros.diagnosis import load_base, read_recordings
from trackres_ros.diagnosis.base.base import Acting
from trackres_ros.diagnosis.base.patterns import SlopeByPlace, TorqueByPlace
from trackres_ros.diagnosis.empirical.routes import find_route, roads_of
from trackres_ros.diagnosis.inference.fitting import Problem, fit
from trackres_ros.diagnosis.preparation import checked_sessions
from trackres_ros.diagnosis.prepare.gate import gate, on_route
from trackres_ros.diagnosis.prepare.session import DriveSession
from trackres_ros.effects import Active
from trackres_ros.effects.sensor.delay import Delay
from trackres_ros.estimator import columns as at
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.records import GroundSeries
from trackres_ros.files.resources import config_dir
from trackres_ros.recording.bindings import Topics
from trackres_ros.route.learned import SLOPE, TORQUE, of_kind
from trackres_ros.tasks.diagnose import PICTURES
from trackres_ros.vehicle import load_any, with_surroundings
from trackres_ros.vehicle.surroundings import load_route

BUS = config_dir().parents[1] / "shared/data/real/ztbus/B183_2021-10-05_13-53-20.csv.gz"
LOADS = (1.0, 1.2, 0.9, 1.1)


@pytest.fixture(scope="module")
def base():
    return load_base("ztbus_hess19").base


def session_of(base, seed, rounds, slope=0.0, soft_nm=0.0, loads=(1.0,), with_positions=True, noise_nm=150.0, wanders_nm=0.0):
    """A drive round the block with a slope that is not recorded, or with soft ground on a part of it."""
    item, rng = drive(seed, rounds), np.random.default_rng(seed + 50)
    n = len(item.speed)
    nan = np.full(n, np.nan)
    latitude, longitude = position_of(item) if with_positions else (nan, nan)
    load = np.array(loads)[np.arange(n) * len(loads) // n]
    made = DriveSession(
        "round", 1.0, np.arange(n, dtype=float), item.speed, np.gradient(item.speed), base.facts.weight * load, np.full(n, 15.0),
        slope * slope_at(item.way) * item.direction, nan, nan, item.distance, nan, nan, item.speed > 1.0,
        (item.distance // LAP_M).astype(np.int64), given=frozenset({"grade", "load", "position"}), latitude=latitude,
        longitude=longitude,
    )  # fmt: skip
    torque = base.predict([made], base.nominal, ())[0].torque + soft_nm * ((item.way > 600.0) & (item.way < 1000.0))
    torque = (
        torque + autoregression(n, rng, 3.0, noise_nm) + rng.normal(0.0, noise_nm, n) + autoregression(n, rng, 150.0, wanders_nm)
    )
    given_values = frozenset({"load", "position"})
    return DriveSession(**{**made.__dict__, "torque": torque, "grade": np.zeros(n), "given": given_values}), item


def found_in(base, session, fitted_rounds):
    mask = session.used & (session.block < fitted_rounds)
    current = fit(Problem(base, (session,), (mask,)))
    roads = roads_of((session,))
    return current, None if roads is None else find_route(current, roads)


def test_a_two_way_street_slope_is_found_and_holds_on_new_laps(base):
    session, _ = session_of(base, 0, (1, -1, 1, -1, 1), slope=1.0)
    current, route = found_in(base, session, 4)
    assert route is not None
    assert route.is_slope
    assert isinstance(route.effect, SlopeByPlace)
    held = session.used & (session.block == 4)
    result_before, result_after = (np.abs(session.torque - f.predicted[0].torque)[held].mean() for f in (current, route.fit))
    assert result_after < 0.4 * result_before
    assert route.pattern.metres == pytest.approx(LAP_M, rel=0.4)
    learned_values = route.learned(route.fit)
    assert np.array_equal(learned_values.value[:, 0], -learned_values.value[:, 1], equal_nan=True)


def test_different_loads_identify_a_slope_on_one_way_streets(base):
    session, _ = session_of(base, 3, (1, 1, 1, 1), slope=1.0, loads=LOADS)
    _, route = found_in(base, session, 4)
    assert route is not None
    assert route.is_slope
    assert "one way" not in route.effect.text
    learned_values, final = route.effect.route, route.fit
    assert abs(np.nanmean(learned_values.value[:, 0])) < 0.002  # a closed loop has no rise
    assert abs(final.base_values["rolling_coefficient"] - base.nominal["rolling_coefficient"]) < 0.002


def test_on_an_open_one_way_road_the_std_has_the_unknown_mean(base):
    """And no sample without a known place teaches a mean that the road has not."""
    session, item = session_of(base, 7, (1, 1, 1), slope=1.0, loads=LOADS)
    current, roads = fit(Problem(base, (session,), (session.used,))), roads_of((session,))
    roads = replace(roads, streets=replace(roads.streets, closed_loops=roads.streets.closed_loops[:0]))
    effect = find_route(current, roads).effect
    learned_values = effect.route
    at, way = (
        learned_values.frame.metres(learned_values.latitude, learned_values.longitude),
        learned_values.frame.metres(*position_of(item)),
    )
    near = np.argmin(np.hypot(*(np.subtract.outer(x, value) for x, value in zip(at, way, strict=True))), axis=1)
    error, std = learned_values.value[:, 0] - slope_at(item.way[near]), learned_values.std[:, 0]
    assert abs(np.nanmean(error)) < np.nanmedian(std)
    assert 0.0015 < np.nanmedian(std) < 0.004  # as of the rolling coefficient in the vehicle file
    assert np.sqrt(np.nanmean((error / std) ** 2)) < 2.0
    assert effect.text.endswith("on a road driven one way, all may be 0.6 % off")


def test_soft_ground_on_streets_passed_both_ways_is_no_slope(base):
    session, item = session_of(base, 4, (1, -1, 1, -1), soft_nm=2500.0, loads=(1.0,))
    _, route = found_in(base, session, 4)
    assert route is not None
    assert not route.is_slope
    assert route.pattern.slope_gain < 0.0
    assert isinstance(route.effect, TorqueByPlace)
    adds = route.fit.contribution("place")[0]
    soft = (item.way > 650.0) & (item.way < 950.0) & session.used
    level = (item.way > 1150.0) & session.used
    assert adds[soft].mean() - adds[level].mean() == pytest.approx(2500.0, rel=0.25)


def test_one_way_and_one_load_do_not_tell_a_slope(base):
    session, _ = session_of(base, 5, (1, 1, 1, 1), slope=1.0)
    _, route = found_in(base, session, 4)
    assert route is not None
    assert not route.is_slope
    assert isinstance(route.effect, TorqueByPlace)  # which says nothing of the way that was not driven
    assert np.isnan(route.effect.route.value).any(axis=1).mean() > 0.9


def test_what_is_known_by_place_is_not_looked_for_again(base):
    hills, _ = session_of(base, 3, (1, -1, 1, -1), slope=1.0)
    soft, _ = session_of(base, 4, (1, -1, 1, -1), soft_nm=2500.0)
    one_way, _ = session_of(base, 5, (1, 1, 1, 1), slope=1.0)
    for session, kinds in ((hills, (TORQUE,)), (soft, (SLOPE,)), (one_way, (TORQUE,)), (one_way, (SLOPE,))):
        current = fit(Problem(base, (session,), (session.used,)))
        assert find_route(current, roads_of((session,)), kinds) is None, kinds


NOTHING = {
    "a route driven once": {"rounds": (1,), "slope": 1.0},
    "a street driven there and back in part": {"rounds": (1,), "slope": 1.0, "wanders_nm": 300.0},
    "noise": {"rounds": (1, -1, 1)},
    "a torque that wanders": {"rounds": (1, 1, 1), "wanders_nm": 600.0},
    "a torque that wanders, both ways": {"rounds": (1, -1, 1, -1), "wanders_nm": 600.0},
    "no position": {"rounds": (1, 1, 1), "slope": 1.0, "with_positions": False},
}


@pytest.mark.parametrize("kind", NOTHING)
def test_nothing_is_found(base, kind):
    for seed in range(1 if kind == "no position" else 2):
        session, _ = session_of(base, 10 + seed, **NOTHING[kind])
        assert found_in(base, session, len(NOTHING[kind]["rounds"]))[1] is None, seed


def as_table(path, session, one):
    """A recording of a drive, without its slope."""
    latitude, longitude = np.degrees(position_of(one))
    air, brake_off = np.full(len(session), 15.0), np.zeros(len(session))
    rows = np.column_stack(
        [1.76e9 + session.time, session.speed, session.weight, air, session.torque, latitude, longitude, brake_off]
    )
    header = "time_s,speed_mps,weight_n,ambient_degc,torque_nm,latitude_deg,longitude_deg,brake_on"
    np.savetxt(path, rows, delimiter=",", header=header, comments="", fmt="%.8f")
    return path


@pytest.fixture(scope="module")
def diagnose(run):
    """The report of `trackres diagnose`."""

    def report_of(recording, out, vehicle="ztbus_hess19", surroundings=None, page=False):
        given_values = ("--surroundings", surroundings) if surroundings else ()
        process = run([recording], out, *given_values, page=page, vehicle=vehicle)
        assert process.exit_code == 0, process.output
        return json.loads((out / "report.json").read_text())

    return report_of


ROUNDS = (1, -1, 1, -1, 1, -1, 1, -1)


@pytest.fixture(scope="module")
def hilly(base, tmp_path_factory):
    """A table of rounds with a slope that is not recorded."""
    return as_table(tmp_path_factory.mktemp("hilly") / "rounds.csv", *session_of(base, 21, ROUNDS, slope=1.0))


@pytest.fixture(scope="module")
def diagnosed(hilly, diagnose, tmp_path_factory):
    output = tmp_path_factory.mktemp("diagnosed")
    diagnose(hilly, output, page=True)
    return output


@pytest.fixture(scope="module")
def soft(base, diagnose, tmp_path_factory):
    """A table of rounds over soft ground, and what a diagnosis leaves of it."""
    made = session_of(base, 22, ROUNDS, soft_nm=2500.0)
    folder = tmp_path_factory.mktemp("soft")
    path = as_table(folder / "rounds.csv", *made)
    return *made, path, folder, diagnose(path, folder / "out")


def test_the_diagnosis_names_it_and_draws_it(diagnosed):
    report = json.loads((diagnosed / "report.json").read_text())
    assert report["verdict"]["status"] == "named"
    assert report["effects"][0]["name"] == "grade"
    assert report["effects"][0]["grade"] == "confirmed"
    assert report["heldout"]["mae"]["with_effects"] < 0.5 * report["heldout"]["mae"]["refitted"]
    assert report["route"]["kind"] == "slope"
    assert report["route"]["passes"] > 2
    assert (diagnosed / "route.svg").is_file()
    assert {file for name in PICTURES for file in diagnosed.glob(name)} == set(diagnosed.glob("*.svg"))
    assert "By place" in (diagnosed / "report.html").read_text()


def test_the_slopes_are_written_for_where_they_hold(diagnosed):
    report = json.loads((diagnosed / "report.json").read_text())
    assert report["kept"]["surroundings"] == ["grade"]
    assert "grade" in report["written"]["effects"]
    (route,) = load_route(diagnosed / "surroundings.yaml", 1e5)
    item = drive(21, (1,), scatter_m=0.0)
    x, y = route.frame.metres(*position_of(item))
    slope = learned_by(route)
    result = np.array([slope(*entry)[0] for entry in zip(x[:-1], y[:-1], *unit(np.diff(x), np.diff(y)), strict=True)])
    known = np.isfinite(result) & (item.speed[:-1] > 2.0)
    assert known.mean() > 0.7
    assert np.abs(result - slope_at(item.way[:-1]))[known].mean() < 0.006


def unit(east, north):
    length = np.maximum(np.hypot(east, north), 1e-9)
    return east / length, north / length


def test_a_route_that_is_given_is_taken_as_recorded(hilly, diagnosed):
    given_values = load_base(diagnosed / "vehicle.yaml", surroundings=diagnosed / "surroundings.yaml")
    passed = gate(read_recordings([hilly], None), given_values.known)
    gate_result = on_route(passed, given_values.route)
    session = gate_result.sessions[0]
    lost = (passed.sessions[0].used & ~session.used).sum() * session.step
    assert sum(gate_result.exclusions.values()) - sum(passed.exclusions.values()) == round(lost) > 0
    assert "grade" in session.given
    assert any("of it is on the route" in note for note in gate_result.notes)
    level = replace(session, grade=np.zeros(len(session)))
    errors = [
        np.abs(s.torque - given_values.base.predict([s], given_values.base.nominal, ())[0].torque)[s.used].mean()
        for s in (session, level)
    ]
    assert errors[0] < 0.5 * errors[1]


def test_a_route_elsewhere_is_not_used(hilly, diagnosed):
    given_values = load_base(diagnosed / "vehicle.yaml", surroundings=diagnosed / "surroundings.yaml")
    distance = replace(given_values.route[0], latitude=given_values.route[0].latitude + 0.001)
    gate_result = on_route(gate(read_recordings([hilly], None), given_values.known), [distance])
    assert "grade" not in gate_result.sessions[0].given
    assert gate_result.notes[-1].endswith("0 % of it is on the route with known slopes; they are not used")


def test_soft_ground_is_described_confirmed_and_written_each_way(soft):
    _, _, _, folder, report = soft
    assert report["verdict"]["status"] == "described"
    (term,) = report["described"]
    assert (term["form"], term["grade"], term["predictable"]) == ("place", "confirmed", True)
    assert report["kept"]["surroundings"] == ["place"]
    assert "place" in report["written"]["effects"]
    (route,) = load_route(folder / "out" / "surroundings.yaml", 1e5)
    assert route.kind == TORQUE
    x, y = route.frame.metres(*position_of(drive(22, (1,), scatter_m=0.0)))
    way, learned_values = drive(22, (1,), scatter_m=0.0).way[:-1], learned_by(route)
    for sign in (1.0, -1.0):
        headings = (sign * part for part in unit(np.diff(x), np.diff(y)))
        at = [learned_values(*place) for place in zip(x[:-1], y[:-1], *headings, strict=True)]
        value, std = np.array(at).T
        on_it, deviation = (way > 650.0) & (way < 950.0), (way > 1150.0) | (way < 500.0)
        assert np.nanmedian(value[on_it]) - np.nanmedian(value[deviation]) == pytest.approx(2500.0, rel=0.25)
        assert 20.0 < np.nanmedian(std) < 600.0


def test_with_its_written_files_a_rerun_finds_nothing_new(soft, diagnose):
    _, _, path, folder, report = soft
    output = folder / "out"
    repetition = diagnose(path, folder / "again", output / "vehicle.yaml", output / "surroundings.yaml")
    assert repetition["route"] is None
    assert not [*repetition["effects"], *repetition["described"]], repetition["verdict"]["sentence"]
    # The base keeps the file's values, as its re-fit alone, without the places, would be worse on held-out rounds.
    assert report["written"]["base"] is False
    assert repetition["heldout"]["mae"]["nominal"] < 1.2 * report["heldout"]["mae"]["with_effects"]
    assert repetition["heldout"]["mae"]["nominal"] < 0.7 * report["heldout"]["mae"]["nominal"]
    written, kept = (load_route(folder / name / "surroundings.yaml", 1e5)[0] for name in ("out", "again"))
    np.testing.assert_array_equal(written.value, kept.value)  # what was given is written on


def test_given_the_slope_the_torque_is_found_and_written_with_it(base, diagnosed, diagnose, tmp_path):
    """Of the block's slope from elsewhere, and rounds that have soft ground too."""
    path = as_table(tmp_path / "rounds.csv", *session_of(base, 23, ROUNDS, slope=1.0, soft_nm=2500.0))
    report = diagnose(path, tmp_path / "out", diagnosed / "vehicle.yaml", diagnosed / "surroundings.yaml")
    assert report["route"]["kind"] == "torque"
    assert "grade" not in [effect["name"] for effect in report["effects"]]
    (given_values,), result = (load_route(folder / "surroundings.yaml", 1e5) for folder in (diagnosed, tmp_path / "out"))
    np.testing.assert_array_equal(of_kind(result, SLOPE).value, given_values.value)
    soft = of_kind(result, TORQUE).value
    assert np.nanmax(soft) - np.nanmedian(soft) == pytest.approx(2500.0, rel=0.3)
    errors = []
    for folder in (diagnosed, tmp_path / "out"):
        given_values = load_base(folder / "vehicle.yaml", surroundings=folder / "surroundings.yaml")
        gate_result, expectation, _ = checked_sessions(read_recordings([path], None), given_values)
        errors.append(np.abs(gate_result.sessions[0].torque - expectation[0])[gate_result.sessions[0].used].mean())
    assert errors[1] < 0.8 * errors[0]


def test_spells_on_a_hilly_route_are_beside_the_slopes(base, diagnose, tmp_path):
    """A live watch sees the torque that the written slopes leave, so its levels have none of them."""
    session, item = session_of(base, 21, (*ROUNDS, 1, -1), slope=1.0)
    lengths = np.random.default_rng(21).uniform(50.0, 150.0, 100).astype(int)
    on = np.repeat(np.arange(100) % 2, lengths)[: len(session)]
    path = as_table(tmp_path / "rounds.csv", replace(session, torque=session.torque + 1500.0 * on * (session.speed > 0.5)), item)
    report = diagnose(path, tmp_path / "out")
    assert report["kept"]["surroundings"] == ["grade"]
    spells = load_any(tmp_path / "out" / "vehicle.yaml").disturbance
    assert spells.level - spells.rest == pytest.approx(1500.0, rel=0.2)
    assert spells.noise < 0.3 * 1500.0


def expected_live(vehicle, sessions):
    """What the torque sensor would show by the live step, of sessions that begin soaked."""
    estimator = Estimator(vehicle)
    late = Acting.of([Active(Delay(), {"time": vehicle.values["torque_delay"]})], vehicle.constants)
    results = []
    for session in sessions:
        begin = estimator.cold_start(estimator.inputs(float(session.speed[0]), ambient=float(session.ambient[0])))
        unknown = np.full(len(session), np.nan)
        _, rows = estimator.run(
            begin, session.time, session.speed, session.weight, session.ambient, session.accel, session.grade, session.yaw_rate,
            session.heading, ground=GroundSeries(unknown, session.torque_by_place, unknown, np.ones_like(unknown)),
        )  # fmt: skip
        results.append(vehicle.values["torque_scale"] * late.sensor_torque(rows[:, at.Results.drive_torque_nm], session))
    return results


def test_live_errs_as_the_diagnosis_reports(hilly, diagnosed):
    files = diagnosed / "vehicle.yaml", diagnosed / "surroundings.yaml"
    result = tr.diagnose(hilly, files[0], surroundings=files[1], quick=True)
    repetition, sessions = result.diagnosis, result.diagnosis.gated.sessions
    assert [value.kind for value in result.vehicle.route] == [SLOPE]  # a vehicle in the given surroundings
    shown = expected_live(with_surroundings(load_any(files[0]), files[1]), sessions)
    errors = [np.abs(s.torque - value)[repetition.split.held_out_mask(s)] for s, value in zip(sessions, shown, strict=True)]
    assert np.concatenate(errors).mean() == pytest.approx(repetition.held_out.mae["nominal"], rel=1e-9)


def test_a_replay_follows_the_slopes_that_were_written(hilly, diagnosed, good, tmp_path):
    """By the commands, from positions alone: the surroundings take most of the error off."""
    errors = {}
    for name, around in (("without", ()), ("with", ("--surroundings", diagnosed / "surroundings.yaml"))):
        good("replay", hilly, "--vehicle", diagnosed / "vehicle.yaml", *around, "-o", tmp_path / "r.csv")
        rows = np.genfromtxt(tmp_path / "r.csv", delimiter=",", names=True)
        moves = rows["speed_mps"] > 1.0
        errors[name] = np.nanmean(np.abs(rows["residual_nm"][moves]))
    assert errors["with"] < 0.6 * errors["without"]


@pytest.mark.skipif(not BUS.is_file(), reason="no recording of the bus")
def test_on_a_bus_live_expects_what_the_diagnosis_does():
    known = load_base("ztbus_hess19")
    gate_result = gate(read_recordings([BUS], Topics.load("ztbus")), known.known)
    (expectation,) = known.base.predict(gate_result.sessions, known.base.nominal, ())
    (shown,) = expected_live(known.base.vehicle, gate_result.sessions)
    np.testing.assert_allclose(shown, expectation.torque, rtol=0.0, atol=1e-9)
    (session,) = gate_result.sessions
    errors = [np.abs(session.torque - item)[session.used].mean() for item in (shown, expectation.torque)]
    assert errors[0] == pytest.approx(errors[1], rel=1e-12)
