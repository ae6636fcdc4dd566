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
from trackres_ros.estimator import columns as layout
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
    session, time_ns, rows = estimator.session(), START_NS, []
    for pause, speed in steps:
        time_ns += round(pause * 1e9)
        estimate = session.handle(layout.SPEED, time_ns, time_ns, speed)
        if estimate is not None:
            rows.append((time_ns, estimate))
    return rows


def at_speeds(session, enables):
    """The feed-forward at one speed a second, with the enables that come at times [s] in between."""
    estimates = []
    for time_s in sorted([*range(10), *enables]):
        now_ns = START_NS + round(time_s * 1e9)
        if time_s in enables:
            session.handle(layout.ENABLE, now_ns, now_ns, enables[time_s])
        else:
            estimates.append(session.handle(layout.SPEED, now_ns, now_ns, 8.0))
    return estimates


@pytest.mark.parametrize("hold", [0.0, 60.0])
def test_a_disable_between_two_speeds_is_in_the_next_step(hold):
    session = Estimator(load("xgd24d"), Settings(enable_hold_s=hold, speed_max_age_s=5.0)).session()
    rows = at_speeds(session, {-0.1: 1.0, 3.1: 0.0, 6.2: 1.0, 6.8: 0.0, 6.9: 1.0})
    torques = [row.feedforward_torque_nm for row in rows]
    is_disabled = [bool(int(row.reasons) & layout.Reason.DISABLED) for row in rows]
    assert is_disabled == [second in (4, 5, 6) for second in range(10)]
    assert min(torques[1:4]) > 3000.0
    assert torques[4:7] == [0.0] * 3
    assert torques[7] == pytest.approx(20000.0 * FEEDFORWARD_STEP_S)  # its target was zero until this step
    assert min(torques[8:]) > 3000.0


def test_an_enable_that_never_came_is_needed_only_with_a_hold():
    for hold, is_needed in ((0.0, False), (0.5, True)):
        estimates = at_speeds(Estimator(load("xgd24d"), Settings(enable_hold_s=hold, speed_max_age_s=5.0)).session(), {})
        assert (estimates[-1].feedforward_torque_nm == 0.0) == is_needed


def left_of(settings, pause):
    return min(1.0, max(0.0, 1.0 - (pause - settings.speed_max_age_s) / settings.feedforward_fade_s))


@settings(max_examples=60)
@given(st.sampled_from(sorted(RATES)), st.lists(st.tuples(PAUSES_S, SPEEDS), min_size=2, max_size=40))
def test_feedforward_keeps_its_rate_and_resumes_where_it_faded(rate, steps):
    estimator = RATES[rate]
    limit = estimator.constants.number.feedforward_limit
    rows = rows_of(estimator, steps)
    for (before_ns, last_estimate), (now_ns, estimate) in itertools.pairwise(rows):
        pause = (now_ns - before_ns) * 1e-9
        share = left_of(estimator.settings, pause)
        change = abs(estimate.feedforward_torque_nm - last_estimate.feedforward_torque_nm)
        to_zero = max(rate, limit / estimator.settings.feedforward_fade_s)
        assert change <= to_zero * pause + (1.0 - share) * limit + 1e-6
        if abs(estimate.feedforward_torque_nm) > abs(last_estimate.feedforward_torque_nm):
            assert change <= rate * pause + 1e-6
        if share == 0.0:
            assert abs(estimate.feedforward_torque_nm) <= rate * FEEDFORWARD_STEP_S + 1e-6
        assert abs(estimate.feedforward_torque_nm) <= limit + 1e-6


@given(ANY, ANY, ANY)
def test_no_way_leads_beyond_its_ends(here, there, room):
    end = step_towards(here, there, room)
    assert end in (here, there) or min(here, there) < end < max(here, there) or math.isnan(here)


TORQUES_NM, TIMES_S = st.floats(-LIMIT_NM, LIMIT_NM), st.floats(0.0, 5.0)


@given(st.sampled_from(sorted(RATES)), TORQUES_NM, TORQUES_NM, TIMES_S, TIMES_S)
def test_its_way_is_one_and_a_wrong_sign_goes_first_and_fast(rate, value, target, first, then):
    number, way = RATES[rate].constants.number, approach
    zero_rate = rate_towards(number, 0.0)
    halfway, end = (way(number, value, target, seconds) for seconds in (first, first + then))
    assert way(number, halfway, target, then) == pytest.approx(end, abs=1e-6)
    assert min(value, target) <= end <= max(value, target)
    gone_s = abs(value) / zero_rate if value * target < 0.0 else 0.0
    if first < gone_s:
        assert abs(value - halfway) == pytest.approx(zero_rate * first)
    else:
        start = 0.0 if gone_s else value
        longest_way = (rate if target else zero_rate) * (first - gone_s)
        assert abs(halfway - start) == pytest.approx(min(longest_way, abs(target - start)), abs=1e-6)


