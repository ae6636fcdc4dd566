# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Enable, fade and rate of the exported C hold in the time that its caller has passed, whatever that is; a bad one is refused."""

import math
from fractions import Fraction

import numpy as np
import pytest
from built import Built, have
from hypothesis import example, given, settings
from hypothesis import strategies as st

import trackres_ros as tr
from trackres_ros.errors import InputError
from trackres_ros.estimator import columns as at
from trackres_ros.estimator.settings import Settings

pytestmark = pytest.mark.skipif(not have("gcc"), reason="gcc is not installed")

WEEK = 604800.0
STEPPED, WAITED, BAD_TIME = 1, 0, -2
OK, STALE = 0, 3
RATE, HOLD_S, MAX_AGE_S, FADE_S, AT_ONCE_S = 1000.0, 0.3, 0.5, 1.0, 0.02
BAD = (
    math.nan,
    math.inf,
    -math.inf,
    -5e-324,
    -1e-12,
    -0.01,
    -0.88,
    -5.0,
    -1e9,
    math.nextafter(WEEK, math.inf),
    4294967.295,
    1e300,
)
GOOD = (0.0, -0.0, 1e-12, 2.9e-10, 1e-6, 0.001, 0.01, 0.02, 0.1, 0.31, 0.7, 3600.0, WEEK)


class OutputFilter:
    """The feed-forward as docs/export.md describes it, of a vehicle that drives forward: times in whole nanoseconds."""

    def __init__(self, to_zero):
        self.to_zero = to_zero  # Nm/s
        self.passed = Fraction(0)  # s
        self.value = self.target = 0.0
        self.moved_until = self.speed_at = self.enabled_until = 0
        self.driven = False

    @property
    def now(self):
        return round(self.passed * 10**9)

    def moved(self, until):
        """The value at a time, after it went to its target, and to zero from when the enable ended."""
        value, begin = self.value, self.moved_until
        enabled_until = max(begin, min(until, self.enabled_until))
        for end, target in ((enabled_until, self.target), (until, 0.0)):
            seconds = max(0, end - begin) * 1e-9
            rate = self.to_zero if target == 0.0 else RATE
            value = max(target, value - rate * seconds) if value > target else min(target, value + rate * seconds)
            begin = max(begin, end)
        return value

    def left(self):
        """Share that the age of the speed leaves."""
        return min(1.0, max(0.0, 1.0 - ((self.now - self.speed_at) * 1e-9 - MAX_AGE_S) / FADE_S))

    def enable(self, on):
        self.value, self.moved_until = self.moved(self.now), max(self.now, self.moved_until)
        self.enabled_until = self.now + round(HOLD_S * 1e9) if on else self.now - 1

    def speed(self, target):
        """An accepted speed, of which the vehicle's torque is a target [Nm]: it moves at once by what 20 ms allow, then waits."""
        elapsed_s = (self.now - self.speed_at) * 1e-9 if self.driven else 0.0
        self.value = self.moved(self.now) * self.left() if self.driven else 0.0
        rate = self.to_zero if target == 0.0 else RATE
        room = rate * min(elapsed_s, AT_ONCE_S)
        self.value += max(-room, min(room, target - self.value))
        self.target, self.driven = target, True
        self.speed_at, self.moved_until = self.now, self.now + round(AT_ONCE_S * 1e9)

    def output(self):
        return self.moved(self.now) * self.left() if self.driven else 0.0


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """A vehicle whose C needs an enable, and its new state."""
    build = Built(
        tr.load_vehicle("ztbus_hess19"), tmp_path_factory.mktemp("time"), Settings(enable_hold_s=HOLD_S, feedforward_rate=RATE)
    )
    return build, bytes(build.state)


TIMES = st.sampled_from(BAD + GOOD) | st.sampled_from((0.01, 0.02)) | st.floats(0.0, 2.0)
SPEEDS = st.sampled_from((math.nan, 5.0, 5.0, 5.03))
ENABLES = st.sampled_from((math.nan, 1.0, 1.0, 1.0, 0.0))
CALLS = st.lists(st.tuples(TIMES, SPEEDS, ENABLES), min_size=1, max_size=80)
DRIVE = [(0.02, 5.0, 1.0)] * 60


