# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Effects without a name: laws of curves, corners and latches, and their way through a vehicle file."""

import math

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from trackres_ros.diagnosis import load_base
from trackres_ros.effects import Active, catalogue, check_effects
from trackres_ros.effects.calls import is_compiled
from trackres_ros.effects.effect import conditions
from trackres_ros.effects.learned import (
    ABOVE,
    ACCELERATION,
    AMBIENT,
    BELOW,
    BELT,
    CORNERS,
    CURVATURE,
    CURVES,
    DRIVING_TORQUE,
    LATCHED,
    LOAD,
    MOST_KNOTS,
    NAMES,
    NEGATIVE,
    SIDES,
    SPEED,
    STEP,
    TURN,
    TURNING,
    VARIABLES,
    Corner,
    Curve,
    Latch,
    SidedGain,
    sized_effect,
)
from trackres_ros.effects.stepping import new_memory
from trackres_ros.errors import InputError
from trackres_ros.model.track import vehicle_constants
from trackres_ros.tasks.main import cli
from trackres_ros.units import STANDSTILL_MPS
from trackres_ros.vehicle import load
from trackres_ros.vehicle.writing.changes import FileChanges

FACTS = vehicle_constants(load("xgd24d"))
STEP_S = 0.1
OF_VARIABLE = {
    SPEED: lambda at: abs(at.speed),
    ACCELERATION: lambda at: at.accel * at.direction,
    LOAD: lambda at: at.weight,
    AMBIENT: lambda at: at.ambient,
    TURN: lambda at: at.yaw_rate,
    TURNING: lambda at: abs(at.yaw_rate),
    CURVATURE: lambda at: at.curvature,
    DRIVING_TORQUE: lambda at: at.drive_torque * at.direction,
    BELT: lambda at: at.belt,
}
# Ranges of the variables, for knots.
REACH = {
    SPEED: (0.0, 15.0), ACCELERATION: (-1.0, 1.0), LOAD: (1e5, 4e5), AMBIENT: (-20.0, 40.0),
    TURN: (-0.5, 0.5), TURNING: (0.0, 0.5), CURVATURE: (0.0, 0.5), DRIVING_TORQUE: (-2e4, 2e4),
    BELT: (-20.0, 90.0),
}  # fmt: skip
SOME = [  # of every kind, one
    Curve(SPEED, [1.0, 3.0, 8.0]),
    Curve(BELT, [10.0, 30.0, 60.0]),
    Corner(SPEED, STEP, 1.0, 5.0, 10.0),
    Corner(BELT, ABOVE, 10.0, 20.0, 60.0),
    Corner(LOAD, BELOW, 2e5, 2.7e5, 3e5),
    Latch(SPEED, 1.0, 3.0, 6.0, 10.0),
    Latch(BELT, 10.0, 20.0, 40.0, 60.0),
    *(SidedGain(side, 9000.0) for side in SIDES),
]


def within(pair):
    return st.floats(*pair, allow_nan=False)


@st.composite
def curves(draw):
    """A curve of any variable, with values."""
    variable = draw(st.sampled_from(sorted(VARIABLES)))
    low, high = REACH[variable]
    # Hundredths of the reach: knots that lie apart by more than rounding.
    places = draw(st.lists(st.integers(0, 100), min_size=1, max_size=MOST_KNOTS, unique=True).map(sorted))
    x = [low + 0.01 * place * (high - low) for place in places]
    curve = Curve(variable, x)
    y = draw(st.lists(within((-3000.0, 3000.0)), min_size=len(x), max_size=len(x)))
    return curve, x, y


ANYWHERE = st.builds(
    conditions, st.just(FACTS), speed=within((-15.0, 15.0)), accel=within((-1.5, 1.5)), weight=within((5e4, 5e5)),
    ambient=within((-30.0, 50.0)), yaw_rate=within((-0.6, 0.6)), drive_torque=within((-3e4, 3e4)), belt=within((-30.0, 110.0)),
)  # fmt: skip


def active(curve, y):
    return Active(curve, {**curve.values(), **{f"y{i}": height for i, height in enumerate(y, 1)}})


# Curves


@given(curves(), ANYWHERE)
def test_a_curve_is_linear_between_knots_and_constant_beyond(drawn, at):
    curve, x, y = drawn
    by_hand = np.interp(OF_VARIABLE[curve.variable](at), x, y) * math.tanh(at.speed / STANDSTILL_MPS)
    assert active(curve, y).terms(at).torque == pytest.approx(by_hand, rel=1e-9, abs=1e-7)


