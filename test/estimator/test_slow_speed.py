# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Age limits follow the period of a slow input within a bound, and a sensor that fails is not believed for having been slow."""

import numpy as np
import pytest

from trackres_ros.estimator import columns as at
from trackres_ros.estimator.columns import Reason
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.settings import Settings, settings_for
from trackres_ros.recording.bindings import Topics
from trackres_ros.vehicle import load

START, S = 1_700_000_000_000_000_000, 1_000_000_000
VEHICLE = load("xgd24d")
ESTIMATOR = Estimator(VEHICLE)


def driven(gaps, estimator=ESTIMATOR, speed=8.0):
    """The steps of a session with a speed after each gap [s]."""
    session, now, found = estimator.session(), START, []
    for gap in gaps:
        now += round(gap * S)
        found.append(session.handle(at.SPEED, now, now, speed))
    return session, found


def age_of(session):
    return max(session.estimator.settings.speed_max_age_s, float(session.motion[at.Motion.longest_age]))


@pytest.mark.parametrize(("hz", "age_s"), [(100.0, 0.5), (4.0, 0.5), (2.0, 0.75), (1.0, 1.5), (0.8, 1.5), (0.3, 1.5)])
def test_the_age_follows_the_period_within_its_bound(hz, age_s):
    session, found = driven([1.0 / hz] * 40)
    assert age_of(session) == pytest.approx(age_s)
    assert bool(Reason(found[-1].reasons) & Reason.SPEED_SLOW) == (age_s > 0.5)


def test_a_speed_of_1_hz_is_fed_forward_without_a_saw():
    _, found = driven([1.0] * 40)
    torques = np.array([one.row[at.Results.feedforward_torque_nm] for one in found[10:]])
    assert torques.min() > 0.97 * torques.max()


@pytest.mark.parametrize("pause_s", [5.0, 100.0, 3600.0])
def test_a_pause_of_a_quick_speed_is_no_period(pause_s):
    session, _ = driven([0.02] * 100 + [pause_s] * 6)
    assert age_of(session) == 0.5


def test_a_slow_speed_that_becomes_quick_is_trusted_no_longer():
    session, _ = driven([1.0] * 40 + [0.05] * 10)
    assert age_of(session) == 0.5


def test_no_gaps_whatever_allow_more_than_the_bound():
    random = np.random.default_rng(3)
    for _ in range(20):
        session, _ = driven(10.0 ** random.uniform(-2.5, 2.0, 50))
        assert age_of(session) <= Settings().slow_input_max_age_s


def test_a_slow_grade_is_used_until_the_next_one():
    estimator = Estimator(VEHICLE, Settings(feedforward_parts=("hysteresis", "grade")))
    session, now = estimator.session(), START
    known = []
    for i in range(400):
        now += S // 10
        if i % 10 == 0:
            session.handle(at.GRADE, now, now, 0.05)
        known.append(session.handle(at.SPEED, now, now, 8.0).row[at.Results.grade_nm] > 0.0)
    assert all(known[100:])
    for _ in range(16):
        now += S // 10
        last = session.handle(at.SPEED, now, now, 8.0)
    assert last.row[at.Results.grade_nm] == 0.0


def test_an_age_limit_of_a_topics_file_is_kept():
    line = {"topic": "/v", "type": "std_msgs/msg/Float64", "field": "data", "max_age_s": 0.3}
    limited = settings_for(Settings(), Topics.parse({"speed": line}))
    session, _ = driven([1.0] * 20, Estimator(VEHICLE, limited))
    assert age_of(session) == 0.3
