# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Models the dynamic moduli of the compound over frequency and temperature, equations (2) to (4)."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from trackres_ros.arrays import Array
from trackres_ros.kernels.marks import kernel
from trackres_ros.model.interpolation import MonotoneCubic
from trackres_ros.vehicle import Rubber

REFERENCE_ABOVE_TG = 50.0  # K: the shift function is 1 at Tg + 50, equation (4)


@kernel
def log_shift_factor(belt_degc: float, glass_transition: float, c1: float, c2: float) -> tuple[float, float]:
    """log10 a_T of one temperature and its derivative [1/K]; scalars in and out, shared with the live kernel.

    Notes
    -----
    WLF about Tg + 50 K, equation (4). Its pole lies at Tg + 50 - C2; below Tg it continues on its tangent.
    """
    above = belt_degc - glass_transition
    if above >= 0.0:
        span = c2 + above - REFERENCE_ABOVE_TG
        return -c1 * (above - REFERENCE_ABOVE_TG) / span, -c1 * c2 / (span * span)
    span = c2 - REFERENCE_ABOVE_TG
    slope = -c1 * c2 / (span * span)
    return c1 * REFERENCE_ABOVE_TG / span + slope * above, slope


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
        above = np.asarray(belt_degc, dtype=float) - r.glass_transition
        span = r.wlf_c2 + np.maximum(above, 0.0) - REFERENCE_ABOVE_TG
        wlf = -r.wlf_c1 * (np.maximum(above, 0.0) - REFERENCE_ABOVE_TG) / span
        slope = -r.wlf_c1 * r.wlf_c2 / (r.wlf_c2 - REFERENCE_ABOVE_TG) ** 2
        return np.asarray(wlf + slope * np.minimum(above, 0.0))

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

    def reduced(self, frequency: ArrayLike, belt_degc: ArrayLike) -> Array:
        """log10(a_T f / Hz) at frequencies [Hz] and temperatures [degC], broadcast; frequency 0 is replaced by 1e-30 Hz."""
        return np.asarray(np.log10(np.maximum(frequency, 1e-30)) + self.log_shift(belt_degc))

    def storage_modulus(self, frequency: ArrayLike, belt_degc: ArrayLike) -> Array:
        """E' [Pa]."""
        return np.asarray(np.exp(self._log_storage(self.equivalent_temperature(self.reduced(frequency, belt_degc)))))

    def loss_modulus(self, frequency: ArrayLike, belt_degc: ArrayLike) -> Array:
        """E'' [Pa]."""
        return np.asarray(np.exp(self._log_loss(self.equivalent_temperature(self.reduced(frequency, belt_degc)))))

    def dynamic_modulus(self, frequency: ArrayLike, belt_degc: ArrayLike) -> Array:
        """abs(E*) [Pa], equation (2), times the stiffening of a confined layer."""
        equivalent = self.equivalent_temperature(self.reduced(frequency, belt_degc))
        moduli = np.exp(self._log_storage(equivalent)), np.exp(self._log_loss(equivalent))
        return np.asarray(np.hypot(*moduli) * self.rubber.layer_stiffening)
