# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What no catalogue has, by its own laws, and the instruments of each case."""

from collections import Counter
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from trackres_ros.evaluation.sealed import outside
from trackres_ros.evaluation.sealed.cases import (
    AFTER_FREEZE,
    CATALOGUE,
    LEVELS,
    MOST_GAIN,
    MOST_LAG_S,
    MOST_OFFSET_NM,
    OUTSIDE,
    PREDICTABLE_FORMS,
    QUICK,
    RIGHT_FORMS,
    STREET,
    draw_cases,
    predictable,
    sensors_of,
)
from trackres_ros.evaluation.sealed.data_sheet import read_data_sheet
from trackres_ros.evaluation.sealed.drives import Drive, drive
from trackres_ros.evaluation.sealed.generate import EVERY, means
from trackres_ros.evaluation.sealed.phenomenon import Journey
from trackres_ros.evaluation.sealed.sensors import Sensors, lagging, record
from trackres_ros.evaluation.sealed.truth import TruthRun
from trackres_ros.files.resources import find_vehicle

ADDS = {**outside.PHENOMENA, **outside.SHOWN}
FORMS = {"curve", "gated_curve", "build_up", "spells", "wave", "place", "payload", "drift", "level_change"}
STOPS_S = 60.0  # of a steady drive with stops, how long it stands


@pytest.fixture(scope="module")
def sheet():
    return read_data_sheet(find_vehicle("xgd24d"))


def steady(sheet, speed, load=1.0, minutes=15.0, yaw_rate=0.0, stops=()):
    """A drive at one speed, but for stops that begin at some times [s]."""
    n = int(minutes * 600)
    time, speeds = np.arange(n) * 0.1, np.full(n, speed)
    speeds[:50] = 0.0
    for begin in stops:
        speeds[(time >= begin) & (time < begin + STOPS_S)] = 0.0
    turning = np.full(n, yaw_rate) * (speeds > 0.0)
    return Drive(
        0.1, speeds, np.gradient(speeds, 0.1), turning, np.cumsum(turning) * 0.1,
        np.full(n, load * sheet["weight"]), np.full(n, 15.0),
    )  # fmt: skip


def added(sheet, name, one, torque=5000.0, seed=3, **values):
    p = {key: float(x) for key, x in OUTSIDE[name](np.random.default_rng(seed), 1.0).items()} | values
    return ADDS[name](Journey(sheet, one, 0.0), p, np.full(len(one), torque)), p


def test_each_has_a_draw_and_right_forms_and_none_is_in_the_catalogue():
    assert set(OUTSIDE) == set(RIGHT_FORMS) - set(STREET) == set(ADDS)
    assert set(AFTER_FREEZE) < set(OUTSIDE)
    assert not set(OUTSIDE) & set(CATALOGUE)
    assert {form.name for forms in RIGHT_FORMS.values() for form in forms} <= FORMS
    assert set(PREDICTABLE_FORMS) < FORMS
    assert predictable("mud")
    assert not predictable("pump")
    assert not predictable("ratchet")  # no form is right of it


@pytest.mark.parametrize(("levels", "each"), [(LEVELS, 4), (QUICK, 1)])
def test_each_is_in_a_run_equally_often(levels, each):
    cases = [case for case in draw_cases(levels, 1) if case.level == "outside"]
    assert Counter(name for case in cases for name in case.hidden) == dict.fromkeys(OUTSIDE, each)


def test_each_is_drawn_equally_often():
    cases = [case for case in draw_cases({"outside": 2 * len(OUTSIDE), "none": 3}, 4) if case.level == "outside"]
    assert set(Counter(name for case in cases for name in case.hidden).values()) == {2}


def test_a_pump_runs_for_minutes_whether_it_drives_or_stands(sheet):
    on, _ = added(sheet, "pump", steady(sheet, 5.0, minutes=60.0))
    standing, _ = added(sheet, "pump", steady(sheet, 0.0, minutes=60.0))
    np.testing.assert_array_equal(on, standing)
    runs = np.diff(np.flatnonzero(np.diff((on > 0.5 * on.max()).astype(int)))) * 0.1
    assert len(runs) >= 8
    assert (runs > 50.0).all()


def test_a_brake_drags_after_stops_and_at_no_other_time(sheet):
    starts = np.arange(0.0, 3600.0, 300.0)
    drags, p = added(sheet, "brake_after_stops", steady(sheet, 5.0, minutes=60.0, stops=starts[1:] - STOPS_S))
    after = drags.reshape(len(starts), -1)  # a row from each start on
    assert np.abs(after[:, 1750:2400]).max() < 0.01 * p["torque"]
    assert np.abs(after[:, 2500:]).max() < 0.01 * p["torque"]
    assert set((after[:, 250] > 0.5 * p["torque"]).tolist()) == {True, False}


