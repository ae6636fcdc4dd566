# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Towns, drives through them and hidden physics there, by their own laws; and the recorded channels."""

from collections import Counter, defaultdict
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from proofs.sealed.cases import (
    ALTITUDE_M,
    CATALOGUE,
    LEVELS,
    POSITION_M,
    QUICK,
    STREET,
    Case,
    draw_cases,
    sensors_of,
    streets_of,
)
from proofs.sealed.drives import BLOCKS_M, RIGHT_M, SIDEWAYS_MPS2, draw_town, street_drive
from proofs.sealed.phenomena import LOAD, TOWN_PHENOMENA, Journey, loaded
from proofs.sealed.recordings import make_case
from proofs.sealed.truth import EARTH_M, LATITUDE_DEG, LONGITUDE_DEG, Build, Sensors, TruthRun, record, simulate_truth, wandering
from trackres_ros.diagnosis import load_base, read_recordings
from trackres_ros.diagnosis.prepare.gate import gate
from trackres_ros.files.resources import find_vehicle

SHEET = find_vehicle("xgd24d")
WEIGHT_N, STEEPEST, MINUTES = 272e3, 0.03, 30.0


def town_of(seed):
    return draw_town(np.random.default_rng(seed))


def drive_of(seed, minutes=MINUTES):
    return street_drive(minutes, WEIGHT_N, 15.0, town_of(seed), STEEPEST, np.random.default_rng([seed, 1]))


@pytest.fixture(scope="module", params=range(4))
def one(request):
    return drive_of(request.param)


def along(town, street):
    """Places each half metre along the middle of a street, its heading, and how far apart they are [m]."""
    begin, end = (town.at(crossing) for crossing in street)
    share = (np.arange(2000) + 0.5) / 2000.0
    x, y = (begin[i] + share * (end[i] - begin[i]) for i in (0, 1))
    heading = np.arctan2(end[1] - begin[1], end[0] - begin[0])
    return x, y, np.full(2000, heading), float(np.abs(end - begin).sum()) / 2000.0


@pytest.mark.parametrize("seed", range(5))
def test_slopes_round_a_block_add_up_to_nothing(seed):
    town = town_of(seed)
    block = [(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)]
    climbs = []
    for street in pairwise(block):
        x, y, heading, spacing = along(town, street)
        climbs.append(float(town.slope(x, y, heading).sum()) * spacing)
    assert abs(sum(climbs)) < 1e-3 * max(map(abs, climbs))


@pytest.mark.parametrize("seed", range(5))
def test_a_slope_reverses_with_direction_and_the_steepest_is_one(seed):
    town = town_of(seed)
    steepest = 0.0
    for street in town.streets:
        x, y, heading, spacing = along(town, street)
        up, down = town.slope(x, y, heading), town.slope(x, y, heading + np.pi)
        np.testing.assert_allclose(up, -down, atol=1e-12)
        changes = np.abs(np.diff(up)) / spacing
        assert changes.max() < 1.0 / 15.0  # smooth: from level to steepest takes tens of metres
        steepest = max(steepest, float(np.abs(up).max()))
    assert steepest == pytest.approx(1.0, rel=0.01)


@pytest.mark.parametrize("seed", range(5))
def test_blocks_are_as_long_as_blocks_are(seed):
    town = town_of(seed)
    for lines in (town.east, town.north):
        assert BLOCKS_M[0] <= np.diff(lines).min() <= np.diff(lines).max() <= BLOCKS_M[1]


def test_some_streets_are_soft_and_their_crossings_are_not():
    for seed in range(5):
        town = town_of(seed)
        softest = [float(town.softness(*along(town, street)[:2]).max()) for street in town.streets]
        assert max(softest) == pytest.approx(1.0, abs=0.05)
        assert 0.2 < np.mean(np.array(softest) > 0.3) < 0.45
        for crossing in {c for street in town.streets for c in street}:
            x, y = town.at(crossing)
            assert town.softness(np.array([x]), np.array([y]))[0] < 0.05


def test_positions_agree_with_distance_and_heading(one):
    rate = np.gradient(one.street.x, one.step), np.gradient(one.street.y, one.step)
    assert np.abs(rate[0] - one.speed * np.cos(one.heading)).max() < 0.1 * SIDEWAYS_MPS2 * 10.0
    is_moving = one.speed > 2.0
    for shown_text, expectation in zip(rate, (np.cos(one.heading), np.sin(one.heading)), strict=True):
        deviation = (shown_text - one.speed * expectation)[is_moving] / one.speed[is_moving]
        assert np.sqrt(np.mean(deviation**2)) < 0.05
    assert np.abs(one.heading - one.heading[0] - np.cumsum(one.yaw_rate) * one.step).max() < 0.05


