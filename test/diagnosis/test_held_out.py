# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What held-out laps say: how much a model gains on them, by lap and over all, and how sure that is."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trackres_ros.diagnosis.prepare.session import DriveSession
from trackres_ros.diagnosis.selection.held_out import CONFIRMED, REFUTED, SUSPECTED, HeldOutLaps, Improvement, held_out


@pytest.mark.parametrize(
    ("after", "low", "high", "likelier", "grade"),
    [
        (90.0, 1.0, 19.0, -np.inf, CONFIRMED),
        (90.0, 1.0, 19.0, -0.1, CONFIRMED),  # the mean error surely falls
        (98.1, 0.9, 2.9, -0.1, SUSPECTED),  # but by too little
        (90.0, -1.0, 21.0, -np.inf, SUSPECTED),
        (90.0, -1.0, 21.0, 0.1, CONFIRMED),  # by the likelihood
        (90.0, -1.0, 21.0, -0.1, SUSPECTED),
        (90.0, 0.0, 20.0, 0.0, SUSPECTED),
        (100.0, -1.0, 1.0, 0.5, CONFIRMED),
        (100.5, -2.0, 1.0, 0.5, SUSPECTED),  # likelier, and yet no smaller error
        (101.0, -2.0, 1.0, -np.inf, SUSPECTED),
        (101.1, -2.0, 1.0, 1.0, REFUTED),
        (100.5, -0.9, -0.1, 9.0, REFUTED),  # surely worse, however little
        (100.5, -1.0, 0.0, -np.inf, SUSPECTED),
    ],
)
def test_what_laps_say_of_an_improvement(after, low, high, likelier, grade):
    assert Improvement(100.0, after, low, high, likelier).grade == grade


@given(st.floats(-50.0, 50.0), st.floats(0.0, 40.0), st.floats(-9.0, 9.0), st.floats(0.1, 9.0))
def test_a_falling_score_is_the_reason_where_a_rising_confirms(low, fall, gained, wide):
    laps, other = (Improvement(100.0, 100.0 - fall, low, low + wide, -99.0, g) for g in (gained, 1.0))
    assert laps.less_likely == (laps.grade == SUSPECTED != other.grade)


def session(laps, lap_s=60, torque=None, name="drive", first=0):
    time = np.arange(laps * lap_s, dtype=float)
    none = np.zeros(len(time))
    block = first + (time // lap_s).astype(np.int64)
    return DriveSession(name, 1.0, time, *(none,) * 8, none if torque is None else torque, none, none == 0.0, block)


@given(st.integers(1, 40), st.integers(0, 2**31))
def test_equal_error_is_suspected_and_smaller_error_confirmed(laps, seed):
    rng, item = np.random.default_rng(seed), session(laps)
    held = HeldOutLaps([item], [np.ones(len(item), dtype=bool)], rng)
    wrong = [item.torque + rng.normal(0.0, 30.0, len(item))]
    assert held.improvement(wrong, wrong).grade == SUSPECTED
    better = [item.torque + 0.5 * (wrong[0] - item.torque)]
    assert held.improvement(wrong, better).grade == CONFIRMED
    assert held.improvement(better, wrong).grade == REFUTED


def test_many_laps_are_resampled_whole_and_few_in_minute_pieces():
    total = np.ones(1200, dtype=bool)
    many = HeldOutLaps([session(20)], [total], np.random.default_rng(1))
    assert len(many._count) == 20
    few = HeldOutLaps([session(2, 600)], [total], np.random.default_rng(1))
    assert len(few._count) == 20
    eight, seven = (HeldOutLaps([session(n, 90)], [np.ones(n * 90, dtype=bool)], np.random.default_rng(1)) for n in (8, 7))
    assert len(eight._count) == 8
    assert len(seven._count) == 14


def test_an_interval_is_as_wide_as_laps_differ():
    rng, item = np.random.default_rng(1), session(100)
    laps = HeldOutLaps([item], [np.ones(6000, dtype=bool)], rng)
    gained = np.repeat(rng.normal(5.0, 2.0, 100), 60)
    result = laps.improvement([np.full(6000, 20.0)], [20.0 - gained])
    assert result.before == pytest.approx(20.0)
    assert result.after == pytest.approx(20.0 - gained.mean())
    mean, std = gained.mean(), gained.std() / 10.0
    assert (result.low, result.high) == pytest.approx((mean - 1.96 * std, mean + 1.96 * std), abs=0.15 * std)
    assert result.likelihood_bound == -np.inf


def test_errors_are_counted_by_stage_and_by_lap():
    torque = np.tile([90.0, 110.0], 300)
    sessions = (session(4, 100, torque[:400], "one"), session(2, 100, torque[:200], "two", first=4))
    masks = [sessions[0].block >= 2, np.ones(200, dtype=bool)]
    laps = HeldOutLaps(sessions, masks, np.random.default_rng(1))
    deviations = {"nominal": 20.0, "refitted": -10.0, "with_effects": 2.0}
    expectations = {stage: [s.torque - by * (1.0 + (s.block == 5)) for s in sessions] for stage, by in deviations.items()}
    as_file = [s.torque + 15.0 * (1.0 + (s.block == 5)) for s in sessions]
    result = held_out(laps, expectations, as_file)
    assert result.laps == ("one: 3", "one: 4", "two: 1", "two: 2")
    for stage, by in deviations.items():
        each = np.array([1.0, 1.0, 1.0, 2.0]) * by
        assert result.by_lap["bias"][stage] == pytest.approx(each)
        assert result.by_lap["mae"][stage] == pytest.approx(np.abs(each))
        assert result.by_lap["r2"][stage] == pytest.approx(1.0 - each**2 / 100.0)
        assert result.mae[stage] == pytest.approx(1.25 * abs(by))
        assert result.bias[stage] == pytest.approx(1.25 * by)
        assert result.r2[stage] == pytest.approx(1.0 - 1.75 * by**2 / 100.0)
    assert (result.of_refit.before, result.of_refit.after) == pytest.approx((25.0, 18.75))
    assert (result.of_effects.before, result.of_effects.after) == pytest.approx((12.5, 2.5))
    assert result.of_effects.grade == CONFIRMED


@pytest.mark.parametrize(("error", "predicts"), [(0.15, True), (0.25, False)])
def test_a_steady_torque_is_predicted_within_a_fifth(error, predicts):
    laps = SimpleNamespace(measured=np.full(9, 100.0) + np.arange(-4, 5), samples=lambda x: np.concatenate(x))
    fit = SimpleNamespace(predicted=[SimpleNamespace(torque=laps.measured - 100.0 * error)])
    assert HeldOutLaps.predicts(laps, fit) == predicts


def test_a_varying_torque_is_predicted_better_than_by_its_mean():
    laps = SimpleNamespace(measured=np.linspace(-100.0, 100.0, 9), samples=lambda x: np.concatenate(x))
    for share, predicts in ((0.5, True), (-0.5, False)):
        fit = SimpleNamespace(predicted=[SimpleNamespace(torque=share * laps.measured)])
        assert HeldOutLaps.predicts(laps, fit) == predicts
