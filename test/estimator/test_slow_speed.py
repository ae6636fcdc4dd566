# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Age limits follow the period of a slow input within a bound, and a sensor that fails is not believed for having been slow."""

import numpy as np
import pytest

from trackres_ros.estimator import columns as layout
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
    session, time_ns, estimates = estimator.session(), START, []
    for gap in gaps:
        time_ns += round(gap * S)
        estimates.append(session.handle(layout.SPEED, time_ns, time_ns, speed))
    return session, estimates


def age_of(session):
    return max(session.estimator.settings.speed_max_age_s, float(session.motion[layout.Motion.longest_age]))


@pytest.mark.parametrize(("hz", "age_s"), [(100.0, 0.5), (4.0, 0.5), (2.0, 0.75), (1.0, 1.5), (0.8, 1.5), (0.3, 1.5)])
def test_the_age_follows_the_period_within_its_bound(hz, age_s):
    session, estimates = driven([1.0 / hz] * 40)
    assert age_of(session) == pytest.approx(age_s)
    assert bool(Reason(estimates[-1].reasons) & Reason.SPEED_SLOW) == (age_s > 0.5)


def test_a_speed_of_1_hz_is_fed_forward_without_a_saw():
    _, estimates = driven([1.0] * 40)
    torques = np.array([estimate.row[layout.Results.feedforward_torque_nm] for estimate in estimates[10:]])
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
    session, time_ns = estimator.session(), START
    has_grade = []
    for i in range(400):
        time_ns += S // 10
        if i % 10 == 0:
            session.handle(layout.GRADE, time_ns, time_ns, 0.05)
        has_grade.append(session.handle(layout.SPEED, time_ns, time_ns, 8.0).row[layout.Results.grade_nm] > 0.0)
    assert all(has_grade[100:])
    for _ in range(16):
        time_ns += S // 10
        last_estimate = session.handle(layout.SPEED, time_ns, time_ns, 8.0)
    assert last_estimate.row[layout.Results.grade_nm] == 0.0


def test_an_age_limit_of_a_topics_file_is_kept():
    line = {"topic": "/v", "type": "std_msgs/msg/Float64", "field": "data", "max_age_s": 0.3}
    settings = settings_for(Settings(), Topics.parse({"speed": line}))
    session, _ = driven([1.0] * 20, Estimator(VEHICLE, settings))
    assert age_of(session) == 0.3