@pytest.mark.parametrize("effect", SOME, ids=lambda e: e.name)
@pytest.mark.parametrize("speed", [-3.0, 0.0, 0.2, 6.0])
def test_compiled_and_interpreted_give_the_same_bits(stepped, effect, speed):
    assert is_compiled(effect)
    learned_effect = active(effect, [120.0, -80.0, 310.0][: effect.knots])
    of_machine, of_python = new_memory(1), new_memory(1)
    for accel, yaw_rate, belt in ((0.2, 0.1, 30.0), (-0.5, -0.1, 50.0), (-0.5, 0.2, 30.0), (0.0, 0.0, 10.0)):
        at = conditions(FACTS, speed, accel, 250e3, 10.0, yaw_rate, drive_torque=3000.0 if accel > 0.0 else -3000.0, belt=belt)
        terms = [
            stepped([learned_effect], at, memory, machine, dt=7.0) for memory, machine in ((of_machine, True), (of_python, False))
        ]
        np.testing.assert_array_equal(*terms)
    np.testing.assert_array_equal(of_machine, of_python)


# Corners, latches and gains


@given(within((-30.0, 110.0)), within((-15.0, 15.0)))
def test_corners_are_straight_from_their_threshold_to_the_end(belt, speed):
    at, sign = conditions(FACTS, speed, belt=belt), math.tanh(speed / STANDSTILL_MPS)
    expected = {
        STEP: 400.0 * (belt > 30.0),
        ABOVE: np.interp(belt, [30.0, 60.0], [0.0, 400.0]),
        BELOW: np.interp(belt, [10.0, 30.0], [400.0, 0.0]),
    }
    for kind, torque in expected.items():
        terms = active(Corner(BELT, kind, 10.0, 30.0, 60.0), [400.0]).terms(at)
        assert terms.torque == pytest.approx(torque * sign, rel=1e-9, abs=1e-9)
        assert (terms.extrapolated > 0.0) == (not 5.0 <= belt <= 65.0)


def test_a_latch_holds_its_state_between_its_thresholds(stepped):
    latch, memory = active(Latch(SPEED, 0.0, 3.0, 6.0, 10.0), [400.0]), new_memory(1)
    course = [(2.0, 0), (5.0, 0), (6.5, 1), (5.0, 1), (3.1, 1), (2.9, 0), (5.9, 0), (-7.0, 1), (-4.0, 1), (0.0, 0), (4.0, 0)]
    for speed, state in course:
        torque = stepped([latch], conditions(FACTS, speed), memory, dt=0.02)[0]
        assert torque == pytest.approx(400.0 * state * math.tanh(speed / STANDSTILL_MPS), abs=1e-6)


@given(within((-2e4, 2e4)), within((-15.0, 15.0)), st.sampled_from([*SIDES]))
def test_a_sided_gain_changes_one_sign_of_the_torque_only(drive, speed, side):
    gain_effect = Active(SidedGain(side, 1e4), {**SidedGain(side, 1e4).values(), "gain": -0.3})
    terms, forward_torque = (
        gain_effect.terms(conditions(FACTS, speed, drive_torque=drive)),
        drive * math.tanh(speed / STANDSTILL_MPS),
    )
    assert terms.torque == 0.0
    if abs(forward_torque) > 500.0:
        is_active = drive < 0.0 if side == NEGATIVE else forward_torque * side > 0.0
        share = abs(math.tanh(speed / STANDSTILL_MPS)) if is_active else 0.0
        assert terms.drive_gain == pytest.approx(1.0 - 0.3 * share, rel=1e-3)


@pytest.mark.parametrize("effect", SOME, ids=lambda e: e.name)
def test_at_rest_no_learned_effect_does_anything(effect):
    learned_effect = active(effect, [400.0] * effect.knots)
    for state in (0.0, 1.0):
        terms = learned_effect.terms(conditions(FACTS, 0.0, 0.2, 250e3, 10.0, 0.1, drive_torque=3000.0, belt=50.0), state)
        assert (terms.torque, terms.drive_gain) == (0.0, 1.0)


# Names and sizes


def test_every_name_is_that_of_one_form():
    assert len(set(NAMES)) == len(NAMES) == len(CURVES) + 9 * len(CORNERS) + len(LATCHED) + len(SIDES)
    assert not set(NAMES) & set(catalogue())
    for name, variable in CURVES.items():
        assert Curve(variable, [0.0]).name == name


