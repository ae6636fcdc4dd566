# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Laws of the delay of the torque behind the speed: it shifts with the torque, and is unknown where nothing tells it."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from trackres_ros.estimator.estimator import Estimator
from trackres_ros.learning.columns import LEARNED, learning_values
from trackres_ros.learning.delay import (
    EARLIEST_S,
    FIRST_STD_S,
    LATEST_S,
    SPAN_S,
    WORST_STD_S,
    DelayEstimator,
    KeptDelays,
    window_delay,
)
from trackres_ros.learning.learner import Learner
from trackres_ros.learning.store import learner_content, take_content
from trackres_ros.vehicle import load_any

START_NS = 1_700_000_000_000_000_000
INERTIA, ROLLING_NM = 11_000.0, 3000.0
MOST_SHIFT_S = 0.5


class Drive:
    """A vehicle that sometimes accelerates or slows down, and the estimator's results."""

    def __init__(self, delay, seed=1, rate_hz=20.0, noise_nm=40.0, step_mps=0.03, gain=1.0, changes=True, brakes_nm=None):
        self.random = np.random.default_rng(seed)
        self.delay, self.rate_hz, self.noise_nm, self.step_mps, self.gain = delay, rate_hz, noise_nm, step_mps, gain
        self.brakes_nm = brakes_nm  # friction brakes supply a stronger braking torque
        self.time = np.arange(0.0, 3600.0, 0.05)
        targets = (
            np.repeat(self.random.uniform(4.0, 14.0, 180), 400)[: len(self.time)] if changes else np.full(len(self.time), 8.0)
        )
        self.speed, speed, accel = np.empty(len(self.time)), targets[0], 0.0
        for i, aim in enumerate(targets.tolist()):
            accel += (min(max((aim - speed) / 1.5, -0.6), 0.5) - accel) * 0.05 / 0.6
            speed += accel * 0.05
            self.speed[i] = speed
        self.torque = gain * (ROLLING_NM + INERTIA * np.gradient(self.speed, 0.05))
        if brakes_nm is not None:
            self.torque = np.maximum(self.torque, brakes_nm)
        self.estimator, self.begun = DelayEstimator(ROLLING_NM), 0.0

    def on(self, minutes, torque=lambda torque, _t: torque, ahead_s=0.0):
        """Drive on; `torque` is the sensor's function of one, by its time [s], and its clock is ahead."""
        times = self.begun + np.arange(int(60.0 * minutes * self.rate_hz)) / self.rate_hz
        self.begun += 60.0 * minutes
        speeds = np.round(np.interp(times, self.time, self.speed) / self.step_mps) * self.step_mps
        torques = np.interp(times - self.delay, self.time, self.torque) + self.random.normal(0.0, self.noise_nm, len(times))
        for t, v, nm in zip(times.tolist(), speeds.tolist(), torques.tolist(), strict=True):
            stamp = START_NS + round(t * 1e9)
            self.estimator.take(stamp, v, ROLLING_NM, INERTIA, stamp + round(ahead_s * 1e9), torque(nm, t))
        return self.estimator.kept


@settings(max_examples=6, deadline=None)
@example(delay=-0.15, rate_hz=10.0, seed=0)
@given(delay=st.floats(-0.15, MOST_SHIFT_S), rate_hz=st.sampled_from([5.0, 10.0, 20.0, 50.0]), seed=st.integers(0, 1000))
def test_a_delay_is_found_within_20_ms_in_ten_minutes(delay, rate_hz, seed):
    """A negative one is of a torque ahead of the speed."""
    delays = Drive(delay, seed, rate_hz).on(10.0)
    value, std = delays.value
    assert value == pytest.approx(delay, abs=0.02)
    assert abs(value - delay) < 3.0 * std
    assert delays.is_known


