# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which publisher gives the speed, and when two disagree: laws over drives, told apart or not."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trackres_ros.node.inputs import SpeedSources

SECOND_NS = 1_000_000_000
ACCEL, MAX_AGE_S = 9.81, 0.5
PERIODS = st.sampled_from([0.01, 0.02, 0.05, 0.1, 0.2])


def heard(drives, mixed=False, until_s=6.0):
    """Sources after publishers, each a function of time with a period [s] and a phase, have published; which speeds were used."""
    sources = SpeedSources(ACCEL, lambda: MAX_AGE_S)
    times = [(phase + step * period, i) for i, (_, period, phase) in enumerate(drives) for step in range(int(until_s / period))]
    used = []
    for time_s, i in sorted(times):
        if sources.takes(0 if mixed else i + 1, drives[i][0](time_s), int(time_s * SECOND_NS), mixed):
            used.append((time_s, i))
    return sources, used


def ramp(accel, top):
    return lambda time_s: min(max(0.0, accel * time_s), top)


@given(st.floats(0.1, ACCEL), st.floats(1.0, 30.0), st.floats(0.0, 0.1), PERIODS, PERIODS)
def test_two_sensors_of_one_drive_never_disagree(accel, top, delay_s, period, other):
    drive = ramp(accel, top)
    drives = (drive, period, 0.0), (lambda time_s: 0.99 * drive(time_s - delay_s), other, 0.003)
    sources, used = heard(drives)
    assert sources.disagreeing(int(6.0 * SECOND_NS)) is None
    assert {i for _, i in used} == {0}  # the first that was heard


@given(st.floats(1.0, 30.0), PERIODS, PERIODS, st.floats(0.0, 0.009), st.booleans())
def test_a_standing_and_a_rolling_publisher_disagree_soon(speed, period, other, phase, mixed):
    drives = (lambda _: 0.0, period, 0.0), (lambda _: speed, other, phase)
    sources, used = heard(drives, mixed)
    assert max(time_s for time_s, _ in used) <= MAX_AGE_S + 3.0 * max(period, other)
    if not mixed or speed > 2.0 * ACCEL * period + 0.5:  # else the vehicle can have gained it between two messages
        assert {i for _, i in used} == {0}  # the first that was heard, until none is
    pair = sources.disagreeing(int(6.0 * SECOND_NS))
    assert {value for _, value in pair} == {0.0, speed}
    assert sources.disagreeing(int(9.0 * SECOND_NS)) is None  # nothing came for long
    assert sources.takes(0 if mixed else 1, 0.0, int(9.0 * SECOND_NS), mixed)


@given(st.lists(st.floats(-100.0, 100.0), min_size=2, max_size=200), PERIODS)
def test_one_publisher_never_disagrees_with_itself(speeds, period):
    drives = ((lambda time_s: speeds[int(time_s / period) % len(speeds)], period, 0.0),)
    sources, used = heard(drives)
    assert sources.disagreeing(int(6.0 * SECOND_NS)) is None
    assert len(used) == int(6.0 / period)


def test_another_publisher_takes_over_from_one_that_is_silent():
    sources, _ = heard([(lambda _: 8.0, 0.02, 0.0)], until_s=1.0)
    taken = [sources.takes(2, 8.0, int((1.0 + 0.05 * step) * SECOND_NS)) for step in range(20)]
    assert taken.index(True) == pytest.approx(MAX_AGE_S / 0.05, abs=1)
    assert all(taken[taken.index(True) :])