def test_it_climbs_as_its_slope_says(one):
    climbed = np.cumsum(one.speed * one.street.slope) * one.step
    rise = one.street.height - one.street.height[0]
    assert np.abs(climbed - rise).max() < 0.15
    assert np.ptp(rise) > 2.0
    assert np.abs(one.street.slope).max() < 1.45 * STEEPEST  # across a crossing both streets may rise


def test_the_same_street_has_the_same_slope_either_way(one):
    moving = np.flatnonzero(one.speed > 1.0)[::10]
    x, y, heading, slope = (s[moving] for s in (one.street.x, one.street.y, one.heading, one.street.slope))
    near = np.hypot(np.subtract.outer(x, x), np.subtract.outer(y, y)) < 1.1 * 2.0 * RIGHT_M
    turned = np.cos(np.subtract.outer(heading, heading))
    for met, sign in ((near & (turned > 0.99), 1.0), (near & (turned < -0.99), -1.0)):
        here, there = np.nonzero(met & (np.subtract.outer(moving, moving) > 600))
        assert len(here) > 100
        assert np.abs(slope[here] - sign * slope[there]).max() < 0.15 * STEEPEST


@pytest.mark.parametrize("seed", range(4))
def test_streets_are_passed_several_times_both_ways(seed):
    town, passed = town_of(seed), defaultdict(int)
    item = drive_of(seed, 90.0)
    for street in town.streets:
        x, y, heading, _ = along(town, street)
        near = (np.hypot(item.street.x - x[1000], item.street.y - y[1000]) < 25.0) & (item.speed > 0.0)
        for way in (1.0, -1.0):
            there = near & (way * np.cos(item.heading - heading[0]) > 0.9)
            passed[street, way] = int((np.diff(there.astype(int)) == 1).sum())
    counts = np.array(list(passed.values()))
    assert np.median(counts) >= 3
    assert (counts > 0).mean() > 0.75


def test_it_drives_as_a_vehicle_can(one):
    assert one.speed.min() == 0.0
    assert 9.0 < one.speed.max() < 13.5
    assert 4.0 < one.speed.mean() < 8.0
    assert -1.6 < one.accel.min() < one.accel.max() < 1.0
    assert np.abs(one.speed * one.yaw_rate).max() < 1.05 * SIDEWAYS_MPS2
    stands = np.diff(np.flatnonzero(np.diff((one.speed < 0.1).astype(int), prepend=0)))[::2] * one.step
    assert len(stands) >= 8
    assert 4.0 < np.min(stands[1:]) < np.max(stands) < 44.0


def test_long_streets_are_driven_faster():
    fast = defaultdict(list)
    for seed in range(4):
        town, item = town_of(seed), drive_of(seed)
        for street in town.streets:
            x, y, _, spacing = along(town, street)
            near = np.hypot(item.street.x - x[1000], item.street.y - y[1000]) < 20.0
            if near.any():
                fast[spacing * 2000.0 > np.mean(BLOCKS_M)].append(item.speed[near].max())
    assert np.mean(fast[True]) > np.mean(fast[False]) + 1.5


@pytest.mark.parametrize("bulk", [0.0, 1.0])
def test_loads_change_only_at_stops(one, bulk):
    carried = loaded(one, {"share": 0.2, "bulk": bulk, "seed": 4.0}, 0.0)
    changes = np.flatnonzero(np.diff(carried.weight)) + 1
    assert len(changes) >= 3
    for change in changes:
        assert one.speed[change - 20 : change + 1].max() == 0.0
    more = carried.weight / one.weight - 1.0
    assert 0.0 <= more.min() < more.max() <= 0.2
    repetition = loaded(one, {"share": 0.2, "bulk": bulk, "seed": 4.0}, 0.0)
    np.testing.assert_array_equal(carried.weight, repetition.weight)
    if bulk:
        assert ((more < 0.011) | (more > 0.159)).all()


