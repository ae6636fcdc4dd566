# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Defines empirical effects, which have no name in the catalogue: each is a torque that depends on a variable of the drive.

A curve depends on one variable. A corner is a step or a hinge at one value of a variable. A
latch is on above one value and off below another. A sided gain changes the gain of the driving torque for one of its signs. They
are fitted, run live and written to the vehicle file like any other effect. Their names give the variable
(`curve_of_speed`), their parameters are knots and heights.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

from trackres_ros.effects.effect import REFERENCE_NM, Conditions, Effect, Lag, Parameter, Terms, Values
from trackres_ros.kernels.marks import kernel

TYPICAL_NM, MOST_NM = 150.0, 20_000.0  # of a vehicle of `REFERENCE_NM`
MOST_KNOTS = 9
FURTHEST = 1e7  # of a knot, in any unit
CODES = 1  # parameters of a curve before its knots: the variable
MARGIN = 0.1  # of the range between the knots: so far outside of them it was driven now and then
LATCHES_S = 1e-3  # shorter than any step: a latch has its state from the last one
MOST_GAIN = 0.8
TYPICAL_GAIN = 0.1
SMOOTH = 1e-3  # of weight times radius: over it driving turns into braking

SPEED, ACCELERATION, LOAD, AMBIENT, TURN, TURNING, CURVATURE, DRIVING_TORQUE, BELT = range(9)
STEP, ABOVE, BELOW = range(3)
DRIVES, BRAKES, NEGATIVE = 1, -1, 0


@dataclass(frozen=True, slots=True)
class Followed:
    """A variable or a sign of one: its part of an effect's name and of a sentence, its unit and its required inputs."""

    name: str
    text: str
    unit: str
    needs: tuple[str, ...] = ("speed",)


VARIABLES = {
    SPEED: Followed("speed", "speed", "m/s"),
    ACCELERATION: Followed("acceleration", "acceleration", "m/s^2", ("speed", "accel")),
    LOAD: Followed("load", "load", "N", ("speed", "weight")),
    AMBIENT: Followed("ambient", "ambient temperature", "degC", ("speed", "ambient")),
    TURN: Followed("yaw_rate", "yaw rate to the left", "rad/s", ("speed", "yaw_rate")),
    TURNING: Followed("turning", "yaw rate", "rad/s", ("speed", "yaw_rate")),
    CURVATURE: Followed("curvature", "curvature", "1/m", ("speed", "yaw_rate")),
    DRIVING_TORQUE: Followed("driving_torque", "driving torque", "Nm", ("speed", "accel")),
    BELT: Followed("belt_temperature", "belt temperature", "degC", ("speed", "belt")),
}
CORNERS = {STEP: "step_of", ABOVE: "hinge_above", BELOW: "hinge_below"}
SIDES = {DRIVES: Followed("driving", "while it drives", "Nm"), BRAKES: Followed("braking", "while it brakes", "Nm")}
SIDES |= {NEGATIVE: Followed("negative", "where it is negative", "Nm")}  # to a sensor: in reverse it then drives
LATCHED = (SPEED, LOAD, BELT)


@kernel
def variable(at: Conditions, code: float) -> float:
    """The variable of a code."""
    if code == SPEED:
        return abs(at.speed)
    if code == ACCELERATION:
        return at.accel * at.direction
    if code == LOAD:
        return at.weight
    if code == AMBIENT:
        return at.ambient
    if code == TURN:
        return at.yaw_rate
    if code == TURNING:
        return abs(at.yaw_rate)
    if code == CURVATURE:
        return at.curvature
    if code == DRIVING_TORQUE:
        return at.drive_torque * at.direction
    if code == BELT:
        return at.belt
    return 0.0


@kernel
def is_beyond(x: float, low: float, high: float) -> float:
    """1 where a variable is outside of its driven range, with a margin, else 0."""
    margin = MARGIN * (high - low)
    return 1.0 if x < low - margin or x > high + margin else 0.0


@kernel
def latch_state(x: float, state: float, off: float, on: float) -> float:
    """1 if a latch is on now, given its last state `state`, else 0."""
    if x > on:
        return 1.0
    return 1.0 if x >= off and state > 0.5 else 0.0


class EmpiricalEffect(Effect):
    """An effect found by a diagnosis in recordings, without a name in the catalogue."""

    acts_on = "torque"
    belongs_to = "vehicle"
    variable: int
    is_function = True
    """Whether its torque is a function of its variable."""
    rising: Sequence[str] = ()
    """The parameters that rise from one to the next."""

    @property
    def knots(self) -> int:
        """Number of heights."""
        return sum(q.name.startswith("y") for q in self.parameters)


