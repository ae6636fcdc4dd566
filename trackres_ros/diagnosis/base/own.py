# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A user's own function as a base: driving torque as a function of speed, acceleration and parameters."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np

from trackres_ros import checks
from trackres_ros.arrays import IntArray
from trackres_ros.diagnosis.base.base import Acting, Base, BaseParameter, Values
from trackres_ros.diagnosis.prepare.session import Array, DriveSession, GateSettings, with_unseen
from trackres_ros.effects.effect import Active, VehicleConstants
from trackres_ros.effects.stepping import (
    DISTANCE,
    TERM,
    UNUSABLE,
    EffectScratch,
    EffectTable,
    cool_memory,
    new_effect_scratch,
    new_memory,
    rest_effects,
    set_conditions,
    step_effects,
)
from trackres_ros.effects.vehicle.rotating_inertia import RotatingInertia
from trackres_ros.errors import InputError
from trackres_ros.kernels.marks import entry, kernel
from trackres_ros.units import STANDSTILL_MPS
from trackres_ros.vehicle.road import SLOW_SHARE
from trackres_ros.vehicle.writing.changes import FileChanges
from trackres_ros.vehicle.writing.vehicle_file import finish, sources_of
from trackres_ros.vehicle.writing.yaml_edit import Document, flow

Torque = Callable[[DriveSession, Values], Array]

SIZE = 0.15  # largest torque over weight times radius: of a vehicle that it accelerates by 1.5 m/s^2
AMBIENT_DEGC = 20.0


@dataclass(frozen=True)
class OwnModel:
    """Your own model, diagnosed like a vehicle: see `trackres_ros.diagnose`.

    Attributes
    ----------
    name
        Name of the model.
    torque
        ``torque(inputs, p)``: the driving torque or force in each step, shape (n,), in the unit of the recording's ``torque``.
        ``inputs.speed`` and ``inputs.accel`` are arrays of that shape, means over each step; ``p["name"]`` is a parameter.
        These arrays and ``p`` are copies; other series of ``inputs`` are read-only.
    parameters
        By name: value, expected minimum and maximum (read as +-2 standard deviations), and unit. A fit may exceed the range
        by its width, but not change the sign. With equal limits the value is fixed.
    max_speed, max_torque
        Maximum speed and torque. Below a tenth of the speed, friction may be static; thresholds of the search scale with the
        torque.
    effects
        Effects that the model already has, as `DiagnosisResult.vehicle` gives them.
    """

    name: str
    torque: Torque
    parameters: Mapping[str, tuple[float, float, float, str]]
    max_speed: float
    max_torque: float
    effects: tuple[Active, ...] = field(default=())

    def __post_init__(self) -> None:
        checks.function(self.torque, f"{self.name}: torque")
        if not isinstance(self.parameters, Mapping):
            raise InputError(f"{self.name}: parameters", self.parameters, "a mapping of name to (value, least, greatest, unit)")
        for name, row in self.parameters.items():
            if not (isinstance(row, Sequence) and len(row) == 4 and _are_numbers(*row[:3]) and row[1] <= row[0] <= row[2]):
                raise InputError(f"{self.name}: {name}", row, "a value within a finite least and greatest one, and a unit")
        for name in ("max_speed", "max_torque"):
            if not (_are_numbers(getattr(self, name)) and getattr(self, name) > 0.0):
                raise InputError(f"{self.name}: {name}", getattr(self, name), "a positive number")

    @property
    def known(self) -> GateSettings:
        """Facts for the checks of the recordings."""
        weight = self.max_torque / SIZE
        return GateSettings(weight, self.max_speed, AMBIENT_DEGC, None, is_vehicle=False, friction=self.max_torque)


def _are_numbers(*values: object) -> bool:
    return all(isinstance(value, Real) and math.isfinite(value) for value in values)


