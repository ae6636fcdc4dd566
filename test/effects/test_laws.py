# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""For all effects in a vehicle or surroundings file: nothing pushes a standing vehicle, and every number is finite."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from trackres_ros.effects import Active, Effect, Lag, Parameter, Terms, catalogue
from trackres_ros.estimator import columns as layout
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.settings import Settings
from trackres_ros.model.resistance import TORQUE_TERMS
from trackres_ros.units import STANDSTILL_MPS
from trackres_ros.vehicle import load

START_NS = 1_700_000_000_000_000_000
VEHICLE = load("xgd24d")
SIZE = VEHICLE.weight * VEHICLE.track_of(VEHICLE.assemblies[0]).sprocket_radius
CATALOGUE = [effect for effect in catalogue(size=SIZE).values() if effect.belongs_to != "sensor"]
WILD = [0.0, 1e12, -1e12, 1e300, -1e300, math.inf, -math.inf, math.nan, 1e-300, -1.0]
USABLE = [0.02, 0.5, 1.0, 3.0, 50.0]
TERMS = [name for name in Terms._fields if not name.startswith(("sensor", "speed"))]
SPEEDS = st.one_of(
    st.sampled_from([0.0, -0.0, 1e-12, -1e-12, 1e-3, -0.02, STANDSTILL_MPS, -STANDSTILL_MPS]), st.floats(-16.0, 16.0)
)
AT_REST = (0.0, 0.0, 1e-9, -1e-10, -0.0)


class Nasty(Effect):
    """A user's effect that returns any given value, moving or not, or fails."""

    name = "nasty"
    acts_on = "torque"
    belongs_to = "vehicle"
    text = "anything"
    parameters = (Parameter("size", "1", 0.0, 2.0, 1.0, "of it", off=0.0),)

    def __init__(self, says, tends, fails, needs):
        self.says, self.tends, self.fails, self.needs = says, tends, fails, needs

    def lag(self, at, p):
        return None if self.tends is None else Lag(*self.tends)

    def terms(self, at, p):
        if self.fails:
            raise ZeroDivisionError
        return Terms(**self.says)


@st.composite
def of_catalogue(draw):
    effect = draw(st.sampled_from(CATALOGUE))
    values = {q.name: draw(st.floats(q.low, q.high)) for q in effect.parameters}
    ranges = {name: (0.9 * value, 1.1 * value) if value > 0 else (1.1 * value, 0.9 * value) for name, value in values.items()}
    return Active(effect, values, ranges)


@st.composite
def nasty(draw):
    wild_number, number_of = st.sampled_from(WILD), st.sampled_from(USABLE)
    terms = draw(st.dictionaries(st.sampled_from(TERMS), number_of, max_size=4))
    if draw(st.booleans()):
        terms["torque"] = draw(st.sampled_from([3e3, -3e3, 2e5, -9e5]))
    if draw(st.integers(0, 3)) == 0:
        terms |= draw(st.dictionaries(st.sampled_from(TERMS), wild_number, max_size=2))
    tends = draw(st.none() | st.tuples(number_of, number_of, number_of) | st.tuples(wild_number, wild_number, wild_number))
    has_error = draw(st.integers(0, 9)) == 0
    effect = Nasty(terms, tends, has_error, draw(st.sampled_from([("speed",), ("speed", "accel")])))
    return Active(effect, {"size": 1.0}, {"size": (0.5, 1.5)})


