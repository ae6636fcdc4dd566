# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Adds the probability and size of the vehicle file's disturbance to the table of a replay."""

from __future__ import annotations

import math
from types import MappingProxyType

import numpy as np

from trackres_ros.arrays import Array
from trackres_ros.estimator import columns as at
from trackres_ros.estimator.disturbance import STEADY_MPS, STEADY_MPS2, DisturbanceWatch
from trackres_ros.estimator.records import Steps
from trackres_ros.vehicle import AnyVehicle

THERE, TORQUE = "disturbance_probability", "disturbance_torque_nm"
MEANING = MappingProxyType(
    {
        THERE: "probability that a spell of the vehicle file's `disturbance` is present; nan for a drift",
        TORQUE: "its estimated torque against travel [Nm], from the previous 5 s blocks; no other column includes it",
    }
)
TIME_RESET, CLOCK_JUMPED = int(at.Reason.TIME_RESET), int(at.Reason.CLOCK_JUMPED)
LOOKED_AT = [at.Results.residual_nm, at.Results.speed_mps, at.Results.accel_mps2, at.Results.reasons]


class DisturbanceColumns:
    """Takes the results of a replay block by block, in their order; has no columns without a disturbance to watch for."""

    def __init__(self, vehicle: AnyVehicle) -> None:
        self._watch = None if vehicle.disturbance is None else DisturbanceWatch(vehicle.disturbance)
        self.names: tuple[str, ...] = () if self._watch is None else tuple(MEANING)

    def of(self, steps: Steps) -> list[Array]:
        """The columns of a block, each of shape (steps,)."""
        watch = self._watch
        if watch is None:
            return []
        found = np.empty((len(self.names), len(steps)))
        times, rows = (steps.stamp_ns.tolist(), steps.arrival_ns.tolist()), steps.rows[:, LOOKED_AT].tolist()
        for i, (stamp, arrival, (residual, speed, accel, reasons)) in enumerate(zip(*times, rows, strict=True)):
            if int(reasons) & TIME_RESET:
                watch.restart()
            counts = abs(speed) >= STEADY_MPS and abs(accel) <= STEADY_MPS2
            jumped = bool(int(reasons) & CLOCK_JUMPED)
            belief = watch.take(stamp, residual if counts else math.nan, speed, stamp - arrival, jumped)
            found[:, i] = belief.there, belief.torque_nm
        return list(found)
