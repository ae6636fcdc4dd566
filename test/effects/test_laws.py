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
from trackres_ros.estimator import columns as at
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
    wild, usable = st.sampled_from(WILD), st.sampled_from(USABLE)
    says = draw(st.dictionaries(st.sampled_from(TERMS), usable, max_size=4))
    if draw(st.booleans()):
        says["torque"] = draw(st.sampled_from([3e3, -3e3, 2e5, -9e5]))
    if draw(st.integers(0, 3)) == 0:
        says |= draw(st.dictionaries(st.sampled_from(TERMS), wild, max_size=2))
    tends = draw(st.none() | st.tuples(usable, usable, usable) | st.tuples(wild, wild, wild))
    fails = draw(st.integers(0, 9)) == 0
    effect = Nasty(says, tends, fails, draw(st.sampled_from([("speed",), ("speed", "accel")])))
    return Active(effect, {"size": 1.0}, {"size": (0.5, 1.5)})


@st.composite
def states(draw):
    """Effects, their owners, and known values at a few steps."""
    effects = draw(st.lists(st.one_of(of_catalogue(), nasty()), min_size=1, max_size=3, unique_by=lambda a: a.effect.name))
    places = st.sampled_from(["vehicle", "surroundings"])
    where = [draw(places) if active.effect.name == "nasty" else active.effect.belongs_to for active in effects]
    parts = draw(st.sets(st.sampled_from(TORQUE_TERMS)))
    known = {
        "load": draw(st.floats(0.15, 2.4)) * VEHICLE.weight,
        "ambient": draw(st.floats(-40.0, 50.0)),
        "yaw_rate": draw(st.floats(-4.0, 4.0)),
        "heading": draw(st.floats(-10.0, 10.0)),
        "accel": draw(st.floats(-5.0, 5.0)),
        "grade": draw(st.floats(-0.5, 0.5)),
        "torque": draw(st.floats(-1e5, 1e5)),
    }
    given_ = {name: value for name, value in known.items() if draw(st.booleans())}
    speeds = draw(st.lists(SPEEDS, min_size=1, max_size=4))
    return effects, where, parts, given_, speeds


def made(effects, where, parts):
    """An estimator whose feed-forward follows at once."""
    of = {kind: tuple(a for a, w in zip(effects, where, strict=True) if w == kind) for kind in ("vehicle", "surroundings")}
    at_once = replace(VEHICLE.chassis, max_acceleration=1e6)  # any speed may follow any other
    vehicle = replace(VEHICLE, chassis=at_once, effects=of["vehicle"], surroundings=of["surroundings"])
    return Estimator(vehicle, Settings(feedforward_rate=1e9, feedforward_parts=tuple(parts)))


def check(estimator, row, parts, accel, grade, stood):
    """The law, on one row of results."""
    names = estimator.columns
    unknown = {"measured_torque_nm", "residual_nm", "motor_torque_nm"}
    bad = [name for name, value in zip(names, row, strict=True) if name not in unknown and not math.isfinite(value)]
    assert not bad
    speed, fed = row[at.Results.speed_mps], row[at.Results.feedforward_torque_nm]
    limit = estimator.constants.number.feedforward_limit * min(1.0, row[at.Results.weight_n] / VEHICLE.weight)
    assert abs(fed) <= limit * (1.0 + 1e-12)
    assert row[at.Results.resistance_std_nm] > 0.0
    if stood and not (grade and "grade" in parts) and not (accel and "inertia" in parts):
        assert fed == 0.0 if speed == 0.0 else abs(fed) < 1.0


@settings(max_examples=60, deadline=None)
@given(states())
@example(([], [], {"inertia"}, {"load": 0.3 * VEHICLE.weight, "accel": 5.0}, [8.0]))
def test_live_feedforward_is_zero_at_rest_and_outputs_are_finite(state):
    effects, where, parts, known, speeds = state
    estimator = made(effects, where, parts)
    session, now = estimator.session(), START_NS
    for i, speed in enumerate((*speeds, *AT_REST)):
        stood = i > len(speeds)  # the first step at rest still reduces the earlier feed-forward
        for name, value in known.items():
            session.handle(session.channel(name), now, now, value)
        estimate = session.handle(at.SPEED, now, now, speed)
        check(estimator, estimate.row, parts, "accel" in known, "grade" in known, stood)
        assert bool(estimate.reasons & at.Reason.SURROUNDINGS) == ("surroundings" in where)
        now += 10**8