@st.composite
def states(draw):
    """Effects, their owners, and known values at a few steps."""
    effects = draw(st.lists(st.one_of(of_catalogue(), nasty()), min_size=1, max_size=3, unique_by=lambda a: a.effect.name))
    places = st.sampled_from(["vehicle", "surroundings"])
    owners = [draw(places) if active.effect.name == "nasty" else active.effect.belongs_to for active in effects]
    parts = draw(st.sets(st.sampled_from(TORQUE_TERMS)))
    values = {
        "load": draw(st.floats(0.15, 2.4)) * VEHICLE.weight,
        "ambient": draw(st.floats(-40.0, 50.0)),
        "yaw_rate": draw(st.floats(-4.0, 4.0)),
        "heading": draw(st.floats(-10.0, 10.0)),
        "accel": draw(st.floats(-5.0, 5.0)),
        "grade": draw(st.floats(-0.5, 0.5)),
        "torque": draw(st.floats(-1e5, 1e5)),
    }
    given_ = {name: value for name, value in values.items() if draw(st.booleans())}
    speeds = draw(st.lists(SPEEDS, min_size=1, max_size=4))
    return effects, owners, parts, given_, speeds


def made(effects, where, parts):
    """An estimator whose feed-forward follows at once."""
    by_owner = {kind: tuple(a for a, w in zip(effects, where, strict=True) if w == kind) for kind in ("vehicle", "surroundings")}
    at_once = replace(VEHICLE.chassis, max_acceleration=1e6)  # any speed may follow any other
    vehicle = replace(VEHICLE, chassis=at_once, effects=by_owner["vehicle"], surroundings=by_owner["surroundings"])
    return Estimator(vehicle, Settings(feedforward_rate=1e9, feedforward_parts=tuple(parts)))


def check(estimator, row, parts, accel, grade, stood):
    """The law, on one row of results."""
    names = estimator.columns
    unchecked = {"measured_torque_nm", "residual_nm", "motor_torque_nm"}
    faults = [name for name, value in zip(names, row, strict=True) if name not in unchecked and not math.isfinite(value)]
    assert not faults
    speed, feedforward = row[layout.Results.speed_mps], row[layout.Results.feedforward_torque_nm]
    limit = estimator.constants.number.feedforward_limit * min(1.0, row[layout.Results.weight_n] / VEHICLE.weight)
    assert abs(feedforward) <= limit * (1.0 + 1e-12)
    assert row[layout.Results.resistance_std_nm] > 0.0
    if stood and not (grade and "grade" in parts) and not (accel and "inertia" in parts):
        assert feedforward == 0.0 if speed == 0.0 else abs(feedforward) < 1.0


@settings(max_examples=60, deadline=None)
@given(states())
@example(([], [], {"inertia"}, {"load": 0.3 * VEHICLE.weight, "accel": 5.0}, [8.0]))
def test_live_feedforward_is_zero_at_rest_and_outputs_are_finite(state):
    effects, owners, parts, values, speeds = state
    estimator = made(effects, owners, parts)
    session, time_ns = estimator.session(), START_NS
    for i, speed in enumerate((*speeds, *AT_REST)):
        has_stood = i > len(speeds)  # the first step at rest still reduces the earlier feed-forward
        for name, value in values.items():
            session.handle(session.channel(name), time_ns, time_ns, value)
        estimate = session.handle(layout.SPEED, time_ns, time_ns, speed)
        check(estimator, estimate.row, parts, "accel" in values, "grade" in values, has_stood)
        assert bool(estimate.reasons & layout.Reason.SURROUNDINGS) == ("surroundings" in owners)
        time_ns += 10**8


@settings(max_examples=15, deadline=None)
@given(states())
def test_along_a_series_too(state):
    effects, owners, parts, values, speeds = state
    estimator = made(effects, owners, parts)
    series = np.array([*speeds, *AT_REST])
    given_ = {"acceleration": values.get("accel", math.nan), "grade": values.get("grade", math.nan)}
    weight, ambient = values.get("load", VEHICLE.weight), values.get("ambient", 15.0)
    start = estimator.cold_start(estimator.inputs(series[0], weight=weight, ambient=ambient))
    _, rows = estimator.run(start, 0.1 * np.arange(len(series)), series, weight, ambient, **given_)
    for i, row in enumerate(rows):
        check(estimator, row, parts, "accel" in values, "grade" in values, i > len(speeds))


