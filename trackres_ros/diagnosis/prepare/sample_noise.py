"""Samples in, what their noise leaves in a mean over a step out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.prepare.speed_smoothing import FEWEST, SLOWEST_S, without_repeats

Array = NDArray[np.float64]

SECOND_DIFFERENCE = 6.0  # variance of a second difference over that of the noise
LARGEST = 99.0  # percentile of second differences beyond which they are jumps


def noise_of_means(at: Array, value: Array, step: float) -> float:
    """Standard deviation that the noise from one sample to the next leaves in means over a step; 0 where it cannot be told.

    Second differences show that noise where samples come faster than what is measured changes its course. What the noise has
    that lasts longer is not in it.

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
    second = np.abs(np.diff(value, 2))
    noise = np.sqrt(np.mean(np.minimum(second, np.percentile(second, LARGEST)) ** 2) / SECOND_DIFFERENCE)
    return float(noise * np.sqrt(np.median(np.diff(at)) / step))
