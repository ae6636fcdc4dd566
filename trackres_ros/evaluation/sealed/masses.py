# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Compares the masses of a described payload with the true load between one stop and the next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

DRIVING_MPS = 0.3
LEAST_KNOWN = 0.5  # of the driving: hold-out laps are not fitted
LONG_S = 300.0  # of driving
CLOSE = 0.08  # of the greatest load
NORMAL_95 = 1.96  # standard deviations


@dataclass(frozen=True)
class MassError:
    """Driving time between two changes of the load [s], error of the mass, relative to the greatest load, and whether its
    95 % interval covers the true one.
    """

    driving_s: float
    off: float
    covered: bool = True

    @property
    def long(self) -> bool:
        """Whether it drove so long that the mass should show."""
        return self.driving_s > LONG_S

    @property
    def close(self) -> bool:
        """Whether the mass is near the true one."""
        return self.off <= CLOSE


def mass_errors(speed: Array, mass: Array, told: Sequence[Mapping[str, Any]], greatest: float) -> list[MassError]:
    """Errors of the masses of one recording, one for each time between two changes of the load of which at least half is
    described.

    Parameters
    ----------
    speed, mass
        In each second, shape (n,) [m/s], and the load in addition to the empty vehicle [kg].
    told
        Stretches of a report: `begin_s`, `end_s`, the `mass` in addition to the model's and its standard deviation `std` [kg].
    greatest
        Largest possible load [kg].
    """
    second, driving = np.arange(len(mass)), np.abs(speed) > DRIVING_MPS
    estimate, std = np.full((2, len(mass)), np.nan)
    for one in told:
        there = (second >= one["begin_s"]) & (second < one["end_s"])
        estimate[there], std[there] = one["mass"], one["std"]
    found = []
    for piece in np.split(second, np.flatnonzero(np.diff(mass)) + 1):
        drives = piece[driving[piece]]
        known = drives[np.isfinite(estimate[drives])]
        if len(drives) and len(known) >= LEAST_KNOWN * len(drives):
            off = abs(float(estimate[known].mean()) - float(mass[piece[0]]))
            found.append(MassError(float(len(drives)), off / greatest, off <= NORMAL_95 * float(std[known].mean())))
    return found
