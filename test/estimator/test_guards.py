# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The guards: every message is counted once, all outputs are finite, and each policy is followed."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trackres_ros.effects import Active, catalogue
from trackres_ros.effects.stepping import EACH
from trackres_ros.estimator.columns import REFUSALS, Belt, Count, Reason
from trackres_ros.estimator.estimator import Estimator, Session
from trackres_ros.estimator.settings import Settings
from trackres_ros.estimator.snapshot import rest_session
from trackres_ros.vehicle import load_any

START = 1_700_000_000_000_000_000
MS = 1_000_000
S = 1_000_000_000
SPEED = 8.0


@pytest.fixture
def session(reference):
    return reference.session()


def send(session, stamp, value=SPEED, name="speed", arrival=None):
    return session.handle(session.channel(name), stamp, stamp if arrival is None else arrival, value)


def steady(session, seconds=2.0, start=START, every=20 * MS):
    """Good messages with a little life in them; returns the next stamp and the last estimate."""
    count = int(seconds * S / every)
    for i in range(count):
        estimate = send(session, start + i * every, SPEED + 0.01 * (i % 3))
    return start + count * every, estimate


def count(session, counter, name="speed"):
    return int(session.memory.counters[session.channel(name), counter])


STAMPS = st.one_of(
    st.integers(-3600, 3600).map(lambda s: START + s * S), st.integers(0, 3000).map(lambda ms: START + ms * MS), st.just(0)
)
VALUES = st.one_of(st.floats(-20, 20), st.sampled_from([float("nan"), float("inf"), -float("inf"), 1e9, -1e300, 0.0]))


@given(
    messages=st.lists(
        st.tuples(
            st.sampled_from(["speed", "load", "ambient", "belt/rear_left", "accel", "torque", "load/front"]),
            STAMPS,
            STAMPS,
            VALUES,
        ),
        max_size=80,
    )
)
def test_whatever_comes_counters_add_up_and_results_are_finite(reference, messages):
    session = reference.session()
    limit = reference.constants.number.feedforward_limit
    for name, stamp, arrival, value in messages:
        estimate = send(session, stamp, value, name, abs(arrival))
        if estimate is not None:
            assert np.isfinite(estimate.row[:13]).all()
            assert np.isfinite(estimate.belt_degc()).all()
            assert abs(estimate.feedforward_torque_nm) <= limit
    counters = session.memory.counters
    assert counters[:, Count.ACCEPTED].sum() + counters[:, [int(c) for c in REFUSALS]].sum() == len(messages)


@pytest.mark.parametrize("jump", [3600 * S, -3600 * S])
def test_a_clock_jump_accepted_after_three_keeps_the_temperature(session, jump):
    time_ns, last_estimate = steady(session, 60.0)
    results = [send(session, time_ns + jump + i * 20 * MS, arrival=time_ns + i * 20 * MS) for i in range(4)]
    assert results[:2] == [None, None]
    assert results[2].reasons & Reason.CLOCK_JUMPED
    assert results[2].belt_degc()[0] == pytest.approx(last_estimate.belt_degc()[0], abs=0.05)
    assert count(session, Count.CLOCK_JUMP) == 1
    assert not results[3].reasons & Reason.CLOCK_JUMPED


def test_time_going_back_on_any_channel_is_reported_as_a_reset(session):
    send(session, START + 1, 300e3, "load")
    steady(session, 60.0, START + 2)
    send(session, START + 60 * S, 300e3, "load")
    assert send(session, START, 280e3, "load") is None
    estimate = send(session, START + MS)
    assert estimate.reasons & Reason.TIME_RESET
    assert estimate["weight_n"] == pytest.approx(280e3)
    assert estimate.belt_degc()[0] == pytest.approx(15.0)
    assert not send(session, START + 21 * MS).reasons & Reason.TIME_RESET


