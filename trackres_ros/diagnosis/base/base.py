# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A base model: the simulation without missing effects, and the parameters that may be re-fitted."""

from __future__ import annotations

import copy
import threading
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.base.patterns import ResidualPattern, SlopeByPlace, TorqueByPlace
from trackres_ros.diagnosis.prepare.session import DriveSession
from trackres_ros.effects.effect import Active, Conditions, Terms, VehicleConstants, conditions, together
from trackres_ros.effects.stepping import LIMITS, MOST_TORQUE, EffectTable, effect_table
from trackres_ros.errors import InputError
from trackres_ros.vehicle.writing.changes import FileChanges

Array = NDArray[np.float64]
Values = Mapping[str, float]

USABLE = "finite, plausible terms, with all values of its parameters within their bounds"
ROUNDING = 1e-6  # of the span between the bounds of a fit
MOST_CHECKED = 20  # steps looked at to find why an effect was left out


@dataclass(frozen=True, slots=True)
class BaseParameter:
    """A parameter of a base model that may be re-fitted.

    Attributes
    ----------
    name, unit
        What it is.
    nominal, std
        The value of the vehicle file, and how well it is known: a Gaussian prior. Infinite where nothing is known.
    low, high
        Bounds of a fit.
    by_file
        The range that the vehicle file gives; bounds of a fit are wider.
    """

    name: str
    unit: str
    nominal: float
    std: float
    low: float
    high: float
    by_file: tuple[float, float] = (-np.inf, np.inf)

    def outside(self, value: float) -> bool:
        """Whether a value leaves the range of the vehicle file."""
        low, high = self.by_file
        rounding = ROUNDING * (self.high - self.low)
        return not low - rounding <= value <= high + rounding

    def inside(self) -> BaseParameter:
        """The same parameter with the range of the vehicle file as bounds; a range without width is no bound."""
        low, high = max(self.low, self.by_file[0]), min(self.high, self.by_file[1])
        return replace(self, low=low, high=high) if low < high else self


@dataclass(frozen=True, eq=False)
class Predicted:
    """What a model expects of a session, series of shape (n,): the torque as the sensor shows it [Nm], the torque itself,
    and the belt's temperature [degC], which sets its loss, and that of its surface; nan where the model has none.
    """

    torque: Array
    at_sprockets: Array
    belt: Array
    skin: Array


class Model(Protocol):
    """What a diagnosis needs of a model. `Defaults` has the rest of a `Base`; `own.OwnModel` makes one of a function."""

    @property
    def name(self) -> str:
        """Of the model, as ``track`` or ``road_load``."""

    @property
    def parameters(self) -> tuple[BaseParameter, ...]:
        """Parameters that may be re-fitted: units, values with standard deviations, ranges and bounds."""

    @property
    def facts(self) -> VehicleConstants:
        """What effects may know: weight times radius is the size that their bounds and typical values grow with."""

    def predict(self, sessions: Sequence[DriveSession], values: Values, effects: Sequence[Active]) -> list[Predicted]:
        """Simulate sessions one after the other.

        Parameters
        ----------
        sessions
            Series of one step each: speed [m/s], acceleration [m/s^2] and what else is known, shape (n,).
        values
            Of `parameters`, by name.
        effects
            What is added; `Acting` sorts it.
        """