def test_mud_is_gone_after_a_stop_and_comes_back_with_distance(sheet):
    mud, p = added(sheet, "mud", steady(sheet, 5.0, stops=(600.0,)), distance=1000.0)
    assert mud[1500] == pytest.approx(0.75 * p["torque"], rel=0.2)
    assert mud[5900] == pytest.approx(p["torque"], rel=0.2)
    assert mud[6650] < 0.15 * p["torque"]
    assert mud[8600] == pytest.approx(p["torque"], rel=0.2)


def test_left_turns_and_not_right_ones(sheet):
    left, p = added(sheet, "left_turns", steady(sheet, 5.0, yaw_rate=0.1))
    right, _ = added(sheet, "left_turns", steady(sheet, 5.0, yaw_rate=-0.1))
    assert left[100:].mean() == pytest.approx(p["torque"], rel=0.1)
    assert np.abs(right).max() < 1e-3 * p["torque"]


def test_backlash_steps_with_the_sign_of_the_torque_that_drives(sheet):
    (ahead, p), (coasting, _) = (added(sheet, "backlash", steady(sheet, 5.0), torque) for torque in (5000.0, -5000.0))
    assert (ahead - coasting).mean() == pytest.approx(p["torque"], rel=0.1)
    at_zero, _ = added(sheet, "backlash", steady(sheet, 5.0), 0.0)
    assert np.abs(at_zero).max() < 1e-9


def test_a_resonance_is_at_one_speed_and_when_light(sheet):
    swings = {
        (share, load): added(sheet, "light_resonance", steady(sheet, share * 7.0, load), speed=7.0)[0][600:].mean()
        for share in (0.4, 1.0, 1.8)
        for load in (0.8, 1.0, 1.25)
    }
    most = swings.pop((1.0, 0.8))
    assert max(swings.values()) < 0.25 * most


def test_a_stiff_joint_comes_round_with_the_belt(sheet):
    one = steady(sheet, 2.0)
    wave, p = added(sheet, "stiff_joint", one)
    distance = np.cumsum(one.speed) * 0.1
    lengths = np.linspace(3.0, 7.0, 401)
    strength = [abs((wave * np.exp(2j * np.pi * distance / length)).sum()) for length in lengths]
    assert lengths[int(np.argmax(strength))] == pytest.approx(p["length"] * sheet["track.belt.loop_length"], rel=0.005)


def test_a_zero_that_drifts_is_slow_and_begins_at_zero(sheet):
    drift, p = added(sheet, "zero_drift", steady(sheet, 5.0))
    assert drift[0] == 0.0
    assert np.sqrt(np.mean(drift**2)) == pytest.approx(p["torque"])
    assert np.abs(np.diff(drift)).max() < 0.01 * p["torque"]


def slips(series, least):
    """How often a torque falls below minus something."""
    return int((np.diff((series < -least).astype(int)) == 1).sum())


def test_a_ratchet_slips_when_it_pulls_hard_and_more_often_when_cold(sheet):
    counts = {}
    for torque, air in ((2000.0, 25.0), (6000.0, 25.0), (8000.0, 25.0), (6000.0, 5.0)):
        one = replace(steady(sheet, 5.0), ambient=np.full(9000, air))
        jumps, p = added(sheet, "ratchet", one, torque, limit=6000.0, rate=0.3)
        counts[torque, air] = slips(jumps[:3000], 0.5 * p["torque"])  # in five minutes: later it is warm
    assert counts[2000.0, 25.0] == 0
    assert 0 < counts[6000.0, 25.0] < counts[8000.0, 25.0]
    assert counts[6000.0, 25.0] < counts[6000.0, 5.0]


def test_a_ratchet_loses_the_drive_for_a_moment_and_makes_up_for_it(sheet):
    jumps, p = added(sheet, "ratchet", steady(sheet, 5.0, minutes=60.0), 5000.0, limit=5000.0, rate=0.1)
    lost = jumps < -0.5 * p["torque"]
    lasts = np.diff(np.flatnonzero(np.diff(lost.astype(int)))[: 2 * slips(jumps, 0.5 * p["torque"])])[::2] * 0.1
    assert len(lasts) > 30
    assert lasts.max() < 2.5
    assert jumps.max() > 0.5 * p["torque"]
    assert 0.0 < jumps.mean() < 0.1 * p["torque"]


def test_a_ratchet_takes_no_more_drive_than_there_is(sheet):
    jumps, _ = added(sheet, "ratchet", steady(sheet, 5.0), 300.0, limit=0.0, rate=1.0)
    assert jumps.min() == pytest.approx(-240.0, rel=1e-3)
    braking, _ = added(sheet, "ratchet", steady(sheet, 5.0), -5000.0)
    assert np.abs(braking).max() == 0.0


def places_of(sheet, one, driven=0.0, **values):
    p = {"torque": 600.0, "lap": 1000.0, "seed": 5.0} | values
    return outside.PHENOMENA["route_places"](Journey(sheet, one, driven), p, np.zeros(len(one)))