@pytest.mark.parametrize(
    "says",
    [{"torque": math.nan}, {"torque": 1e300}, {"loss_factor": math.inf}, {"heat": 1e9}, {"film_offset_factor": 0.0}],
    ids=str,
)
def test_what_says_nothing_usable_is_left_out_and_that_is_said(says):
    bare_estimator, effect_estimator = (
        made([], [], ()),
        made([Active(Nasty(says, None, False, ("speed",)), {"size": 1.0})], ["vehicle"], ()),
    )
    rows = []
    for estimator in (bare_estimator, effect_estimator):
        session = estimator.session()
        estimates = [session.handle(layout.SPEED, START_NS + i * 10**8, START_NS + i * 10**8, 5.0) for i in range(3)]
        rows.append(np.array([e.row[: layout.Results.reasons] for e in estimates]))
        assert all(bool(e.reasons & layout.Reason.EFFECT_LEFT_OUT) == (estimator is effect_estimator) for e in estimates)
    np.testing.assert_array_equal(rows[0], rows[1])


def fed(effects, where, parts, speed, **known):
    """Feed-forward and drive torque of one step, with effects and without [Nm]."""
    torques = []
    for active_effects, places in ((effects, where), ([], [])):
        session = made(active_effects, places, parts).session()
        for name, value in known.items():
            session.handle(session.channel(name), START_NS, START_NS, value)
        for time_ns in (START_NS, START_NS + 10**8):  # over no time at all nothing moves
            row = session.handle(layout.SPEED, time_ns, time_ns, speed).row
        torques.append((row[layout.Results.feedforward_torque_nm], row[layout.Results.drive_torque_nm]))
    return torques


def test_only_a_moving_vehicles_own_effects_are_fed_forward():
    push = Active(Nasty({"torque": 500.0}, None, False, ("speed",)), {"size": 1.0})
    for owner, speed in itertools.product(("vehicle", "surroundings"), (0.0, 5.0)):
        share = float(owner == "vehicle" and speed > 0.0)
        (effect_torque, drive_torque), (bare_torque, bare_drive_torque) = fed([push], [owner], ("hysteresis",), speed)
        assert effect_torque - bare_torque == pytest.approx(500.0 * share, abs=0.01)
        assert drive_torque - bare_drive_torque == pytest.approx(500.0)


def test_an_acceleration_effect_is_fed_forward_like_inertia():
    inertia_effect = Active(next(e for e in CATALOGUE if e.name == "rotating_inertia"), {"factor": 0.5})
    given_ = {"accel": 0.2}
    for parts, values, fed_forward in (((), given_, False), (("inertia",), given_, True), (("inertia",), {}, False)):
        (effect_torque, _), (bare_torque, _) = fed([inertia_effect], ["vehicle"], parts, 5.0, **values)
        assert (abs(effect_torque - bare_torque) > 500.0) == fed_forward


def test_a_drivetrain_gain_scales_only_the_feedforward():
    gain_effect = Active(next(e for e in CATALOGUE if e.name == "drivetrain_efficiency"), {"efficiency": 0.8})
    session = made([gain_effect], ["vehicle"], ("hysteresis",)).session()
    for i in range(3):  # it looks at the driving torque of the step before
        time_ns = START_NS + i * 10**8
        session.handle(session.channel("grade"), time_ns, time_ns, 0.1)
        estimate = session.handle(layout.SPEED, time_ns, time_ns, 5.0)
    assert estimate["feedforward_torque_nm"] == pytest.approx(estimate["hysteresis_nm"] / 0.8, rel=1e-6)


def test_the_range_of_an_effect_is_in_the_standard_deviation():
    drag = next(e for e in CATALOGUE if e.name == "drivetrain_drag")
    stds = []
    for ranges in ({}, {"drag": (100.0, 300.0)}):
        session = made([Active(drag, {"drag": 200.0}, ranges)], ["vehicle"], ()).session()
        stds.append(session.handle(layout.SPEED, START_NS, START_NS, 5.0)["resistance_std_nm"])
    assert math.sqrt(stds[1] ** 2 - stds[0] ** 2) == pytest.approx(50.0, rel=1e-6)  # the range is +-2 of them
