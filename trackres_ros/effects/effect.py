# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Defines the interface of an effect, for the fit, the live estimator and the report."""

from __future__ import annotations

import copy
import math
from abc import ABC
from collections import namedtuple
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, lru_cache
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple, Protocol

import numpy as np

from trackres_ros.units import STANDSTILL_MPS

REFERENCE_NM = 97920.0  # weight times wheel radius of the 24-tonne vehicle that the magnitudes of the catalogue are of
ACTS_ON = ("torque", "heat", "cooling", "sensor")
BELONGS_TO = ("vehicle", "surroundings", "sensor")


class VehicleKind(NamedTuple):
    """What decides which effects a vehicle can have."""

    has_belt: bool = True
    rolls: bool = True  # else it slides, see `Effect.only_of`
    includes: tuple[str, ...] = ()  # names of effects that are quantities of its file


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of an effect; SI, temperatures in degC."""

    name: str
    unit: str
    low: float  # physically plausible bounds
    high: float
    start: float  # a typical value, where fits begin
    text: str
    off: float | None = None  # the value without effect; None for one of shape, without a meaning while the others are off
    more_starts: tuple[float, ...] = ()  # other values to begin a fit at, where its result may depend on that
    of_size: bool = False  # whether bounds and typical values are of a vehicle of `REFERENCE_NM`, and grow with the vehicle
    on_tyres: float | None = None  # typical value over weight times wheel radius on tyres, if that makes a difference
    fitted: bool = True  # whether a fit may move it; what is not fitted stays at `start`

    @property
    def is_fixed(self) -> bool:
        """Whether there is only one value: it selects the effect within its family, and is in no file."""
        return not self.fitted and self.low == self.high

    def for_size(self, size: float, on_tyres: bool) -> Parameter:
        """The same for a vehicle with another weight times wheel radius [Nm]."""
        if not self.of_size:
            return self
        typical = self.on_tyres * size if on_tyres and self.on_tyres is not None else self.start * size / REFERENCE_NM
        return self.times(float(f"{typical / self.start:.2g}"))

    def times(self, factor: float) -> Parameter:
        """The same parameter for a vehicle of `factor` times the size."""
        low, high, start = (factor * x for x in (self.low, self.high, self.start))
        return replace(self, low=low, high=high, start=start, more_starts=tuple(factor * x for x in self.more_starts))


class Values(Protocol):
    """Values of an effect's parameters, each an attribute, or by its place in their order."""

    def __getattr__(self, name: str, /) -> float:
        """The value of a parameter."""

    def __getitem__(self, place: int, /) -> float:
        """The value of the parameter at a place."""

    def __len__(self) -> int:
        """How many there are."""


@cache
def values_type(names: tuple[str, ...]) -> Any:
    """A tuple with a field for each parameter."""
    return namedtuple("values", names)


class VehicleConstants(NamedTuple):
    """Constants of the vehicle that an effect may use, in SI units; some are per assembly: means of unlike ones."""

    radius: float  # sprocket pitch radius, or of the wheel; of unlike sprockets the mean by nominal load
    weight: float  # nominal, whole vehicle
    drag_area: float  # C_d A
    air_density: float
    contact_length: float  # on the ground
    assemblies: float
    cooled_area: float  # of one assembly's belt; 0 without one
    tension: float  # of one belt; 0 without one
    standstill: float = STANDSTILL_MPS  # speed over which friction changes its sign smoothly
    cooling: float = 0.0  # of one belt by its film at rest [W/K]
    cooling_by_speed: float = 0.0  # what it gains with the speed [W/K per m/s]


class Conditions(NamedTuple):
    """Conditions at one instant that an effect may use; nan if unknown. `conditions` makes them from measurements."""

    facts: VehicleConstants
    speed: float  # m/s
    accel: float  # m/s^2
    weight: float  # N, whole vehicle
    ambient: float  # degC
    yaw_rate: float  # rad/s
    heading: float  # rad
    distance: float  # m, driven since the first known start
    drive_torque: float  # Nm, expected at the sprockets without the effects' changes in this step
    direction: float  # sign of the speed, smooth through zero
    curvature: float  # of the path [1/m], unsigned; bounded when turning on the spot
    belt: float = math.nan  # degC, mean of the belts at the end of the last step
    own: float = 0.0  # the effect's own state, see `Effect.lag`


def conditions(
    facts: VehicleConstants,
    speed: float = 0.0,
    accel: float = 0.0,
    weight: float | None = None,
    ambient: float = 20.0,
    yaw_rate: float = math.nan,
    heading: float = math.nan,
    distance: float = math.nan,
    drive_torque: float = 0.0,
    own: float = 0.0,
    belt: float = math.nan,
) -> Conditions:
    """Conditions for effects from known values: units of `Conditions`, nominal weight by default."""
    turn_rate = abs(yaw_rate)
    curvature = turn_rate / math.hypot(speed, facts.contact_length * turn_rate + STANDSTILL_MPS)
    weight = facts.weight if weight is None else weight
    return Conditions(
        facts, speed, accel, weight, ambient, yaw_rate, heading, distance, drive_torque,
        math.tanh(speed / facts.standstill), curvature, belt, own,
    )  # fmt: skip


