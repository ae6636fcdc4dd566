# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Way and energy of a drive out of rows of results."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LONGEST_STEP_S, UNUSUAL = 1.0, 5.0  # or that many times the usual: over a longer step nothing is known


def steps_of(time_s: Array) -> Array:
    """How long before each row the one before it was [s]; 0 of the first, after a gap, and where time does not rise."""
    step = np.diff(time_s, prepend=time_s[:1])
    longest = max(LONGEST_STEP_S, UNUSUAL * float(np.median(step)))
    return np.where((step > 0.0) & (step <= longest), step, 0.0)


def energy_j(step_s: Array, speed: Array, torque: Array, radius: float) -> float:
    """Of a torque at the sprockets [Nm] along a drive, shapes (rows,), with their radius [m]; unknown values count as none."""
    return float(np.nansum(step_s * speed * torque)) / radius
