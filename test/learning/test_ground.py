# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Learning on ground that rises and falls: by an altitude, by an IMU, and by neither; on wheels as on tracks."""

import numpy as np
import pytest

import trackres_ros as tr
from trackres_ros.estimator import columns as layout
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.learning.parameters import HEIGHT, SLOPE, TILT
from trackres_ros.learning.store import write_learned
from trackres_ros.vehicle import load_any

MORE_ROLLING = 0.3


def cruising(t):
    return 14.0 + 9.0 * np.sin(t / 40.0)


@pytest.fixture(scope="module")
def car(road):
    """A car that needs more than its file says, driven for some minutes."""
    estimator = Estimator(load_any("bmw_i3"))

    def drive_car(minutes, slope=None, speed=cruising, **given):
        drive = road("on", {layout.OF_BEARING: MORE_ROLLING}, 3, estimator=estimator, slope=slope, **given)
        return drive.drive(minutes, speed=speed, noise=5.0)

    return drive_car


def rolling_of(driven):
    """Learned rolling coefficient and its standard deviation."""
    s = driven.learner.learned
    return float(s.mean[layout.OF_BEARING]), float(np.sqrt(s.covariance[layout.OF_BEARING, layout.OF_BEARING]))


def hills(way):
    return 0.015 * np.sin(way / 250.0)


def climb(way):
    return 0.004 + 0.01 * np.sin(way / 250.0)


@pytest.fixture(scope="module")
def level(car):
    """A car after 25 minutes on the level."""
    return car(25.0)


def test_a_car_is_learned_on_the_level_and_acts(level):
    assert rolling_of(level)[0] == pytest.approx(MORE_ROLLING, abs=0.05)
    assert level.learner.has_evidence[layout.OF_BEARING]
    true_torque, expected = np.array(level.rows[-1200:]).T[:2]
    assert np.abs(expected - true_torque).mean() < 0.05 * np.abs(true_torque).mean()


def test_unknown_hills_do_not_freeze_learning_or_bias_it_much(car):
    mean, std = rolling_of(car(20.0, hills))
    assert abs(mean - MORE_ROLLING) < 3.0 * std
    assert 0.5 * MORE_ROLLING < mean < 1.5 * MORE_ROLLING


def test_an_altitude_tells_a_climb_from_rolling(car):
    rolling_alone, rolling_altitude = (rolling_of(car(20.0, climb, altitude=noise))[0] for noise in (None, 0.5))
    assert abs(rolling_altitude - MORE_ROLLING) < 0.3 * abs(rolling_alone - MORE_ROLLING)


def test_hills_by_an_altitude_are_no_disturbance(car):
    drive = car(6.0, climb, altitude=0.3)
    for _ in range(20):
        assert drive.drive(0.5, speed=cruising, noise=5.0).learner.disturbance == ""


def test_an_imu_and_an_altitude_find_slope_and_tilt(car):
    drive = car(20.0, climb, altitude=0.5, tilt=0.02)
    state = drive.learner.learned
    assert state.mean[TILT] == pytest.approx(0.02, abs=0.004)
    assert state.mean[SLOPE] == pytest.approx(climb(drive.way), abs=0.006)
    assert state.mean[HEIGHT] == pytest.approx(drive.height - state.ground.zero_m, abs=3.0)


def test_a_slope_that_the_step_knows_is_not_counted_twice(car):
    """With the slope as an input, an altitude that agrees with it leaves no other slope."""
    drive = car(0.0, climb, altitude=0.5)
    handle = drive.session.handle

    def handle_grade(channel, stamp, arrival, value):
        if channel == layout.SPEED:
            handle(layout.GRADE, stamp, arrival, climb(drive.way))
        return handle(channel, stamp, arrival, value)

    drive.session.handle = handle_grade
    drive.drive(10.0, speed=cruising, noise=5.0)
    assert abs(drive.learner.learned.mean[SLOPE]) < 0.002


def test_an_altitude_that_drifts_at_standstill_is_trusted_less(car):
    drive = car(1.0, speed=lambda _t: 0.0, altitude=0.3)
    old_drift = drive.learner.learned.ground.drift
    handle, stop_step = drive.session.handle, drive.steps

    def drifts(channel, stamp, arrival, value):
        return handle(channel, stamp, arrival, value + (0.03 * (drive.steps - stop_step) if channel == layout.ALTITUDE else 0.0))

    drive.session.handle = drifts
    drive.drive(1.0, speed=lambda _t: 0.0, noise=5.0)
    assert drive.learner.learned.ground.drift > 10.0 * old_drift


def test_what_was_learned_of_a_car_becomes_its_file(level, tmp_path):
    file = write_learned(level.learner, level.session.estimator.vehicle, tmp_path / "learned.yaml")
    assert file.written == (tmp_path / "learned.yaml",)
    old_values, new_values = tr.load_vehicle("bmw_i3").values, tr.load_vehicle(tmp_path / "learned.yaml").values
    assert new_values["rolling_coefficient"] == pytest.approx((1.0 + MORE_ROLLING) * old_values["rolling_coefficient"], rel=0.05)
    assert new_values["mass"] == old_values["mass"]
