# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The watch for disturbances: laws of its two filters, and its result on residuals that begin, end and drop out."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trackres_ros.estimator import columns as layout
from trackres_ros.estimator.disturbance import (
    BLOCK_S,
    LONGEST_MEANS,
    MOST_DRIFT,
    DisturbanceWatch,
    predict_level,
    predict_presence,
    update_level,
    update_presence,
)
from trackres_ros.estimator.records import Steps
from trackres_ros.tasks.replay_run import DisturbanceColumns
from trackres_ros.vehicle import Drift, Spells

START_NS = 1_700_000_000_000_000_000
SPELLS = Spells(level=300.0, rest=-50.0, mean_there=80.0, mean_away=160.0, noise=60.0)
SHARE, MEAN_NM = 1.0 / 3.0, -50.0 + 350.0 / 3.0
DRIFT = Drift(size=150.0, time_constant=300.0, noise=40.0)

probability = st.floats(0.0, 1.0)
chance = st.floats(1e-6, 0.5)
torque = st.floats(-1e6, 1e6)


def fed(watch, residual, seconds, start_s=0.0, speed=8.0, dt=0.1):
    """Residuals as of a time [s], every dt; the last belief."""
    belief = None
    for i in range(round(seconds / dt)):
        time_s = start_s + i * dt
        belief = watch.take(START_NS + round(time_s * 1e9), residual(time_s) if callable(residual) else residual, speed)
    return belief


def at_s(watch, time_s):
    return watch.belief(START_NS + round(time_s * 1e9))


# Laws


@given(probability, chance, chance, st.floats(0.0, 1e6))
def test_ageing_keeps_a_probability_and_moves_it_to_the_share(there, comes, goes, blocks):
    share, later = comes / (comes + goes), predict_presence(there, comes, goes, blocks)
    assert -1e-12 <= later <= 1.0 + 1e-12
    assert abs(later - share) <= abs(there - share) + 1e-12
    assert predict_presence(share, comes, goes, blocks) == pytest.approx(share)


@given(probability, chance, chance, st.floats(0.0, 50.0), st.floats(0.0, 50.0))
def test_ageing_twice_is_ageing_for_both(there, comes, goes, first, second):
    twice = predict_presence(predict_presence(there, comes, goes, first), comes, goes, second)
    assert twice == pytest.approx(predict_presence(there, comes, goes, first + second), abs=1e-9)


def test_a_block_later_it_has_come_or_gone_by_chance():
    assert predict_presence(1.0, 0.02, 0.3) == pytest.approx(0.7)
    assert predict_presence(0.0, 0.02, 0.3) == pytest.approx(0.02)


@given(probability, torque, torque, torque, st.floats(1e-6, 1e12))
def test_what_is_seen_moves_the_probability_to_the_nearer_level(there, mean, rest, level, variance):
    seen = update_presence(there, mean, (rest, level), variance)
    assert 0.0 <= seen <= 1.0
    if abs(mean - level) <= abs(mean - rest):
        assert seen >= there * (1.0 - 1e-12)
    else:
        assert seen <= there * (1.0 + 1e-12) + 1e-300


@given(torque, st.floats(0.0, 1e6), torque)
def test_a_noiseless_level_is_the_mean_and_a_noisy_one_the_prior(level, variance, mean):
    assert update_level(level, variance + 1.0, mean, 0.0) == pytest.approx((mean, 0.0), abs=1e-6)
    assert update_level(level, variance, mean, 1e30) == pytest.approx((level, variance), abs=1e-6)


@given(torque, st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.floats(0.1, 1e4))
def test_a_level_decays_to_zero_and_its_variance_to_the_prior(level, share, keep, size):
    later, variance = predict_level(level, share * size**2, keep, size)
    assert abs(later) <= abs(level)
    assert share * size**2 * (1.0 - 1e-9) <= variance <= size**2 * (1.0 + 1e-9)


# The watch


def test_without_a_residual_it_is_there_as_often_as_it_is():
    watch = DisturbanceWatch(SPELLS)
    for belief in (watch.belief(START_NS), fed(watch, math.nan, 60.0)):
        assert belief.there == pytest.approx(SHARE)
        assert belief.torque_nm == pytest.approx(MEAN_NM)
        assert not belief.present
        assert belief.since_ns is None
    assert fed(DisturbanceWatch(DRIFT), math.nan, 60.0).torque_nm == 0.0


def test_a_lasting_level_is_found_and_dated_within_a_few_blocks():
    watch = DisturbanceWatch(SPELLS)
    first_belief = fed(watch, -50.0, 60.0)
    assert first_belief.there < 0.1
    assert not first_belief.present
    spell_belief = fed(watch, 300.0, 3.0 * BLOCK_S, start_s=60.0)
    assert spell_belief.there > 0.9
    assert spell_belief.present
    assert spell_belief.since_ns == pytest.approx(START_NS + 60 * 10**9, abs=1.1 * BLOCK_S * 1e9)
    last_belief = fed(watch, -50.0, 3.0 * BLOCK_S, start_s=75.0)
    assert not last_belief.present
    assert last_belief.since_ns == pytest.approx(START_NS + 75 * 10**9, abs=1.1 * BLOCK_S * 1e9)


