# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Programs of physics that no catalogue has, the drives they are hidden in, and the instruments of each case."""

import json
from collections import Counter
from dataclasses import asdict, replace
from itertools import groupby
from pathlib import Path

import numpy as np
import pytest

from proofs.sealed.cases import CATALOGUE, D_PRIME, LEAST, RECORDED, SOURCES, Case, draw_cases, sensors_of, sized
from proofs.sealed.drives import HARDEST_MPS2, SealedDrive, drive, read_profiles, recorded, trapezoids
from proofs.sealed.own import is_true
from proofs.sealed.phenomena import (
    ENTRIES,
    FUNCTIONS,
    KINDS,
    MEMORIES,
    PROGRAM,
    TURNS,
    VARIABLES,
    WINDING_S,
    Journey,
    Seen,
    draw_program,
)
from proofs.sealed.recordings import AIRS_DEGC, EVERY, _drives, _kept, means
from proofs.sealed.truth import MOST_GAIN, MOST_LAG_S, MOST_OFFSET_NM, Build, Sensors, TruthRun, lagging, record, simulate_truth
from trackres_ros.files.resources import find_vehicle

SHEET = find_vehicle("xgd24d")
REAL = Path(__file__).resolve().parents[3] / "shared" / "data" / "real"
STOPS_S = 60.0  # of a steady drive with stops, its standing time
EVERY_SEED = range(600)


@pytest.fixture(scope="module")
def one(sheet):
    return drive(6.0, sheet["weight"], 15.0, 14.0, np.random.default_rng(2))


def steady(sheet, speed, load=1.0, minutes=15.0, yaw_rate=0.0, stops=()):
    """A drive at one speed, but for stops that begin at some times [s]."""
    n = int(minutes * 600)
    time, speeds = np.arange(n) * 0.1, np.full(n, speed)
    speeds[:50] = 0.0
    for begin in stops:
        speeds[(time >= begin) & (time < begin + STOPS_S)] = 0.0
    turning = np.full(n, yaw_rate) * (speeds > 0.0)
    return SealedDrive(
        0.1, speeds, np.gradient(speeds, 0.1), turning, np.cumsum(turning) * 0.1,
        np.full(n, load * sheet["weight"]), np.full(n, 15.0),
    )  # fmt: skip


def seen(sheet, one, driven=0.0):
    return Seen(Journey(sheet, one, driven), 20.0 + 0.02 * np.arange(len(one)) * 0.1, 2500.0 + 8000.0 * one.accel)


def hidden(entry, size=1.0, memory=None):
    """The first program with an entry point, and with a memory where one is given."""
    results = (draw_program(seed) for seed in EVERY_SEED)
    program = next(
        p for p in results if p.entry == entry and p.kind is None and p.gate is None and memory in (None, p.description["memory"])
    )
    return {PROGRAM: {"seed": float(program.seed), "size": size}}


def test_every_part_is_drawn():
    every = [draw_program(seed).description for seed in EVERY_SEED]
    assert {d["kind"] for d in every} == {None, *KINDS}
    texts = [d for d in every if d["kind"] is None]
    assert {d["entry"] for d in texts} == set(ENTRIES)
    assert {name for d in texts for name in d["variables"]} == set(VARIABLES)
    assert {name for d in texts for name in d["functions"]} == set(FUNCTIONS)
    assert {d["memory"] for d in texts} == {None, *MEMORIES}
    assert {len(d["variables"]) for d in texts} == {1, 2}
    assert not any(d["gate"] in d["variables"] for d in texts)
    assert len({d["words"] for d in texts}) > 0.95 * len(texts)  # hardly any comes twice
    assert json.loads(json.dumps(every)) == every


def test_a_seed_gives_one_program_and_each_drive_its_own_chance(sheet, one):
    for seed in range(60):
        first, repetition, later = (draw_program(seed).series(seen(sheet, one, driven)) for driven in (0.0, 0.0, 5000.0))
        np.testing.assert_array_equal(first, repetition)
        assert np.isfinite(first).all()
        assert np.abs(first).max() < 6.0
        if np.abs(first).max() > 0.0:
            assert np.abs(first - later).max() > 0.0