def test_gaps_are_bridged_or_marked_unknown(session):
    time_ns, last_estimate = steady(session)
    short_gap = send(session, time_ns + 10 * S)
    assert short_gap.reasons & Reason.GAP_BRIDGED
    assert short_gap.belt_degc()[0] > last_estimate.belt_degc()[0] + 0.3
    long_gap = send(session, time_ns + 600 * S)
    assert long_gap.reasons & Reason.GAP_UNKNOWN
    assert count(session, Count.GAP) == 2


def driven(estimator, restart, steps, ambient_at, change, speed):
    """Belts' temperatures and an effect's state after so many steps; at one of them the nominal air turns out to be another."""
    session = estimator.session()
    if restart:
        for i in range(-10, 0):
            send(session, START + i * S // 2, speed)
        restart(session)
    for i in range(steps + 1):
        if i == ambient_at:
            send(session, START + i * S // 2, estimator.vehicle.chassis.ambient + change, "ambient")
        send(session, START + i * S // 2, speed)
    return np.append(session.belts[:, :, Belt.temperature], session.effects[-EACH])


@pytest.fixture(scope="module")
def warming(xgd24d, agri3t):
    """Estimators with belts of one and two nodes, of another vehicle, and without belts, each with an effect that warms up."""
    vehicles = {"one": xgd24d, "two": replace(xgd24d, thermal="core_surface"), "small": agri3t, "wheels": load_any("bmw_i3")}
    tyres = catalogue()["roadwheel_tyres"]
    soon_old = Settings(ambient_hold_s=5.0)
    return {name: Estimator(replace(one, effects=(Active(tyres, tyres.values()),)), soon_old) for name, one in vehicles.items()}


RESTARTS = {
    "first": None,
    "back": Session.start_anew,
    "standing": lambda session: session.start_cold(is_driving=False),
    "driving": lambda session: session.start_cold(is_driving=True),
    "off": lambda session: session.begin(session.estimator.rest(session.state, None, 600.0)),
}


@pytest.mark.parametrize(("steps", "speed", "change"), [(1, 2.0, -35.0), (1, 2.0, 20.0), (120, 0.0, -35.0), (600, 2.0, -1.0)])
@pytest.mark.parametrize("restart", RESTARTS.values(), ids=RESTARTS)
@pytest.mark.parametrize("name", ["one", "two", "small", "wheels"])
def test_a_start_is_in_the_first_ambient_whenever_it_comes(warming, name, restart, steps, speed, change):
    temperatures, expected, control = (driven(warming[name], restart, steps, i, change, speed) for i in (steps, 0, -1))
    assert abs(expected - control).max() > 0.3 * abs(change)
    assert temperatures == pytest.approx(expected, abs=0.01 * abs(expected - control).max())


def drive_on(session, seconds, after=0):
    for i in range(2 * seconds):
        send(session, DRIVEN + after * S + i * S // 2, 2.0)
    return session


def with_setting(session):
    """The session with another uncertainty of an assumed air."""
    copy = Estimator(session.estimator.vehicle, replace(session.estimator.settings, ambient_unknown_std_k=2.0)).session()
    copy.copy_from(session)
    return copy


DRIVEN = START + 120 * S
UNHEARD = {  # a time without an ambient temperature [s], and the session after it
    "night on": (36_000, lambda session: session),
    "pause on": (300, lambda session: session),
    "night off": (36_000, lambda session: rest_session(session, 36_000.0)),
    "pause off": (300, lambda session: rest_session(session, 300.0)),
    "off twice": (600, lambda session: rest_session(rest_session(session, 300.0), 300.0)),
    "driving": (600, lambda session: drive_on(session, 600)),
    "another setting": (600, lambda session: drive_on(with_setting(drive_on(session, 300)), 300, 300)),
    "reset": (300, lambda session: (session.start_cold(is_driving=False), session)[1]),
}


def after_unheard(estimator, way, steps, ambient_at, change):
    """Belts' temperatures and an effect's state so many steps after such a time; at -1 its ambient temperature came before."""
    session, ambient, (seconds, change_session) = estimator.session(), estimator.vehicle.chassis.ambient + 8.0, UNHEARD[way]
    for i in range(241):
        send(session, START + i * S // 2, ambient + (change if i == 240 and ambient_at < 0 else 0.0), "ambient")
        send(session, START + i * S // 2, 2.0)
    session = change_session(session)
    for i in range(steps + 1):
        if i == ambient_at:
            send(session, DRIVEN + seconds * S + i * S // 2, ambient + change, "ambient")
        send(session, DRIVEN + seconds * S + i * S // 2, 2.0)
    return np.append(session.belts[:, :, Belt.temperature], session.effects[-EACH])


@pytest.mark.parametrize(("steps", "change"), [(1, -35.0), (1, 20.0), (60, 10.0)])
@pytest.mark.parametrize("way", UNHEARD)
@pytest.mark.parametrize("name", ["one", "two", "small", "wheels"])
def test_a_time_in_an_assumed_air_was_in_the_one_that_comes(warming, name, way, steps, change):
    temperatures, expected, control = (after_unheard(warming[name], way, steps, i, change) for i in (steps, -1, steps + 1))
    assert temperatures == pytest.approx(expected, abs=0.03 * abs(expected - control).max())
    unchanged = (after_unheard(warming[name], way, steps, i, 0.0) for i in (steps, -1, steps + 1))
    assert len({belts.tobytes() for belts in unchanged}) == 1


@pytest.mark.parametrize("change", [-20.0, 10.0])
@pytest.mark.parametrize("name", ["one", "two", "small"])
def test_no_belt_moves_by_more_than_its_air_is_corrected(warming, name, change):
    """However much one standard deviation of an assumed air is said to have moved it."""
    session, air = warming[name].session(), warming[name].vehicle.chassis.ambient
    for i in range(3):
        send(session, START + i * S // 50, 2.0)
    session.belts[:, :, Belt.consider_ambient] *= 3.0
    old_temperatures = session.belts[:, :, Belt.temperature].copy()
    send(session, START + 3 * S // 50, air + change, "ambient")
    send(session, START + 3 * S // 50, 2.0)
    assert session.belts[:, :, Belt.temperature] - old_temperatures == pytest.approx(
        np.full_like(old_temperatures, change), abs=0.05 * abs(change)
    )


def test_a_rest_in_a_given_air_stays_in_it(warming):
    session = warming["two"].session()
    send(session, START)
    session.begin(warming["two"].rest(session.state, 0.0, 600.0))
    old_belts = session.state.belts
    send(session, START + S, -20.0, "ambient")
    send(session, START + S)
    assert session.belts == pytest.approx(old_belts, abs=0.1)


def test_blocks_equal_single_messages_bit_for_bit(reference):
    random = np.random.default_rng(5)
    n = 2000
    channel = random.choice([0, 0, 0, 1, 3, 4], n).astype(np.int16)
    stamp = START + np.cumsum(random.integers(0, 40 * MS, n))
    stamp[random.integers(0, n, 20)] = 0
    value = np.where(channel == 0, random.normal(8, 0.2, n), np.where(channel == 1, random.normal(272e3, 1e3, n), 20.0))
    value[random.integers(0, n, 20)] = np.nan
    single_session, block_session = reference.session(), reference.session()
    singles = [
        e.row
        for e in (
            single_session.handle(int(c), int(s), int(s) or 1, float(v)) for c, s, v in zip(channel, stamp, value, strict=True)
        )
        if e
    ]
    arrival = np.where(stamp == 0, 1, stamp)
    halves = [
        block_session.handle_block(channel[part], stamp[part], arrival[part], value[part]).rows
        for part in (slice(0, 777), slice(777, n))
    ]
    assert np.array_equal(np.array(singles), np.concatenate(halves), equal_nan=True)
    assert np.array_equal(single_session.memory.counters, block_session.memory.counters)


def test_reasons_are_counted_by_step(session):
    step = 1 / 3.6
    for i in range(100):
        send(session, START + i * 200 * MS, step * min(i, 30))
    counts = session.reason_counts()
    assert counts[Reason.LOAD_NOMINAL] == counts[Reason.AMBIENT_NOMINAL] == 100
    assert counts[Reason.SPEED_QUANTISED] == 98
    assert Reason.GAP_BRIDGED not in counts