class OwnBase(Base):
    """Base model of a function; see `base.Base`."""

    def __init__(self, model: OwnModel) -> None:
        super().__init__()
        self.model, self.name = model, model.name
        self._by_default = {name: row[0] for name, row in model.parameters.items()}
        self.includes = (RotatingInertia.name, *(active.effect.name for active in model.effects))
        self.facts = VehicleConstants(
            radius=1.0, weight=model.known.weight, drag_area=0.0, air_density=0.0, contact_length=1.0, assemblies=1,
            cooled_area=0.0, tension=1.0, standstill=min(STANDSTILL_MPS, SLOW_SHARE * model.max_speed),
        )  # fmt: skip
        self.parameters = tuple(_parameter(name, *row) for name, row in model.parameters.items() if row[1] < row[2])

    def _own_effects(self, _: Values) -> Sequence[Active]:
        return self.model.effects

    def _simulate(self, sessions: Sequence[DriveSession], values: Values, acting_effects: Acting) -> list[Array]:
        scratch, memory = new_effect_scratch(self.facts), new_memory(len(acting_effects.step_effects))
        results = []
        for i, (session, is_unrecorded) in enumerate(with_unseen(sessions)):
            distance = float(memory[DISTANCE])
            if i > 0 and np.isfinite(session.gap):
                rest_own(*acting_effects.table, memory, scratch, float(session.ambient[0]), session.gap)
            else:
                memory = cool_memory(memory)
                if session.first_drive:
                    memory[DISTANCE] = distance = 0.0
            true_session = replace(session, speed=acting_effects.speed(session), accel=acting_effects.accel(session))
            own_torque = self._own_torque(true_session, values) + acting_effects.torque_by_place(session, i) * np.sign(
                true_session.speed
            )
            torque, outcome = np.empty(len(session)), np.empty(len(session), dtype=np.int64)
            series = (
                session.time,
                true_session.speed,
                true_session.accel,
                session.weight,
                session.ambient,
                session.yaw_rate,
                session.heading,
            )
            step_own(acting_effects.table, scratch, memory, own_torque, *series, torque, outcome)
            acting_effects.check(outcome == UNUSABLE, session, self.facts)
            if is_unrecorded:
                memory[DISTANCE] = distance
            else:
                results.append(np.stack([torque, *np.full((2, len(session)), np.nan)]))
        return results

    def _own_torque(self, session: DriveSession, values: Values) -> Array:
        """Result of the user's function; an `InputError` if it fails, or is not a finite number for each step."""
        try:
            torque = np.array(self.model.torque(_handed_out(session), dict(values)))
            if np.iscomplexobj(torque):
                raise TypeError("complex numbers")
            torque = torque.astype(float)
        except Exception as error:
            raise InputError(f"{self.name}: torque", f"{type(error).__name__}: {error}", "a function of inputs and p") from error
        if torque.shape != session.speed.shape or not np.isfinite(torque).all():
            statement = (
                f"shape {torque.shape}" if torque.shape != session.speed.shape else f"no finite number with {dict(values)}"
            )
            raise InputError(f"{self.name}: torque", statement, f"a finite number for each step, shape {session.speed.shape}")
        return torque

    def share_limits(self, sessions: Sequence[DriveSession]) -> tuple[float, float] | None:
        """See `base.Base`: one parameter after the other at the ends of its range; their products."""
        steady_sessions = [replace(s, accel=np.zeros(len(s))) for s in sessions]

        def torques(values: Values) -> tuple[Array, Array]:
            total, resistance = (
                np.concatenate([p.torque[s.used] for p, s in zip(self.predict(group, values, ()), sessions, strict=True)])
                for group in (sessions, steady_sessions)
            )
            return total, total - resistance

        nominal, low, high = torques(self.nominal), 1.0, 1.0
        for q in self.parameters:
            at_ends = [torques({**self.nominal, q.name: end}) for end in q.by_file]
            shares = [float(x @ n) / float(n @ n) for group in at_ends for x, n in zip(group, nominal, strict=True) if n.any()]
            low, high = low * max(min(1.0, *shares), 0.0), high * max(1.0, *shares)
        return low, high

    def with_kept(self, file_changes: FileChanges) -> OwnModel:
        """The model with the kept values and effects."""
        values = file_changes.values or {}
        parameters = {name: (values.get(name, parameter[0]), *parameter[1:]) for name, parameter in self.model.parameters.items()}
        parameters = {n: (v, min(low, v), max(high, v), unit) for n, (v, low, high, unit) in parameters.items()}
        return replace(self.model, parameters=parameters, effects=(*self.model.effects, *file_changes.effects_of("vehicle")))

    def write(self, path: Path, file_changes: FileChanges, text: str) -> list[Path]:
        """See `base.Base`: the values of the parameters, and effects."""
        lines = [f"name: {flow(self.name)}", "parameters:"]
        for name, (value, low, high, unit) in self.with_kept(file_changes).parameters.items():
            span = file_changes.range_of(name) if file_changes.values is not None else None
            lines.append(f"  {name}: {flow({'value': value, 'unit': unit, 'range': list(span or (low, high))})}")
        return finish(Document("\n".join(lines) + "\n"), self.name, sources_of(self.model.effects), (), path, file_changes, text)


def _handed_out(session: DriveSession) -> DriveSession:
    """A session that a user's function cannot change: speed and acceleration are copies, other series are read-only."""
    series = {f.name: getattr(session, f.name) for f in fields(session) if f.name not in ("speed", "accel")}
    views: dict[str, Any] = {name: value.view() for name, value in series.items() if isinstance(value, np.ndarray)}
    for view in views.values():
        view.flags.writeable = False
    return replace(session, speed=session.speed.copy(), accel=session.accel.copy(), **views)


def _parameter(name: str, value: float, low: float, high: float, unit: str) -> BaseParameter:
    width = high - low
    lower_bound, upper_bound = (0.0 if low >= 0.0 else low - width), (0.0 if high <= 0.0 else high + width)
    return BaseParameter(name, unit, value, 0.25 * width, lower_bound, upper_bound, (low, high))


@kernel
def own_along(
    effects: EffectTable,
    scratch: EffectScratch,
    memory: Array,
    own_torque: Array,
    times: Array,
    speeds: Array,
    accelerations: Array,
    weights: Array,
    ambients: Array,
    yaw_rates: Array,
    headings: Array,
    torque: Array,
    outcome: IntArray,
) -> None:
    """Fill `torque`, the model's with effects added, and their `outcome` at each time; see `effects.stepping`."""
    last_torque = last_own = 0.0
    for i in range(times.shape[0]):
        drive = last_torque + own_torque[i] - last_own
        turn = yaw_rates[i], headings[i], math.nan
        set_conditions(scratch.conditions, speeds[i], accelerations[i], weights[i], ambients[i], *turn, drive, math.nan)
        dt = times[i] - times[i - 1] if i > 0 else 0.0
        outcome[i] = step_effects(effects.rows, effects.values, memory, scratch, dt)
        torque[i] = (own_torque[i] + scratch.terms[TERM.torque]) * scratch.terms[TERM.drive_gain]
        last_torque, last_own = torque[i], own_torque[i]


step_own, rest_own = entry(own_along), entry(rest_effects)
