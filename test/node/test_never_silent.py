# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Laws of the running application under anything: no exception ends a tick, status goes out, outputs move at their rate."""

import itertools
import math
import random
from types import SimpleNamespace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trackres_ros.node.inputs import Sent
from trackres_ros.node.transport import FIRST_NS, LAST_NS, UNUSABLE, Level, is_usable, nearest_usable, stamp_ns
from trackres_ros.output.topics import TOTALS, output_topics

START_NS = 1_700_000_000_000_000_000
SECOND_NS = 1_000_000_000
NUMBERS = st.floats(allow_nan=True, allow_infinity=True) | st.floats(-25.0, 25.0) | st.sampled_from([8.0, 2e5, 15.0])
SECONDS = st.integers(-(2**31), 2**31 - 1) | st.sampled_from([0, 2**31 - 1, -(2**31), START_NS // SECOND_NS])
NANOSECONDS = st.integers(0, 2**32 - 1) | st.sampled_from([0, 999_999_999, 10**9, 2**32 - 1])
ROLES = st.sampled_from(["speed", "load", "ambient"])
SENT = st.sampled_from([0, 1, 2**63 - 1]) | st.integers(0, 2**62)
EVENTS = st.lists(
    st.one_of(
        st.tuples(st.just("message"), ROLES, SECONDS, NANOSECONDS, NUMBERS, SENT),
        st.tuples(st.just("now"), ROLES, st.just(None), st.just(None), NUMBERS, SENT),
        st.tuples(st.just("strange"), ROLES, st.none(), st.none(), st.sampled_from([None, object(), b"", "x"]), SENT),
        st.tuples(st.just("pass"), st.floats(0.0, 3.0)),
        st.tuples(st.just("clock"), st.integers(-(2**70), 2**70)),
        st.tuples(st.just("broken"), st.sets(st.sampled_from(["publish", "publish_status", "peers", "log", "now_ns"]))),
    ),
    max_size=30,
)


@settings(max_examples=60)
@given(st.booleans(), EVENTS)
def test_whatever_comes_no_tick_raises_and_status_goes_out(wild_by_clock, simulated, events):
    d = wild_by_clock[simulated]
    d.broken.clear()
    for what, *given_ in events:
        if what == "pass":
            d.forward(given_[0])
        elif what == "clock":
            d.own_clock = given_[0]
        elif what == "broken":
            d.broken = set(given_[0])
        else:
            role, seconds, nanoseconds, value, sent_message = given_
            if what == "strange":
                d.app.messages.receive(d.index(role), value, Sent(sent_message))
            else:
                time_now = divmod(START_NS + round(d.time_s * SECOND_NS), SECOND_NS)
                stamp = (seconds, nanoseconds) if what == "message" else time_now
                d.app.messages.receive(d.index(role), d.message(role, *stamp, value), Sent(sent_message))
        d.app.tick()
    d.broken.clear()
    count = len(d.statuses)
    d.forward(1.2)
    assert {name for name, _ in d.statuses[count:]} >= {"status", "/diagnostics"}
    assert d.all_finite()
    d.own_clock = None
    d.published.clear()
    d.statuses.clear()


@pytest.mark.parametrize("what", ["publish", "peers", "log", "now_ns"])
def test_what_fails_each_time_is_said_and_the_status_goes_on(wild_desk, what):
    d = wild_desk(output_rate_hz=50.0)
    d.drive(1.0)
    d.broken = {what}
    count = len(d.statuses)
    d.forward(6.0)
    assert len(d.statuses) - count >= 5
    if what in ("publish", "peers"):
        assert any(f"{what} does not work" in result[0].message for _, result in d.statuses[count:])
    d.broken.clear()
    d.drive(7.0)
    assert not {"INTERNAL_ERROR", "OUTPUT_FAILED"} & d.names()


def test_one_topic_that_cannot_be_published_holds_up_no_other(desk, monkeypatch):
    d = desk(output_rate_hz=50.0)
    publish = d.publish

    def refuse(output, stamp, values, reasons):
        if d.app.outputs[output].name == "feedforward_torque":
            raise RuntimeError("no room")
        publish(output, stamp, values, reasons)

    monkeypatch.setattr(d, "publish", refuse)
    d.drive(1.0)
    d.forward(0.2)
    names = {name for name, _, _ in d.published}
    assert "feedforward_torque" not in names
    assert {"feedforward_torque_nm", "resistance_torque"} <= names
    status = d.statuses[-1][1][0]
    assert status.level >= Level.ERROR
    assert "feedforward_torque cannot be published: RuntimeError: no room" in status.message


def test_a_first_stamp_beyond_the_message_range_is_refused(desk):
    d = desk(output_rate_hz=50.0)
    d.app.messages.receive(d.index("speed"), d.message("speed", 2**31 - 1, 10**9, 8.0))
    d.forward(0.5)
    assert "REFUSED" in d.names()
    speed = next(input for input in d.app.overview().inputs if input.role == "speed")
    assert dict(speed.counts) == {"bad_stamp": 1}
    d.drive(2.5)
    assert d.last("resistance_torque")[0] == pytest.approx(d.now_ns(), abs=SECOND_NS)


@given(SECONDS | st.integers(), NANOSECONDS | st.integers())
def test_stamps_are_those_of_builtin_interfaces(seconds, nanoseconds):
    stamp = stamp_ns(seconds, nanoseconds)
    fits = -(2**31) <= seconds < 2**31 and 0 <= nanoseconds < 10**9
    assert (stamp == UNUSABLE) is not fits
    assert not is_usable(UNUSABLE)
    if fits:
        assert divmod(stamp, SECOND_NS) == (seconds, nanoseconds)
    assert FIRST_NS <= nearest_usable(seconds) <= LAST_NS


class Pace:
    """Keeps each published feed-forward with its target and the settings since the one before, and judges them."""

    def __init__(self, d):
        self.d, self.passed_on, self.outputs, self.settings = d, d.publish, [(d.steady_s, 0.0, 0.0, [])], []
        d.publish = self
        self.changed()

    def changed(self):
        """Until the next output, the settings from before hold too."""
        self.settings.append(self.d.app.estimator.constants.number)

    def begins(self):
        self.outputs.append((self.d.steady_s, 0.0, 0.0, []))

    def __call__(self, output, stamp, values, reasons):
        self.passed_on(output, stamp, values, reasons)
        if self.d.app.outputs[output].name == "feedforward_torque_nm":
            steady = self.d.app.clock.steady_ns()
            target = 0.0 if self.d.app.filter.ends else self.d.app.filter.course(steady).target_nm
            self.outputs.append((self.d.steady_s, values[0], target, self.settings))
            self.settings = self.settings[-1:]

    def judge(self):
        """Hold the laws, and return the kinds of outputs that there were."""
        seen, wrong_s, longest_s = set(), 0.0, 0.0
        for (before_s, torque_before, *_), (now_s, torque_now, target, numbers) in itertools.pairwise(self.outputs):
            if not numbers:
                wrong_s = 0.0
                continue
            rate = max(number.feedforward_rate for number in numbers)
            fading = max(number.feedforward_limit / number.feedforward_fade for number in numbers)
            distance = abs(torque_now) > abs(torque_before) and torque_now * torque_before >= 0.0
            most = rate if distance else rate + fading
            assert abs(torque_now - torque_before) <= most * (now_s - before_s) + 1e-3  # of a clock that counts nanoseconds
            assert torque_now * target > 0.0 or (not distance and torque_now * torque_before >= 0.0)
            longest_s = max(longest_s if wrong_s else 0.0, *(number.feedforward_fade for number in numbers))
            wrong_s = wrong_s + now_s - before_s if torque_now * target < 0.0 else 0.0
            assert wrong_s <= longest_s + 0.2
            seen.add("away" if distance else "wrong" if wrong_s else "zero" if target == 0.0 else "to it")
        return seen


@pytest.mark.parametrize(
    ("nm_per_s", "rate_hz", "hz"),
    [(500.0, 50.0, 50.0), (500.0, 20.0, 7.0), (500.0, 0.0, 2.0), (2e4, 50.0, 1.0), (2e4, 0.0, 50.0)],
)
def test_outputs_keep_the_feedforward_rate_over_speeds_and_gaps(desk, rate_hz, hz, nm_per_s):
    d = desk(output_rate_hz=rate_hz, output_deadline_s=0.0, feedforward_rate=nm_per_s)
    pace, chance = Pace(d), random.Random(7)
    for _ in range(20):
        d.drive(chance.uniform(0.1, 1.0), speed=chance.choice([3.0, -2.0, 0.0, 0.07, 5.0]), dt=1.0 / hz)
        d.forward(chance.choice([0.0, 0.3, 0.6, 1.0, 1.4, 3.0, 40.0]))
    assert "away" in pace.judge()


AIMS = {"ahead": 3.0, "slowly": 1.5, "back": -1.5, "stop": 0.0}
CHANGES = {
    "feedforward_rate": (300.0, 1000.0, 20000.0),
    "feedforward_fade_s": (0.3, 1.0, 10.0),
    "speed_max_age_s": (0.1, 0.5, 5.0),
    "output_rate_hz": (0.0, 0.5, 50.0),
}


@pytest.mark.parametrize("seed", range(4))
def test_whatever_comes_the_feedforward_moves_only_as_documented(desk, seed):
    enable = "enable: {topic: enable, type: std_msgs/msg/Bool, field: data, max_age_s: 60.0}\n"
    d = desk("speed: {topic: speed, type: geometry_msgs/msg/TwistStamped, field: twist.linear.x}\n" + enable,
             output_rate_hz=50.0, output_deadline_s=0.0, feedforward_rate=1000.0)  # fmt: skip
    pace, chance, speed, on = Pace(d), random.Random(seed), 0.0, True
    kinds = [*AIMS, *AIMS, "silent", "silent", "silent", "enable", "change", "activation"]
    for what in ["ahead", "back", *chance.choices(kinds, k=30)]:
        if what == "silent":
            d.forward(chance.choice([0.3, 0.8, 1.3, 3.0]))
        if what in ("silent", "change"):
            name = chance.choice(list(CHANGES))
            d.app.change({name: chance.choice(CHANGES[name])})
            pace.changed()
            d.forward(0.2)
        elif what == "enable":
            on = chance.random() < 0.7
        elif what == "activation" and d.app.active:
            d.app.deactivate()
        elif what == "activation":
            d.app.activate()
            pace.begins()
        d.app.messages.receive(d.index("enable"), SimpleNamespace(data=on))
        for _ in range(0 if what == "silent" else 60 if len(pace.outputs) < 200 else chance.choice([3, 60])):
            speed += max(-0.1, min(0.1, AIMS.get(what, speed) - speed))
            d.drive(0.04, speed=speed, dt=0.04)
    assert pace.judge() == {"away", "wrong", "zero", "to it"}


def test_at_a_slow_rate_a_torque_of_the_wrong_sign_goes_in_time(desk):
    d = desk(output_rate_hz=0.2, output_deadline_s=0.0, feedforward_rate=1000.0)
    d.drive(10.1, speed=1.5)
    assert d.last("feedforward_torque_nm")[1][0] > 1000.0
    for i in range(30):
        d.drive(0.04, speed=1.45 - 0.1 * i, dt=0.04)
    d.drive(1.1, speed=-1.5)
    assert d.last("feedforward_torque_nm")[1][0] <= 0.0


def test_live_and_replay_agree_over_pauses(desk):
    d = desk(output_rate_hz=0.0, feedforward_rate=2000.0)
    d.drive(4.0)
    for pause in (0.3, 0.9, 2.5):
        d.forward(pause)
        d.drive(0.5)
    first = {}
    for name, stamp, values in d.published:
        if name == "feedforward_torque":
            first.setdefault(stamp, values[0])
    session = d.app.estimator.session()
    for stamp, fed in sorted(first.items()):
        estimate = session.handle(session.channel("speed"), stamp, stamp, 8.0)
        assert fed == pytest.approx(estimate.feedforward_torque_nm, abs=2000.0 * 0.1)  # the way between two of its outputs
    assert len(first) == 275


def test_a_quantity_has_one_sign_on_all_topics(desk):
    d = desk(output_rate_hz=50.0)
    d.drive(3.0, ambient=20.0, load=250e3)
    d.forward(1.0)
    _, entries = next((name, result) for name, result in reversed(d.statuses) if name == "/diagnostics")
    text = dict(entries[0].values)
    topic = next(t for t in output_topics(d.app.vehicle) if t.name == "resistance_torque")
    efforts = dict(zip(topic.names, d.last("resistance_torque")[1], strict=True))
    for part in TOTALS:
        assert float(text[f"resistance_torque/{part}"]) == pytest.approx(efforts[part], abs=1e-3)
    assert efforts["total"] < 0.0 < efforts["drive"]
    signs = {}
    for topic in output_topics(d.app.vehicle):
        for column, sign in zip(topic.columns, topic.signs, strict=True):
            assert signs.setdefault(column, sign) == sign
    assert math.isclose(efforts["drive"], -(efforts["total"] + efforts["grade"] + efforts["inertia"]), abs_tol=1e-9)


def test_the_age_of_an_input_goes_on_while_nothing_comes(desk):
    d = desk(output_rate_hz=50.0)
    d.drive(2.0, load=250e3)
    for load, level in ((math.nan, Level.WARN), (250e3, Level.OK)):
        for _ in range(50):  # loads go on
            d.forward(0.05)
            d.send("load", load)
        entries = next(result for name, result in reversed(d.statuses) if name == "/diagnostics")
        levels = [
            entry.level for role in ("load", "speed", "ambient") for entry in entries if entry.name.endswith(f"input {role}")
        ]
        assert levels == [level, Level.STALE, Level.STALE]
    ages = {input.role: input.age_s for input in d.app.overview().inputs}
    assert ages["speed"] == pytest.approx(5.0, abs=0.1)
    assert ages["load"] == pytest.approx(0.0, abs=0.1)
    d.forward(1.0)
    assert {input.role: input.age_s for input in d.app.overview().inputs}["load"] == pytest.approx(1.0, abs=0.1)