@pytest.mark.parametrize("seed", range(6))
def test_places_of_a_route_come_again_with_each_lap_and_slip_by_a_percent(sheet, seed):
    one = steady(sheet, 5.0, minutes=60.0)
    distance = np.cumsum(one.speed) * 0.1
    laps = np.array(
        [np.interp(np.arange(1000.0), distance - 1000.0 * lap, places_of(sheet, one, seed=float(seed))) for lap in range(17)]
    )
    assert np.abs(laps[0]).max() == pytest.approx(600.0, rel=0.4)
    assert (np.abs(laps[0]) < 6.0).mean() > 0.5  # most of a lap is none of them
    for before, after in pairwise(laps):
        alike = [np.corrcoef(before, np.roll(after, metres))[0, 1] for metres in range(-12, 13)]
        assert max(alike) > 0.8
    assert np.corrcoef(laps[0], np.roll(laps[1], 300))[0, 1] < 0.8


def test_places_are_where_they_were_when_the_next_drive_begins(sheet):
    one = steady(sheet, 5.0, minutes=20.0)
    whole, driven = places_of(sheet, one), float(np.sum(one.speed[:6000])) * 0.1
    rest = Drive(*(getattr(one, name)[6000:] if name != "step" else 0.1 for name in (
        "step", "speed", "accel", "yaw_rate", "heading", "weight", "ambient"
    )))  # fmt: skip
    again = places_of(sheet, rest, driven)
    assert np.corrcoef(whole[6000:], again)[0, 1] > 0.95  # each pass is on another line


def test_a_bearing_rumbles_binds_and_then_is_seized_for_good(sheet):
    one = steady(sheet, 5.0, minutes=60.0)
    drag, p = added(sheet, "seized_bearing", one, distance=9000.0)
    distance = np.cumsum(one.speed) * 0.1
    early, late, after = distance < 3000.0, (distance > 6000.0) & (distance < 8700.0), distance > 9300.0
    assert 0.0 < np.median(drag[early][100:]) < 0.05 * p["torque"]
    assert slips(-drag[late], 0.2 * p["torque"]) > slips(-drag[early], 0.2 * p["torque"])
    assert np.median(drag[late]) < 0.1 * p["torque"]
    assert np.median(drag[after]) == pytest.approx(0.9 * p["torque"], rel=0.1)
    assert (drag[after] > 0.5 * p["torque"]).mean() > 0.8
    later = outside.PHENOMENA["seized_bearing"](Journey(sheet, one, 30000.0), p, np.zeros(len(one)))
    assert np.median(later[100:]) == pytest.approx(0.85 * p["torque"], rel=0.05)
    light, _ = added(sheet, "seized_bearing", steady(sheet, 5.0, load=0.8, minutes=60.0), distance=9000.0)
    np.testing.assert_allclose(light[after], 0.86 * drag[after])


@pytest.mark.parametrize("name", AFTER_FREEZE)
@pytest.mark.parametrize("driven", [0.0, 40_000.0])
def test_what_was_written_after_the_freeze_does_nothing_to_a_vehicle_that_stands(sheet, name, driven):
    p = {key: float(x) for key, x in OUTSIDE[name](np.random.default_rng(3), 1.0).items()}
    standing = steady(sheet, 0.0)
    assert np.abs(ADDS[name](Journey(sheet, standing, driven), p, np.full(len(standing), 8000.0))).max() == 0.0


def test_drives_of_one_case_differ_and_come_out_the_same_again(sheet):
    one = drive(6.0, sheet["weight"], 15.0, 14.0, np.random.default_rng(2))
    for name, adds in ADDS.items():
        p = {key: float(x) for key, x in OUTSIDE[name](np.random.default_rng(8), 1.0).items()}
        first, again, later = (adds(Journey(sheet, one, driven), p, 3000.0 + one.accel * 1e4) for driven in (0.0, 0.0, 5000.0))
        np.testing.assert_array_equal(first, again, err_msg=name)
        assert np.abs(first - later).max() > 0.0, name


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


def test_what_is_recorded_has_the_gain_and_the_offset_of_the_instrument(sheet, tmp_path):
    one = steady(sheet, 5.0, minutes=1.0)
    shown = np.linspace(0.0, 8000.0, len(one))
    still = np.full(len(one), 15.0)
    good = {"torque_nm": 0.0, "torque_share": 0.0, "torque_step_nm": 0.01, "road": 0.0, "dropouts": 0.0}
    sensors = Sensors(**good, torque_lag_s=0.05, torque_offset_nm=12.0, torque_gain=1.004)
    run = TruthRun(shown, shown, still, still, {}, one.weight)
    record(tmp_path / "a.csv", one, run, sensors, 0.36, 1.7e9, np.random.default_rng(1))
    torque = np.genfromtxt(tmp_path / "a.csv", delimiter=",", names=True)["torque_nm"]
    even = one.accel == 0.0  # the sensor's noise grows with the acceleration
    expected = 1.004 * (shown - 0.05 * (shown[1] - shown[0]) / 0.1) + 12.0
    np.testing.assert_allclose(torque[even][20:], expected[even][20:], atol=0.02)


def test_means_over_a_fits_steps():
    series = np.arange(25.0)
    np.testing.assert_allclose(means(series), [4.5, 14.5, 22.0])
    assert EVERY == 10
