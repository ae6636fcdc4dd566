# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Laws of the one filter of the published feed-forward, behind a real session, whatever comes in whatever order."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import trackres_ros as tr
from trackres_ros.estimator import columns as at
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.settings import Settings
from trackres_ros.node.inputs import NodeClock
from trackres_ros.node.output import FeedforwardFilter

SECOND_NS, TICK_NS, HOLD_S = 1_000_000_000, 20_000_000, 0.5
RATES_AND_FADES = ((500.0, 2.0), (3000.0, 1.0), (20000.0, 0.3))
LONGEST_FADE_S = max(fade_s for _, fade_s in RATES_AND_FADES)
ROUNDING_NM = 1e-3


@pytest.fixture(scope="module")
def estimators():
    vehicle = tr.load_vehicle("xgd24d")
    return [
        Estimator(vehicle, Settings(enable_hold_s=HOLD_S, feedforward_rate=rate, feedforward_fade_s=fade_s))
        for rate, fade_s in RATES_AND_FADES
    ]


class Drive:
    """A filter with its session, and the laws at each of its outputs, one in a tick."""

    def __init__(self, estimators):
        self.estimators, self.session = estimators, estimators[1].session()
        clock = NodeClock(None, False, lambda: 0, None)
        clock.offset_ns = 0
        self.filter = FeedforwardFilter(self.session, clock)
        self.now, self.speed, self.torque, self.withheld = SECOND_NS, 0.0, 0.0, False
        self.enabled, self.enabled_ns, self.rolls, self.begun = False, 0, False, False
        self.idle_s, self.number = 0.0, [self.session.estimator.constants.number]

    def enable(self, on):
        self.session.handle(at.ENABLE, self.now, self.now, float(on))
        self.enabled, self.enabled_ns = on, self.now

    def send(self, speed):
        if (estimate := self.session.handle(at.SPEED, self.now, self.now, float(speed))) is not None:
            self.rolls, self.begun = estimate.row[at.Results.speed_mps] != 0.0, True
            self.filter.take(self.now, 0)

    def change(self, index):
        changed = self.estimators[index].session()
        changed.copy_from(self.session)
        self.session = self.filter.session = changed
        self.number.append(changed.estimator.constants.number)

    def begin_or_end(self):
        if not self.filter.ends:
            self.filter.end(self.now)
        else:
            self.filter.begin()
            self.torque = self.idle_s = 0.0
            self.withheld = False

    @property
    def may_rise(self):
        """By all that was sent: the last speed is not zero, a fresh enable, and nothing that withholds it."""
        enabled = self.enabled and self.now - self.enabled_ns <= HOLD_S * SECOND_NS
        return self.rolls and enabled and not self.withheld and not self.filter.ends

    @property
    def may_stay(self):
        """And with a fresh speed; one that comes rarely may be older. While it fades, a slow rise may still go on."""
        return self.may_rise and self.filter.age_s(self.now) <= self.filter.max_age_s

    def output(self):
        result_before = self.torque
        if self.begun:
            self.torque = self.filter.move(self.filter.course(self.now))
        rate = max(number.feedforward_rate for number in self.number)
        to_zero = max(number.feedforward_limit / number.feedforward_fade for number in self.number)
        distance = abs(self.torque) > abs(result_before) and self.torque * result_before >= 0.0
        assert math.isfinite(self.torque)
        most = rate if distance else max(rate, to_zero) + to_zero  # to zero by its rate and by fading at once
        assert abs(self.torque - result_before) <= most * TICK_NS / SECOND_NS + ROUNDING_NM
        assert self.may_rise or not distance
        self.idle_s = 0.0 if self.may_stay else self.idle_s + TICK_NS / SECOND_NS
        if self.idle_s > LONGEST_FADE_S + 0.1:
            assert self.torque == 0.0
        self.number = self.number[-1:]

    def roll(self, ticks, aim, every, on, enable_first):
        """Ticks with a speed on its way to an aim, every so many, and an enable as often; None is not sent."""
        for tick in range(ticks):
            self.now += TICK_NS
            sends = [lambda: on is None or self.enable(on), lambda: aim is None or self.send(self.speed)]
            if aim is not None:
                self.speed += max(-0.1, min(0.1, aim - self.speed))
            if tick % every == 0:
                for send in sends if enable_first else reversed(sends):
                    send()
            self.output()


AIMS = st.sampled_from([None, 0.0, 0.0, 1.0, 3.0, 8.0, -2.0])
ENABLES = st.sampled_from([None, True, True, False])
EVENTS = st.one_of(
    st.tuples(st.just("roll"), st.integers(1, 150), AIMS, st.sampled_from([1, 2, 5, 40]), ENABLES, st.booleans()),
    st.tuples(st.just("withhold"), st.booleans()),
    st.tuples(st.just("change"), st.integers(0, len(RATES_AND_FADES) - 1)),
    st.tuples(st.just("begin_or_end")),
    st.tuples(st.just("send"), st.sampled_from([0.0, 1e9, math.nan, -25.0, 8.0])),
)


@settings(max_examples=150)
@given(st.lists(EVENTS, min_size=1, max_size=25))
def test_it_moves_at_its_rate_and_pushes_nothing_unasked(estimators, events):
    drive = Drive(estimators)
    for what, *values in events:
        if what == "withhold":
            (drive.withheld,) = values
            drive.filter.withhold(drive.withheld, drive.now)
        else:
            {"roll": drive.roll, "change": drive.change, "send": drive.send, "begin_or_end": drive.begin_or_end}[what](*values)
        drive.now += TICK_NS
        drive.output()
    drive.roll(150, None, 1, None, True)
    assert drive.torque == 0.0


STOPS = {  # ticks, aim, every so many ticks, enable, enable first
    "standstill": (200, 0.0, 1, True, True),
    "disabled": (200, 3.0, 1, False, True),
    "no speed": (200, None, 1, True, True),
    "no enable": (200, 3.0, 1, None, True),
}


@pytest.mark.parametrize("stop", [*STOPS, "withheld", "ended"])
@pytest.mark.parametrize("index", range(len(RATES_AND_FADES)))
def test_it_pushes_where_it_may_and_stops_where_it_may_not(estimators, index, stop):
    drive = Drive(estimators)
    drive.change(index)
    drive.roll(500, 3.0, 1, True, True)
    assert drive.torque > 2000.0
    if stop == "withheld":
        drive.withheld = drive.filter.withhold(True, drive.now)
    elif stop == "ended":
        drive.filter.end(drive.now)
    drive.roll(*STOPS.get(stop, (200, 3.0, 1, True, True)))
    assert drive.torque == 0.0


@pytest.mark.parametrize("silent_ticks", [30, 45, 60])
@pytest.mark.parametrize("index", range(len(RATES_AND_FADES)))
def test_a_speed_that_returns_while_it_fades_makes_no_jump(estimators, index, silent_ticks):
    drive = Drive(estimators)
    drive.change(index)
    drive.roll(500, 3.0, 1, True, True)
    result_before = drive.torque
    drive.roll(silent_ticks, None, 1, True, True)
    assert drive.torque < result_before
    drive.roll(500, 3.0, 1, True, True)
    assert drive.torque == pytest.approx(result_before, rel=0.05)
