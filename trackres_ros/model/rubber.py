# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Models the dynamic moduli of the compound over frequency and temperature, equations (2) to (4).

Values are joined by cubics without scipy, which takes longer to load than a loss table takes to build.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from trackres_ros.arrays import Array
from trackres_ros.kernels.marks import kernel
from trackres_ros.vehicle import Rubber

# Cubics

STEEPEST_END = 3.0  # of a monotone cubic's slope at its end, over that of the line to the next value


def thinned_numbers(count: int, density: int) -> Array:
    """Whole numbers from 1 to `count`; large ones are thinned to `density` numbers per factor e."""
    numbers = [1]
    while numbers[-1] < count:
        numbers.append(min(count, numbers[-1] + max(1, numbers[-1] // density)))
    return np.array(numbers, float)


def cubic_weights(nodes: Array, points: Array) -> Array:
    """Weights of values at rising nodes, four or more, in the values at others, shape (at, nodes).

    Each is joined by Lagrange's cubic through the four nodes about it.
    """
    places = np.clip(np.searchsorted(nodes, points, side="right") - 2, 0, len(nodes) - 4)[:, np.newaxis] + np.arange(4)
    four = nodes[places]
    weights = np.ones(four.shape)
    for i in range(4):
        for j in set(range(4)) - {i}:
            weights[:, i] *= (points - four[:, j]) / (four[:, i] - four[:, j])
    matrix = np.zeros((len(points), len(nodes)))
    np.put_along_axis(matrix, places, weights, axis=1)
    return matrix


class MonotoneCubic:
    """Values joined by cubics that rise and fall only where the values do: at least three values at rising nodes.

    Notes
    -----
    The slope in a node is the harmonic mean of the slopes on its two sides, weighted by their lengths; 0 at an extreme. At an
    end it is that of the parabola through three values, as long as it keeps to the sense of the outer line.

    References
    ----------
    F. N. Fritsch and J. Butland, A method for constructing local monotone piecewise cubic interpolants, SIAM J. Sci. Stat.
    Comput. 5 (1984) 300-304; as scipy's PchipInterpolator.
    """

    def __init__(self, nodes: Array, values: Array) -> None:
        length = np.diff(nodes)
        line = np.diff(values) / length
        slope = np.concatenate([[_end(length, line)], _inner_slopes(length, line), [_end(length[::-1], line[::-1])]])
        third = (slope[:-1] + slope[1:] - 2.0 * line) / length
        self._nodes = nodes
        self._coefficients = values[:-1], slope[:-1], (line - slope[:-1]) / length - third, third / length

    def __call__(self, at: ArrayLike) -> Array:
        """Values at others, same shape; beyond the ends by the outer cubics."""
        points = np.asarray(at, float)
        piece = np.searchsorted(self._nodes[1:-1], points, side="right")
        offset = points - self._nodes[piece]
        c_0, c_1, c_2, c_3 = (coefficient[piece] for coefficient in self._coefficients)
        return np.asarray(c_0 + offset * (c_1 + offset * (c_2 + offset * c_3)))


def _inner_slopes(length: Array, line: Array) -> Array:
    """Slopes in the inner nodes."""
    weight, other_weight = 2.0 * length[1:] + length[:-1], length[1:] + 2.0 * length[:-1]
    turns = line[:-1] * line[1:] <= 0.0
    left_slope, right_slope = (np.where(turns, 1.0, side) for side in (line[:-1], line[1:]))
    return np.where(turns, 0.0, (weight + other_weight) / (weight / left_slope + other_weight / right_slope))


def _end(length: Array, line: Array) -> float:
    """Slope in the first node."""
    slope = float(((2.0 * length[0] + length[1]) * line[0] - length[0] * line[1]) / (length[0] + length[1]))
    if slope * line[0] <= 0.0:
        return 0.0
    steepest = STEEPEST_END * float(line[0])
    return steepest if line[0] * line[1] < 0.0 and abs(slope) > abs(steepest) else slope


# Moduli

REFERENCE_ABOVE_TG = 50.0  # K: the shift function is 1 at Tg + 50, equation (4)


@kernel
def log_shift_factor(belt_degc: float, glass_transition: float, c1: float, c2: float) -> tuple[float, float]:
    """log10 a_T of one temperature and its derivative [1/K]; scalars in and out, shared with the live kernel.

    Notes
    -----
    WLF about Tg + 50 K, equation (4). Its pole lies at Tg + 50 - C2; below Tg it continues on its tangent.
    """
    excess = belt_degc - glass_transition
    if excess >= 0.0:
        span = c2 + excess - REFERENCE_ABOVE_TG
        return -c1 * (excess - REFERENCE_ABOVE_TG) / span, -c1 * c2 / (span * span)
    span = c2 - REFERENCE_ABOVE_TG
    slope = -c1 * c2 / (span * span)
    return c1 * REFERENCE_ABOVE_TG / span + slope * excess, slope


class RubberModel:
    """Moduli of one compound by time-temperature superposition.

    E(f, T) = E(f_sweep, T_eq): every frequency and temperature is a point of the sweep. So the moduli depend on the one
    number log10(a_T f), the reduced frequency; the loss table rests on that.
    Beyond the ends of the sweep the moduli keep their end values.
    """

    def __init__(self, rubber: Rubber) -> None:
        self.rubber = rubber

    @cached_property
    def _log_storage(self) -> MonotoneCubic:
        return MonotoneCubic(self.rubber.sweep_degc, np.log(self.rubber.storage_pa))

    @cached_property
    def _log_loss(self) -> MonotoneCubic:
        return MonotoneCubic(self.rubber.sweep_degc, np.log(self.rubber.loss_pa * self.rubber.loss_modulus_scale))

    def log_shift(self, belt_degc: ArrayLike) -> Array:
        """log10 a_T at temperatures [degC], same shape."""
        r = self.rubber
        excess = np.asarray(belt_degc, dtype=float) - r.glass_transition
        span = r.wlf_c2 + np.maximum(excess, 0.0) - REFERENCE_ABOVE_TG
        wlf = -r.wlf_c1 * (np.maximum(excess, 0.0) - REFERENCE_ABOVE_TG) / span
        slope = -r.wlf_c1 * r.wlf_c2 / (r.wlf_c2 - REFERENCE_ABOVE_TG) ** 2
        return np.asarray(wlf + slope * np.minimum(excess, 0.0))

    def equivalent_temperature(self, log_reduced_frequency: ArrayLike) -> Array:
        """Temperature [degC] of the sweep's point with a reduced frequency log10(a_T f / Hz)."""
        r = self.rubber
        y = np.asarray(log_reduced_frequency, dtype=float) - np.log10(r.sweep_frequency)
        span = r.wlf_c2 - REFERENCE_ABOVE_TG
        y_glass = r.wlf_c1 * REFERENCE_ABOVE_TG / span
        slope = -r.wlf_c1 * r.wlf_c2 / span**2
        denominator = np.maximum(r.wlf_c1 + y, 1e-9)  # at the pole every slower frequency is hotter than any sweep
        above_glass = (r.wlf_c1 * REFERENCE_ABOVE_TG - span * y) / denominator
        equivalent = r.glass_transition + np.where(y > y_glass, (y - y_glass) / slope, above_glass)
        return np.asarray(np.clip(equivalent, r.sweep_degc[0], r.sweep_degc[-1]))

    def reduced_frequency(self, frequency: ArrayLike, belt_degc: ArrayLike) -> Array:
        """log10(a_T f / Hz) at frequencies [Hz] and temperatures [degC], broadcast; frequency 0 is replaced by 1e-30 Hz."""
        return np.asarray(np.log10(np.maximum(frequency, 1e-30)) + self.log_shift(belt_degc))

    def storage_modulus(self, frequency: ArrayLike, belt_degc: ArrayLike) -> Array:
        """E' [Pa]."""
        return np.asarray(np.exp(self._log_storage(self.equivalent_temperature(self.reduced_frequency(frequency, belt_degc)))))

    def loss_modulus(self, frequency: ArrayLike, belt_degc: ArrayLike) -> Array:
        """E'' [Pa]."""
        return np.asarray(np.exp(self._log_loss(self.equivalent_temperature(self.reduced_frequency(frequency, belt_degc)))))

    def dynamic_modulus(self, frequency: ArrayLike, belt_degc: ArrayLike) -> Array:
        """abs(E*) [Pa], equation (2), times the stiffening of a confined layer."""
        equivalent = self.equivalent_temperature(self.reduced_frequency(frequency, belt_degc))
        moduli = np.exp(self._log_storage(equivalent)), np.exp(self._log_loss(equivalent))
        return np.asarray(np.hypot(*moduli) * self.rubber.layer_stiffening)
