# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Propagates the uncertainty of a belt's temperature: variance, process noise, and the correction by a measurement.

A belt state has the shape (2, BELT_COLUMNS): the mean and its surface. Every column but the temperature is the departure [K]
due to one standard deviation of an uncertain input. Their squares sum to the variance. An input that affects heat and torque
keeps their correlation.
"""

from __future__ import annotations

import math

from trackres_ros.arrays import Array
from trackres_ros.estimator.columns import BELT_COLUMNS, FIRST_DEPARTURE, Belt
from trackres_ros.kernels.arithmetic import squared
from trackres_ros.kernels.marks import kernel


@kernel
def belt_variance(belt: Array, of_mean: float, of_surface: float) -> float:
    """Variance [K^2] of h'T, the sum of (h'd_c)^2, with h = (of_mean, of_surface)."""
    total = 0.0
    for column in range(FIRST_DEPARTURE, BELT_COLUMNS):
        total += squared(of_mean * belt[0, column] + of_surface * belt[1, column])
    return total


@kernel
def add_noise(belt: Array, of_mean: float, of_both: float, of_skin: float) -> None:
    """Add an independent covariance W [K^2] of the two nodes to the random part: the factor of N N' + W (Cholesky)."""
    mean, skin = Belt(belt[0]), Belt(belt[1])
    c11 = squared(mean.noise_1) + squared(mean.noise_2) + of_mean
    c21 = mean.noise_1 * skin.noise_1 + mean.noise_2 * skin.noise_2 + of_both
    c22 = squared(skin.noise_1) + squared(skin.noise_2) + of_skin
    mean.noise_1, mean.noise_2 = math.sqrt(c11), 0.0
    skin.noise_1 = c21 / mean.noise_1 if c11 > 0.0 else 0.0
    skin.noise_2 = math.sqrt(max(c22 - squared(skin.noise_1), 0.0))


@kernel
def correct_belt(belt: Array, measured: float, variance: float, expected: float, of_mean: float, of_surface: float) -> None:
    """Correct a belt by a measured temperature z [degC] of variance r [K^2], by the Kalman update; change `belt`.

    Notes
    -----
    With h = (of_mean, of_surface): k = sum d_c (h'd_c) / (sum (h'd_c)^2 + r), T += k (z - h'T), d_c -= k h'd_c; k sqrt(r) joins
    the random part. The uncertainty of parameters is considered, not estimated (Schmidt's filter [6]). The update reduces the
    departures, but they grow back with time, as the parameters stay wrong.
    """
    innovation = measured - expected
    total = belt_variance(belt, of_mean, of_surface) + variance
    gain_1 = gain_2 = 0.0
    for column in range(FIRST_DEPARTURE, BELT_COLUMNS):
        departure = of_mean * belt[0, column] + of_surface * belt[1, column]
        gain_1 += belt[0, column] * departure / total
        gain_2 += belt[1, column] * departure / total
    Belt(belt[0]).temperature += gain_1 * innovation
    Belt(belt[1]).temperature += gain_2 * innovation
    for column in range(FIRST_DEPARTURE, BELT_COLUMNS):
        departure = of_mean * belt[0, column] + of_surface * belt[1, column]
        belt[0, column] -= gain_1 * departure
        belt[1, column] -= gain_2 * departure
    noise = math.sqrt(variance)
    of_mean, of_skin = gain_1 * noise, gain_2 * noise
    add_noise(belt, squared(of_mean), of_mean * of_skin, squared(of_skin))