def test_feedforward_keeps_its_limit_whatever_is_no_number():
    """And below the nominal weight it is on its way to less, in proportion to the weight."""
    constants, random = RATES[2000.0].constants, np.random.default_rng(3)
    arms, nominal = (constants.assembly[:, place] for place in (layout.Assembly.radius, layout.Assembly.nominal_load))
    names = [name for name in constants.number._fields if name.startswith("feed")]

    def odd_numbers(count, bound=1e5):
        """Numbers, some of them replaced by nan or infinity."""
        numbers = random.uniform(-bound, bound, count)
        return np.where(random.random(count) < 0.1, random.choice([math.nan, math.inf, -math.inf], count), numbers).tolist()

    for _ in range(300):
        motion, total, terms = (np.array(odd_numbers(count)) for count in (layout.Motion.columns, layout.PARTS, TERM_COUNT))
        motion[[layout.Motion.feedforward, layout.Motion.feedforward_target]] = odd_numbers(2, LIMIT_NM)
        number = constants.number._replace(
            **dict(zip(names, odd_numbers(len(names)), strict=True)), speed_max_age=odd_numbers(1)[0]
        )
        limit = random.choice([LIMIT_NM, math.nan, math.inf])
        k = constants._replace(number=number._replace(feedforward_limit=limit))
        of_effects, share, dt = odd_numbers(3)
        inputs = Inputs(8.0, np.abs(odd_numbers(4)), 15.0, 2.0, np.zeros(4), acceleration=0.1, grade=0.1, fed=share)
        with np.errstate(invalid="ignore", divide="ignore"):
            output, _ = feedforward(k, terms, layout.Motion(motion), layout.Part(total), of_effects, inputs, abs(dt))
        assert abs(output) <= (math.inf if limit == math.inf else LIMIT_NM)
        load_share = float(inputs.load @ arms / (nominal @ arms))
        assert not abs(motion[layout.Motion.feedforward_target]) > limit * (load_share if load_share < 1.0 else 1.0) * (
            1.0 + 1e-12
        )


@pytest.mark.parametrize("rate", [1.0, 500.0, 2000.0, 20000.0])
@pytest.mark.parametrize("fade", [0.2, 1.0])
def test_at_standstill_it_is_gone_within_its_fade_at_any_rate(rate, fade):
    estimator = Estimator(load("xgd24d"), Settings(feedforward_rate=20000.0, feedforward_fade_s=fade))
    session = estimator.session()
    speeds = [10.0] * 100 + [max(0.0, 10.0 - 0.06 * i) for i in range(167)]
    for i, speed in enumerate(speeds):
        session.handle(layout.SPEED, START_NS + 20_000_000 * i, START_NS + 20_000_000 * i, speed)
    slow_session = Estimator(load("xgd24d"), Settings(feedforward_rate=rate, feedforward_fade_s=fade)).session()
    slow_session.copy_from(session)
    slow_session.motion[layout.Motion.feedforward] = estimator.constants.number.feedforward_limit
    rows = [
        slow_session.handle(layout.SPEED, time_ns, time_ns, 0.0)
        for time_ns in (START_NS + 20_000_000 * i for i in range(267, 400))
    ]
    assert all(row.feedforward_torque_nm == 0.0 for row in rows[round(fade * 50) + 1 :])


@settings(max_examples=60)
@given(st.floats(0.5, 20.0), st.floats(0.0, 20.0))
def test_after_any_pause_feedforward_is_one_step_from_its_fade(speed, pause):
    estimator = RATES[2000.0]
    steps = [(0.02, speed)] * 200
    full_torque = rows_of(estimator, steps)[-1][1].feedforward_torque_nm
    estimate = rows_of(estimator, [*steps, (pause + 0.02, speed)])[-1][1]
    faded_torque = full_torque * left_of(estimator.settings, pause + 0.02)
    assert (
        abs(estimate.feedforward_torque_nm - faded_torque) <= 2000.0 * FEEDFORWARD_STEP_S + 1.0
    )  # the belt has changed a little too


@pytest.mark.parametrize("quantum", [0.0, 0.05, 1 / 3.6])
@pytest.mark.parametrize("std", [0.02, 0.1])
def test_feedforward_is_exactly_zero_at_rest_under_sensor_noise(quantum, std):
    estimator = Estimator(load("xgd24d"), Settings(speed_std_mps=std))
    noise = np.clip(np.random.default_rng(5).normal(0.0, std, 5000), -ROLLS_FROM * std, ROLLS_FROM * std)
    speeds = np.round(noise / quantum) * quantum if quantum else noise
    torques = [estimate.feedforward_torque_nm for _, estimate in rows_of(estimator, [(0.02, float(v)) for v in speeds])]
    assert torques == [0.0] * 5000
    # After a drive too, once it has come down.
    steps = [(0.02, 5.0)] * 100 + [(0.02, float(v)) for v in speeds]
    rows = [estimate.feedforward_torque_nm for _, estimate in rows_of(estimator, steps)]
    assert rows[99] > 1000.0
    rest_torques = rows[100 + 50 :]
    if quantum:
        assert rest_torques == [0.0] * len(rest_torques)
    else:  # three standard deviations are passed now and then until it has come to rest once
        assert all(torques == 0.0 for torques in rest_torques[rest_torques.index(0.0) :])


def test_at_rest_the_standard_deviation_is_that_of_a_crawl():
    rest_std, crawl_std = (rows_of(RATES[20000.0], [(0.02, v)] * 3)[-1][1].resistance_std_nm for v in (0.0, 1e-3))
    assert rest_std == pytest.approx(crawl_std, rel=0.05)
    walk_std = rows_of(RATES[20000.0], [(0.02, 0.2)] * 3)[-1][1].resistance_std_nm
    assert 0.5 * walk_std < rest_std < 2.0 * walk_std