def test_a_description_names_what_the_program_follows(sheet, one):
    """A program stays as it is when a variable changes that it does not name."""
    for seed in range(60):
        program = draw_program(seed)
        journey = seen(sheet, one)
        warm = Seen(journey.at, journey.belt + 9.0, journey.torque)
        named = {*program.description["variables"], program.description["gate"]}
        changed = np.abs(program.series(warm) - program.series(journey)).max() > 0.0
        assert "belt temperature" in named or not changed, program.words


@pytest.mark.parametrize("entry", ENTRIES)
def test_a_program_acts_at_its_entry_point_alone(sheet, one, entry):
    plain = simulate_truth(SHEET, Build(), {}, [one])[0]
    run = simulate_truth(SHEET, Build(), hidden(entry), [one])[0]
    heats = np.abs(run.belt - plain.belt).max() > 0.0
    turns = np.abs(run.torque - plain.torque).max() > 0.0
    assert np.abs(run.shown - plain.shown).max() > 0.0
    assert heats == (entry in ("loss", "heat", "cooling"))
    assert turns == (entry != "sensor")
    np.testing.assert_allclose(run.added[PROGRAM], run.shown - plain.shown, atol=1e-9)


def test_an_integrator_is_reset_and_a_latch_has_two_thresholds(sheet):
    rng = np.random.default_rng(0)
    journey = Journey(sheet, steady(sheet, 5.0, stops=(600.0,)), 0.0)
    total = MEMORIES["integrator"][2](np.ones(9000), journey, rng, 0.0, 1.0, np.log(100.0))
    assert total[5990] == pytest.approx(1.0)
    assert total[6200] < 0.01
    up_and_down = np.concatenate((np.linspace(0.0, 1.0, 4500), np.linspace(1.0, 0.0, 4500)))
    state = MEMORIES["latch"][2](up_and_down, journey, rng, 0.6, 0.3) > 0.5
    assert up_and_down[np.argmax(state)] == pytest.approx(0.6, abs=0.01)
    assert up_and_down[9000 - np.argmax(state[::-1])] == pytest.approx(0.3, abs=0.01)


def test_sizes_make_programs_as_plain_as_was_drawn():
    for case in draw_cases({"outside": 6}, 5):
        drives = _drives(case, 6.0, "drive")
        result = sized(case, SHEET, drives)
        q = result.hidden[PROGRAM]
        assert q == sized(case, SHEET, drives).hidden[PROGRAM]
        assert result.program == draw_program(int(q["seed"])).description
        largest = ENTRIES[result.program["entry"]].largest
        as_drawn = q["d_prime"] == pytest.approx(case.hidden[PROGRAM]["d_prime"], rel=0.2)
        assert as_drawn or q["size"] == pytest.approx(largest)
        assert LEAST <= q["d_prime"] < 1.2 * D_PRIME[1]


def test_an_undetectable_kind_gives_way_to_another(sheet, one):
    """Without a long stop no parking brake drags. A winding, which is seen, stays one."""
    for name, stays in (("parking brake", False), ("winding", True)):
        hidden = {PROGRAM: {"seed": float(TURNS.index(name)), "d_prime": 60.0}}
        result = sized(Case("a", "outside", hidden, asdict(Build()), False, False, False, True, 4), SHEET, [one])
        assert (result.program["kind"] == name) == stays
        assert result.hidden[PROGRAM]["d_prime"] >= LEAST


def test_each_source_is_drawn_the_last_only_with_speeds_given():
    assert set(Counter(case.source for case in draw_cases({"single": 60}, 3))) == set(SOURCES[:-1])
    assert set(Counter(case.source for case in draw_cases({"outside": 60}, 3, SOURCES))) == set(SOURCES)


@pytest.mark.parametrize("source", SOURCES)
def test_each_source_draws_drives_within_the_vehicles_limits(source):
    rough = np.repeat([0.0, 30.0, 8.0, 0.0], 900) + 0.0
    profiles = [np.convolve(rough, np.full(150, 1.0 / 150.0), mode="same")]
    profiles[0][[0, -1]] = 0.0
    case = Case("a", "single", {}, {}, False, False, False, True, 4, source)
    made, repetition = (_drives(case, 5.0, "drive", profiles) for _ in range(2))
    assert sorted(float(round(value.ambient[0])) for value in made) == sorted(AIRS_DEGC)
    for value, same in zip(made, repetition, strict=True):
        np.testing.assert_array_equal(value.speed, same.speed)
        assert len(value) == len(value.weight) == len(value.yaw_rate) == 3000
        assert value.speed.min() >= 0.0
        assert 3.0 < value.speed.max() < 17.0
        assert np.abs(value.accel).max() < 1.1 * HARDEST_MPS2
        assert np.abs(value.yaw_rate).max() > 0.01
        assert value.street is None