def test_a_hidden_load_weighs_and_is_not_in_what_is_known(one):
    hidden = {LOAD: {"share": 0.2, "bulk": 1.0, "seed": 4.0}}
    (run,) = simulate_truth(SHEET, Build(), hidden, [one])
    (plain,) = simulate_truth(SHEET, Build(), {}, [one])
    np.testing.assert_allclose(run.weight, loaded(one, hidden[LOAD], 0.0).weight)
    np.testing.assert_array_equal(plain.weight, one.weight)
    np.testing.assert_allclose(run.added[LOAD], run.shown - plain.shown)
    empty = run.weight < 1.02 * WEIGHT_N
    assert np.abs(run.added[LOAD][empty]).mean() < 0.2 * np.abs(run.added[LOAD][~empty]).mean()


def test_ground_takes_the_same_either_way_and_slopes_do_not(sheet, one):
    back = replace(one, speed=-one.speed)
    values = {"torque": 500.0, "seed": 2.0}
    forecast, reverse = (TOWN_PHENOMENA["street_ground"](Journey(sheet, d, 0.0), values, one.speed) for d in (one, back))
    np.testing.assert_allclose(forecast, -reverse)  # a resistance: against the way it moves
    assert (forecast >= 0.0).all()
    np.testing.assert_array_equal(forecast[one.speed == 0.0], 0.0)
    assert forecast[one.street.softness < 1e-3].max() < 2.0
    up = TOWN_PHENOMENA["street_slope"](Journey(sheet, one, 0.0), {}, one.speed)
    assert np.corrcoef(up, one.street.slope)[0, 1] > 0.9999
    assert np.abs(up).max() == pytest.approx(WEIGHT_N * sheet["track.sprocket_radius"] * np.abs(one.street.slope).max(), rel=1e-2)


def test_brakes_take_part_of_hard_braking_and_hold_at_standstill():
    item = drive_of(0)
    assert (item.street.brakes[item.speed == 0.0] == 1.0).all()
    (run,) = simulate_truth(SHEET, Build(), {"street_slope": {}}, [item])
    np.testing.assert_array_equal(run.shown[item.speed == 0.0], 0.0)
    hard = (item.accel < -0.9) & (item.speed > 0.0)
    assert hard.sum() > 100
    assert (np.abs(run.shown[hard]) < np.abs(run.torque[hard])).all()
    mild = (item.accel > -0.7) & (item.speed > 0.0)
    np.testing.assert_array_equal(run.shown[mild], run.torque[mild])


def recorded(folder, one, sensors, seed=1):
    still = np.full(len(one), 15.0)
    torque = np.where(one.speed > 0.0, 2000.0, 0.0)
    run = TruthRun(torque, torque, still, {}, one.weight)
    record(folder / "a.csv", one, run, sensors, 0.36, 1.7e9, np.random.default_rng(seed))
    return np.genfromtxt(folder / "a.csv", delimiter=",", names=True)


def test_positions_come_once_a_second_and_wander(tmp_path):
    item = drive_of(1)
    table = recorded(tmp_path, item, Sensors(position_m=6.0))
    assert item.street.covered.mean() > 0.01
    known = np.isfinite(table["latitude_deg"])
    assert (np.flatnonzero(known) % 10 == 0).all()
    assert not (known & item.street.covered).any()
    assert (known == np.isfinite(table["longitude_deg"])).all()
    north = np.radians(table["latitude_deg"] - LATITUDE_DEG) * EARTH_M - item.street.y
    east = np.radians(table["longitude_deg"] - LONGITUDE_DEG) * EARTH_M * np.cos(np.radians(LATITUDE_DEG)) - item.street.x
    for deviation in (north[known], east[known]):
        assert 3.5 < np.sqrt(np.mean(deviation**2)) < 9.5
        assert 0.8 < np.std(np.diff(deviation)) < 2.5  # from one second to the next: white noise, and little of the slow error
    gaps = np.diff(np.flatnonzero(known)) * 0.1
    lost = gaps[gaps > 1.5]
    assert len(lost) >= 2
    assert np.max(lost) > 20.0


def test_what_wanders_does_so_within_a_minute():
    series = wandering(3_600_000, 0.1, 5.0, np.random.default_rng(1))
    assert np.std(series) == pytest.approx(5.0, rel=0.1)
    assert np.corrcoef(series[600:], series[:-600])[0, 1] == pytest.approx(np.exp(-1.0), abs=0.1)


