# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Learned effects have no name in the catalogue: each is a torque that follows what is known of a drive, as a diagnosis found it.

A curve follows one variable, always or only where a gate is open; a build-up is taken away by a stop or by time. They are effects
as any other: they are fitted, run live and are written to the vehicle file. Their names say what they follow
(`curve_of_speed_when_light`), their parameters are the knots.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from trackres_ros.effects.effect import REFERENCE_NM, Conditions, Effect, Lag, Parameter, Terms, Values
from trackres_ros.jit.compiled import inlined

TYPICAL_NM, MOST_NM = 150.0, 20_000.0  # of a vehicle of `REFERENCE_NM`
MOST_KNOTS = 9
FURTHEST = 1e7  # of a knot, in any unit
CODES = 3  # parameters of a curve before its knots: variable, gate, threshold
MARGIN = 0.1  # of the range between the knots: so far outside of them it was driven now and then
MOVING_MPS = 0.3
BRAKING_MPS2 = -0.3
RESET_S = 1.0
SETS_ON_S = 2.0

ALWAYS, SPEED, ACCELERATION, LOAD, AMBIENT, TURN, TURNING, CURVATURE, DRIVING_TORQUE = range(9)
OPEN, LEFT, RIGHT, HEAVY, LIGHT, BRAKING, ACCELERATING = range(7)
BY_DISTANCE, BY_TIME, BY_BRAKING = range(3)


@dataclass(frozen=True, slots=True)
class Followed:
    """A variable, a gate or a build-up: its name in an effect's name, what a sentence says, its unit and what it needs."""

    name: str
    text: str
    unit: str
    needs: tuple[str, ...] = ("speed",)


VARIABLES = {
    ALWAYS: Followed("constant", "", "1"),
    SPEED: Followed("speed", "speed", "m/s"),
    ACCELERATION: Followed("acceleration", "acceleration", "m/s^2", ("speed", "accel")),
    LOAD: Followed("load", "load", "N", ("speed", "weight")),
    AMBIENT: Followed("ambient", "ambient temperature", "degC", ("speed", "ambient")),
    TURN: Followed("yaw_rate", "yaw rate to the left", "rad/s", ("speed", "yaw_rate")),
    TURNING: Followed("turning", "yaw rate", "rad/s", ("speed", "yaw_rate")),
    CURVATURE: Followed("curvature", "curvature", "1/m", ("speed", "yaw_rate")),
    DRIVING_TORQUE: Followed("driving_torque", "driving torque", "Nm", ("speed", "accel")),
}
GATES = {
    OPEN: Followed("", "", "1"),
    LEFT: Followed("left", "in left turns", "rad/s", ("yaw_rate",)),
    RIGHT: Followed("right", "in right turns", "rad/s", ("yaw_rate",)),
    HEAVY: Followed("heavy", "when heavy", "N", ("weight",)),
    LIGHT: Followed("light", "when light", "N", ("weight",)),
    BRAKING: Followed("braking", "while it slows down", "m/s^2", ("accel",)),
    ACCELERATING: Followed("accelerating", "while it speeds up", "m/s^2", ("accel",)),
}
BUILD_UPS = {
    BY_DISTANCE: Followed("build_up_over_distance", "with distance since a stop", "m"),
    BY_TIME: Followed("build_up_over_time", "with time since a stop", "s"),
    BY_BRAKING: Followed("drag_after_braking", "after it has slowed down", "s", ("speed", "accel")),
}


@inlined
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
    return 0.0


@inlined
def is_open(at: Conditions, code: float, threshold: float) -> bool:
    """Whether the gate of a code is open."""
    if code == LEFT:
        return at.yaw_rate > threshold
    if code == RIGHT:
        return at.yaw_rate < -threshold
    if code == HEAVY:
        return at.weight > threshold
    if code == LIGHT:
        return at.weight < threshold
    if code == BRAKING:
        return at.accel * at.direction < -threshold
    if code == ACCELERATING:
        return at.accel * at.direction > threshold
    return True


class Learned(Effect):
    """An effect that a diagnosis found in recordings and that the catalogue has no name for."""

    acts_on = "torque"
    belongs_to = "vehicle"

    @property
    def knots(self) -> int:
        """How many heights it has."""
        return sum(q.name.startswith("y") for q in self.parameters)


