# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Coloured noise with heavy tails: residuals are autocorrelated and have outliers.

An autoregression whitens them; the innovations follow Student's t, with tails estimated from the data.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg.lapack import dgeev, dposv, dtbtrs
from scipy.special import gammaln

from trackres_ros.diagnosis.prepare.session import MOST_LAGS, Array, Mask, whole_past
from trackres_ros.text import figures
from trackres_ros.units import MAD_TO_STD

LARGEST_ROOT = 0.995  # of the autoregression: a larger one would treat a constant as noise
SHORT_ROOT = 0.7  # of a noise that is certainly no random walk
OUTLIER = 4.0  # standard deviations
DEGREES = (2.5, 4.0, 7.0, 15.0, 60.0)  # candidate degrees of freedom; the last is nearly normal
TURNS = 6  # of weights and coefficients


@dataclass(frozen=True, eq=False)
class Noise:
    """An autoregression e_t = x_t - sum phi_i x_(t-i) with innovations of Student's t, times `scale`."""

    phi: Array
    scale: float
    degrees: float

    @property
    def std(self) -> float:
        """Standard deviation of normal innovations with the same information [unit of the series]."""
        return self.scale * float(np.sqrt((self.degrees + 3.0) / (self.degrees + 1.0)))

    @property
    def dc_gain(self) -> float:
        """Gain of the whitening for a constant."""
        return float(1.0 - self.phi.sum())

    @property
    def text(self) -> str:
        """Summary in words."""
        return f"AR({len(self.phi)}) {np.array2string(self.phi, precision=2)}, {figures(self.std)} Nm, t({self.degrees:g})"

    def weights(self, white: Array) -> Array:
        """Weights of residuals over `std`: about 1 on average, smaller for outliers."""
        return (self.degrees + 3.0) / (self.degrees + self._squares(white))

    def deviance_root(self, white: Array) -> Array:
        """Signed root of twice the fall of the log-density from its peak, of residuals over `std`: its least squares are the
        maximum likelihood.
        """
        return np.sign(white) * np.sqrt((self.degrees + 1.0) * np.log1p(self._squares(white) / self.degrees))

    def deviance_slope(self, white: Array) -> Array:
        """Derivative of `deviance_root`."""
        root = self.deviance_root(white)
        is_near = root == 0.0
        return np.where(is_near, np.sqrt(self.weights(0.0 * white)), self.weights(white) * white / np.where(is_near, 1.0, root))

    def log_density(self, white: Array) -> Array:
        """Log-density of the innovations, from residuals over `std`."""
        return -0.5 * self.deviance_root(white) ** 2 + self._log_peak()

    def _log_peak(self) -> float:
        half_degrees = 0.5 * self.degrees
        return float(
            gammaln(half_degrees + 0.5) - gammaln(half_degrees) - 0.5 * np.log(np.pi * self.degrees) - np.log(self.scale)
        )

    def _squares(self, white: Array) -> Array:
        return np.asarray((white * (self.std / self.scale)) ** 2)


def whitened(series: Array, mask: Mask, phi: Array) -> Array:
    """Whitened series along axis 0, shape (n,) or (n, k); rows without `MOST_LAGS` known past samples are nan.

    The number is independent of the order, so likelihoods of two fits use the same rows.
    """
    return whitened_at(series, whole_past(mask, MOST_LAGS), phi)


def whitened_at(series: Array, is_valid: Mask, phi: Array) -> Array:
    """The same for rows known to be valid."""
    output = np.array(series, dtype=float)
    for lag, coefficient in enumerate(phi, start=1):
        output[lag:] -= coefficient * series[:-lag]
    output[~is_valid] = np.nan
    return output


def autoregression(shocks: Array, phi: Array) -> Array:
    """The series that shocks drive from rest, shape (n,): the inverse of whitening."""
    bands = np.tile(np.concatenate(([1.0], -phi))[:, np.newaxis], len(shocks))
    return np.asarray(dtbtrs(bands, shocks[:, np.newaxis], uplo="L")[0][:, 0])