def test_the_altitude_of_one_pass_tells_no_slope(tmp_path):
    item = drive_of(2)
    table = recorded(tmp_path, item, Sensors(altitude_m=3.0))[::10]
    way, known = np.cumsum(item.speed)[::10] * item.step, np.isfinite(table["altitude_m"])
    forecast, behind = (np.interp(way + metres, way[known], table["altitude_m"][known]) for metres in (50.0, -50.0))
    shown_text, true = (forecast - behind) / 100.0, item.street.slope[::10]
    is_moving = item.speed[::10] > 1.0
    coefficient = np.polyfit(shown_text[is_moving], true[is_moving], 1)[0]
    assert coefficient < 0.4


def test_it_is_recorded_as_vehicles_of_the_road_record(tmp_path):
    item = drive_of(3)
    fast = recorded(tmp_path, item, Sensors(load_measured=False, belt_measured=False))
    assert "weight_n" not in fast.dtype.names
    assert "heading_rad" not in fast.dtype.names
    assert "grade" not in fast.dtype.names
    assert len(fast) == len(item)
    np.testing.assert_array_equal(fast["brake_on"] > 0.5, item.street.brakes > 0.0)
    slow = recorded(tmp_path, replace(item, slope=item.street.slope), Sensors(every_s=1.0))
    np.testing.assert_allclose(np.diff(slow["time_s"]), 1.0, atol=1e-4)
    assert {"weight_n", "grade", "belt_degc"} < set(slow.dtype.names)
    assert np.isfinite(slow["latitude_deg"]).mean() > 0.7


def test_each_kind_is_drawn_as_often_as_nothing():
    for levels in (LEVELS, QUICK):
        cases = [case for case in draw_cases(levels, 3) if case.level == "street"]
        counts = Counter(" and ".join(case.hidden) for case in cases)
        assert set(counts) == {"", *STREET}
        assert len(set(counts.values())) == 1
    assert not set(STREET) & set(CATALOGUE)


def test_towns_leave_the_draws_of_other_levels_as_they_are():
    without = {"none": 3, "single": 4, "outside": 5}
    result_before, result_after = draw_cases(without, 8), draw_cases({**without, "street": 6}, 8)
    kept = [case for case in result_after if case.level != "street"]
    assert sorted(map(repr, kept)) == sorted(map(repr, result_before))


def test_what_is_recorded_says_nothing_of_what_is_hidden():
    """What is not recorded may be as the vehicle file says, and what is level need not be recorded."""
    cases = draw_cases({"street": 240}, 5)
    item = defaultdict(Counter)
    for case in cases:
        sensors, streets = sensors_of(case), streets_of(case)
        assert len(case.name) == 8
        item[" and ".join(case.hidden)][sensors.load_measured, streets.steepest > 0.0] += 1
        assert (streets.load is None) or sensors.load_measured
        assert POSITION_M[0] <= sensors.position_m <= POSITION_M[1]
        assert ALTITUDE_M[0] <= sensors.altitude_m <= ALTITUDE_M[1]
    assert set(item[""]) == {(load, slope) for load in (True, False) for slope in (True, False)}
    for kind in STREET:
        assert set(item[kind]) <= set(item[""])
    slow = np.mean([sensors_of(case).every_s > 0.0 for case in cases])
    assert 0.23 < slow < 0.43


@pytest.mark.parametrize("hidden", [{LOAD: {"share": 0.2, "bulk": 1.0, "seed": 7.0}}, {"street_slope": {"steepest": 0.02}}])
def test_a_case_passes_the_gate(tmp_path, hidden):
    make_case(tmp_path, 4.0, Case("a", "street", hidden, {}, False, False, False, False, 21))
    loaded_base = load_base(tmp_path / "cases" / "a" / "vehicle.yaml")
    paths = sorted((tmp_path / "cases" / "a").glob("drive_*.csv"))
    sessions = gate(read_recordings(paths, None), loaded_base.known).sessions
    assert len(sessions) == 3
    assert all({"position", "altitude"} <= s.given for s in sessions)
    assert not any("grade" in s.given for s in sessions) or "street_slope" not in hidden
    assert not any("load" in s.given for s in sessions) or LOAD not in hidden
    truth = np.load(tmp_path / "sealed" / "a.npz")
    assert np.abs(truth[f"added/{next(iter(hidden))}"]).max() > 500.0
    assert (len(np.unique(truth["over/load"])) > 3) == (LOAD in hidden)