@settings(max_examples=15, deadline=None)
@given(states())
def test_along_a_series_too(state):
    effects, where, parts, known, speeds = state
    estimator = made(effects, where, parts)
    series = np.array([*speeds, *AT_REST])
    given_ = {"acceleration": known.get("accel", math.nan), "grade": known.get("grade", math.nan)}
    weight, ambient = known.get("load", VEHICLE.weight), known.get("ambient", 15.0)
    start = estimator.cold_start(estimator.inputs(series[0], weight=weight, ambient=ambient))
    _, rows = estimator.run(start, 0.1 * np.arange(len(series)), series, weight, ambient, **given_)
    for i, row in enumerate(rows):
        check(estimator, row, parts, "accel" in known, "grade" in known, i > len(speeds))


@pytest.mark.parametrize(
    "says",
    [{"torque": math.nan}, {"torque": 1e300}, {"loss_factor": math.inf}, {"heat": 1e9}, {"film_offset_factor": 0.0}],
    ids=str,
)
def test_what_says_nothing_usable_is_left_out_and_that_is_said(says):
    plain, without = made([], [], ()), made([Active(Nasty(says, None, False, ("speed",)), {"size": 1.0})], ["vehicle"], ())
    rows = []
    for estimator in (plain, without):
        session = estimator.session()
        estimates = [session.handle(at.SPEED, START_NS + i * 10**8, START_NS + i * 10**8, 5.0) for i in range(3)]
        rows.append(np.array([e.row[: at.Results.reasons] for e in estimates]))
        assert all(bool(e.reasons & at.Reason.EFFECT_LEFT_OUT) == (estimator is without) for e in estimates)
    np.testing.assert_array_equal(rows[0], rows[1])


def fed(effects, where, parts, speed, **known):
    """Feed-forward and drive torque of one step, with effects and without [Nm]."""
    found = []
    for some, places in ((effects, where), ([], [])):
        session = made(some, places, parts).session()
        for name, value in known.items():
            session.handle(session.channel(name), START_NS, START_NS, value)
        for now in (START_NS, START_NS + 10**8):  # over no time at all nothing moves
            row = session.handle(at.SPEED, now, now, speed).row
        found.append((row[at.Results.feedforward_torque_nm], row[at.Results.drive_torque_nm]))
    return found


def test_only_a_moving_vehicles_own_effects_are_fed_forward():
    pushing = Active(Nasty({"torque": 500.0}, None, False, ("speed",)), {"size": 1.0})
    for where, speed in itertools.product(("vehicle", "surroundings"), (0.0, 5.0)):
        share = float(where == "vehicle" and speed > 0.0)
        (with_it, driven), (without, driven_without) = fed([pushing], [where], ("hysteresis",), speed)
        assert with_it - without == pytest.approx(500.0 * share, abs=0.01)
        assert driven - driven_without == pytest.approx(500.0)


def test_an_acceleration_effect_is_fed_forward_like_inertia():
    rotating = Active(next(e for e in CATALOGUE if e.name == "rotating_inertia"), {"factor": 0.5})
    given_ = {"accel": 0.2}
    for parts, known, fed_forward in (((), given_, False), (("inertia",), given_, True), (("inertia",), {}, False)):
        (with_it, _), (without, _) = fed([rotating], ["vehicle"], parts, 5.0, **known)
        assert (abs(with_it - without) > 500.0) == fed_forward


def test_a_drivetrain_gain_scales_only_the_feedforward():
    lossy = Active(next(e for e in CATALOGUE if e.name == "drivetrain_efficiency"), {"efficiency": 0.8})
    session = made([lossy], ["vehicle"], ("hysteresis",)).session()
    for i in range(3):  # it looks at the driving torque of the step before
        now = START_NS + i * 10**8
        session.handle(session.channel("grade"), now, now, 0.1)
        estimate = session.handle(at.SPEED, now, now, 5.0)
    assert estimate["feedforward_torque_nm"] == pytest.approx(estimate["hysteresis_nm"] / 0.8, rel=1e-6)


def test_the_range_of_an_effect_is_in_the_standard_deviation():
    drag = next(e for e in CATALOGUE if e.name == "drivetrain_drag")
    stds = []
    for ranges in ({}, {"drag": (100.0, 300.0)}):
        session = made([Active(drag, {"drag": 200.0}, ranges)], ["vehicle"], ()).session()
        stds.append(session.handle(at.SPEED, START_NS, START_NS, 5.0)["resistance_std_nm"])
    assert math.sqrt(stds[1] ** 2 - stds[0] ** 2) == pytest.approx(50.0, rel=1e-6)  # the range is +-2 of them
