# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Defines the state that is carried from one step to the next."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from trackres_ros.effects.stepping import new_memory
from trackres_ros.estimator import columns as at
from trackres_ros.text.numbers import decimals

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class State:
    """State carried from one step to the next; not to be changed.

    Attributes
    ----------
    belts : ndarray, shape (assemblies, 2, BELT_COLUMNS)
        Temperature [degC] and its departures [K], of the mean and of the surface; see `columns` and `belt_step`.
    motion : ndarray, shape (MOTION_COLUMNS,)
        Filtered speed and values of the last step; see `columns`.
    effects : ndarray, shape (effects, columns)
        Memory of the effects; see `effects.stepping`.
    learned : ndarray, shape (LEARNED_COLUMNS,)
        Learned departures of the vehicle; see `columns`.
    """

    belts: Array
    motion: Array
    effects: Array = field(default_factory=lambda: new_memory(0))
    learned: Array = field(default_factory=lambda: np.zeros(at.Learned.columns))

    def __repr__(self) -> str:
        degrees = ", ".join(decimals(float(degc), 1) for degc in self.belts[:, 0, at.Belt.temperature])
        belts = f"belts {degrees} degC, " if degrees else ""
        return f"<State: {belts}speed {decimals(float(self.motion[at.Motion.last_speed]), 2)} m/s>"
