# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Plausible speeds: a vehicle accelerates at most as its file says, and agrees with its wheels and its odometer."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trackres_ros.estimator import columns as layout
from trackres_ros.estimator.columns import Count, Reason
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.plausible import LONGEST_RUN_NS
from trackres_ros.estimator.settings import Settings
from trackres_ros.vehicle import load

START = 1_700_000_000_000_000_000
S, MS = 1_000_000_000, 1_000_000
VEHICLE = load("xgd24d")
A_MAX = VEHICLE.chassis.max_acceleration
ESTIMATOR = Estimator(VEHICLE)
SLACK = ESTIMATOR.constants.number.speed_slack


class Drive:
    """A session and its messages, one each 20 ms."""

    def __init__(self, estimator=ESTIMATOR):
        self.session, self.now, self.estimates = estimator.session(), START, []
        self.clock = 0  # of the stamps, ahead of the arrivals [ns]

    def send(self, value, name="speed", after=20 * MS):
        self.now += after
        estimate = self.session.handle(self.session.channel(name), self.now + self.clock, self.now, float(value))
        if estimate is not None:
            self.estimates.append((self.now, estimate))
        return estimate

    def along(self, values, after=20 * MS):
        for value in values:
            self.send(value, after=after)
        return self

    @property
    def refused(self):
        return int(self.session.memory.counters[layout.SPEED, Count.IMPLAUSIBLE])

    @property
    def fed(self):
        """The feed-forward as it is published now: it fades where the last accepted speed is old."""
        time_ns, estimate = self.estimates[-1]
        limits = self.session.estimator.settings
        age_s = (self.now - time_ns) * 1e-9
        return estimate.feedforward_torque_nm * min(
            1.0, max(0.0, 1.0 - (age_s - limits.speed_max_age_s) / limits.feedforward_fade_s)
        )

    def held(self, reason):
        return any(estimate.reasons & reason for _, estimate in self.estimates)


# The case of the issue


def test_a_leap_from_standing_for_a_second_feeds_nothing():
    drive = Drive().along([0.0] * 100).along([16.6] * 50)
    assert drive.fed == 0.0
    assert drive.refused == 50
    assert all(estimate.feedforward_torque_nm == 0.0 for _, estimate in drive.estimates)
    drive.along([0.0] * 60)
    assert drive.held(Reason.SPEED_IMPLAUSIBLE)
    assert drive.fed == 0.0


@pytest.mark.parametrize("jump", [5 * S, 100 * S, -100 * S, 10**6 * S])
def test_a_leap_with_a_jump_of_the_clock_waits_as_without(jump):
    drive = Drive().along([0.0] * 100)
    drive.clock = jump
    drive.along([16.6] * round(50 * (16.6 - SLACK) / A_MAX - 1))
    assert len(drive.estimates) == 100
    assert drive.fed == 0.0
    drive.along([16.6] * 2)
    assert drive.estimates[-1][1].row[layout.Results.speed_mps] == 16.6


@pytest.mark.parametrize("every", [1, 5])
def test_a_second_speed_of_another_clock_takes_nothing_over(every):
    drive = Drive().along([0.0] * 100)
    for i in range(500):
        drive.clock = -3600 * S
        drive.send(16.6)
        drive.clock = 0
        if i % every == 0:
            drive.send(0.0, after=1)
    assert all(estimate.row[layout.Results.speed_mps] == 0.0 for _, estimate in drive.estimates)