class Curve(EmpiricalEffect):
    """A torque against travel, piecewise linear between knots and constant outside of them. A fit fixes one knot at zero.

    Parameters
    ----------
    variable
        Of `VARIABLES`.
    at
        The variable's value at each knot, rising.
    """

    def __init__(self, variable: int, at: Sequence[float]) -> None:
        quantity = VARIABLES[variable]
        self.variable, self.needs, self.name = variable, quantity.needs, curve_name(variable)
        self.text = f"a torque that follows the {quantity.text}"
        zero = 1 + int(min(range(len(at)), key=lambda i: abs(at[i])))
        self.parameters = (
            _fixed("variable", variable, "code of the variable that it follows"),
            *(_place(f"x{i}", quantity, x, f"value at knot {i}") for i, x in enumerate(at, 1)),
            *(height(f"y{i}", f"torque at knot {i}", i != zero) for i in range(1, len(at) + 1)),
        )
        self.rising = [f"x{i}" for i in range(1, len(at) + 1)]

    def terms(self, at: Conditions, p: Values) -> Terms:
        count = (len(p) - CODES) // 2
        x, knot, end = variable(at, p[0]), CODES, CODES + count - 1
        is_outside = is_beyond(x, p[knot], p[end]) if count > 1 else 0.0
        if x >= p[end]:
            return Terms(torque=p[end + count] * at.direction, extrapolated=is_outside)
        if x <= p[knot]:
            return Terms(torque=p[knot + count] * at.direction, extrapolated=is_outside)
        while p[knot + 1] < x:
            knot += 1
        share = (x - p[knot]) / (p[knot + 1] - p[knot])
        return Terms(torque=(p[knot + count] + share * (p[knot + count + 1] - p[knot + count])) * at.direction)


class Corner(EmpiricalEffect):
    """A step or a hinge: a torque against travel that is constant above a value of a variable, or that is linear
    from there to the end of the driven range, above or below. It is constant outside of that range.

    Parameters
    ----------
    variable, kind
        Of `VARIABLES` and `CORNERS`.
    low, threshold, high
        The variable's value at both ends of the driven range and at the corner, rising.
    """

    rising = ("x1", "threshold", "x2")

    def __init__(self, variable: int, kind: int, low: float = 0.0, threshold: float = 0.5, high: float = 1.0) -> None:
        quantity = VARIABLES[variable]
        self.variable, self.kind, self.needs = variable, kind, quantity.needs
        self.name = corner_name(variable, kind)
        side = "below" if kind == BELOW else "above"
        self.text = f"a torque that {'is there' if kind == STEP else 'grows'} {side} a value of the {quantity.text}"
        self.parameters = (
            _fixed("variable", variable, "code of the variable that it follows"),
            _fixed("kind", kind, "code of a step, a hinge above or a hinge below"),
            _place("threshold", quantity, threshold, "where it begins"),
            _place("x1", quantity, low, "lowest that was driven"),
            _place("x2", quantity, high, "highest that was driven"),
            height("y1", "torque above the threshold" if kind == STEP else "torque at the end of the range"),
        )

    def terms(self, at: Conditions, p: Values) -> Terms:
        x, low, high = variable(at, p[0]), p[3], p[4]
        if p[1] == STEP:
            share = 1.0 if x > p[2] else 0.0
        elif p[1] == ABOVE:
            share = min(max((x - p[2]) / (high - p[2]), 0.0), 1.0)
        else:
            share = min(max((p[2] - x) / (p[2] - low), 0.0), 1.0)
        return Terms(torque=p[5] * share * at.direction, extrapolated=is_beyond(x, low, high))


class Latch(EmpiricalEffect):
    """A torque against travel with hysteresis: it switches on where a variable rises above one value and off where that falls
    below another. It is off in the beginning.

    Parameters
    ----------
    variable
        Of `LATCHED`.
    low, off, on, high
        The variable's value at both ends of the driven range, and at switching off and on, rising.
    """

    rising = ("x1", "off", "on", "x2")

    def __init__(self, variable: int, low: float = 0.0, off: float = 0.3, on: float = 0.7, high: float = 1.0) -> None:
        quantity = VARIABLES[variable]
        self.variable, self.needs, self.name = variable, quantity.needs, f"latch_of_{quantity.name}"
        self.text = f"a torque that comes above one value of the {quantity.text} and goes below another"
        self.parameters = (
            _fixed("variable", variable, "code of the variable that it follows"),
            _place("off", quantity, off, "lower threshold, where it ends"),
            _place("on", quantity, on, "upper threshold, where it begins"),
            _place("x1", quantity, low, "lowest that was driven"),
            _place("x2", quantity, high, "highest that was driven"),
            height("y1", "torque while it acts"),
        )

    def lag(self, at: Conditions, p: Values) -> Lag:
        return Lag(latch_state(variable(at, p[0]), at.own, p[1], p[2]), LATCHES_S, 0.0)

    def terms(self, at: Conditions, p: Values) -> Terms:
        x = variable(at, p[0])
        state = latch_state(x, at.own, p[1], p[2])
        return Terms(torque=p[5] * state * at.direction, extrapolated=is_beyond(x, p[3], p[4]))