def test_trapezoids_hold_speeds_and_stop(sheet):
    item = trapezoids(15.0, sheet["weight"], 15.0, 14.0, np.random.default_rng(1))
    assert (np.abs(np.diff(item.speed)) < 1e-9).mean() > 0.5
    assert (np.diff((item.speed > 0.0).astype(int)) == 1).sum() >= 4


def test_recorded_speeds_of_real_vehicles_are_driven(sheet, tmp_path):
    if not REAL.is_dir():
        pytest.skip("no recordings of real vehicles here")
    for name in ("bmw_i3/TripA01.csv.gz", "bmw_i3/TripB17.csv.gz"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).symlink_to(REAL / name)
    profiles = read_profiles(tmp_path)
    made = recorded(15.0, sheet["weight"], 15.0, 16.7, profiles, np.random.default_rng(1))
    assert len(made) == 9000
    assert made.speed.max() <= 16.7
    assert 0.01 < (made.speed < 0.1).mean() < 0.6


def test_instruments_are_good_and_none_is_perfect():
    kinds = [sensors_of(case) for case in draw_cases({"none": 30, "single": 30}, 9)]
    assert all(0.0 < s.torque_lag_s <= MOST_LAG_S for s in kinds)
    assert all(0.0 < abs(s.torque_offset_nm) <= MOST_OFFSET_NM for s in kinds)
    assert all(0.0 < abs(s.torque_gain - 1.0) <= MOST_GAIN for s in kinds)
    assert all(0.02 <= s.speed_step_mps <= 0.05 for s in kinds)
    rng = np.random.default_rng(1)
    least_hidden = min(CATALOGUE["delay"](rng, 1.0)["time"] for _ in range(200))
    assert least_hidden > MOST_LAG_S


@pytest.mark.parametrize("seconds", [0.0, 1e-5, 0.02, 0.1])
def test_a_lag_shifts_a_ramp_by_its_time_and_leaves_a_level(seconds):
    time = np.arange(200) * 0.1
    np.testing.assert_allclose(lagging(3.0 * time, seconds, 0.1)[50:], 3.0 * (time[50:] - seconds), atol=1e-4)
    np.testing.assert_allclose(lagging(np.full(50, 7.0), seconds, 0.1), 7.0)


def test_the_recording_has_the_instruments_gain_and_offset(sheet, tmp_path):
    item = steady(sheet, 5.0, minutes=1.0)
    shown = np.linspace(0.0, 8000.0, len(item))
    still = np.full(len(item), 15.0)
    good = {"torque_nm": 0.0, "torque_share": 0.0, "torque_step_nm": 0.01, "road": 0.0, "dropouts": 0.0}
    sensors = Sensors(**good, torque_lag_s=0.05, torque_offset_nm=12.0, torque_gain=1.004)
    run = TruthRun(shown, shown, still, {}, item.weight)
    record(tmp_path / "a.csv", item, run, sensors, 0.36, 1.7e9, np.random.default_rng(1))
    torque = np.genfromtxt(tmp_path / "a.csv", delimiter=",", names=True)["torque_nm"]
    even = item.accel == 0.0  # the sensor's noise grows with the acceleration
    expectation = 1.004 * (shown - 0.05 * (shown[1] - shown[0]) / 0.1) + 12.0
    np.testing.assert_allclose(torque[even][20:], expectation[even][20:], atol=0.02)


def test_means_over_a_fits_steps():
    series = np.arange(25.0)
    np.testing.assert_allclose(means(series), [4.5, 14.5, 22.0])
    assert EVERY == 10


def of_kind(name, size=1.0):
    seed = TURNS.index(name)
    return draw_program(seed), {PROGRAM: {"seed": float(seed), "size": size}}


def test_kinds_and_drawn_programs_come_in_turn_on_all_drives():
    cases = sorted(draw_cases({"outside": 24}, 3, SOURCES), key=lambda case: case.program["kind"] or "")
    assert Counter(case.program["kind"] for case in cases) == {None: 12, **dict.fromkeys(KINDS, 4)}
    for _, value in groupby(cases, key=lambda case: case.program["kind"]):
        assert {case.source == RECORDED for case in value} == {True, False}


