# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A base model: the simulation without missing effects, and the parameters that may be re-fitted."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np

from trackres_ros.diagnosis.base.patterns import ResidualPattern, SlopeByPlace, TorqueByPlace
from trackres_ros.diagnosis.prepare.session import Array, DriveSession
from trackres_ros.effects.effect import Active, Terms, VehicleConstants, conditions, terms_by_parameters
from trackres_ros.effects.stepping import EffectTable, fit_table, refuse_unusable
from trackres_ros.vehicle.writing.changes import FileChanges

Values = Mapping[str, float]

ROUNDING = 1e-6  # of the span between the bounds of a fit
MOST_CHECKED = 20  # steps checked to find why an effect was omitted


@dataclass(frozen=True, slots=True)
class BaseParameter:
    """A parameter of a base model that may be re-fitted."""

    name: str
    unit: str
    nominal: float  # of the vehicle file
    std: float  # its standard deviation: a Gaussian prior; infinite for an unknown value
    low: float  # bounds of a fit
    high: float
    by_file: tuple[float, float] = (-np.inf, np.inf)  # range in the vehicle file, with a width; the bounds of a fit are wider
    of_file: float | None = None  # value of the vehicle file that it multiplies, in any unit; None if it is no factor

    def outside(self, value: float) -> bool:
        """Whether a value leaves the range of the vehicle file."""
        low, high = self.by_file
        rounding = ROUNDING * (self.high - self.low)
        return not low - rounding <= value <= high + rounding

    def inside(self) -> BaseParameter:
        """The same parameter with the range of the vehicle file as bounds."""
        return replace(self, low=max(self.low, self.by_file[0]), high=min(self.high, self.by_file[1]))


class RangedValue(NamedTuple):
    """A value of a vehicle file with its range there."""

    unit: str
    value: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Predicted:
    """Series predicted for a session, shape (n,): sensed torque [Nm], true torque [Nm], mean belt temperature [degC],
    which sets the loss, and surface temperature [degC]; nan where the model has none.
    """

    torque: Array
    at_sprockets: Array
    belt: Array
    skin: Array


class Base(ABC):
    """A base model of one vehicle. By default it has no rolling resistance, belt or surroundings."""

    name: str
    parameters: tuple[BaseParameter, ...]  # may be re-fitted
    facts: VehicleConstants  # for effects, whose bounds and typical values scale with weight times radius
    has_belt = False
    rolls = False  # a sliding machine has friction instead, see `Effect.only_of`
    includes: tuple[str, ...] = ()  # names of effects that the model already has
    torque_scale = 1.0  # shown over true torque, by the file: the torques of sessions are divided by it
    rotating_mass_factor = 1.0  # effective over true mass in acceleration

    def __init__(self) -> None:
        self.parts: Mapping[str, float] = {}  # rotating ones, with their distance per turn [m]
        self._by_default: Values = {}  # of parameters that a call does not give
        self._last = dict[tuple[object, ...], list[Array]]()

    @property
    def noun(self) -> str:
        """What sentences call the thing that moves."""
        return "vehicle" if self.rolls else "machine"

    @property
    def file(self) -> str:
        """What sentences call the file of `nominal`."""
        return "vehicle file" if self.rolls else "model"

    @property
    def nominal(self) -> dict[str, float]:
        """Values of `parameters` in the vehicle file."""
        return {q.name: q.nominal for q in self.parameters}

    @property
    def quantities(self) -> Mapping[str, RangedValue]:
        """Values as they stand in the vehicle file, by their place there; `parameters` may be factors on several of them."""
        return {q.name: RangedValue(q.unit, q.nominal, *q.by_file) for q in self.parameters}

    @property
    def acting(self) -> Sequence[Active]:
        """Effects of the vehicle and its surroundings, with the values of their files."""
        return self._own_effects(self._by_default)

    def predict(self, sessions: Sequence[DriveSession], values: Values, effects: Sequence[Active]) -> list[Predicted]:
        """Simulate sessions in sequence.

        Parameters
        ----------
        sessions
            Series of one step each: speed [m/s], acceleration [m/s^2] and other known channels, shape (n,).
        values
            Values of `parameters`, by name.
        effects
            Effects to add, sorted by `Acting`.

        Notes
        -----
        The last simulation is kept, also for copies: calls of a fit often differ only by sensor effects.
        """
        values = {**self._by_default, **values}
        acting_effects = Acting.of([*self._own_effects(values), *effects], self.facts)
        step_effects = tuple(
            (active.effect, *active.numbers)
            for active in (*acting_effects.step_effects, *acting_effects.slopes, *acting_effects.torques)
        )
        key = (*sessions, *values.values(), acting_effects.sensors.speed_factor, *step_effects)
        if key not in self._last:
            rows = self._simulate(sessions, values, acting_effects)
            self._last.clear()
            self._last[key] = rows
        predictions = []
        for i, (session, (simulation, belt, skin)) in enumerate(zip(sessions, self._last[key], strict=True)):
            drive = acting_effects.with_watched(simulation, i)
            predictions.append(
                Predicted(self._shown_value(values) * acting_effects.sensor_torque(drive, session), drive, belt, skin)
            )
        return predictions

    def share_limits(self, _: Sequence[DriveSession]) -> tuple[float, float] | None:
        """Least and most of true over expected torque within the ranges of the parameters; None where the facts of the gate
        have it.
        """
        return None

    def _own_effects(self, _: Values) -> Sequence[Active]:
        """Effects of the vehicle and its surroundings."""
        return ()

    def _simulate(self, sessions: Sequence[DriveSession], values: Values, acting_effects: Acting) -> list[Array]:
        """Step through sessions: torque [Nm], belt and surface temperature [degC] of each, shape (3, n)."""
        raise NotImplementedError

    def _shown_value(self, _: Values) -> float:
        """Torque of a session over the sensed one."""
        return 1.0

    @abstractmethod
    def write(self, path: Path, file_changes: FileChanges, text: str) -> list[Path]:
        """Write a vehicle file with the kept changes, and surroundings next to it; returns the files to use."""

    @property
    def alone(self) -> Self:
        """The same vehicle without the given surroundings, as a controller runs it."""
        return self

    def inside_ranges(self, free_names: Collection[str]) -> Self:
        """The same base, its parameters bound to the ranges of the vehicle file, except those in `free_names`."""
        return self._with_parameters(tuple(q if q.name in free_names else q.inside() for q in self.parameters))

    def as_written(self, values: Values) -> Self:
        """The base that a reader gets from the file `write` makes of these values, in the same surroundings."""
        return self._with_parameters(tuple(replace(q, nominal=values[q.name]) for q in self.parameters))

    def _with_parameters(self, parameters: tuple[BaseParameter, ...]) -> Self:
        base = copy.copy(self)
        base.parameters = parameters
        return base


