# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Models the truth's rubber: springs and dashpots in parallel (generalised Maxwell), shifted along temperature after WLF."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import nnls

from proofs.sealed.data_sheet import Array, DataSheet

ELEMENTS_PER_DECADE = 2
SHIFT_ABOVE_TG_K = 50.0
BELOW_TG_K = 40.0  # the shift function has a pole further down; it goes on straight from here

AT_ONCE = 64  # frequencies, whose elements the processor keeps at hand


@dataclass(frozen=True, eq=False)
class Material:
    """Moduli [Pa] and relaxation times [s] at the reference temperature, and the constants of the shift."""

    equilibrium: float
    moduli: Array
    times: Array
    glass_transition: float
    c1: float
    c2: float

    def log_shift(self, degc: ArrayLike) -> Array:
        """log10 a_T."""
        above = np.maximum(np.asarray(degc, dtype=float) - self.glass_transition, -BELOW_TG_K) - SHIFT_ABOVE_TG_K
        return np.asarray(-self.c1 * above / (self.c2 + above))

    def loss(self, omega_shifted: ArrayLike) -> Array:
        """Loss modulus [Pa] at an angular frequency times a_T [rad/s]."""
        omega = np.asarray(omega_shifted, dtype=float)
        if omega.size > AT_ONCE:
            flat = omega.ravel()
            parts = [self.loss(flat[i : i + AT_ONCE]) for i in range(0, flat.size, AT_ONCE)]
            return np.concatenate(parts).reshape(omega.shape)
        x = omega[..., np.newaxis] * self.times
        below = x * x
        below += 1.0
        x *= self.moduli
        x /= below
        return np.asarray(x.sum(axis=-1))

    def size(self, omega_shifted: ArrayLike) -> Array:
        """Size of the complex modulus [Pa]."""
        x = np.asarray(omega_shifted, dtype=float)[..., np.newaxis] * self.times
        storage = self.equilibrium + (self.moduli * x * x / (1.0 + x * x)).sum(axis=-1)
        return np.asarray(np.hypot(storage, self.loss(omega_shifted)))


def fit_material(sheet: DataSheet) -> Material:
    """The elements that make the sheet's temperature sweep at one frequency, by non-negative least squares of relative errors."""
    degc, storage, loss = sheet.sweep
    blank = Material(
        0.0, np.empty(0), np.empty(0), sheet["rubber.glass_transition"], sheet["rubber.wlf_c1"], sheet["rubber.wlf_c2"]
    )
    omega = 2.0 * np.pi * sheet["rubber.sweep_frequency"] * 10.0 ** blank.log_shift(degc)
    decades = np.log10(omega.max() / omega.min()) + 2.0
    times = 1.0 / np.geomspace(omega.min() / 10.0, omega.max() * 10.0, int(decades * ELEMENTS_PER_DECADE))
    x = omega[:, np.newaxis] * times
    rows_storage = np.column_stack([x * x / (1.0 + x * x), np.ones(len(omega))]) / storage[:, np.newaxis]
    rows_loss = np.column_stack([x / (1.0 + x * x), np.zeros(len(omega))]) / loss[:, np.newaxis]
    found, _ = nnls(np.vstack([0.3 * rows_storage, rows_loss]), np.concatenate([np.full(len(omega), 0.3), np.ones(len(omega))]))
    return Material(float(found[-1]), found[:-1], times, blank.glass_transition, blank.c1, blank.c2)
