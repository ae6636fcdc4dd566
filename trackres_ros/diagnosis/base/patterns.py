# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Terms that follow only the clock or the place: a series found in the residual, whose size is fitted."""

from __future__ import annotations

from collections.abc import Sequence

from trackres_ros.diagnosis.prepare.session import Array
from trackres_ros.effects.effect import REFERENCE_NM, Effect, Parameter
from trackres_ros.effects.learned import CORNERS, height
from trackres_ros.route.learned import RouteMap

WATCHED = "watched"
FADE = len(CORNERS)  # beside the kinds of corners: a torque that fades with the variable
STEEPEST = 0.3  # rise over run, as of the catalogue's slopes


class ResidualPattern(Effect):
    """A series for each session, times a size.

    `shape` has the series of each session, in the order of the problem: shape (n,), about 1 where it acts; zero on hold-out laps.
    `ahead` is its forecast for a fitted lap that is left out, from other measurements. `size` is weight times wheel radius [Nm].
    """

    acts_on = WATCHED
    belongs_to = "vehicle"
    needs = ()

    def __init__(
        self, name: str, text: str, shape: Sequence[Array], size: float, forecast: Sequence[Array] | None = None
    ) -> None:
        self.name, self.text, self.shape = name, text, tuple(shape)
        self.ahead = self.shape if forecast is None else tuple(forecast)
        self.parameters = (height("level", "torque where it acts").times(size / REFERENCE_NM),)


class ClockTerm(ResidualPattern):
    """A torque against travel that changes with time or distance alone: a step or a hinge at a value of it, or a fade.

    Parameters
    ----------
    variable, kind
        One of `empirical.thresholds.CLOCKS`; of `effects.learned.CORNERS`, or a fade.
    threshold, ends
        Where it changes, or the scale of the fade; and both ends of the driven range.
    """

    def __init__(
        self, variable: str, kind: int, threshold: float, ends: tuple[float, float], shape: Sequence[Array], size: float
    ) -> None:
        form = {**CORNERS, FADE: "fade_over"}[kind]
        name = f"{form}_{variable.replace(' ', '_')}"
        super().__init__(name, f"a torque that follows the {variable}", shape, size)
        self.variable, self.kind, self.threshold, self.ends = variable, kind, threshold, ends

    @property
    def text_of_variable(self) -> str:
        """Beginning of the variable, in words after a value of it."""
        return "of distance" if self.variable == "distance" else f"after {self.variable.removeprefix('time since ')}"


class ByPlace(ResidualPattern):
    """A learned value for each place of a route. Positions make it predictable, so it may be written.

    The map `route` was learned at the typical value of its parameter.
    """

    acts_on = "torque"
    belongs_to = "surroundings"

    def __init__(self, name: str, text: str, shape: Sequence[Array], size: float, route: RouteMap, typical_torque: float) -> None:
        super().__init__(name, text, shape, size)
        self.route, self.typical = route, typical_torque

    def learned(self, value: float) -> RouteMap:
        """The map, scaled to the fitted parameter."""
        return self.route.times(value / self.typical)


class TorqueByPlace(ByPlace):
    """A torque learned for each place: the series are against travel."""


class SlopeByPlace(ByPlace):
    """A slope learned for each place: the series are the rise over run in the vehicle's heading."""

    def __init__(self, name: str, text: str, shape: Sequence[Array], size: float, route: RouteMap, size_by_place: float) -> None:
        super().__init__(name, text, shape, size, route, size_by_place)
        typical_slope = Parameter("slope", "1", -STEEPEST, STEEPEST, size_by_place, "root mean square over the places", off=0.0)
        self.parameters = (typical_slope,)