def test_a_spell_that_does_not_end_is_overdue():
    watch, longest_s = DisturbanceWatch(SPELLS), LONGEST_MEANS * SPELLS.mean_there
    assert not fed(watch, 300.0, longest_s - 1.0, dt=0.5).is_overdue
    assert fed(watch, 300.0, 20.0, start_s=longest_s, dt=0.5).is_overdue
    assert not fed(watch, -50.0, 20.0, start_s=longest_s + 20.0).is_overdue


def test_in_reverse_it_resists_the_other_way():
    forward_watch, reverse = (DisturbanceWatch(SPELLS) for _ in range(2))
    ahead = fed(forward_watch, 300.0, 30.0)
    assert fed(reverse, -300.0, 30.0, speed=-8.0) == ahead


@pytest.mark.parametrize("disturbance", [SPELLS, DRIFT])
def test_standstill_and_a_missing_torque_only_age_it(disturbance):
    rest_watch, invalid_watch = (DisturbanceWatch(disturbance) for _ in range(2))
    belief = fed(rest_watch, 250.0, 60.0)
    fed(invalid_watch, 250.0, 60.0)
    fed(invalid_watch, math.nan, 0.1, start_s=60.0)
    times = np.arange(60.0, 1200.0, 30.0)
    torques = [fed(rest_watch, math.nan, 30.0, start_s=t, speed=0.0, dt=0.5).torque_nm for t in times]
    prior = MEAN_NM if disturbance is SPELLS else 0.0
    assert belief.torque_nm > torques[0] > prior
    assert (np.diff(torques) <= 1e-9).all()
    assert torques[-1] == pytest.approx(prior, abs=0.1 * belief.torque_nm)
    assert at_s(invalid_watch, 1199.5).torque_nm == pytest.approx(torques[-1], abs=1e-6)


@pytest.mark.parametrize("disturbance", [SPELLS, DRIFT])
def test_the_rate_of_the_residuals_hardly_matters(disturbance):
    def course(t):
        return 250.0 if 100.0 < t < 200.0 else 0.0

    torques = [fed(DisturbanceWatch(disturbance), course, 160.0, dt=dt).torque_nm for dt in (0.01, 0.1, 1.0)]
    assert torques == pytest.approx([torques[0]] * 3, rel=0.02)


def test_a_drift_is_followed_and_never_taken_for_more_than_one():
    rng, watch = np.random.default_rng(1), DisturbanceWatch(DRIFT)
    belief = fed(watch, lambda t: 120.0 + rng.normal(0.0, 200.0), 600.0)
    assert belief.torque_nm == pytest.approx(120.0, abs=3.0 * belief.std_nm)
    assert belief.std_nm < 40.0
    assert math.isnan(belief.there)
    drift_belief = fed(watch, 1e4, 3600.0, start_s=600.0, dt=0.5)
    assert drift_belief.torque_nm == MOST_DRIFT * DRIFT.size


def test_a_spike_says_little_of_a_drift():
    calm_watch, spike_watch = (DisturbanceWatch(DRIFT) for _ in range(2))
    fed(calm_watch, 50.0, 300.0)
    fed(spike_watch, lambda t: 1e9 if abs(t - 150.0) < 1.0 else 50.0, 300.0)
    assert at_s(spike_watch, 300.0).torque_nm == pytest.approx(at_s(calm_watch, 300.0).torque_nm, abs=DRIFT.noise)


@pytest.mark.parametrize("by_s", [-3600.0, 3600.0])
def test_a_jump_of_the_clock_changes_no_column_of_a_replay(by_s):
    rows = np.zeros((400, len(layout.VEHICLE_COLUMNS)))
    rows[:, layout.Results.residual_nm], rows[:, layout.Results.speed_mps] = 300.0, 8.0
    rows[201, layout.Results.reasons] = layout.Reason.CLOCK_JUMPED
    arrivals = START_NS + 10**8 * np.arange(400)
    stamps = (arrivals, arrivals + (np.arange(400) > 200) * round(by_s * 1e9))
    still, jump_columns = (
        DisturbanceColumns(SimpleNamespace(disturbance=SPELLS)).of(Steps(stamps_ns, arrivals, rows)) for stamps_ns in stamps
    )
    np.testing.assert_array_equal(jump_columns, still)


def test_a_late_residual_is_left_out():
    watch = DisturbanceWatch(SPELLS)
    fed(watch, 300.0, 30.0)
    belief = at_s(watch, 30.0)
    fed(watch, -50.0, 2.0, start_s=25.0)
    assert at_s(watch, 30.0) == belief


STEPS_NS = st.one_of(st.just(10**9), st.integers(-(10**11), 10**12))


@given(st.lists(st.tuples(STEPS_NS, st.floats(allow_nan=True, allow_infinity=True)), max_size=60))
def test_whatever_comes_the_belief_is_one(steps):
    watch, stamp = DisturbanceWatch(SPELLS), START_NS
    for step, residual in steps:
        stamp += step
        belief = watch.take(stamp, residual, 8.0)
        assert 0.0 <= belief.there <= 1.0
        assert SPELLS.rest <= belief.torque_nm <= SPELLS.level