def estimate_noise(residuals: Sequence[Array], masks: Sequence[Mask], largest_root: float = LARGEST_ROOT) -> Noise:
    """Fit the autoregression with bounded roots, and the tails of residuals; the order by BIC."""
    lag_rows = []
    for series, mask in zip(residuals, masks, strict=True):
        rows = np.flatnonzero(whole_past(mask, MOST_LAGS))
        lag_rows.append([series[rows - lag] for lag in range(MOST_LAGS + 1)])
    y, *past_values = np.concatenate(lag_rows, axis=1)
    x = np.array(past_values).T  # each lag contiguous
    initial = _initial_noises(x, y, largest_root)

    def most_likely(order: int, degrees: float) -> Noise:
        return improve_noise(x[:, :order], y, replace(initial[order], degrees=degrees), TURNS, largest_root)

    def criterion(noise: Noise) -> float:
        order = len(noise.phi)
        return _log_likelihood(x[:, :order], y, noise) - 0.5 * order * float(np.log(len(y)))

    best_noise = max((most_likely(MOST_LAGS, degrees) for degrees in DEGREES), key=criterion)
    return max((*(most_likely(order, best_noise.degrees) for order in range(MOST_LAGS)), best_noise), key=criterion)


def improve_noise(x: Array, y: Array, noise: Noise, turns: int = 2, largest_root: float = LARGEST_ROOT) -> Noise:
    """Improve coefficients and scale in turn, by expectation-maximisation; order and tails stay.

    x are past values, nearest first, shape (n, lags), and y is the series, shape (n,).
    """
    phi, scale, degrees = noise.phi, noise.scale, noise.degrees
    residual = y - x @ phi
    for _ in range(turns):
        weight = 1.0 / (1.0 + residual * residual / (degrees * scale * scale))
        phi = _coefficients(x, y, weight, largest_root)
        residual = y - x @ phi
        square = (degrees + 1.0) / degrees * float((weight * residual) @ residual)
        scale = max(math.sqrt(square / len(residual)), 1e-12 * scale)
    return Noise(phi, scale, degrees)


def _log_likelihood(x: Array, y: Array, noise: Noise) -> float:
    return float(noise.log_density((y - x @ noise.phi) / noise.std).sum())


def _initial_noises(x: Array, y: Array, largest_root: float) -> list[Noise]:
    """Noise of each order up to the number of columns of x, robust against outliers, to improve."""
    scale = MAD_TO_STD * float(np.median(np.abs(y))) or float(np.abs(y).max()) or 1.0
    limit = OUTLIER * scale  # limits the influence of outliers on the first coefficients
    tame_x, tame_y, weights_of_one = np.clip(x, -limit, limit), np.clip(y, -limit, limit), np.ones(len(y))
    noises = []
    for order in range(x.shape[1] + 1):
        phi = _coefficients(tame_x[:, :order], tame_y, weights_of_one, largest_root)
        noises.append(Noise(phi, MAD_TO_STD * float(np.median(np.abs(y - x[:, :order] @ phi))) or scale, DEGREES[-1]))
    return noises


def _coefficients(x: Array, y: Array, weight: Array, largest_root: float) -> Array:
    if not x.shape[1]:
        return np.empty(0)
    weighted_columns = x.T * weight
    return _make_stable(solve_normal(weighted_columns @ x, weighted_columns @ y, 1e-9), largest_root)


def solve_normal(normal: Array, right_side: Array, ridge: float) -> Array:
    """Solution of normal equations, with a small part of their trace added on their diagonal, in place; the shortest one where
    nothing determines it.
    """
    diagonal = normal.reshape(-1)[:: len(normal) + 1]  # a view: `normal` is contiguous
    diagonal += ridge * diagonal.sum()
    _, solution, failure = dposv(normal, right_side)
    if not failure:
        return np.asarray(solution)
    try:
        return np.asarray(np.linalg.solve(normal, right_side))
    except np.linalg.LinAlgError:  # singular: the shortest solution
        return np.asarray(np.linalg.lstsq(normal, right_side, rcond=None)[0])


def _make_stable(phi: Array, largest_root: float) -> Array:
    """Shrink an autoregression until its largest root is within the limit."""
    reach = 0.0
    for x in reversed(phi.tolist()):
        reach = (reach + abs(x)) / largest_root
    if reach < 1.0:  # surely
        return phi
    companion = np.eye(len(phi), k=-1)
    companion[0] = phi
    real_parts, imaginary_parts, *_ = dgeev(companion, compute_vl=False, compute_vr=False)
    largest_root_of_phi = float(np.hypot(real_parts, imaginary_parts).max())
    shrink = min(1.0, largest_root / largest_root_of_phi) if largest_root_of_phi > 0 else 1.0
    return phi * shrink ** np.arange(1, len(phi) + 1)
