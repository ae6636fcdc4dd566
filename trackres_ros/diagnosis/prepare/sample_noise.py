# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Estimates the noise of a mean over a step from its samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.prepare.speed_smoothing import FEWEST, SLOWEST_S, without_repeats
from trackres_ros.units import MAD_TO_STD

Array = NDArray[np.float64]

SECOND_DIFFERENCE = 6.0  # variance of a second difference over that of the noise


def noise_of_means(at: Array, value: Array, step: float) -> float:
    """Standard deviation of a step mean due to sample-to-sample noise; 0 where unknown.

    Second differences show that noise if the sampling is faster than changes of the signal. They exclude slower
    noise.

    Parameters
    ----------
    at, value
        Times [s], rising, and samples.
    step
        Length of a step [s].
    """
    new = without_repeats(value)
    at, value = at[new], value[new]
    if len(at) < FEWEST or float(np.median(np.diff(at))) > SLOWEST_S:
        return 0.0
    noise = MAD_TO_STD * np.median(np.abs(np.diff(value, 2))) / np.sqrt(SECOND_DIFFERENCE)  # a median, as a torque may jump
    return float(noise * np.sqrt(np.median(np.diff(at)) / step))
