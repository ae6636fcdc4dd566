# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The step of an extended Kalman filter with one measurement, in Joseph's form. It only uses sums and products of elements, in a
fixed order, so results are equal to the bit.
"""

from __future__ import annotations

import numpy as np

from trackres_ros.arrays import Array, Mask


def aged(mean: Array, covariance: Array, keep: Array, gained: Array) -> None:
    """Predict states with decay and process noise; changes both.

    `keep` is the remaining share of each state, `gained` its process noise, shape (states,).
    """
    mean *= keep
    covariance *= keep[:, None]
    covariance *= keep[None, :]
    covariance[np.diag_indices_from(covariance)] += gained


def widened(covariance: Array, stds: Array) -> None:
    """Raise standard deviations to those given, shape (states,); the correlations stay. Changes the covariance."""
    now = np.sqrt(np.diag(covariance))
    share = np.divide(np.maximum(stds, now), now, out=np.ones(len(now)), where=now > 0.0)
    covariance *= share[:, None]
    covariance *= share[None, :]


def expected(mean: Array, looks: Array) -> float:
    """Expected measurement: the sum of states times their sensitivities, shape (states,)."""
    return float((mean * looks).sum())


def spread(covariance: Array, looks: Array) -> tuple[Array, float]:
    """Covariance of the states with the expected measurement, shape (states,), and its variance."""
    tied = (covariance * looks[None, :]).sum(axis=1)
    return tied, float((tied * looks).sum())


def corrected(mean: Array, covariance: Array, looks: Array, departure: float, variance: float, free: Mask) -> None:
    """Update by a measurement; changes mean and covariance.

    Parameters
    ----------
    looks
        Sensitivity of the measurement to each state, shape (states,).
    departure
        Measured less expected.
    variance
        Of the measurement's noise.
    free
        States to update, shape (states,); the others are considered with their uncertainty (Schmidt's filter).

    Notes
    -----
    With gain K, P' = (I - K h) P (I - K h)^T + K r K^T, which is symmetric, and right for any gain.
    """
    tied, total = spread(covariance, looks)
    total += variance
    gain = np.where(free, tied / total, 0.0)
    mean += gain * departure
    cross = gain[:, None] * tied[None, :]
    covariance -= cross
    covariance -= cross.T
    covariance += total * (gain[:, None] * gain[None, :])


def given_others(mean: Array, covariance: Array, learned: Mask) -> Array:
    """Departures of accepted parameters, given the file's values for all others; zero elsewhere, shape (states,).

    The estimates are correlated. If some are not accepted, their estimated contributions are conditionally assigned to the
    accepted ones.
    """
    found = np.zeros_like(mean)
    left = ~learned
    if not learned.any():
        return found
    found[learned] = mean[learned]
    left &= np.diag(covariance) > 0.0
    if left.any():
        ties = np.linalg.solve(covariance[np.ix_(left, left)], mean[left])
        found[learned] -= (covariance[np.ix_(learned, left)] * ties[None, :]).sum(axis=1)
    return found