# Of `conditions`: any drive in which an effect must work.
ALL_KNOWN = {
    "speed": 1.0, "accel": 0.1, "yaw_rate": 0.1, "heading": 0.1, "distance": 1.0, "drive_torque": 100.0, "belt": 25.0,
}  # fmt: skip


class Terms(NamedTuple):
    """The action of an effect at one instant. The defaults do nothing."""

    torque: float = 0.0  # added to the resistance [Nm], whole vehicle, positive against forward travel
    drive_gain: float = 1.0  # factor on the torque that drives
    loss_factor: float = 1.0  # factor on the belt's loss: torque and heat
    softening: float = 0.0  # a further exp(-softening (T - `SOFTENING_FROM_DEGC`)) [1/K]
    film_offset_factor: float = 1.0  # factors on the two parts of the film coefficient
    film_slope_factor: float = 1.0
    conductance: float = 0.0  # of one belt to something [W/K]
    sink: float = 0.0  # at this temperature [degC]
    heat: float = 0.0  # into one belt [W]
    inner_resistance: float = 0.0  # from the mean of one belt to its surface [K/W]; depends on the parameters alone
    speed_factor: float = 1.0  # true over measured speed; this and the next three depend on the parameters alone
    sensor_gain: float = 1.0  # of the torque sensor
    sensor_offset: float = 0.0  # Nm
    sensor_delay: float = 0.0  # s
    extrapolated: float = 0.0  # 1 outside the range in which it was learned, where it holds the value at the end of that range

    def with_(self, other: Terms) -> Terms:
        """Both together."""
        conductance = self.conductance + other.conductance
        share = other.conductance / conductance if conductance != 0.0 else 0.0
        parts = {name: getattr(self, name) * getattr(other, name) for name in FACTORS}
        parts |= {name: getattr(self, name) + getattr(other, name) for name in SUMS}
        return Terms(**parts, conductance=conductance, sink=self.sink + share * (other.sink - self.sink))


# How two effects act together in a term: factors multiply, all else adds up, but for a conductance with its sink.
FACTORS = tuple(name for name, alone in Terms._field_defaults.items() if alone == 1.0)
SUMS = tuple(name for name in Terms._fields if name not in (*FACTORS, "conductance", "sink"))
SOFTENING_FROM_DEGC = 40.0


class Lag(NamedTuple):
    """An effect's own state: it follows a target with a time constant [s], from a value after a long rest.

    `lag` reads the present state in `Conditions.own`, and 0 before there is one.
    """

    target: float
    time_constant: float
    start: float


FACTS, ANSWERED = len(VehicleConstants._fields), len(Terms._fields)  # numbers that an effect looks at, and that it answers
LOOKED_AT = FACTS + len(Conditions._fields) - 1
ANSWERS = {"terms": ANSWERED, "lag": len(Lag._fields)}