@pytest.mark.parametrize("count", [6, 24, 48])
def test_half_of_the_drives_outside_use_recorded_speeds(count):
    cases = draw_cases({"outside": count, "single": 60}, 3, SOURCES)
    assert Counter(case.source == RECORDED for case in cases if case.level == "outside") == {True: count // 2, False: count // 2}
    assert not any(case.source == RECORDED for case in draw_cases({"outside": count}, 3))


@pytest.mark.parametrize("name", KINDS)
def test_a_kind_is_zero_at_standstill_and_never_pushes(sheet, one, name):
    """At its largest size and in any drive: it takes from the motion, and no torque changes its sign by it."""
    program, _ = of_kind(name)
    stops = steady(sheet, 5.0, stops=(100.0, 400.0))
    for drive_ in (one, stops):
        most = {PROGRAM: {"seed": float(program.seed), "size": ENTRIES[program.entry].largest}}
        plain, run = (simulate_truth(SHEET, Build(), hidden, [drive_])[0] for hidden in ({}, most))
        added = run.torque - plain.torque
        still = (drive_.speed == 0.0) & (drive_.accel == 0.0)
        assert still.any()
        assert np.abs(added[still]).max() == 0.0
        assert drive_ is one or np.abs(added).max() > 50.0  # the first has no long stop
        assert (plain.torque * run.torque >= 0.0)[plain.torque != 0.0].all() or program.entry == "torque"
        assert (added * drive_.speed >= 0.0).all() or program.entry == "gain"


def test_a_seal_drags_by_the_distance_of_all_drives_alone(sheet):
    program, _ = of_kind("seal")
    fast, slow = (steady(sheet, speed, minutes=30.0) for speed in (8.0, 4.0))
    length = float(np.exp(program.kind[1][0]))
    for value, driven in ((fast, 0.0), (slow, 0.0), (fast, 6000.0)):
        journey = Journey(sheet, value, driven)
        np.testing.assert_allclose(
            KINDS["seal"].strength(journey, journey.speed, *program.kind[1]), np.exp(-journey.distance / length)
        )
    assert 2000.0 <= length <= 10_000.0


def test_a_brake_drags_after_long_stops_and_wears_free(sheet):
    program, _ = of_kind("parking brake")
    seconds = float(np.exp(program.kind[1][0]))
    n = 6000
    speed = np.full(n, 5.0)
    speed[1000:1190] = 0.0  # 19 s
    speed[3000:3210] = 0.0  # 21 s
    item = replace(steady(sheet, 5.0, minutes=10.0), speed=speed)
    drag = KINDS["parking brake"].strength(Journey(sheet, item, 0.0), speed, *program.kind[1])
    assert np.abs(drag[:3199]).max() == 0.0
    np.testing.assert_allclose(drag[3210:], np.exp(-np.arange(1, n - 3209) * 0.1 / seconds))
    assert 20.0 <= seconds <= 150.0


def test_a_windings_gain_falls_by_torque_squared_in_450_s(sheet):
    program, _ = of_kind("winding")
    (rated,) = program.kind[1]
    journey = Journey(sheet, steady(sheet, 5.0, minutes=30.0), 0.0)
    seconds = np.arange(len(journey.speed)) * 0.1
    for torque in (0.5 * rated, -rated, rated):
        gain = KINDS["winding"].strength(journey, np.full(len(seconds), torque), rated)
        np.testing.assert_allclose(gain, -((torque / rated) ** 2) * (1.0 - np.exp(-seconds / WINDING_S)), atol=1e-9)


@pytest.mark.parametrize("name", KINDS)
def test_a_true_statement_of_a_kind_is_taken_as_true(name):
    case = Case("a", "outside", of_kind(name)[1], {}, False, False, False, True, 5, "trapezoids")
    drives = _drives(case, 12.0, "drive")
    truth = _kept(case, drives, simulate_truth(SHEET, Build(), case.hidden, drives))
    over = {key.removeprefix("over/"): x for key, x in truth.items() if key.startswith("over/")}

    def true(variable):
        term = {"form": "curve", "variable": variable, "gate": None}
        return is_true(term, over, truth[f"added/{PROGRAM}"], truth["lengths"])

    (variable,) = draw_program(int(case.hidden[PROGRAM]["seed"])).description["variables"]
    assert true(variable)
    assert not true("yaw rate to the left")
