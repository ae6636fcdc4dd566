# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The step of an extended Kalman filter with one measurement a step, in Joseph's form. Only sums and products of elements, in an
order that is always the same: the same numbers to the bit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def aged(mean: Array, covariance: Array, keep: Array, gained: Array) -> None:
    """Let states decay and become less sure; changes both.

    Parameters
    ----------
    mean, covariance
        Shapes (states,) and (states, states).
    keep
        Share of each state that is left, shape (states,).
    gained
        Variance that each gains, shape (states,).
    """
    mean *= keep
    covariance *= keep[:, None]
    covariance *= keep[None, :]
    covariance[np.diag_indices_from(covariance)] += gained


def expected(mean: Array, looks: Array) -> float:
    """What is to be measured: the sum of states times what each adds, shape (states,)."""
    return float((mean * looks).sum())


def spread(covariance: Array, looks: Array) -> tuple[Array, float]:
    """Covariance of the states with what is to be measured, shape (states,), and its variance."""
    tied = (covariance * looks[None, :]).sum(axis=1)
    return tied, float((tied * looks).sum())


def corrected(mean: Array, covariance: Array, looks: Array, departure: float, variance: float, free: Mask) -> None:
    """Take in a measurement; changes mean and covariance.

    Parameters
    ----------
    looks
        What each state adds to the measurement, shape (states,).
    departure
        Measured less expected.
    variance
        Of the measurement's noise.
    free
        States that may move, shape (states,); the others are considered with what they may be off by (Schmidt's filter).

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
    """Departures of what counts as learned, where all else is as the file has it; zero elsewhere, shape (states,).

    What is known of a sum is known of it with the others as they are estimated. Where these are not to count, what they were
    thought to add goes to those that do.
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


def known_of_others(covariance: Array, learned: Mask) -> Array:
    """Covariance of what counts as learned, where all else is as the file has it, shape (states, states)."""
    left = ~learned & (np.diag(covariance) > 0.0)
    found = covariance.copy()
    if left.any():
        across = covariance[np.ix_(learned, left)]
        found[np.ix_(learned, learned)] -= across @ np.linalg.solve(covariance[np.ix_(left, left)], across.T)
    return found