class SidedGain(EmpiricalEffect):
    """Another gain on the driving torque for one sign of it, of `SIDES`; `most` is the largest that was driven [Nm]."""

    variable = DRIVING_TORQUE
    is_function = False
    rising = ("x1",)

    def __init__(self, side: int, largest_torque: float = 1.0) -> None:
        side_of_torque = SIDES[side]
        self.side, self.name, self.needs = side, f"gain_while_{side_of_torque.name}", VARIABLES[DRIVING_TORQUE].needs
        self.text = f"another gain on the torque {side_of_torque.text}"
        self.parameters = (
            _fixed("side", side, "1 while driving, -1 while braking, 0 where it is negative"),
            Parameter(
                "gain", "1", -MOST_GAIN, MOST_GAIN, TYPICAL_GAIN, f"share added to the torque {side_of_torque.text}", off=0.0
            ),
            _place("x1", side_of_torque, largest_torque, "largest torque of that sign that was driven"),
        )

    def terms(self, at: Conditions, p: Values) -> Terms:
        drive = at.drive_torque * (at.direction * p[0] if p[0] != NEGATIVE else -1.0)
        share = 0.5 + 0.5 * math.tanh(drive / (SMOOTH * at.facts.weight * at.facts.radius))
        return Terms(
            drive_gain=1.0 + p[1] * share * abs(at.direction), extrapolated=1.0 if drive > (1.0 + MARGIN) * p[2] else 0.0
        )


def curve_name(variable: int) -> str:
    """The name of a curve."""
    return f"curve_of_{VARIABLES[variable].name}"


def corner_name(variable: int, kind: int) -> str:
    """The name of a step or a hinge."""
    return f"{CORNERS[kind]}_{VARIABLES[variable].name}"


CURVES = {curve_name(v): v for v in VARIABLES}
OTHERS: dict[str, Callable[[], EmpiricalEffect]] = {
    **{corner_name(v, kind): partial(Corner, v, kind) for v in VARIABLES for kind in CORNERS},
    **{f"latch_of_{VARIABLES[v].name}": partial(Latch, v) for v in LATCHED},
    **{f"gain_while_{SIDES[side].name}": partial(SidedGain, side) for side in SIDES},
}
NAMES = (*CURVES, *OTHERS)


def learned_effect(name: str, parameters: object, size: float) -> EmpiricalEffect:
    """The effect of a name with as many knots as parameters ask for, for a vehicle with a weight times wheel radius [Nm]."""
    if name in CURVES:
        heights = [key for key in parameters if str(key).startswith("y")] if isinstance(parameters, Mapping) else []
        count = min(max(1, len(heights)), MOST_KNOTS)
        effect: EmpiricalEffect = Curve(CURVES[name], [0.0] * count)
    else:
        effect = OTHERS[name]()
    return sized_effect(effect, size)


def examples() -> list[EmpiricalEffect]:
    """One effect of each class, and one curve for each number of knots: all that need their own C code."""
    curves = [Curve(SPEED, [0.0] * count) for count in range(1, MOST_KNOTS + 1)]
    return [*curves, *(factory() for factory in OTHERS.values())]


def sized_effect(effect: EmpiricalEffect, size: float) -> EmpiricalEffect:
    """The same for a vehicle with a weight times wheel radius [Nm]."""
    effect_copy = copy.copy(effect)
    effect_copy.parameters = tuple(q.times(size / REFERENCE_NM) if q.of_size else q for q in effect.parameters)
    return effect_copy


def _fixed(name: str, code: int, text: str) -> Parameter:
    return Parameter(name, "1", float(code), float(code), float(code), text, fitted=False)


def _place(name: str, quantity: Followed, start: float, text: str) -> Parameter:
    return Parameter(name, quantity.unit, -FURTHEST, FURTHEST, start, f"{quantity.text}: {text}", fitted=False)


def height(name: str, text: str, fitted: bool = True) -> Parameter:
    """A torque of an effect without a name; an unfitted one stays at zero."""
    start, off = (TYPICAL_NM, 0.0) if fitted else (0.0, None)
    return Parameter(name, "Nm", -MOST_NM, MOST_NM, start, text, off=off, of_size=True, fitted=fitted)