def test_the_stamps_of_the_torque_count_not_when_it_is_seen():
    """A torque that is held while ten speeds come is as late as its own stamp says."""
    drive = Drive(0.3, rate_hz=50.0)
    estimator, sample = drive.estimator, (0, np.nan)
    for i in range(30_000):
        t = i / 50.0
        stamp = START_NS + round(t * 1e9)
        estimator.take(stamp, float(np.interp(t, drive.time, drive.speed)), ROLLING_NM, INERTIA, *sample)
        if i % 10 == 0:
            sample = stamp, float(np.interp(t - 0.3, drive.time, drive.torque))
    assert estimator.kept.value[0] == pytest.approx(0.3, abs=0.01)


@pytest.mark.parametrize("seed", range(2))
def test_without_changes_of_speed_it_stays_unknown(seed):
    delays = Drive(0.3, seed, changes=False).on(15.0)
    assert not delays.is_known
    assert delays.value[1] > 0.5 * FIRST_STD_S


@pytest.mark.parametrize("seed", range(2))
def test_a_torque_of_noise_alone_tells_no_delay(seed):
    random = np.random.default_rng(seed + 50)
    delays = Drive(0.0, seed).on(30.0, lambda _nm, _t: random.normal(ROLLING_NM, 2000.0))
    assert not delays.is_known
    assert delays.value[1] > 0.05


def test_another_vehicles_torque_tells_no_delay():
    other_drive = Drive(0.0, seed=9)
    delays = Drive(0.0, seed=8).on(30.0, lambda _nm, t: float(np.interp(t, other_drive.time, other_drive.torque)))
    assert not delays.is_known


@pytest.mark.parametrize("gain", [-1.0, 0.3])
def test_of_a_torque_of_another_size_or_sense_it_is_unknown(gain):
    assert not Drive(0.2, gain=gain).on(30.0).is_known


def test_the_standard_deviation_falls_with_more_driving():
    drive = Drive(0.2)
    stds = [drive.on(minutes).value[1] for minutes in (0.0, 3.0, 9.0)]
    assert stds[0] == pytest.approx(FIRST_STD_S, rel=1e-3)
    assert stds == sorted(stds, reverse=True)


@given(st.lists(st.tuples(st.floats(0.1, 0.3), st.floats(0.01, 0.1)), min_size=4, max_size=18))
def test_the_same_windows_twice_are_surer_and_say_the_same(windows):
    single, double = KeptDelays(), KeptDelays()
    for delay, std in windows:
        single.add(delay, std**2)
    for delay, std in windows:
        double.add(delay, std**2)
        double.add(delay, std**2)
    if np.count_nonzero(double.variances) == 2 * np.count_nonzero(single.variances) == 2 * len(windows):  # no change was seen
        assert double.value[1] < single.value[1]
        assert double.value[0] == pytest.approx(single.value[0], abs=single.value[1])


def test_friction_brakes_are_no_delay():
    """The motor does not brake at all, and the torque sensor does not see the brakes."""
    assert Drive(0.25, brakes_nm=0.0).on(15.0).value[0] == pytest.approx(0.25, abs=0.02)


def test_another_delay_is_found_anew_and_never_surely_wrong():
    drive = Drive(0.1)
    assert drive.on(10.0).is_known
    drive.delay = 0.3
    for _ in range(20):
        delays = drive.on(0.5)
        value, std = delays.value
        if delays.is_known and drive.begun > 660.0:  # windows until then hold both
            assert min(abs(value - delay) for delay in (0.1, 0.3)) < 3.0 * std
    assert delays.is_known
    assert delays.value[0] == pytest.approx(0.3, abs=0.02)


@pytest.mark.parametrize("torque", [np.nan, 1e300])
def test_torques_that_are_none_leave_it_as_it_was(torque):
    drive = Drive(0.2)
    old_value = drive.on(10.0).value
    with np.errstate(all="ignore"):
        delays = drive.on(3.0, lambda _nm, _t: torque)
    assert delays.value == pytest.approx(old_value, abs=0.01)


