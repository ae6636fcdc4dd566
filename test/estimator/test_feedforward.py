# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The feed-forward from step to step: its rate over any pauses, nothing at rest, and a standard deviation that is never zero."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trackres_ros.effects.stepping import TERM_COUNT
from trackres_ros.estimator import columns as at
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.feedforward import FEEDFORWARD_STEP_S, approach, feedforward, rate_towards
from trackres_ros.estimator.motion import ROLLS_FROM
from trackres_ros.estimator.plausible import step_towards
from trackres_ros.estimator.records import Inputs
from trackres_ros.estimator.settings import Settings
from trackres_ros.vehicle import load

START_NS = 1_700_000_000_000_000_000
SPEEDS = st.floats(-20.0, 20.0) | st.sampled_from([0.0, 1e-4, 0.05, -0.05, 8.0])
PAUSES_S = st.floats(0.001, 0.1) | st.floats(0.1, 5.0) | st.sampled_from([0.02, 40.0, 1000.0])
RATES = {rate: Estimator(load("xgd24d"), Settings(feedforward_rate=rate)) for rate in (2000.0, 20000.0)}

LIMIT_NM = 5000.0
ANY = st.floats(-1e5, 1e5) | st.sampled_from([math.nan, math.inf, -math.inf])


def rows_of(estimator, steps):
    """Rows of results of speeds after pauses, and the times between them [s]."""
    session, now, rows = estimator.session(), START_NS, []
    for pause, speed in steps:
        now += round(pause * 1e9)
        estimate = session.handle(at.SPEED, now, now, speed)
        if estimate is not None:
            rows.append((now, estimate))
    return rows


def at_speeds(session, enables):
    """The feed-forward at one speed a second, with the enables that come at times [s] in between."""
    found = []
    for now in sorted([*range(10), *enables]):
        now_ns = START_NS + round(now * 1e9)
        if now in enables:
            session.handle(at.ENABLE, now_ns, now_ns, enables[now])
        else:
            found.append(session.handle(at.SPEED, now_ns, now_ns, 8.0))
    return found


@pytest.mark.parametrize("hold", [0.0, 60.0])
def test_a_disable_between_two_speeds_is_in_the_next_step(hold):
    session = Estimator(load("xgd24d"), Settings(enable_hold_s=hold, speed_max_age_s=5.0)).session()
    rows = at_speeds(session, {-0.1: 1.0, 3.1: 0.0, 6.2: 1.0, 6.8: 0.0, 6.9: 1.0})
    fed = [row.feedforward_torque_nm for row in rows]
    disabled = [bool(int(row.reasons) & at.Reason.DISABLED) for row in rows]
    assert disabled == [now in (4, 5, 6) for now in range(10)]
    assert min(fed[1:4]) > 3000.0
    assert fed[4:7] == [0.0] * 3
    assert fed[7] == pytest.approx(20000.0 * FEEDFORWARD_STEP_S)  # its target was zero until this step
    assert min(fed[8:]) > 3000.0


def test_an_enable_that_never_came_is_needed_only_with_a_hold():
    for hold, needed in ((0.0, False), (0.5, True)):
        fed = at_speeds(Estimator(load("xgd24d"), Settings(enable_hold_s=hold, speed_max_age_s=5.0)).session(), {})
        assert (fed[-1].feedforward_torque_nm == 0.0) == needed


def left_of(settings, pause):
    return min(1.0, max(0.0, 1.0 - (pause - settings.speed_max_age_s) / settings.feedforward_fade_s))


@settings(max_examples=60)
@given(st.sampled_from(sorted(RATES)), st.lists(st.tuples(PAUSES_S, SPEEDS), min_size=2, max_size=40))
def test_feedforward_keeps_its_rate_and_resumes_where_it_faded(rate, steps):
    estimator = RATES[rate]
    limit = estimator.constants.number.feedforward_limit
    rows = rows_of(estimator, steps)
    for (before_ns, before), (now_ns, now) in itertools.pairwise(rows):
        pause = (now_ns - before_ns) * 1e-9
        left = left_of(estimator.settings, pause)
        moved = abs(now.feedforward_torque_nm - before.feedforward_torque_nm)
        to_zero = max(rate, limit / estimator.settings.feedforward_fade_s)
        assert moved <= to_zero * pause + (1.0 - left) * limit + 1e-6
        if abs(now.feedforward_torque_nm) > abs(before.feedforward_torque_nm):
            assert moved <= rate * pause + 1e-6
        if left == 0.0:
            assert abs(now.feedforward_torque_nm) <= rate * FEEDFORWARD_STEP_S + 1e-6
        assert abs(now.feedforward_torque_nm) <= limit + 1e-6


@given(ANY, ANY, ANY)
def test_no_way_leads_beyond_its_ends(here, there, room):
    found = step_towards(here, there, room)
    assert found in (here, there) or min(here, there) < found < max(here, there) or math.isnan(here)


TORQUES_NM, TIMES_S = st.floats(-LIMIT_NM, LIMIT_NM), st.floats(0.0, 5.0)


@given(st.sampled_from(sorted(RATES)), TORQUES_NM, TORQUES_NM, TIMES_S, TIMES_S)
def test_its_way_is_one_and_a_wrong_sign_goes_first_and_fast(rate, value, target, first, then):
    number, way = RATES[rate].constants.number, approach
    fast = rate_towards(number, 0.0)
    halfway, found = (way(number, value, target, lasted) for lasted in (first, first + then))
    assert way(number, halfway, target, then) == pytest.approx(found, abs=1e-6)
    assert min(value, target) <= found <= max(value, target)
    gone_s = abs(value) / fast if value * target < 0.0 else 0.0
    if first < gone_s:
        assert abs(value - halfway) == pytest.approx(fast * first)
    else:
        here = 0.0 if gone_s else value
        most = (rate if target else fast) * (first - gone_s)
        assert abs(halfway - here) == pytest.approx(min(most, abs(target - here)), abs=1e-6)