@settings(max_examples=80, deadline=None)
@given(CALLS)
@example([(-0.9, math.nan, math.nan), *[(0.01, math.nan, 0.0)] * 40])
@example([(-5.0, 5.0, 0.0), (0.01, math.nan, math.nan), (WEEK, math.nan, math.nan), *[(0.02, 5.0, 1.0)] * 5])
@example([(0.0, math.nan, 0.0), *[(1e-9, math.nan, math.nan)] * 10, *[(0.1, 5.0, math.nan)] * 4])
def test_feedforward_holds_its_rules_in_the_time_passed(exported, calls):
    build, build.state[:] = exported
    filtered = OutputFilter(build.estimator.constants.number.feedforward_limit / FADE_S)
    motion = build.array(build.library.drive_place_of_motion(), np.zeros(at.Motion.columns))
    for dt, speed, enable in DRIVE + calls:
        result_before, given_ = bytes(build.state), build.outputs.tobytes()
        result, outputs = build.step({"speed_mps": speed, "enable": enable}, dt)
        if not 0.0 <= dt <= WEEK:
            assert result == BAD_TIME
            assert bytes(build.state) == result_before
            assert build.outputs.tobytes() == given_
            continue
        assert result in (STEPPED, WAITED)
        filtered.passed += Fraction(dt)
        if not math.isnan(enable):
            filtered.enable(enable > 0.0)
        if result == STEPPED:
            filtered.speed(motion[at.Motion.feedforward_target])
        assert outputs["feedforward_torque_nm"] == pytest.approx(filtered.output(), rel=1e-6, abs=1e-4)
        assert (outputs["level"] == STALE) == (filtered.now - filtered.speed_at > MAX_AGE_S * 1e9)


def test_the_drive_of_the_laws_has_a_torque(exported):
    build, build.state[:] = exported
    for dt, speed, enable in DRIVE:
        _, outputs = build.step({"speed_mps": speed, "enable": enable}, dt)
    assert outputs["feedforward_torque_nm"] > 500.0


def test_smallest_times_add_up_to_their_sum(exported):
    build, build.state[:] = exported
    for dt, speed, enable in DRIVE:
        build.step({"speed_mps": speed, "enable": enable}, dt)
    clock = build.array(8, np.zeros(1, dtype=np.int64))
    result_before = int(clock[0])
    for _ in range(10_000):
        build.step({}, 0.7e-9)
    assert abs(int(clock[0]) - result_before - 7_000) <= 1


@pytest.mark.parametrize("dt", BAD)
def test_python_refuses_the_times_that_c_refuses(dt):
    estimator = tr.Estimator("ztbus_hess19")
    inputs = estimator.inputs(speed=5.0, ambient=15.0)
    state = estimator.cold_start(inputs)
    with pytest.raises(InputError, match="dt"):
        estimator.step(state, inputs, dt)
    for good in GOOD:
        estimator.step(state, inputs, good)


@pytest.mark.parametrize("far", [2**62, -(2**62), 2**63 - 1, -(2**63)])
def test_a_session_refuses_the_stamps_that_c_refuses(far, exported):
    build, build.state[:] = exported
    session = build.estimator.session()
    for stamp, arrival in ((far, 0), (0, far)):
        assert build.message(at.SPEED, stamp, arrival, 5.0) == BAD_TIME
        with pytest.raises(InputError, match=r"stamp_ns|arrival_ns"):
            session.handle(at.SPEED, stamp, arrival, 5.0)
    near = far - 1 if far > 0 else far + 1
    if abs(near) < 2**62:
        assert build.message(at.SPEED, near, near, 5.0) == STEPPED
        assert session.handle(at.SPEED, near, near, 5.0) is not None


@pytest.mark.parametrize("back_s", [0.001, 0.019, 0.1, 0.88, 5.0])
@pytest.mark.parametrize("disabled_before", [True, False])
def test_messages_of_a_clock_set_back_hold_nothing(back_s, disabled_before, exported):
    build, build.state[:] = exported
    for i in range(60):
        for channel, value in ((at.ENABLE, 1.0), (at.SPEED, 5.0)):
            build.message(channel, 20_000_000 * (i + 1), 20_000_000 * (i + 1), value)
    last = result_before = build.outputs["feedforward_torque_nm"][0]
    assert last > 500.0
    time_now = 61 * 20_000_000
    if disabled_before:
        build.message(at.ENABLE, time_now, time_now, 0.0)
    arrival, ticks = time_now - round(back_s * 1e9), round((FADE_S + AT_ONCE_S) / 0.01)
    for i in range(ticks):
        time_now, arrival = time_now + 10_000_000, arrival + 10_000_000
        build.message(at.ENABLE, time_now, arrival, 0.0)
        last, result_before = build.outputs["feedforward_torque_nm"][0], last
        assert last <= result_before
        if i % 2 == 0:
            build.message(at.SPEED, time_now, arrival, 5.0)
    assert last == 0.0
