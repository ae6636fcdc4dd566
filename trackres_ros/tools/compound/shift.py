# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

r"""The shift function of a compound, as the model has it: WLF above the glass transition, its tangent below.

About any reference, $-C_1 (T - T_r) / (C_2 + T - T_r)$ is $B / (T - T_\infty)$ but for a constant, with $T_\infty = T_r - C_2$
and $B = C_1 C_2$. So data above the glass transition tell two numbers, and not three. With $T_\infty$ at 0 K this is Arrhenius'
law, of activation energy $R B \ln 10$: a vehicle file can hold either.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log

import numpy as np
from numpy.typing import ArrayLike

from trackres_ros.arrays import Array
from trackres_ros.model.rubber import REFERENCE_ABOVE_TG
from trackres_ros.units import ZERO_DEGC_K

GAS_CONSTANT = 8.314462618  # J/mol/K, exact since 2019
ABSOLUTE_ZERO_DEGC = -ZERO_DEGC_K


@dataclass(frozen=True, slots=True)
class Shift:
    """log10 a_T = strength / (T - pole) above the glass transition, all in K and degC."""

    strength: float
    pole: float
    glass_transition: float

    @classmethod
    def of_wlf(cls, glass_transition: float, c1: float, c2: float) -> Shift:
        """From the values of a vehicle file, which are about Tg + 50 K."""
        return cls(c1 * c2, glass_transition + REFERENCE_ABOVE_TG - c2, glass_transition)

    def wlf(self, about_degc: float | None = None) -> tuple[float, float]:
        """C1 and C2 [K] about a temperature [degC], by default Tg + 50 K."""
        c2 = (self.glass_transition + REFERENCE_ABOVE_TG if about_degc is None else about_degc) - self.pole
        return self.strength / c2, c2

    @property
    def activation_energy(self) -> float:
        """Of Arrhenius' law [J/mol], where the pole is at 0 K."""
        return GAS_CONSTANT * self.strength * log(10.0)

    def log_shift(self, temp_degc: ArrayLike) -> Array:
        """log10 a_T at temperatures [degC], about infinite temperature; same shape."""
        t = np.asarray(temp_degc, dtype=float)
        span = self.glass_transition - self.pole
        above = np.maximum(t, self.glass_transition) - self.pole
        return np.asarray(self.strength / above - self.strength / span**2 * np.minimum(t - self.glass_transition, 0.0))

    def equivalent_degc(self, frequency: ArrayLike, temp_degc: ArrayLike, at_frequency: float) -> Array:
        """Temperature [degC] at which one frequency [Hz] is equivalent to other pairs of frequency [Hz] and temperature [degC];
        broadcast.
        """
        y = np.log10(np.asarray(frequency, dtype=float) / at_frequency) + self.log_shift(temp_degc)
        span = self.glass_transition - self.pole
        y_glass = self.strength / span
        degc_below = self.glass_transition - (y - y_glass) * span**2 / self.strength
        return np.asarray(np.where(y > y_glass, degc_below, self.pole + self.strength / np.maximum(y, 1e-9)))
