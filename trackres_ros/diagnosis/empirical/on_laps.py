# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Computes the position of sessions on their laps, and searches for a torque that repeats there."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.empirical.places import Place, find_place
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.prepare.session import DriveSession

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FEWEST_TURNS = 2.0  # of a session, least for a circuit


def place_in(current: Fit, residuals: Sequence[Array]) -> Place | None:
    """Find repeating torque residuals at the same place of laps, for the sessions of a fit [Nm]."""
    sessions, masks = current.problem.sessions, current.problem.masks
    against = [r * np.sign(s.speed) for r, s in zip(residuals, sessions, strict=True)]
    return find_place(driven_along(sessions), against, masks, loads_of(sessions, masks))


def loads_of(sessions: Sequence[DriveSession], masks: Sequence[Mask]) -> list[Array]:
    """Weight over its mean where torques are compared: slopes, bends and soft ground take more torque at a higher weight."""
    mean = float(np.mean(np.concatenate([s.weight[m] for s, m in zip(sessions, masks, strict=True)])))
    return [s.weight / mean for s in sessions]


def driven_along(sessions: Sequence[DriveSession]) -> list[Array]:
    """Position of each session on its route, as the distance from its start [m]: it falls while the vehicle reverses, and is
    negative for laps in the other direction.

    A lap is one full turn. If each session turns at least twice in total, those that turn right in forward travel
    pass the same places in the reverse order.
    """
    turns = [float(np.nansum(s.yaw_rate)) * s.step / (2.0 * math.pi) for s in sessions]
    on_laps = all("yaw_rate" in s.given for s in sessions) and min(map(abs, turns)) >= FEWEST_TURNS
    driven = [np.cumsum(np.diff(s.distance, prepend=s.distance[0]) * np.sign(np.nan_to_num(s.speed))) for s in sessions]
    return [-d if on_laps and turn * d[-1] < 0.0 else d for d, turn in zip(driven, turns, strict=True)]