@dataclass(frozen=True)
class Acting:
    """Effects sorted: those of every step, those with their own series, slopes and torques by place, and those of sensors."""

    step_effects: tuple[Active, ...]
    table: EffectTable
    watched_effects: tuple[Active, ...]
    slopes: tuple[Active, ...]
    torques: tuple[Active, ...]
    sensors: Terms

    @classmethod
    def of(cls, effects: Sequence[Active], facts: VehicleConstants) -> Acting:
        """Sort effects; sensor effects depend only on their parameters."""
        series = tuple(active for active in effects if isinstance(active.effect, ResidualPattern))
        slopes = tuple(active for active in series if isinstance(active.effect, SlopeByPlace))
        torques = tuple(active for active in series if isinstance(active.effect, TorqueByPlace))
        watched_effects = tuple(active for active in series if active not in slopes and active not in torques)
        step_effects = tuple(active for active in effects if active not in series and active.effect.acts_on != "sensor")
        sensor_effects = [active for active in effects if active.effect.acts_on == "sensor"]
        sensors = terms_by_parameters(tuple(a.effect for a in sensor_effects), tuple(a.numbers for a in sensor_effects), facts)
        return cls(step_effects, fit_table(step_effects), watched_effects, slopes, torques, sensors)

    def speed(self, session: DriveSession) -> Array:
        """True speed [m/s]."""
        return np.ascontiguousarray(session.speed * self.sensors.speed_factor)

    def accel(self, session: DriveSession) -> Array:
        """True acceleration [m/s^2]; one derived from the speed has the same scale error as the speed."""
        factor = 1.0 if "accel" in session.given else self.sensors.speed_factor
        return np.ascontiguousarray(session.accel * factor)

    def grade(self, session: DriveSession, number: int) -> Array:
        """Slope of session `number`, recorded plus learned by place; level where unknown."""
        grade = session.grade if "grade" in session.given else np.zeros(len(session))
        return np.ascontiguousarray(_with_series(grade, self.slopes, number))

    def torque_by_place(self, session: DriveSession, number: int) -> Array:
        """Torque against travel by place for session `number`, given plus learned [Nm]."""
        return np.ascontiguousarray(_with_series(session.torque_by_place, self.torques, number))

    def with_watched(self, torque: Array, session: int) -> Array:
        """Torque of session `number` plus the effects with their own series [Nm]."""
        return _with_series(torque, self.watched_effects, session)

    def sensor_torque(self, torque: Array, session: DriveSession) -> Array:
        """Torque as the sensor shows it [Nm]."""
        terms = self.sensors
        reading = terms.sensor_gain * torque + terms.sensor_offset
        if terms.sensor_delay == 0.0:
            return np.asarray(reading)
        if session.torque_course is None:  # not measured: a step's mean is at its middle
            return np.interp(session.time - terms.sensor_delay, session.time, reading)
        # Torque may jump within a step, which its mean does not show. So the measured torque is shifted instead, exactly.
        delayed_torque = session.torque_course.later_means(session.time, session.step, terms.sensor_delay)
        return np.asarray(reading - (delayed_torque - session.torque))

    def check(self, omissions: Array, session: DriveSession, facts: VehicleConstants) -> None:
        """Raise the error of a user effect that was omitted in a step, although all its inputs are known there."""
        user_effects = [active for active in self.step_effects if active.effect.source is not None]
        if not user_effects or not omissions.any():
            return
        for i in np.flatnonzero(omissions)[:MOST_CHECKED]:
            inputs = conditions(
                facts, self.speed(session)[i], self.accel(session)[i], session.weight[i],
                session.ambient[i], session.yaw_rate[i], session.heading[i], session.distance[i],
            )  # fmt: skip
            for active in user_effects:
                if all(np.isfinite(getattr(inputs, need)) for need in active.effect.needs):
                    refuse_unusable(active, inputs)


def _with_series(values: Array, effects: Sequence[Active], session: int) -> Array:
    """Values plus the effects that have a series for the given session."""
    for active in effects:
        assert isinstance(active.effect, ResidualPattern)
        values = values + active.numbers[0] * active.effect.shape[session]
    return values