class Base(Model, Protocol):
    """A base model of one vehicle with all that a diagnosis may ask of it."""

    @property
    def has_belt(self) -> bool:
        """Whether belts with a temperature are in it."""

    @property
    def rolls(self) -> bool:
        """Whether rolling resistance is in it; what slides has friction instead, see `Effect.only_of`."""

    @property
    def includes(self) -> tuple[str, ...]:
        """Names of effects that are in it already."""

    @property
    def parts(self) -> Mapping[str, float]:
        """What goes round, and in how many metres."""

    @property
    def torque_scale(self) -> float:
        """Shown over true torque where the torque's topic says nothing of it."""

    @property
    def rotating_mass_factor(self) -> float:
        """Effective over true mass in acceleration, by the vehicle file."""

    @property
    def held(self) -> Values:
        """Possible further effects by name."""

    @property
    def alone(self) -> Base:
        """The same vehicle without the surroundings that were given: what a controller runs."""

    def inside_ranges(self, free: Collection[str]) -> Base:
        """The same base, its parameters bound to the ranges of the vehicle file, except those in `free`."""

    def as_written(self, values: Values) -> Base:
        """The base of the file that `write` makes of these values, in the same surroundings: what runs is what is read again."""

    def write(self, path: Path, kept: FileChanges, text: str) -> list[Path]:
        """Write a vehicle file with what was kept, surroundings beside it; returns the files that are for use."""


class Defaults:
    """What a `Base` is where its class does not say otherwise: nothing rolls, no belt, no surroundings, nothing held."""

    has_belt = rolls = False
    includes: tuple[str, ...] = ()
    torque_scale = rotating_mass_factor = 1.0
    parameters: tuple[BaseParameter, ...]

    def __init__(self) -> None:
        self.parts: Mapping[str, float] = {}
        self.held: Values = {}

    @property
    def alone(self) -> Self:
        """See `Base`."""
        return self

    def inside_ranges(self, free: Collection[str]) -> Self:
        """See `Base`."""
        found = copy.copy(self)
        found.parameters = tuple(q if q.name in free else q.inside() for q in self.parameters)
        return found

    def as_written(self, values: Values) -> Self:
        """See `Base`."""
        found = copy.copy(self)
        found.parameters = tuple(replace(q, nominal=values[q.name]) for q in self.parameters)
        return found


class Remembered(threading.local):
    """The last simulation of each thread: what differs only in what sensors make of it is not simulated anew."""

    def __init__(self) -> None:
        self._hangs_on: tuple[object, ...] = ()
        self._rows: list[Array] = []

    def rows(
        self, sessions: Sequence[DriveSession], values: Values, acting: Acting, simulate: Callable[[], list[Array]]
    ) -> list[Array]:
        """Result of `simulate`, cached for the last arguments."""
        stepped = tuple((active.effect, *active.numbers) for active in (*acting.stepped, *acting.slopes, *acting.torques))
        hangs_on = (*map(id, sessions), *values.values(), acting.sensors.speed_factor, *stepped)
        if hangs_on != self._hangs_on:
            self._hangs_on, self._rows = hangs_on, simulate()
            self._sessions = tuple(sessions)  # as long as they are here, no other has their identity
        return self._rows


