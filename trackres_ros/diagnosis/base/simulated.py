# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Simulates sessions in sequence with the live step, for the bases of vehicle files with and without belts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Self

import numpy as np

from trackres_ros.diagnosis.base.base import Acting, Base, RangedValue, Values
from trackres_ros.diagnosis.prepare.session import Array, DriveSession, with_unseen
from trackres_ros.effects.effect import VehicleConstants
from trackres_ros.effects.stepping import DISTANCE, UNUSABLE, new_memory
from trackres_ros.estimator import columns as at
from trackres_ros.estimator.constants import Constants
from trackres_ros.estimator.kernel import COMPILED, PREDICTED, PREDICTED_BELT, PREDICTED_DRIVE, PREDICTED_OUTCOME, PREDICTED_SKIN
from trackres_ros.estimator.records import DriveSeries, State, new_scratch
from trackres_ros.files.file_sets import trial_folder
from trackres_ros.vehicle import AnyVehicle, load_any
from trackres_ros.vehicle.writing.changes import FileChanges


class FileBase(Base):
    """The base model of a vehicle file."""

    def __init__(self, vehicle: AnyVehicle) -> None:
        super().__init__()
        self.vehicle = vehicle

    @property
    def quantities(self) -> Mapping[str, RangedValue]:
        """See `base.Base`."""
        parameters = self.vehicle.parameters.items()
        return {name: RangedValue(q.unit, q.value, q.low, q.high) for name, q in parameters if isinstance(q.value, float)}

    @property
    def alone(self) -> Self:
        """See `base.Base`."""
        return type(self)(replace(self.vehicle, surroundings=(), route=())) if self.vehicle.surroundings else self

    def as_written(self, values: Values) -> Self:
        """See `base.Base`."""
        vehicle = self.vehicle
        with trial_folder() as folder:
            path = folder / "vehicle.yaml"
            self.write(path, FileChanges(values, (), {}), "")
            effects, surroundings, route = vehicle.effects, vehicle.surroundings, vehicle.route
            base = type(self)(replace(load_any(path), effects=effects, surroundings=surroundings, route=route))
        base.torque_scale = self.torque_scale  # the sessions stay divided by it
        return base


def simulate_sessions(
    k: Constants,
    count: Array,
    belts: int,
    facts: VehicleConstants,
    sessions: Sequence[DriveSession],
    acting_effects: Acting,
) -> list[Array]:
    """Torque at the sprockets [Nm], belt and surface temperature [degC] of each session by `kernel.predict`, shape (3, n).

    `k` has the constants of the step without effects, which come from `acting_effects`. There are `count` assemblies of each
    kind, shape (kinds,), of which `belts` kinds have a belt.
    """
    table = acting_effects.table
    k = k._replace(effects=table.rows, effect_values=table.values)
    state = State(
        np.empty((belts, 2, at.BELT_COLUMNS)),
        np.empty(at.Motion.columns),
        new_memory(len(acting_effects.step_effects)),
        np.zeros(at.Learned.columns),
    )
    constants, carried_arrays = COMPILED.bound(k).given, COMPILED.bound(state).given
    scratch = COMPILED.bound(new_scratch(facts, 0, 0)).given
    results: list[Array] = []
    for i, (session, is_unrecorded) in enumerate(with_unseen(sessions)):
        ambient, distance = float(session.ambient[0]), float(state.effects[DISTANCE])
        if i == 0 or not np.isfinite(session.gap):
            COMPILED.start_belts(constants, carried_arrays, ambient, 0.0)
            if session.first_drive:
                state.effects[DISTANCE] = distance = 0.0
        else:
            COMPILED.rest_vehicle(constants, carried_arrays, scratch, ambient, 0.0, session.gap)
        rows, no_values = np.empty((len(session), PREDICTED)), np.full(len(session), np.nan)
        series = DriveSeries(
            session.time,
            acting_effects.speed(session),
            session.weight,
            session.ambient,
            acting_effects.accel(session),
            acting_effects.grade(session, i),
            session.yaw_rate,
            session.heading,
            no_values,
            no_values,
            acting_effects.torque_by_place(session, i),
            no_values,
            no_values,
        )
        COMPILED.predict_series(constants, carried_arrays, scratch, count, series, rows)
        acting_effects.check(rows[:, PREDICTED_OUTCOME] == UNUSABLE, session, facts)
        if is_unrecorded:
            state.effects[DISTANCE] = distance
        else:
            results.append(np.ascontiguousarray(rows[:, [PREDICTED_DRIVE, PREDICTED_BELT, PREDICTED_SKIN]].T))
    return results
