# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A load changes at standstill or slowly: a jump while driving moves no torque until it has lasted, and a held load ages."""

import numpy as np
import pytest

from trackres_ros.estimator import columns as layout
from trackres_ros.estimator.columns import Count, Reason
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.plausible import FRESH_LOAD_NS, LOAD_LASTS_NS, LOAD_SLACK
from trackres_ros.vehicle import load

START = 1_700_000_000_000_000_000
S, MS = 1_000_000_000, 1_000_000
ESTIMATOR = Estimator(load("xgd24d"))
NOMINAL = float(sum(ESTIMATOR.vehicle.nominal_loads()))
FRONT = 0.5 * NOMINAL


class Drive:
    """A session with a speed and a load each 0.1 s."""

    def __init__(self, channel="load"):
        self.session, self.now, self.channel = ESTIMATOR.session(), START, channel

    def send(self, name, value):
        return self.session.handle(self.session.channel(name), self.now, self.now, float(value))

    def along(self, seconds, carried, speed=8.0):
        for _ in range(round(10 * seconds)):
            self.now += 100 * MS
            self.send("ambient", 20.0)
            if carried is not None:
                self.send(self.channel, carried)
            self.last = self.send("speed", speed)
        return self.last

    @property
    def weight(self):
        return self.last.row[layout.Results.weight_n]

    @property
    def fed(self):
        return self.last.row[layout.Results.feedforward_torque_nm]

    @property
    def std(self):
        return self.last.row[layout.Results.resistance_std_nm]

    @property
    def reasons(self):
        return Reason(self.last.reasons)

    @property
    def refused(self):
        return int(self.session.memory.counters[self.session.channel(self.channel), Count.IMPLAUSIBLE])


@pytest.mark.parametrize(("channel", "nominal"), [("load", NOMINAL), ("load/front", FRONT), ("passengers", 0.0)])
def test_a_jump_while_driving_moves_no_torque_and_is_named(channel, nominal):
    wrong_load = 1.8 * nominal or 400.0
    drive, control = Drive(channel), Drive(channel)
    for run, end_load in ((drive, wrong_load), (control, nominal)):
        run.along(20, nominal)
        run.along(0.2, end_load)
        run.along(5, None)  # loads stop
    assert drive.fed == control.fed
    assert drive.reasons & Reason.LOAD_DOUBTED
    assert not control.reasons & Reason.LOAD_DOUBTED
    assert drive.refused == 2
    assert drive.std > 1.5 * control.std
    drive.along(2, nominal)
    assert not drive.reasons & Reason.LOAD_DOUBTED


@pytest.mark.parametrize("share", [0.5, 1.8])
def test_a_jump_that_lasts_is_believed(share):
    drive = Drive()
    drive.along(20, NOMINAL)
    drive.along(LOAD_LASTS_NS / S - 0.2, share * NOMINAL)
    assert drive.weight == pytest.approx(NOMINAL)
    drive.along(1.0, share * NOMINAL)
    assert drive.weight == pytest.approx(share * NOMINAL)
    assert not drive.reasons & Reason.LOAD_DOUBTED


def test_two_loads_in_turn_are_never_believed():
    drive = Drive()
    drive.along(20, NOMINAL)
    for _ in range(40):
        drive.along(0.5, 1.8 * NOMINAL)
        drive.along(0.5, 0.5 * NOMINAL)
    assert drive.weight == pytest.approx(NOMINAL)


def test_a_load_at_standstill_counts_at_once():
    drive = Drive()
    drive.along(10, NOMINAL)
    drive.along(2, NOMINAL, speed=0.0)
    drive.along(0.1, 1.6 * NOMINAL, speed=0.0)
    assert drive.weight == pytest.approx(1.6 * NOMINAL)
    assert drive.refused == 0


def test_the_first_load_of_a_vehicle_that_drives_counts_at_once():
    drive = Drive()
    drive.along(10, None)
    drive.along(0.1, 1.6 * NOMINAL)
    assert drive.weight == pytest.approx(1.6 * NOMINAL)


def test_noise_and_a_tank_that_fills_are_not_doubted():
    drive, random = Drive(), np.random.default_rng(1)
    for i in range(900):
        tank_load = NOMINAL * (1.0 + 0.2 * i / 900.0)
        drive.along(0.1, tank_load * (1.0 + 0.15 * random.uniform(-1.0, 1.0)))
    assert drive.refused == 0


def test_a_held_load_grows_uncertain_and_then_a_warning():
    drive, control = Drive(), Drive()
    drive.along(20, NOMINAL)
    control.along(20, NOMINAL)
    shares, reasons = [], []
    for _ in range(70):
        drive.along(1.0, None)
        control.along(1.0, NOMINAL)
        row = control.last.row
        rolling = row[layout.Results.hysteresis_nm] + row[layout.Results.bearing_nm]
        shares.append(np.sqrt(drive.std**2 - control.std**2) / rolling)
        reasons.append(drive.reasons)
    age_s = int(FRESH_LOAD_NS / S) + 1
    assert max(shares[: age_s - 1]) == 0.0
    assert all(np.diff(shares[age_s:]) > -1e-9)
    assert shares[-1] == pytest.approx(LOAD_SLACK, rel=1e-6)
    assert drive.fed == pytest.approx(control.fed, rel=1e-9)
    assert not reasons[0] & Reason.LOAD_HELD
    assert reasons[10] & (Reason.LOAD_HELD | Reason.LOAD_OLD | Reason.LOAD_NOMINAL) == Reason.LOAD_HELD
    assert reasons[50] & Reason.LOAD_OLD
    assert reasons[-1] & Reason.LOAD_NOMINAL


def test_without_any_load_the_uncertainty_is_as_before():
    drive = Drive()
    drive.along(20, None)
    assert drive.reasons & Reason.LOAD_NOMINAL
    assert drive.session.memory.runs[layout.LOAD].tolist() == pytest.approx([np.nan] * 2, nan_ok=True)
    nominal_drive = Drive()
    nominal_drive.along(20, NOMINAL)
    assert drive.std == pytest.approx(nominal_drive.std)