def test_torques_grow_with_the_vehicle_and_knots_do_not():
    full = Curve(SPEED, [1.0, 5.0])
    half = sized_effect(full, 0.5 * 97920.0)
    for q, half_parameter in zip(full.parameters, half.parameters, strict=True):
        factor = 0.5 if q.name.startswith("y") else 1.0
        assert (half_parameter.low, half_parameter.start, half_parameter.high) == pytest.approx(
            (factor * q.low, factor * q.start, factor * q.high)
        )


# Vehicle files


def written(tmp_path, one):
    base = load_base("xgd24d").base
    base.write(tmp_path / "vehicle.yaml", FileChanges(None, (one,), {}), "Written by trackres diagnose from x.")
    return tmp_path / "vehicle.yaml"


@pytest.mark.parametrize("effect", SOME, ids=lambda e: e.name)
def test_a_learned_effect_survives_writing_and_reading_its_file(effect, tmp_path):
    learned_effect = active(effect, [123.456, -80.0, 310.0][: effect.knots])
    path = written(tmp_path, learned_effect)
    (copy,) = load(path).effects
    assert copy.effect.name == effect.name
    assert copy.values == pytest.approx(learned_effect.values, rel=1e-5)
    assert [q.name for q in copy.effect.parameters] == [q.name for q in effect.parameters]
    for speed, accel, yaw_rate in ((6.0, 0.1, 0.2), (2.0, -0.4, -0.2), (-4.0, 0.0, 0.1)):
        at = conditions(FACTS, speed, accel, 260e3, 10.0, yaw_rate, drive_torque=4e3, belt=30.0)
        for state in (0.4, 0.6):
            assert copy.terms(at, state) == pytest.approx(learned_effect.terms(at, state), rel=1e-4)


def test_commands_take_a_file_with_what_was_learned(tmp_path):
    path = written(tmp_path, active(Curve(TURN, [-0.2, 0.2]), [0.0, 425.0]))
    rows = [f"{i * 0.1:.1f},5.0,{0.2 if i < 100 else -0.2}" for i in range(200)]
    (tmp_path / "drive.csv").write_text("\n".join(["time_s,speed_mps,yaw_rate_radps", *rows]) + "\n")
    for command in (
        ["vehicle", "check", path, "--points", 10],
        ["replay", tmp_path / "drive.csv", "--vehicle", path, "-o", tmp_path / "out.csv"],
    ):
        result = CliRunner().invoke(cli, [str(word) for word in command])
        assert result.exit_code == 0, result.exception
    effects_nm = np.genfromtxt(tmp_path / "out.csv", delimiter=",", names=True)["effects_nm"]
    assert effects_nm[50:95] == pytest.approx(425.0, rel=1e-4)
    assert effects_nm[105:] == pytest.approx(0.0, abs=1e-6)


KNOTS = {"x1": 1.0, "x2": 3.0, "y1": 10.0, "y2": 20.0}
MANY = {f"{of}{i}": float(i) for of in "xy" for i in range(1, MOST_KNOTS + 2)}


@pytest.mark.parametrize(
    ("name", "values", "said"),
    [
        ("curve_of_speed", {**KNOTS, "x2": 1.0}, "x1 to x2.*rise"),
        ("curve_of_speed", {**KNOTS, "x2": 0.5}, "x1 to x2.*rise"),
        ("curve_of_speed", MANY, f"effects.curve_of_speed.*a value for each of .*x{MOST_KNOTS}, y1"),
        ("curve_of_speed", {**KNOTS, "x3": 4.0}, "effects.curve_of_speed.*a value for each of x1, x2, y1, y2$"),
        ("curve_of_speed", {**KNOTS, "y1": 1e9}, "effects.curve_of_speed.y1"),
        ("curve_of_speed", 7.0, "effects.curve_of_speed.*a value for each"),
        ("step_of_speed", {"threshold": 5.0, "x1": 1.0, "x2": 4.0, "y1": 10.0}, "x1 to x2.*x1, threshold, x2 that rise"),
        ("latch_of_speed", {"off": 3.0, "on": 2.0, "x1": 1.0, "x2": 4.0, "y1": 10.0}, "x1, off, on, x2 that rise"),
        ("gain_while_braking", {"gain": -0.9, "x1": 1e4}, "gain_while_braking.gain"),
        ("curve_of_sped", KNOTS, "curve_of_sped.*did you mean curve_of_speed"),
    ],
    ids=str,
)
def test_what_cannot_be_a_learned_effect_is_refused_by_name(name, values, said):
    with pytest.raises(InputError, match=said):
        check_effects({name: values}, "vehicle.yaml: effects", catalogue(), "vehicle")