@given(
    speed=st.sampled_from([0.0, 8.0, -8.0, 60.0]),
    changes=st.sampled_from([0.0, 1e-9, 0.5, 50.0]),
    inertia=st.sampled_from([0.0, INERTIA]),
    torque=st.sampled_from([0.0, 1e-12, 3000.0, 1e7]),
    like_speed=st.booleans(),
    samples=st.integers(0, 600),
)
def test_any_window_has_a_delay_within_reach_or_none(speed, changes, inertia, torque, like_speed, samples):
    times = np.linspace(0.0, SPAN_S + 1.0, samples)
    speeds = speed + changes * np.sin(times)
    torques = torque * (np.gradient(speeds) if like_speed and samples > 1 else np.ones(samples))
    result = window_delay(
        np.column_stack([times, speeds, np.full((samples, 2), (ROLLING_NM, inertia))]),
        np.column_stack([times, torques]),
        ROLLING_NM,
    )
    if result is not None:
        assert EARLIEST_S < result[0] < LATEST_S
        assert 0.0 <= result[1] < WORST_STD_S**2


def test_gaps_and_time_that_goes_back_cost_a_window_each():
    drive = Drive(0.2)
    for _ in range(20):
        drive.on(1.0)
        drive.begun += 30.0
    assert drive.estimator.kept.value[0] == pytest.approx(0.2, abs=0.02)
    drive.begun -= 300.0
    assert drive.on(3.0).value[0] == pytest.approx(0.2, abs=0.02)
    count = drive.estimator.kept.count
    drive.on(1.0, ahead_s=3600.0)
    assert drive.on(3.0).count > count + 4


def test_at_any_rate_memory_stays_bounded():
    drive = Drive(0.2, rate_hz=400.0)
    drive.on(2.0)
    samples = drive.estimator._samples
    assert max(len(samples.speed), len(samples.torque)) < 3500


def learner_of(road, delay_steps, minutes=8.0, scale=1.0, **vehicle):
    """Values learned of a vehicle with a scaled torque delayed by some steps of 0.1 s."""
    torques = []

    def shown_late(torque, _i):
        torques.append(scale * torque)
        return torques[max(len(torques) - 1 - delay_steps, 0)]

    def speed(t):
        return 8.0 + 3.0 * np.tanh(2.0 * np.sin(t / 4.0)) * np.sin(t / 15.0)

    return road("watch", **vehicle).drive(minutes, shown_late, speed=speed, noise=30.0 * scale).learner


@pytest.fixture(scope="module")
def late(road):
    return learner_of(road, 2)


def test_the_learner_says_it_of_the_estimates_own_torque(late):
    """The expected torque of these drives follows a filtered acceleration, so 0.2 s and what its filter lags come together."""
    names = [learnable.name for learnable in late.learnables]
    value, std, state = learning_values(late)[2 + 3 * names.index("torque_delay") :][:3]
    assert names[-1] == "torque_delay"
    assert state == LEARNED
    assert value > 0.2
    assert std < 0.01


def test_a_torque_two_steps_later_is_two_steps_later(road, late):
    assert late.delay.kept.value[0] - learner_of(road, 0).delay.kept.value[0] == pytest.approx(0.2, abs=0.01)


def test_torque_scale_and_offset_of_a_file_change_no_delay(road):
    car, delays = load_any("bmw_i3"), []
    for scale, offset in ((1.0, 0.0), (0.4, 500.0)):
        scaled = replace(car, values={**car.values, "torque_scale": scale, "torque_offset": offset})
        delays.append(learner_of(road, 2, 3.0, scale, estimator=Estimator(scaled)).delay.kept)
    assert delays[1].count == delays[0].count > 5
    np.testing.assert_allclose(delays[1].delays, delays[0].delays, atol=1e-6)


def test_it_is_kept_over_a_restart_but_to_be_confirmed(reference, late):
    copy = Learner(reference)
    take_content(copy, json.loads(json.dumps(learner_content(late))))
    assert copy.delay.kept.value == late.delay.kept.value
    assert copy.delay.kept.is_known
    copy.age_values(3600.0)
    assert copy.delay.kept.value == late.delay.kept.value
    assert not copy.delay.kept.is_known