@pytest.mark.parametrize("pair", [(5.0, 16.5), (5.0, -5.0), (0.0, 16.5), (5.0, 8.0)])
@pytest.mark.parametrize("each", [1, 2, 10, 25])
def test_two_speeds_in_turn_fade_the_feedforward(pair, each):
    drive = Drive().along([pair[0]] * 100)
    for _ in range(2 * 50 // each):
        drive.along([pair[1]] * each).along([pair[0]] * each)
    assert drive.refused > 80
    if abs(pair[1] - pair[0]) > A_MAX * 0.02 * each * 2 + SLACK:
        assert drive.fed == pytest.approx(0.0, abs=1e-9)


def test_one_wrong_speed_costs_three_samples_and_no_feedforward():
    control = Drive().along([8.0 + 0.01 * (i % 3) for i in range(200)])
    drive = Drive().along([8.0 + 0.01 * (i % 3) for i in range(190)]).along([16.0]).along([8.01] * 9)
    assert drive.refused == 3
    assert drive.fed == pytest.approx(control.fed, rel=0.01)
    assert drive.estimates[190][1].reasons & Reason.SPEED_IMPLAUSIBLE
    assert drive.estimates[190][1].status == "warn"
    assert not drive.estimates[191][1].reasons & Reason.SPEED_IMPLAUSIBLE


def test_the_limit_is_the_vehicle_files_and_one_g_without():
    assert replace(VEHICLE.chassis).max_acceleration == VEHICLE.parameters["chassis.max_acceleration"].value
    slow_estimator = Estimator(load("xgd24d", {"chassis.max_acceleration": 4.0}))
    ramp = [5.5 * 0.02 * i for i in range(100)]
    assert Drive().along(ramp).refused == 0
    assert Drive(slow_estimator).along(ramp).refused > 10


# Laws


@settings(max_examples=60)
@given(
    quantum=st.sampled_from([0.0, 1e-3, 1 / 3.6, 0.5]),
    every=st.sampled_from([1 * MS, 20 * MS, 100 * MS, 1000 * MS]),
    repeats=st.integers(1, 5),
    jitter=st.integers(0, 20),
    seed=st.integers(0, 2**31),
)
def test_what_a_vehicle_can_do_is_never_refused(quantum, every, repeats, jitter, seed):
    """Accelerating and braking by 0.8 of the limit, quantised, noisy, repeated by its bus, with stamps that jitter."""
    random = np.random.default_rng(seed)
    drive, speed, sensor_speed, true_ns = Drive(), 0.0, 0.0, START
    refresh = min(repeats, max(1, 100 * MS // every))
    for i in range(200):
        true_ns += every
        accel = 0.8 * A_MAX * math.sin(i * every * 1e-9 / 1.5 + 0.3)
        speed = min(16.0, max(-16.0, speed + accel * every * 1e-9))
        if i % refresh == 0:
            sensor_speed = speed + float(np.clip(random.normal(0.0, 0.02), -0.06, 0.06))
            sensor_speed = round(sensor_speed / quantum) * quantum if quantum else sensor_speed
        stamp = true_ns + int(random.integers(0, min(jitter * MS, every // 2) + 1))
        drive.send(sensor_speed, after=stamp - drive.now)
    assert drive.refused == 0


SPEEDS = st.floats(-20.0, 20.0) | st.sampled_from([0.0, 5.0, -5.0, 16.5, 16.6])
PAUSES = st.sampled_from([1, 20, 100, 1000, 5000])


@settings(max_examples=100)
@given(st.lists(st.tuples(PAUSES, SPEEDS), min_size=2, max_size=60))
def test_accepted_speeds_change_no_faster_than_the_vehicle(messages):
    drive = Drive()
    for pause, speed in messages:
        drive.send(speed, after=pause * MS)
    for (before_ns, last_estimate), (now_ns, estimate) in itertools.pairwise(drive.estimates):
        assert (
            abs(estimate["speed_mps"] - last_estimate["speed_mps"])
            <= A_MAX * (now_ns - before_ns) * 1e-9 + 2 * (SLACK + 1.0) + 1e-9
        )
    counters = drive.session.memory.counters[layout.SPEED]
    assert counters[Count.ACCEPTED] + counters[Count.IMPLAUSIBLE] == len(messages)


@settings(max_examples=60)
@given(st.lists(st.tuples(PAUSES, SPEEDS), max_size=40), st.floats(-20.0, 20.0), st.sampled_from([20, 100, 500]))
def test_a_speed_that_stays_is_accepted_in_the_end(messages, speed, every):
    drive = Drive()
    for pause, false_speed in messages:
        drive.send(false_speed, after=pause * MS)
    longest_ns = LONGEST_RUN_NS + 40.0 / A_MAX * S + 4 * every * MS
    drive.along([speed] * math.ceil(longest_ns / (every * MS)), after=every * MS)
    assert drive.estimates[-1][0] == drive.now
    assert drive.estimates[-1][1]["speed_mps"] == speed


# Wheels and odometer


def with_wheels(speed, wheels, seconds=3.0, every=1):
    drive = Drive()
    for i in range(int(seconds * 50)):
        for place, rim in wheels.items() if i % every == 0 else ():
            drive.send(rim, f"wheel_speed/{place}", after=1)
        drive.send(speed)
    return drive


@pytest.mark.parametrize("every", [1, 10, 50, 500])
@pytest.mark.parametrize(
    ("speed", "wheels", "apart"),
    [
        (8.0, {"front_left": 0.0, "rear_right": 0.0}, True),
        (0.0, {"front_left": 8.0}, True),
        (0.0, {"front_left": 0.0, "rear": 8.0}, False),  # one of them moves: a wheel spins, or one sensor is broken
        (8.0, {"front_left": 8.5, "front_right": 7.5}, False),
        (-8.0, {"front_left": 8.0}, False),  # many wheel speeds have no sign
        (8.0, {"front_left": 5.0, "front_right": 6.8}, False),
        (0.7, {"front_left": 0.0}, False),
    ],
)
def test_a_speed_beyond_all_wheel_speeds_is_not_fed_forward(speed, wheels, apart, every):
    drive = with_wheels(speed, wheels, 3.0 + 0.04 * every, every)
    assert drive.held(Reason.SPEED_DISAGREES) == apart
    assert (drive.estimates[-1][1].feedforward_torque_nm == 0.0) == (apart or speed == 0.0)
    if apart:
        first_ns = next(time_ns for time_ns, estimate in drive.estimates if estimate.reasons & Reason.SPEED_DISAGREES)
        assert (first_ns - START) * 1e-9 == pytest.approx(max(Settings().speed_max_age_s, 0.02 * every), abs=0.05)
        assert all(estimate.reasons & Reason.SPEED_DISAGREES for time_ns, estimate in drive.estimates if time_ns > first_ns)
        drive.along([speed] * 32, after=S)  # no wheel speed for longer than a gap is bridged
        assert not drive.estimates[-1][1].reasons & Reason.SPEED_DISAGREES


@pytest.mark.parametrize("lag", [10 * MS, 400 * MS, 600 * MS, 990 * MS])
@pytest.mark.parametrize("period", [S, 2 * S])
def test_wheels_as_slow_as_the_speed_are_compared_at_any_lag(period, lag):
    drive = Drive(Estimator(VEHICLE, Settings(speed_max_age_s=2.5)))
    for i in range(8):
        drive.send(8.0, after=period - lag)
        drive.send(4.0 if i > 1 else 8.0, "wheel_speed/front_left", after=lag)
        assert bool(drive.estimates[-1][1].reasons & Reason.SPEED_DISAGREES) == (i > 2 and (i - 3) * period > 2.5 * S)


@pytest.mark.parametrize("lag", [10 * MS, 400 * MS, 990 * MS])
@pytest.mark.parametrize("change", [3.0, -6.0])
def test_slow_wheels_agree_while_the_vehicle_changes_its_speed(change, lag):
    drive = Drive(Estimator(VEHICLE, Settings(speed_max_age_s=1.5)))
    for i in range(30):
        drive.send(np.clip(8.0 + change * (i - 20), 0.0, 15.0), after=S - lag)
        drive.send(np.clip(8.0 + change * (i - 20 + lag / S), 0.0, 15.0), "wheel_speed/front_left", after=lag)
    assert not drive.held(Reason.SPEED_DISAGREES)


def test_wheels_disagree_after_a_jump_of_the_clock_too():
    drive = with_wheels(8.0, {"front_left": 0.0})
    drive.clock, count = -30 * S, len(drive.estimates)
    for _ in range(100):
        drive.send(0.0, "wheel_speed/front_left", after=1)
        drive.send(8.0)
    estimates = [estimate for _, estimate in drive.estimates[count:]]
    assert len(estimates) > 90
    assert all(estimate.reasons & Reason.SPEED_DISAGREES for estimate in estimates)


@pytest.mark.parametrize("resolution", [0.0, 1.0, 100.0])
@pytest.mark.parametrize(("odometer", "apart"), [(8.0, False), (7.0, False), (0.5, True), (14.0, True)])
@pytest.mark.parametrize(("pause_s", "began_m", "good_s"), [(0, 12345, 0), (20, 12345, 150), (60, 12345, 150), (1, 300, 150)])
def test_a_speed_against_the_odometer_is_not_fed_forward(resolution, odometer, apart, pause_s, began_m, good_s):
    """It agrees for some time, with a pause in it. One that began at 300 m has a reset then."""
    drive, way = Drive(), float(began_m)
    for i in range((good_s + 300) * 5):
        way += 0.2 * (8.0 if i < good_s * 5 else odometer)
        if i == 60 * 5 and began_m == 300:
            way = 0.0
        if not 0 <= i - 60 * 5 < pause_s * 5:
            drive.send(math.floor(way / resolution) * resolution if resolution else way, "distance", after=1)
        drive.send(8.0, after=200 * MS)
    last_estimate = drive.estimates[-1][1]
    assert drive.held(Reason.SPEED_DISAGREES) == bool(last_estimate.reasons & Reason.SPEED_DISAGREES) == apart
    assert (last_estimate.feedforward_torque_nm == 0.0) == apart
    drive.along([8.0] * 32, after=S)  # no odometer for longer than a gap is bridged
    assert not drive.estimates[-1][1].reasons & Reason.SPEED_DISAGREES


def test_an_odometer_that_counts_back_in_reverse_agrees():
    drive, way = Drive(), 0.0
    for i in range(3000):
        speed = 3.0 * math.sin(i * 0.1 / 10.0)
        way += 0.1 * speed
        drive.send(way, "distance", after=1)
        drive.send(speed, after=100 * MS)
    assert not drive.held(Reason.SPEED_DISAGREES)


# Enable


ENABLED = Estimator(VEHICLE, Settings(enable_hold_s=0.5))


@pytest.mark.parametrize("value", [2.0, -1.0, math.nan])
def test_an_enable_that_is_neither_is_refused(value):
    drive = Drive(ENABLED)
    drive.send(value, "enable")
    drive.along([8.0] * 5)
    assert drive.fed == 0.0