@dataclass(frozen=True)
class Acting:
    """Effects sorted: those that act in every step, ready for it, those that follow a series of their own, slopes and torques by
    place among them by themselves, and what those of sensors make of speed and torque.
    """

    stepped: tuple[Active, ...]
    table: EffectTable
    watched: tuple[Active, ...]
    slopes: tuple[Active, ...]
    torques: tuple[Active, ...]
    sensors: Terms

    @classmethod
    def of(cls, effects: Sequence[Active], facts: VehicleConstants) -> Acting:
        """Sort effects; what a sensor makes of it hangs on nothing but its parameters."""
        series = tuple(active for active in effects if isinstance(active.effect, ResidualPattern))
        slopes = tuple(active for active in series if isinstance(active.effect, SlopeByPlace))
        torques = tuple(active for active in series if isinstance(active.effect, TorqueByPlace))
        watched = tuple(active for active in series if active not in slopes and active not in torques)
        stepped = tuple(active for active in effects if active not in series and active.effect.acts_on != "sensor")
        sensors = [active.terms(conditions(facts)) for active in effects if active.effect.acts_on == "sensor"]
        return cls(stepped, effect_table(stepped, with_uncertainty=False), watched, slopes, torques, together(sensors))

    def speed(self, session: DriveSession) -> Array:
        """True speed [m/s]."""
        return np.ascontiguousarray(session.speed * self.sensors.speed_factor)

    def accel(self, session: DriveSession) -> Array:
        """True acceleration [m/s^2]; one that was not measured by itself comes from the speed, and is off by the same factor."""
        factor = 1.0 if "accel" in session.given else self.sensors.speed_factor
        return np.ascontiguousarray(session.accel * factor)

    def grade(self, session: DriveSession, number: int) -> Array:
        """Slope of the session of a number, as recorded and as learned by place; level where nothing is known."""
        grade = session.grade if "grade" in session.given else np.zeros(len(session))
        return np.ascontiguousarray(_with_series(grade, self.slopes, number))

    def torque_by_place(self, session: DriveSession, number: int) -> Array:
        """Torque against travel by the place of the session of a number, as given and as learned [Nm]."""
        return np.ascontiguousarray(_with_series(session.torque_by_place, self.torques, number))

    def with_watched(self, torque: Array, session: int) -> Array:
        """A torque of the session of a number with what follows a series of its own [Nm]."""
        return _with_series(torque, self.watched, session)

    def sensed(self, torque: Array, session: DriveSession) -> Array:
        """Torque as the sensor shows it [Nm]."""
        terms = self.sensors
        shown = terms.sensor_gain * torque + terms.sensor_offset
        if terms.sensor_delay == 0.0:
            return np.asarray(shown)
        if session.torque_course is None:  # nothing was measured: the middle of a step is where its mean is
            return np.interp(session.time - terms.sensor_delay, session.time, shown)
        # Within a step the torque may jump, which its mean does not show. So the measured one is taken later instead, exactly.
        later = session.torque_course.later_means(session.time, session.step, terms.sensor_delay)
        return np.asarray(shown - (later - session.torque))

    def check(self, left_out: Array, session: DriveSession, facts: VehicleConstants) -> None:
        """Refuse what a user's effect says where it was left out of a step though all that it needs is known.

        Raises
        ------
        InputError
            If it fails there, or says what is no number or beyond all reason.
        """
        own = [active for active in self.stepped if active.effect.source is not None]
        if not own or not left_out.any():
            return
        for i in np.flatnonzero(left_out)[:MOST_CHECKED]:
            at = conditions(
                facts, self.speed(session)[i], self.accel(session)[i], session.weight[i],
                session.ambient[i], session.yaw_rate[i], session.heading[i], session.distance[i],
            )  # fmt: skip
            for active in own:
                if all(np.isfinite(getattr(at, need)) for need in active.effect.needs):
                    _refuse_unusable(active, at)


def _with_series(values: Array, effects: Sequence[Active], session: int) -> Array:
    """Values with what effects add to them that have a series for the session of a number."""
    for active in effects:
        assert isinstance(active.effect, ResidualPattern)
        values = values + active.numbers[0] * active.effect.shape[session]
    return values


def _refuse_unusable(active: Active, at: Conditions) -> None:
    where = f"{active.effect.source}: effect {active.effect.name}"
    try:
        lag = active.lag(at)
        terms = active.terms(at, 0.0 if lag is None else lag.start)
        said = {**terms._asdict(), **({} if lag is None else lag._asdict())}
        bad = {name: value for name, value in said.items() if not np.isfinite(float(value))}
    except Exception as error:
        raise InputError(where, f"{type(error).__name__}: {error}", USABLE) from error
    most = MOST_TORQUE * at.facts.weight * at.facts.radius
    for name, (low, high) in LIMITS.items():
        low, high = (-most, most) if name == "torque" else (low, high)
        if not low <= said[name] <= high:
            bad[name] = said[name]
    if bad:
        said_of = ", ".join(f"{name} {value:g}" for name, value in bad.items())
        raise InputError(where, f"{said_of} with {dict(active.values)} at {at.speed:g} m/s", USABLE)