class Effect(ABC):
    """An effect that the base model lacks: one class in one file, without other state.

    `lag` and `terms` are for one instant: numbers in, numbers out. They are translated to C for the step that runs live, in
    replay and in a fit, so they use their arguments, constants of their file and `math`, and no `self`; what cannot be translated
    runs in plain Python, some hundred times slower.
    """

    name: str  # stable identifier
    acts_on: ClassVar[str]  # one of `ACTS_ON`
    # One of `BELONGS_TO`: what stays with the vehicle wherever it drives; what is of the site, the weather or the ground, and is
    # another tomorrow; what a sensor makes of it.
    belongs_to: ClassVar[str]
    text: str  # one line that a test engineer understands
    needs: tuple[str, ...] = ("speed",)  # fields of `Conditions` that must be known for it
    parameters: tuple[Parameter, ...]
    belt_only: ClassVar[bool] = False  # whether it makes sense only where there is a belt
    only_of: ClassVar[Literal["", "rolls", "slides"]] = ""  # where it makes sense only of what rolls, or of what does not
    source: Path | None = None  # the file of an effect of the user's own; None for those of the catalogue

    def lag(self, at: Conditions, p: Values) -> Lag | None:  # noqa: ARG002 - most have none
        """Target of its own state, if it has one, under the conditions."""
        return None

    @property
    def of_belts(self) -> bool:
        """Whether it does nothing without a belt."""
        return self.belt_only or "belt" in self.needs

    def unsuited(self, kind: VehicleKind) -> str:
        """Why a kind of vehicle cannot have it; empty if it can."""
        if self.of_belts and not kind.has_belt:
            return "the vehicle has no belt"
        if self.only_of not in ("", "rolls" if kind.rolls else "slides"):
            return f"it is only of what {self.only_of}"
        return "the vehicle file has it as a quantity" if self.name in kind.includes else ""

    @property
    def has_lag(self) -> bool:
        """Whether it has its own state."""
        return type(self).lag is not Effect.lag

    def run(self, method: str, at: Conditions, values: Sequence[float]) -> Any:
        """`lag` or `terms` in plain Python; of a user's own with the arithmetic of C, see `registry`."""
        function = getattr(self, method)
        if self.source is None:
            return function(at, self.pack(*values))
        facts, *rest = at
        real_type = np.float64
        with np.errstate(all="ignore"):
            return function(
                Conditions(VehicleConstants(*map(real_type, facts)), *map(real_type, rest)), self.pack(*map(real_type, values))
            )

    @property
    def pack(self) -> Any:
        """Makes the argument `p` of `lag` and `terms` from values in the order of the parameters."""
        return values_type(tuple(q.name for q in self.parameters))

    def terms(self, at: Conditions, p: Values) -> Terms:
        """Its action under the conditions, with these parameter values."""
        raise NotImplementedError

    def values_after(self, values: Mapping[str, float], distance: float) -> dict[str, float]:  # noqa: ARG002 - most do not wear
        """The values with the same action if the first start comes `distance` [m] later, see `Conditions.distance`."""
        return dict(values)

    def acts(self, values: Mapping[str, float]) -> tuple[str, str]:  # noqa: ARG002 - most show it in the drives
        """When it acts and its torque, in words, where the values tell this better than a range of a variable; else empty."""
        return "", ""

    def values(self, off: bool = False) -> dict[str, float]:
        """Typical values of the parameters, or those without effect."""
        return {q.name: q.off if off and q.off is not None else q.start for q in self.parameters}

    def for_size(self, size: float, on_tyres: bool) -> Effect:
        """The same effect with bounds and typical values for another vehicle, see `Parameter`."""
        effect = copy.copy(self)
        effect.parameters = tuple(q.for_size(size, on_tyres) for q in self.parameters)
        return effect

    def describe(self) -> dict[str, Any]:
        """All of its attributes, for `trackres effects --json`."""
        return {
            "name": self.name,
            "acts_on": self.acts_on,
            "belongs_to": self.belongs_to,
            "text": self.text,
            "needs": list(self.needs),
            "belt_only": self.belt_only,
            "only_of": self.only_of,
            "parameters": {
                q.name: {"unit": q.unit, "low": q.low, "high": q.high, "start": q.start, "off": q.off, "text": q.text}
                for q in self.parameters
            },
        }


def is_of_user(kind: type[Effect]) -> bool:
    """Whether an effect is of a file of the user's own, not of the catalogue."""
    return not kind.__module__.startswith(f"{__package__}.")


@dataclass(frozen=True)
class Active:
    """An effect with values for its parameters, and their ranges if known."""

    effect: Effect
    values: Mapping[str, float]
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @cached_property
    def numbers(self) -> tuple[float, ...]:
        """The values in the order of the parameters."""
        return tuple(float(self.values[q.name]) for q in self.effect.parameters)

    @property
    def does_nothing(self) -> bool:
        """Whether all of its sizes are off."""
        sizes = [q for q in self.effect.parameters if q.off is not None]
        return bool(sizes) and all(self.values[q.name] == q.off for q in sizes)

    def after(self, distance: float) -> Active:
        """The same effect if the first start comes `distance` [m] later."""
        return replace(self, values=self.effect.values_after(self.values, distance))

    def terms(self, at: Conditions, own: float = 0.0) -> Terms:
        """Its terms, given its own state."""
        terms: Terms = self.effect.run("terms", at._replace(own=own), self.numbers)
        return terms

    def lag(self, at: Conditions) -> Lag | None:
        """Target of its own state, if it has one."""
        lag: Lag | None = self.effect.run("lag", at, self.numbers)
        return lag

    def shifted(self) -> list[Active]:
        """Copies with one parameter moved by a standard deviation, for each that has a range (+-2 standard deviations)."""
        copies = []
        for q in self.effect.parameters:
            low, high = self.ranges.get(q.name, (0.0, 0.0))
            if q.off is not None and high > low:
                value, std = self.values[q.name], 0.25 * (high - low)
                neighbour = value + std if value + std <= q.high else value - std
                copies.append(replace(self, values={**self.values, q.name: neighbour}))
        return copies


@lru_cache(maxsize=256)
def terms_by_parameters(effects: tuple[Effect, ...], numbers: tuple[tuple[float, ...], ...], facts: VehicleConstants) -> Terms:
    """Terms of effects together that depend on their parameters alone: of sensors, and the resistance inside a belt."""
    instant = conditions(facts)
    return together([effect.run("terms", instant, values) for effect, values in zip(effects, numbers, strict=True)])


def together(terms: Sequence[Terms]) -> Terms:
    """Sum of all terms."""
    total = Terms()
    for term in terms:
        total = total.with_(term)
    return total
