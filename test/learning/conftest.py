# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Drives of a vehicle whose own model is the truth, but for departures that its file does not have."""

import numpy as np
import pytest

from trackres_ros.estimator import columns as layout
from trackres_ros.learning.columns import LearningColumns
from trackres_ros.learning.learner import Learner
from trackres_ros.units import GRAVITY

START_NS = 1_700_000_000_000_000_000
STEP_NS = 100_000_000


class Road:
    """One driven vehicle, and its learner. `true` are departures that the file does not have, `slope` is the ground's by the way.

    `altitude` is the noise of an altimeter [m], `tilt` that of an IMU against the vehicle's axis.
    """

    def __init__(self, estimator, mode="watch", true=None, seed=1, slope=None, altitude=None, tilt=None):
        self.true = estimator.session()
        self.true.learned[layout.Learned.on] = 1.0
        for index, departure in (true or {}).items():
            layout.Learned(self.true.learned).departures[index] = departure
        self.session, self.learner = estimator.session(), Learner(estimator, mode)
        self.columns = LearningColumns(self.learner)
        self.random, self.steps, self.rows = np.random.default_rng(seed), 0, []
        self.said = set()
        self.ahead_ns = 0  # of the stamps
        self.slope, self.altitude, self.tilt, self.way, self.height = slope, altitude, tilt, 0.0, 500.0

    def drive(self, minutes, shown=lambda torque, i: torque, speed=lambda t: 8.0 + 6.0 * np.sin(t / 60.0), noise=30.0):
        """Drive on; `shown` is the sensor's function of a torque, by the number of the step since here."""
        for i in range(round(minutes * 600.0)):
            stamp, time = START_NS + self.steps * STEP_NS, self.steps * 0.1
            self.steps += 1
            speed_now, slope = (
                float(speed(time)),
                float(self.slope(self.way)) if self.slope else 0.0,
            )  # others are converted slowly
            self.way += 0.1 * speed_now
            self.height += 0.1 * speed_now * slope
            if self.slope:
                self.true.handle(layout.GRADE, stamp, stamp, slope)
            truth = self.true.handle(layout.SPEED, stamp, stamp, speed_now)
            arrival, stamp = stamp, stamp + self.ahead_ns
            torque = shown(truth["drive_torque_nm"], i)
            if torque is not None:
                self.session.handle(layout.TORQUE, stamp, arrival, float(torque + self.random.normal(0.0, noise)))
            if self.altitude is not None and self.steps % 10 == 0:
                self.session.handle(layout.ALTITUDE, stamp, arrival, float(self.height + self.random.normal(0.0, self.altitude)))
            if self.tilt is not None:
                specific_force = GRAVITY * (slope + self.tilt) + truth["accel_mps2"] + self.random.normal(0.0, 0.3)
                self.session.handle(layout.SPECIFIC_FORCE, stamp, arrival, float(specific_force))
            estimate = self.session.handle(layout.SPEED, stamp, arrival, speed_now)
            if estimate is None:  # until a jump of the clock is confirmed
                continue
            row = estimate.row.tolist()
            self.learner.take(stamp, row, self.session)
            torque_with = self.columns.row_values(row, self.session)[0]
            self.rows.append((truth["resistance_torque_nm"], estimate["resistance_torque_nm"], torque_with))
            if self.learner.freeze_reason:
                self.said.add(self.learner.freeze_reason.split(":")[0])
        return self

    def errors(self, minutes):
        """Mean error of the last minutes, without and with learned values, over the torque."""
        rows = np.array(self.rows[-round(minutes * 600.0) :])
        return [float(np.abs(rows[:, i] - rows[:, 0]).mean() / np.abs(rows[:, 0]).mean()) for i in (1, 2)]


@pytest.fixture(scope="session")
def road(reference):
    """`road(mode, true, seed)`: a vehicle to be driven, by default the reference vehicle."""
    return lambda *given, estimator=reference, **named: Road(estimator, *given, **named)
