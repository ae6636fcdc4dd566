"""Residuals are no white noise: each resembles the one before. An autoregression fitted to them makes them white."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MOST_LAGS = 4
LARGEST_ROOT = 0.995  # of the autoregression: more would take a constant for noise
OUTLIER = 4.0  # robust standard deviations
MAD_TO_STD = 1.4826


@dataclass(frozen=True, eq=False)
class Noise:
    """An autoregression: e_t = x_t - sum phi_i x_(t-i), white with a standard deviation `std`."""

    phi: Array
    std: float

    @property
    def gain(self) -> float:
        """What whitening leaves of a constant."""
        return float(1.0 - self.phi.sum())

    @property
    def text(self) -> str:
        """Both in words."""
        return f"AR({len(self.phi)}) {np.array2string(self.phi, precision=2)}, {self.std:.3g} Nm"


def whitened(series: Array, mask: Mask, phi: Array) -> Array:
    """What whitening makes of series along axis 0; rows whose past is not known over `MOST_LAGS` are nan.

    So many whatever the order: likelihoods of two fits are to be of the same rows.

    Parameters
    ----------
    series
        Shape (n,) or (n, k).
    mask
        Where the series can be used, shape (n,).
    """
    valid = whole_past(mask, MOST_LAGS)
    out = np.array(series, dtype=float)
    for lag, coefficient in enumerate(phi, start=1):
        out[lag:] -= coefficient * series[:-lag]
    out[~valid] = np.nan
    return out


def whole_past(mask: Mask, lags: int) -> Mask:
    """Where a sample and the `lags` before it can be used."""
    valid = mask.copy()
    for lag in range(1, lags + 1):
        valid[lag:] &= mask[:-lag]
        valid[:lag] = False
    return valid


def estimate_noise(residuals: Sequence[Array], masks: Sequence[Mask], lags: int | None = None) -> Noise:
    """Fit the autoregression of residuals [Nm]; its order by BIC unless given. Outliers are pulled in first."""
    pooled = np.concatenate([r[m] for r, m in zip(residuals, masks, strict=True)])
    scale = OUTLIER * MAD_TO_STD * float(np.median(np.abs(pooled - np.median(pooled)))) or 1.0
    middle = float(np.median(pooled))
    tame = [np.clip(r, middle - scale, middle + scale) for r in residuals]
    best: tuple[float, Noise] | None = None
    for order in range(MOST_LAGS + 1) if lags is None else (lags,):
        rows, targets = [], []
        for series, mask in zip(tame, masks, strict=True):
            at = np.flatnonzero(whole_past(mask, MOST_LAGS))
            rows.append(np.stack([series[at - lag] for lag in range(1, order + 1)], axis=1) if order else np.empty((len(at), 0)))
            targets.append(series[at])
        x, y = np.concatenate(rows), np.concatenate(targets)
        phi = solve(x.T @ x + 1e-9 * np.trace(x.T @ x) * np.eye(order), x.T @ y, assume_a="pos") if order else np.empty(0)
        phi = _stable(phi)
        variance = float(np.mean((y - x @ phi) ** 2))
        criterion = len(y) * np.log(max(variance, 1e-300)) + order * np.log(len(y))
        if best is None or criterion < best[0]:
            best = (criterion, Noise(phi, float(np.sqrt(variance))))
    assert best
    return best[1]


def _stable(phi: Array) -> Array:
    """Shrink an autoregression until its largest root is `LARGEST_ROOT`."""
    if not len(phi):
        return phi
    largest = float(np.abs(np.roots(np.concatenate(([1.0], -phi)))).max())
    shrink = min(1.0, LARGEST_ROOT / largest) if largest > 0 else 1.0
    return phi * shrink ** np.arange(1, len(phi) + 1)
