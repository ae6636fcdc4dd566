# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The master curve of a sweep: both moduli over the temperature at which one frequency shows them, as a rubber file has it.

Two cubic splines of the logarithms of the moduli, with a penalty on bends (P-splines: Eilers and Marx, Statistical Science 11
(1996) 89), whose weight is chosen by generalised cross-validation. Their coefficients are bounded by what rubber can have, and so
are the splines.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline
from scipy.optimize import lsq_linear

from trackres_ros.tools.compound.reading import Array, Sweep
from trackres_ros.tools.compound.shift import Shift
from trackres_ros.vehicle.loading import SWEEP_LOSS, SWEEP_STORAGE

KNOTS_K = 3.0  # the softening zone of a rubber is some 30 K wide
MOST_KNOTS = 90
DEGREE = 3
PENALTIES = np.logspace(-6, 4, 21)
MOST_USED = 0.8  # of the values, as effective coefficients: the residual gives their uncertainty
LIMITS = SWEEP_STORAGE, SWEEP_LOSS


@dataclass(frozen=True, eq=False)
class Basis:
    """B-splines over equivalent temperatures [degC]."""

    knots: Array

    @classmethod
    def over(cls, sweep: Sweep, equivalent: Array) -> Basis:
        """Evenly spaced over all equivalent temperatures; their number does not depend on the shift."""
        low, high = float(equivalent.min()), float(equivalent.max())
        pieces = int(np.clip(np.ceil(np.ptp(sweep.temp_degc) / KNOTS_K), 8, MOST_KNOTS))
        step = (high - low) / pieces
        return cls(low + step * np.arange(-DEGREE, pieces + DEGREE + 1, dtype=np.float64))

    def at(self, degc: ArrayLike) -> Array:
        """Values, shape (temperatures, splines); beyond the ends those of the ends."""
        degc_inside = np.clip(degc, self.knots[DEGREE], self.knots[-DEGREE - 1])
        return np.asarray(BSpline.design_matrix(degc_inside, self.knots, DEGREE).toarray())

    @cached_property
    def bends(self) -> Array:
        """Second differences of coefficients, shape (splines - 2, splines)."""
        return np.diff(np.eye(len(self.knots) - DEGREE - 1), 2, axis=0)


@dataclass(frozen=True, eq=False)
class Smooth:
    """Least squares with a penalty, for one shift: coefficients and the residuals of both moduli.

    `coefficients` is (splines, 2), `residuals` is (n, 2) of natural logarithms, `penalised` the same with rows for the penalty.
    """

    basis: Basis
    design: Array
    coefficients: Array
    residuals: Array
    penalised: Array


def logs(sweep: Sweep) -> Array:
    """Natural logarithms of both moduli [Pa], shape (n, 2)."""
    return np.log(np.column_stack([sweep.storage, sweep.loss]))


def smooth(sweep: Sweep, shift: Shift, at_frequency: float, penalty: Array) -> Smooth:
    """The splines of a shift, with a penalty for each modulus."""
    equivalent = shift.equivalent_degc(sweep.frequency, sweep.temp_degc, at_frequency)
    basis = Basis.over(sweep, equivalent)
    design, values = basis.at(equivalent), logs(sweep)
    gram, right_side, roughness = design.T @ design, design.T @ values, basis.bends.T @ basis.bends
    coefficients_found = np.column_stack(
        [np.linalg.solve(gram + weight * roughness, right_side[:, k]) for k, weight in enumerate(penalty)]
    )
    residuals = values - design @ coefficients_found
    return Smooth(
        basis,
        design,
        coefficients_found,
        residuals,
        np.vstack([residuals, np.sqrt(penalty) * (basis.bends @ coefficients_found)]),
    )