class Curve(Learned):
    """A torque against travel along straight lines between knots, held at the value of the last knot outside of them, and zero
    where the gate's condition does not hold. A fit leaves one knot of a curve without a gate at zero: a constant is no curve.

    Parameters
    ----------
    variable, gate
        Of `VARIABLES` and `GATES`.
    at
        The variable's value at each knot, rising.
    threshold
        Of the gate, in its unit.
    """

    def __init__(self, variable: int, gate: int, at: Sequence[float], threshold: float = 0.0) -> None:
        follows, opens = VARIABLES[variable], GATES[gate]
        self.variable, self.gate = variable, gate
        self.name = curve_name(variable, gate)
        self.text = " ".join(filter(None, ("a torque", follows.text and f"that follows the {follows.text},", opens.text)))
        self.needs = tuple(dict.fromkeys((*follows.needs, *opens.needs)))
        zero = 1 + int(min(range(len(at)), key=lambda i: abs(at[i])))
        self.parameters = (
            _fixed("variable", variable, "code of what it follows"),
            _fixed("gate", gate, "code of where it acts"),
            Parameter("threshold", opens.unit, -FURTHEST, FURTHEST, threshold, "where the gate opens", fitted=False),
            *(
                Parameter(f"x{i}", follows.unit, -FURTHEST, FURTHEST, x, f"{follows.text or 'nothing'} at knot {i}", fitted=False)
                for i, x in enumerate(at, 1)
            ),
            *(height(f"y{i}", f"torque at knot {i}", gate != OPEN or i != zero) for i in range(1, len(at) + 1)),
        )

    def terms(self, at: Conditions, p: Values) -> Terms:
        if not is_open(at, p[1], p[2]):
            return Terms(torque=0.0)
        count = (len(p) - CODES) // 2
        x, knot, last = variable(at, p[0]), CODES, CODES + count - 1
        little = MARGIN * (p[last] - p[knot])
        extrapolated = 1.0 if count > 1 and (x < p[knot] - little or x > p[last] + little) else 0.0
        if x >= p[last]:
            return Terms(torque=p[last + count] * at.direction, extrapolated=extrapolated)
        if x <= p[knot]:
            return Terms(torque=p[knot + count] * at.direction, extrapolated=extrapolated)
        while p[knot + 1] < x:
            knot += 1
        share = (x - p[knot]) / (p[knot + 1] - p[knot])
        return Terms(torque=(p[knot + count] + share * (p[knot + count + 1] - p[knot + count])) * at.direction)


class BuildUp(Learned):
    """A torque against travel that builds up and goes: with distance or time since a stop, which takes it away at once; or that
    comes with braking and goes with time.

    Parameters
    ----------
    by
        Of `BUILD_UPS`.
    scale
        Distance [m] or time [s] in which two thirds of it have come, or gone.
    """

    def __init__(self, by: int, scale: float) -> None:
        of = BUILD_UPS[by]
        self.by, self.name, self.needs = by, of.name, of.needs
        self.text = f"a torque that {'goes with time' if by == BY_BRAKING else 'builds up'} {of.text}"
        low, high = (20.0, 20_000.0) if by == BY_DISTANCE else (5.0, 3000.0)
        self.parameters = (
            _fixed("by", by, "code of what builds it up"),
            height("y1", "torque when built up"),
            Parameter("scale", of.unit, low, high, scale, "in which two thirds of it have come or gone",
                      more_starts=(0.25 * scale, 4.0 * scale)),
        )  # fmt: skip

    def lag(self, at: Conditions, p: Values) -> Lag:
        moving = abs(at.speed) > MOVING_MPS
        if p[0] == BY_BRAKING:
            if moving and at.accel * at.direction < BRAKING_MPS2:
                return Lag(1.0, SETS_ON_S, 0.0)
            return Lag(0.0, p[2], 0.0)
        if not moving:
            return Lag(0.0, RESET_S, 0.0)
        return Lag(1.0, p[2] / abs(at.speed) if p[0] == BY_DISTANCE else p[2], 0.0)

    def terms(self, at: Conditions, p: Values) -> Terms:
        return Terms(torque=p[1] * at.own * at.direction)


def curve_name(variable: int, gate: int) -> str:
    """The name of a curve."""
    follows = "constant" if variable == ALWAYS else f"curve_of_{VARIABLES[variable].name}"
    return follows if gate == OPEN else f"{follows}_when_{GATES[gate].name}"


CURVES = {curve_name(v, g): (v, g) for v in VARIABLES for g in GATES if v != ALWAYS or g != OPEN}
NAMES = (*CURVES, *(of.name for of in BUILD_UPS.values()))


def learned(name: str, parameters: object, size: float) -> Learned:
    """The effect of a name with as many knots as parameters ask for, for a vehicle with a weight times wheel radius [Nm]."""
    if name in CURVES:
        variable, gate = CURVES[name]
        heights = [key for key in parameters if str(key).startswith("y")] if isinstance(parameters, Mapping) else []
        count = min(max(1, len(heights)), MOST_KNOTS)
        found: Learned = Curve(variable, gate, [0.0] * count)
    else:
        by = next(code for code, of in BUILD_UPS.items() if of.name == name)
        found = BuildUp(by, 300.0)
    return sized(found, size)


def sized(effect: Learned, size: float) -> Learned:
    """The same for a vehicle with a weight times wheel radius [Nm]."""
    found = copy.copy(effect)
    found.parameters = tuple(q.times(size / REFERENCE_NM) if q.of_size else q for q in effect.parameters)
    return found


def _fixed(name: str, code: int, text: str) -> Parameter:
    return Parameter(name, "1", float(code), float(code), float(code), text, fitted=False)


def height(name: str, text: str, fitted: bool = True) -> Parameter:
    """A torque of an effect without a name; one that is not fitted stays at zero."""
    start, off = (TYPICAL_NM, 0.0) if fitted else (0.0, None)
    return Parameter(name, "Nm", -MOST_NM, MOST_NM, start, text, off=off, of_size=True, fitted=fitted)
