# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Propagates the uncertainty of a belt's temperature: its variance, process noise, and what a measurement takes away.

A belt state has the shape (2, BELT_COLUMNS): the mean and its surface. Every column but the temperature is the departure [K] that
one standard deviation of an uncertain input makes. Their squares sum to the variance, and an input that moves heat and torque
together stays one.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from trackres_ros.estimator.columns import BELT_COLUMNS, CONSIDER_1, NOISE_1, NOISE_2, TEMPERATURE
from trackres_ros.jit.arithmetic import squared
from trackres_ros.jit.compiled import compiled, inlined

Array = NDArray[np.float64]


@inlined
def belt_variance(belt: Array, of_mean: float, of_surface: float) -> float:
    """Variance [K^2] of of_mean x mean + of_surface x surface."""
    total = 0.0
    for column in range(CONSIDER_1, BELT_COLUMNS):
        departure = of_mean * belt[0, column] + of_surface * belt[1, column]
        total += departure * departure
    return total


@compiled
def add_noise(belt: Array, first: float, second: float) -> None:
    """Fold one more independent departure [K] of the two nodes into the noise columns, as a lower 2 x 2 factor."""
    c11 = squared(belt[0, NOISE_1]) + squared(belt[0, NOISE_2]) + first * first
    c21 = belt[0, NOISE_1] * belt[1, NOISE_1] + belt[0, NOISE_2] * belt[1, NOISE_2] + first * second
    c22 = squared(belt[1, NOISE_1]) + squared(belt[1, NOISE_2]) + second * second
    belt[0, NOISE_1] = math.sqrt(c11)
    belt[0, NOISE_2] = 0.0
    belt[1, NOISE_1] = c21 / belt[0, NOISE_1] if c11 > 0.0 else 0.0
    belt[1, NOISE_2] = math.sqrt(max(c22 - squared(belt[1, NOISE_1]), 0.0))


@compiled
def correct_belt(belt: Array, measured: float, variance: float, expected: float, of_mean: float, of_surface: float) -> None:
    """Correct a belt by a measured temperature [degC] of a variance [K^2]: the Kalman update, changes `belt`.

    Notes
    -----
    The uncertainty of parameters is considered, not estimated (Schmidt's filter): the update takes its share of the departures
    away, but as the parameters stay wrong they grow back with time.
    """
    innovation = measured - expected
    total = belt_variance(belt, of_mean, of_surface) + variance
    gain_1 = gain_2 = 0.0
    for column in range(CONSIDER_1, BELT_COLUMNS):
        departure = of_mean * belt[0, column] + of_surface * belt[1, column]
        gain_1 += belt[0, column] * departure / total
        gain_2 += belt[1, column] * departure / total
    belt[0, TEMPERATURE] += gain_1 * innovation
    belt[1, TEMPERATURE] += gain_2 * innovation
    for column in range(CONSIDER_1, BELT_COLUMNS):
        departure = of_mean * belt[0, column] + of_surface * belt[1, column]
        belt[0, column] -= gain_1 * departure
        belt[1, column] -= gain_2 * departure
    noise = math.sqrt(variance)
    add_noise(belt, gain_1 * noise, gain_2 * noise)
