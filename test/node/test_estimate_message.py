# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Laws of `~/estimate`, the one message a controller needs: its torque equals `~/feedforward_torque`, and it reports when not to
trust it."""

import itertools
import math
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trackres_ros.estimator.columns import REASON_TEXT
from trackres_ros.node.notices import KINDS
from trackres_ros.node.transport import Level
from trackres_ros.output.topics import ESTIMATE_TOPIC, LEVEL

LIMIT_OF_WEIGHT = 272e3 * 0.36  # nominal weight x sprocket radius of xgd24d [Nm]
SPEEDS = st.floats(-20.0, 20.0) | st.sampled_from([0.0, 0.05, 8.0, math.nan, 1e9])
BROKEN = st.sampled_from([None, "peers", "log"])
EVENTS = st.lists(st.tuples(SPEEDS, st.floats(0.0, 3.0), st.integers(0, 20), BROKEN), max_size=12)


def estimates(d):
    """Of each estimate that was published: stamp, numbers by name, reasons, and the feed-forward published just before it."""
    sent_messages = [result for result in d.published if result[0] in ("feedforward_torque", "estimate")]
    pairs = [(a, b) for a, b in itertools.pairwise(sent_messages) if b[0] == "estimate"]
    assert len(pairs) == len(d.reasons)
    return [
        (stamp, dict(zip(ESTIMATE_TOPIC.names, values, strict=True)), reasons, (other, torque))
        for ((_, other, (torque,)), (_, stamp, values)), reasons in zip(pairs, d.reasons, strict=True)
    ]


def check(d):
    """Laws of every estimate, for any input."""
    for (stamp, numbers, reasons, (other, torque)), remainder in zip(estimates(d), d.left, strict=True):
        assert (stamp, numbers["feedforward_torque_nm"]) == (other, torque)
        assert abs(torque) <= LIMIT_OF_WEIGHT * d.app.estimator.settings.feedforward_share * (1 + 1e-9)
        assert remainder == 1.0 or "SPEED_OLD" in reasons
        assert numbers["resistance_std_nm"] > 0.0
        assert numbers[LEVEL] == max(reasons.values(), default=Level.OK)
        assert all(reasons[name] is KINDS[name].level for name in reasons)
        assert list(reasons.values()) == sorted(reasons.values(), reverse=True)


@settings(max_examples=30)
@given(st.booleans(), EVENTS)
def test_a_message_has_the_published_torque_and_its_worst_level(wild_by_clock, simulated, events):
    d = wild_by_clock[simulated]
    for speed, pause_s, count, broken in events:
        d.broken = {broken}
        d.forward(pause_s)
        for _ in range(count):
            d.forward(0.02)
            d.send("speed", speed)
    d.broken.clear()
    check(d)
    d.published.clear()
    d.reasons.clear()
    d.left.clear()


@pytest.mark.parametrize("rate", [0.0, 50.0])
def test_during_a_fade_each_message_is_stale_and_gives_a_reason(desk, rate):
    d = desk(output_rate_hz=rate)
    d.drive(2.0)
    d.forward(3.0)
    faded = [numbers for (_, numbers, _, _), remainder in zip(estimates(d), d.left, strict=True) if remainder < 1.0]
    assert len(faded) > 20
    assert faded[-1]["feedforward_torque_nm"] == 0.0
    assert {numbers[LEVEL] for numbers in faded} == {Level.STALE}
    d.drive(0.1)
    assert d.reasons[-1].get("SPEED_OLD") is None
    check(d)


@pytest.mark.parametrize(("before", "rate"), [(0.5, 0.0), (8.0, 50.0), (-6.0, 50.0), (20.0, 0.0)])
def test_feedforward_is_zero_at_standstill_after_any_stop(desk, before, rate):
    d = desk(output_rate_hz=rate)
    noise = random.Random(3)
    d.drive(3.0, speed=before)
    pushed = estimates(d)[-1][1]["feedforward_torque_nm"]
    assert pushed != 0.0
    d.published.clear()
    d.reasons.clear()
    for _ in range(200):
        d.drive(0.02, speed=noise.gauss(0.0, 0.02))  # speed_std_mps
    at_rest = [abs(numbers["feedforward_torque_nm"]) for _, numbers, *_ in estimates(d)]
    assert len(at_rest) > 60  # at the output rate 0 with each accepted speed, and at 10 Hz in doubt
    within = math.ceil(abs(pushed) / (d.app.estimator.settings.feedforward_rate * 0.02)) + 2
    assert sorted(at_rest[:within], reverse=True) == at_rest[:within]
    assert set(at_rest[within:]) == {0.0}


def test_its_bound_is_that_of_the_feedforward(desk):
    d = desk(feedforward_share=0.001)
    d.drive(3.0)
    assert d.last("estimate")[1][0] == pytest.approx(0.001 * LIMIT_OF_WEIGHT)
    check(d)


def test_the_first_estimate_already_has_its_own_reasons(desk):
    d = desk()
    d.drive(0.02)
    assert {"LOAD_NOMINAL", "AMBIENT_NOMINAL"} <= set(d.reasons[0])
    d.drive(1.0, load=250e3, ambient=20.0)
    d.forward(1.0)
    d.drive(2.5, load=250e3, ambient=20.0)
    assert not {"LOAD_NOMINAL", "AMBIENT_NOMINAL"} & set(d.reasons[-1])


def test_its_reasons_are_those_of_the_status_within_its_second(desk):
    d = desk(output_rate_hz=50.0)
    d.drive(3.0)
    d.forward(1.0)
    name, (status,) = next(result for result in reversed(d.statuses) if result[0] == "status")
    assert name == "status"
    notices = dict(status.values)["remarks"].split()
    assert set(d.reasons[-1]) == set(notices)
    assert set(notices) & {reason.name for reason in REASON_TEXT}
