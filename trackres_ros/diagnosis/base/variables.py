# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The catalogue of variables over which residuals and effects are examined."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from trackres_ros.diagnosis.base.base import Predicted
from trackres_ros.diagnosis.prepare.session import Array, DriveSession

SLOWEST_TURNING_MPS = 0.3  # bounds the curvature while turning on the spot
CONSTANT_SHARE = 1e-9  # of its size: a smaller variation is constant


@dataclass(frozen=True)
class Variable:
    """A variable with its series of shape (n,), and whether it only grows during a drive, like the clock."""

    name: str
    unit: str
    of: Callable[[DriveSession, Predicted], Array]
    as_clock: bool = False
    simulated: bool = False  # by a model, each with its own


VARIABLES = (
    Variable("speed", "m/s", lambda s, _: s.speed),
    Variable("acceleration", "m/s^2", lambda s, _: s.accel_around * s.ahead),  # along travel, as in learned curves
    Variable("yaw rate", "rad/s", lambda s, _: np.abs(s.yaw_rate)),
    Variable("yaw rate to the left", "rad/s", lambda s, _: s.yaw_rate),
    Variable("curvature", "1/m", lambda s, _: np.abs(s.yaw_rate) / np.maximum(np.abs(s.speed), SLOWEST_TURNING_MPS)),
    Variable("heading", "rad", lambda s, _: np.angle(np.exp(1j * s.heading))),
    Variable("belt temperature", "degC", lambda _, p: p.belt, simulated=True),
    Variable("ambient temperature", "degC", lambda s, _: s.ambient),
    Variable("time since start", "s", lambda s, _: s.time, as_clock=True),
    Variable("load", "N", lambda s, _: s.weight),
    Variable("distance", "m", lambda s, _: s.distance - s.distance[0], as_clock=True),
)
BY_NAME = {variable.name: variable for variable in VARIABLES}


def varying_series(sessions: Sequence[DriveSession], predictions: Sequence[Predicted]) -> dict[str, Array]:
    """Series along all sessions of each variable that is fully known and varies."""
    all_series = {v.name: np.concatenate([v.of(s, p) for s, p in zip(sessions, predictions, strict=True)]) for v in VARIABLES}
    return {
        name: series
        for name, series in all_series.items()
        if np.isfinite(series).all() and np.ptp(series) > CONSTANT_SHARE * max(1.0, np.abs(series).max())
    }
