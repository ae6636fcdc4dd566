"""A base model: what is simulated without any left-out effect, and which of its parameters may be re-fitted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.belt_series import follow
from trackres_ros.diagnosis.kept import Kept
from trackres_ros.diagnosis.session import Session
from trackres_ros.effects.effect import Active, Conditions, Facts, Terms, together
from trackres_ros.errors import InputError

Array = NDArray[np.float64]
Values = Mapping[str, float]

SERIES = "finite terms, for a series as for a number, with all values of its parameters within their bounds"


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
        Bounds.
    """

    name: str
    unit: str
    nominal: float
    std: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Predicted:
    """What a model expects of a session, series of shape (n,): the torque as the sensor shows it [Nm], the torque itself
    without what `Session.accel_apart` leaves out of the inertia, and the belt's temperature [degC], which sets its loss, and
    that of its surface; nan where the model has none.
    """

    torque: Array
    at_sprockets: Array
    belt: Array
    skin: Array


class Base(Protocol):
    """A base model of one vehicle."""

    @property
    def name(self) -> str:
        """``track`` or ``road_load``."""

    @property
    def has_belt(self) -> bool:
        """Whether belts with a temperature are in it."""

    @property
    def facts(self) -> Facts:
        """What effects may know of the vehicle."""

    @property
    def includes(self) -> tuple[str, ...]:
        """Names of effects that are in it already."""

    @property
    def torque_scale(self) -> float:
        """Shown over true torque where the torque's topic says nothing of it."""

    @property
    def rotating_mass_factor(self) -> float:
        """Effective over true mass in acceleration, by the vehicle file."""

    @property
    def parameters(self) -> tuple[BaseParameter, ...]:
        """What may be re-fitted."""

    def predict(
        self, sessions: Sequence[Session], values: Values, effects: Sequence[Active], drive: Sequence[Array]
    ) -> list[Predicted]:
        """Simulate sessions one after the other.

        Parameters
        ----------
        values
            Of `parameters`.
        effects
            What is added.
        drive
            Expected torque of each session, which some effects look at [Nm].
        """

    def write(self, path: Path, kept: Kept, text: str) -> list[Path]:
        """Write a vehicle file with what was kept, surroundings beside it; returns the files that are for use."""


@dataclass(frozen=True, eq=False)
class Course:
    """A session as the effects make it: conditions at the true speed, and the sum of their terms, each a series."""

    at: Conditions
    terms: Terms


def courses(sessions: Sequence[Session], facts: Facts, effects: Sequence[Active], drive: Sequence[Array]) -> list[Course]:
    """Conditions and terms of sessions; states of the effects' own are carried from one to the next."""
    own: list[float | None] = [None] * len(effects)
    found = []
    for session, torque in zip(sessions, drive, strict=True):
        at = Conditions(
            facts, session.speed, session.accel_apart, session.weight, session.ambient, session.yaw_rate, session.heading,
            session.distance, torque,
        )  # fmt: skip
        factor = 1.0
        for active in effects:
            if active.effect.acts_on == "sensor":
                factor *= active.terms(at, 0.0).speed_factor
        if factor != 1.0:
            at = replace(at, speed=session.speed * factor)
        terms = []
        for i, active in enumerate(effects):
            series, own[i] = _own_state(active, at, session, own[i])
            terms.append(_checked(active, at, series))
        found.append(Course(at, together(terms)))
    return found


def full(value: Any, session: Session) -> Array:
    """A term as a series of a session."""
    return np.ascontiguousarray(np.broadcast_to(np.asarray(value, dtype=float), (len(session),)))


def as_sensed(torque: Array, terms: Terms, session: Session) -> Array:
    """What the torque sensor shows of a torque [Nm]."""
    shown = terms.sensor_gain * torque + terms.sensor_offset
    if terms.sensor_delay <= 0.0:
        return shown
    if session.torque_course is None:  # nothing was measured: the middle of a step is where its mean is
        return np.interp(session.time - terms.sensor_delay, session.time, shown)
    # Within a step the torque may jump, which its mean does not show. So the measured one is taken later instead, exactly.
    return shown - (session.torque_course.means(session.time + terms.sensor_delay, session.step) - session.torque)


def _checked(active: Active, at: Conditions, own: Array | float) -> Terms:
    """What an effect does along a session.

    Raises
    ------
    InputError
        If an effect of the user's own fails, or says what is no number.
    """
    where = f"{active.effect.source}: effect {active.effect.name}"
    try:
        terms = active.terms(at, own)
        bad = [f.name for f in fields(Terms) if not np.isfinite(getattr(terms, f.name)).all()] if active.effect.source else []
    except Exception as error:
        if active.effect.source is None:
            raise
        raise InputError(where, f"{type(error).__name__}: {error}", SERIES) from error
    if bad:
        raise InputError(where, f"{', '.join(bad)} that is not finite with {dict(active.values)}", SERIES)
    return terms


def _own_state(active: Active, at: Conditions, session: Session, before: float | None) -> tuple[Array | float, float | None]:
    lag = active.effect.lag(at, active.values)
    if lag is None:
        return 0.0, None
    target, time_constant = full(lag.target, session), full(lag.time_constant, session)
    start = float(full(lag.start, session)[0])
    if before is not None and np.isfinite(session.gap):
        rest = active.effect.lag(replace(at, speed=np.zeros(len(session))), active.values)
        if rest is None:
            raise InputError(f"effect {active.effect.name}", "a lag while driving and none at rest", "a lag always or never")
        decay = np.exp(-session.gap / float(full(rest.time_constant, session)[0]))
        start = float(full(rest.target, session)[0]) * (1.0 - decay) + before * decay
    series = np.empty(len(session))
    follow(target, time_constant, session.step, start, series)
    last = series[-1] + (target[-1] - series[-1]) * -np.expm1(-session.step / time_constant[-1])
    return series, float(last)