def chosen_penalty(sweep: Sweep, shift: Shift, at_frequency: float) -> Array:
    """The penalty of each modulus with the least generalised cross-validation."""
    equivalent = shift.equivalent_degc(sweep.frequency, sweep.temp_degc, at_frequency)
    basis = Basis.over(sweep, equivalent)
    design, values = basis.at(equivalent), logs(sweep)
    gram, roughness, n = design.T @ design, basis.bends.T @ basis.bends, len(values)
    scores = np.full((len(PENALTIES), 2), np.inf)
    places = len(np.unique(np.round(equivalent, 2)))
    for i, weight in enumerate(PENALTIES):
        inverse = np.linalg.inv(gram + weight * roughness)
        degrees_used = float(np.einsum("ij,ji->", inverse, gram))
        if degrees_used <= MOST_USED * places or weight == PENALTIES[-1]:
            residuals = values - design @ (inverse @ (design.T @ values))
            scores[i] = n * (residuals**2).sum(axis=0) / (n - degrees_used) ** 2
    return np.asarray(PENALTIES[scores.argmin(axis=0)])


@dataclass(frozen=True, eq=False)
class MasterCurve:
    """Both moduli at one frequency over temperature, and their uncertainty."""

    at_frequency: float  # [Hz]
    # range of the data
    low_degc: float
    high_degc: float
    residuals: Array  # of the natural logarithms of storage and loss modulus, shape (n, 2)
    scale: Array
    _basis: Basis
    _coefficients: Array
    _factors: tuple[Array, Array]

    def moduli(self, degc: ArrayLike) -> tuple[Array, Array]:
        """Storage and loss modulus [Pa] at temperatures [degC]."""
        values = np.exp(self._basis.at(degc) @ self._coefficients)
        return values[:, 0], values[:, 1]

    def log_std(self, degc: ArrayLike) -> Array:
        """Standard deviation of both natural logarithms, shape (temperatures, 2).

        That of the smoothing prior, which holds over the whole curve (Nychka, J. Am. Stat. Assoc. 83 (1988) 1134); its scale is
        that of the residuals.
        """
        basis_values = self._basis.at(degc)
        return np.column_stack(
            [
                scale * np.sqrt(np.einsum("ij,jk,ik->i", basis_values, f, basis_values))
                for scale, f in zip(self.scale, self._factors, strict=True)
            ]
        )


def master_curve(sweep: Sweep, shift: Shift, at_frequency: float) -> MasterCurve:
    """Fit both moduli at one frequency by bounded least squares."""
    penalty = chosen_penalty(sweep, shift, at_frequency)
    smooth_curve = smooth(sweep, shift, at_frequency, penalty)
    basis, design, values = smooth_curve.basis, smooth_curve.design, logs(sweep)
    coefficients, factors, scales = [], [], []
    for k, (limits, weight) in enumerate(zip(LIMITS, penalty, strict=True)):
        stacked_rows = np.vstack([design, np.sqrt(weight) * basis.bends])
        target = np.concatenate([values[:, k], np.zeros(len(basis.bends))])
        bounds = np.log(1e6 * np.array([limits.low, limits.high]))
        free_coefficients = smooth_curve.coefficients[:, k]
        if (free_coefficients < bounds[0]).any() or (free_coefficients > bounds[1]).any():
            free_coefficients = lsq_linear(stacked_rows, target, bounds, method="bvls").x
        factor = np.linalg.inv(stacked_rows.T @ stacked_rows)
        degrees_used = float(np.einsum("ij,ji->", factor, design.T @ design))
        residual = values[:, k] - design @ free_coefficients
        coefficients.append(free_coefficients)
        factors.append(factor)
        scales.append(np.sqrt((residual**2).sum() / max(len(residual) - degrees_used, 1.0)))
    coefficient_columns = np.column_stack(coefficients)
    return MasterCurve(
        at_frequency,
        float(basis.knots[DEGREE]),
        float(basis.knots[-DEGREE - 1]),
        values - design @ coefficient_columns,
        np.array(scales),
        basis,
        coefficient_columns,
        (factors[0], factors[1]),
    )
