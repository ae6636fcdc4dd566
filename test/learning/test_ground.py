# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Learning on ground that rises and falls: by an altitude, by an IMU, and by neither; on wheels as on tracks."""

import numpy as np
import pytest

import trackres_ros as tr
from trackres_ros.estimator import columns as at
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.learning.learner import Learner
from trackres_ros.learning.parameters import HEIGHT, SLOPE, TILT
from trackres_ros.learning.vehicle_file import write_learned
from trackres_ros.vehicle import load_any

START_NS, STEP_NS = 1_700_000_000_000_000_000, 100_000_000
MORE_ROLLING = 0.3


class Drive:
    """A car that needs more than its file says, on ground with a slope by the way [m]."""

    def __init__(self, slope=lambda _way: 0.0, mode="on", altitude=None, tilt=None, seed=3):
        self.estimator = Estimator(load_any("bmw_i3"))
        self.true, self.session = self.estimator.session(), self.estimator.session()
        self.true.learned[at.Learned.on] = 1.0
        at.Learned(self.true.learned).departures[at.OF_BEARING] = MORE_ROLLING
        self.learner = Learner(self.estimator, mode)
        self.slope, self.altitude, self.tilt = slope, altitude, tilt
        self.random, self.steps, self.way, self.height, self.rows = np.random.default_rng(seed), 0, 0.0, 500.0, []

    def drive(self, minutes, speed=lambda t: 14.0 + 9.0 * np.sin(t / 40.0)):
        """Drive on; keeps true and expected resistance."""
        for _ in range(round(minutes * 600.0)):
            stamp, time = START_NS + self.steps * STEP_NS, 0.1 * self.steps
            self.steps += 1
            now, slope = speed(time), self.slope(self.way)
            self.way += 0.1 * now
            self.height += 0.1 * now * slope
            self.true.handle(at.GRADE, stamp, stamp, slope)
            truth = self.true.handle(at.SPEED, stamp, stamp, now)
            self.session.handle(at.TORQUE, stamp, stamp, truth["drive_torque_nm"] + self.random.normal(0.0, 5.0))
            if self.altitude is not None and self.steps % 10 == 0:
                self.session.handle(at.ALTITUDE, stamp, stamp, self.height + self.random.normal(0.0, self.altitude))
            if self.tilt is not None:
                felt = 9.80665 * (slope + self.tilt) + truth["accel_mps2"] + self.random.normal(0.0, 0.3)
                self.session.handle(at.SPECIFIC_FORCE, stamp, stamp, felt)
            estimate = self.session.handle(at.SPEED, stamp, stamp, now)
            self.learner.take(stamp, estimate.row.tolist(), self.session)
            self.rows.append((truth["resistance_torque_nm"], estimate["resistance_torque_nm"]))
        return self

    @property
    def rolling(self):
        """Learned rolling coefficient and its standard deviation."""
        s = self.learner.learned
        return float(s.mean[at.OF_BEARING]), float(np.sqrt(s.covariance[at.OF_BEARING, at.OF_BEARING]))


def hills(way):
    return 0.015 * np.sin(way / 250.0)


def climb(way):
    return 0.004 + 0.01 * np.sin(way / 250.0)


@pytest.fixture(scope="module")
def level():
    """A car after 25 minutes on the level."""
    return Drive().drive(25.0)


def test_a_car_is_learned_on_the_level_and_acts(level):
    assert level.rolling[0] == pytest.approx(MORE_ROLLING, abs=0.05)
    assert level.learner.counted[at.OF_BEARING]
    true, expected = np.array(level.rows[-1200:]).T
    assert np.abs(expected - true).mean() < 0.05 * np.abs(true).mean()


def test_unknown_hills_do_not_freeze_learning_or_bias_it_much():
    driven = Drive(hills).drive(20.0)
    mean, std = driven.rolling
    assert abs(mean - MORE_ROLLING) < 3.0 * std
    assert 0.5 * MORE_ROLLING < mean < 1.5 * MORE_ROLLING


def test_an_altitude_tells_a_climb_from_rolling():
    without, with_it = Drive(climb).drive(20.0), Drive(climb, altitude=0.5).drive(20.0)
    assert abs(with_it.rolling[0] - MORE_ROLLING) < 0.3 * abs(without.rolling[0] - MORE_ROLLING)


def test_an_imu_and_an_altitude_find_slope_and_tilt():
    driven = Drive(climb, altitude=0.5, tilt=0.02).drive(20.0)
    state = driven.learner.learned
    assert state.mean[TILT] == pytest.approx(0.02, abs=0.004)
    assert state.mean[SLOPE] == pytest.approx(climb(driven.way), abs=0.006)
    assert state.mean[HEIGHT] == pytest.approx(driven.height - state.ground.zero_m, abs=3.0)


def test_a_slope_that_the_step_knows_is_not_counted_twice():
    """With the slope as an input, an altitude that agrees with it leaves no other slope."""
    driven = Drive(climb, altitude=0.5)
    handle = driven.session.handle

    def told(channel, stamp, arrival, value):
        if channel == at.SPEED:
            handle(at.GRADE, stamp, arrival, climb(driven.way))
        return handle(channel, stamp, arrival, value)

    driven.session.handle = told
    driven.drive(10.0)
    assert abs(driven.learner.learned.mean[SLOPE]) < 0.002


def test_an_altitude_that_drifts_at_standstill_is_trusted_less():
    driven = Drive(altitude=0.3).drive(1.0, lambda _t: 0.0)
    before = driven.learner.learned.ground.drift
    handle, stood = driven.session.handle, driven.steps

    def drifts(channel, stamp, arrival, value):
        return handle(channel, stamp, arrival, value + (0.03 * (driven.steps - stood) if channel == at.ALTITUDE else 0.0))

    driven.session.handle = drifts
    driven.drive(1.0, lambda _t: 0.0)
    assert driven.learner.learned.ground.drift > 10.0 * before


def test_nothing_pushes_a_car_that_stands_whatever_was_learned():
    driven = Drive(hills, altitude=0.5).drive(15.0)
    begins = 0.1 * driven.steps
    fastest = 14.0 + 9.0 * np.sin(begins / 40.0)
    driven.drive(0.5, lambda t: max(0.0, fastest - 2.0 * (t - begins)))
    assert driven.rows[-1][1] == 0.0
    assert driven.session.motion[at.Motion.feedforward] == 0.0


def test_what_was_learned_of_a_car_becomes_its_file(level, tmp_path):
    file = write_learned(level.learner, level.estimator.vehicle, tmp_path / "learned.yaml")
    assert file.written == (tmp_path / "learned.yaml",)
    before, after = tr.load_vehicle("bmw_i3").values, tr.load_vehicle(tmp_path / "learned.yaml").values
    assert after["rolling_coefficient"] == pytest.approx((1.0 + MORE_ROLLING) * before["rolling_coefficient"], rel=0.05)
    assert after["mass"] == before["mass"]