def test_feedforward_keeps_its_limit_whatever_is_no_number():
    """And below the nominal weight it is on its way to less, in proportion to the weight."""
    constants, random = RATES[2000.0].constants, np.random.default_rng(3)
    arms, nominal = (constants.assembly[:, place] for place in (at.Assembly.radius, at.Assembly.nominal_load))
    fed = [name for name in constants.number._fields if name.startswith("feed")]

    def some(count, most=1e5):
        """Numbers, some of them replaced by nan or infinity."""
        found = random.uniform(-most, most, count)
        return np.where(random.random(count) < 0.1, random.choice([math.nan, math.inf, -math.inf], count), found).tolist()

    for _ in range(300):
        motion, total, terms = (np.array(some(count)) for count in (at.Motion.columns, at.PARTS, TERM_COUNT))
        motion[[at.Motion.feedforward, at.Motion.feedforward_target]] = some(2, LIMIT_NM)
        number = constants.number._replace(**dict(zip(fed, some(len(fed)), strict=True)), speed_max_age=some(1)[0])
        limit = random.choice([LIMIT_NM, math.nan, math.inf])
        k = constants._replace(number=number._replace(feedforward_limit=limit))
        of_effects, share, dt = some(3)
        inputs = Inputs(8.0, np.abs(some(4)), 15.0, 2.0, np.zeros(4), acceleration=0.1, grade=0.1, fed=share)
        with np.errstate(invalid="ignore", divide="ignore"):
            moved, _ = feedforward(k, terms, at.Motion(motion), at.Part(total), of_effects, inputs, abs(dt))
        assert abs(moved) <= (math.inf if limit == math.inf else LIMIT_NM)
        present = float(inputs.load @ arms / (nominal @ arms))
        assert not abs(motion[at.Motion.feedforward_target]) > limit * (present if present < 1.0 else 1.0) * (1.0 + 1e-12)


@pytest.mark.parametrize("rate", [1.0, 500.0, 2000.0, 20000.0])
@pytest.mark.parametrize("fade", [0.2, 1.0])
def test_at_standstill_it_is_gone_within_its_fade_at_any_rate(rate, fade):
    estimator = Estimator(load("xgd24d"), Settings(feedforward_rate=20000.0, feedforward_fade_s=fade))
    session = estimator.session()
    braking = [10.0] * 100 + [max(0.0, 10.0 - 0.06 * i) for i in range(167)]
    for i, speed in enumerate(braking):
        session.handle(at.SPEED, START_NS + 20_000_000 * i, START_NS + 20_000_000 * i, speed)
    slower = Estimator(load("xgd24d"), Settings(feedforward_rate=rate, feedforward_fade_s=fade)).session()
    slower.copy_from(session)
    slower.motion[at.Motion.feedforward] = estimator.constants.number.feedforward_limit
    rows = [slower.handle(at.SPEED, now, now, 0.0) for now in (START_NS + 20_000_000 * i for i in range(267, 400))]
    assert all(row.feedforward_torque_nm == 0.0 for row in rows[round(fade * 50) + 1 :])


@settings(max_examples=60)
@given(st.floats(0.5, 20.0), st.floats(0.0, 20.0))
def test_after_any_pause_feedforward_is_one_step_from_its_fade(speed, pause):
    estimator = RATES[2000.0]
    steps = [(0.02, speed)] * 200
    full = rows_of(estimator, steps)[-1][1].feedforward_torque_nm
    again = rows_of(estimator, [*steps, (pause + 0.02, speed)])[-1][1]
    faded = full * left_of(estimator.settings, pause + 0.02)
    assert abs(again.feedforward_torque_nm - faded) <= 2000.0 * FEEDFORWARD_STEP_S + 1.0  # the belt has changed a little too


@pytest.mark.parametrize("quantum", [0.0, 0.05, 1 / 3.6])
@pytest.mark.parametrize("std", [0.02, 0.1])
def test_feedforward_is_exactly_zero_at_rest_under_sensor_noise(quantum, std):
    estimator = Estimator(load("xgd24d"), Settings(speed_std_mps=std))
    noise = np.clip(np.random.default_rng(5).normal(0.0, std, 5000), -ROLLS_FROM * std, ROLLS_FROM * std)
    speeds = np.round(noise / quantum) * quantum if quantum else noise
    fed = [estimate.feedforward_torque_nm for _, estimate in rows_of(estimator, [(0.02, float(v)) for v in speeds])]
    assert fed == [0.0] * 5000
    # After a drive too, once it has come down.
    down = [(0.02, 5.0)] * 100 + [(0.02, float(v)) for v in speeds]
    rows = [estimate.feedforward_torque_nm for _, estimate in rows_of(estimator, down)]
    assert rows[99] > 1000.0
    quiet = rows[100 + 50 :]
    if quantum:
        assert quiet == [0.0] * len(quiet)
    else:  # three standard deviations are passed now and then until it has come to rest once
        assert all(fed == 0.0 for fed in quiet[quiet.index(0.0) :])


def test_at_rest_the_standard_deviation_is_that_of_a_crawl():
    rested, crawling = (rows_of(RATES[20000.0], [(0.02, v)] * 3)[-1][1].resistance_std_nm for v in (0.0, 1e-3))
    assert rested == pytest.approx(crawling, rel=0.05)
    walking = rows_of(RATES[20000.0], [(0.02, 0.2)] * 3)[-1][1].resistance_std_nm
    assert 0.5 * walking < rested < 2.0 * walking
