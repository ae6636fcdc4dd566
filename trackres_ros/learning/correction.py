# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Applies the learned parameters to the step, within limits, with their uncertainty."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from trackres_ros.estimator import columns as at
from trackres_ros.learning.filter import given_others
from trackres_ros.learning.learned import LearnerState
from trackres_ros.learning.parameters import STEP, Prior

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

RATE_PER_HOUR = 1.0  # of the file's value: what acts follows no faster
FASTEST = np.full(at.LEARNABLE, RATE_PER_HOUR / 3600.0)  # in a second
FASTEST[at.OF_BELT] = 1.0  # K
BELT_S = 900.0  # of a belt's temperature: its heat capacity over what cools it
ACCEL_DOUBT = 0.04  # of an acceleration filtered out of a speed; of simulated drives a right mass comes out by so much too large


def std_of(s: LearnerState, state: int) -> float:
    """Standard deviation of a state as it is told; of a mass with what accelerations are off by themselves."""
    return told_std(state, float(s.covariance[state, state]))


def told_std(state: int, variance: float) -> float:
    """The same of a variance of it."""
    doubt = ACCEL_DOUBT if state == at.OF_MASS else 0.0
    return math.hypot(math.sqrt(max(variance, 0.0)), doubt)


def sure(s: LearnerState, prior: Prior) -> Mask:
    """Which departures are known twice as well as by the vehicle file, shape (LEARNABLE,)."""
    variances = np.diag(s.covariance)[: at.LEARNABLE]
    return np.asarray(variances < 0.25 * np.diag(prior.covariance)[: at.LEARNABLE])


def aim(s: LearnerState, prior: Prior, counted: Mask) -> None:
    """What is to act: all that counts, with the rest as the file has it."""
    s.aim[:] = 0.0
    if not counted.any():
        return
    of_vehicle = counted.copy()
    of_vehicle[at.OF_BELT] = True
    found = given_others(s.mean[: at.LEARNABLE], s.covariance[: at.LEARNABLE, : at.LEARNABLE], of_vehicle)
    s.aim[:] = np.clip(found, prior.low[: at.LEARNABLE], prior.high[: at.LEARNABLE])


def follow(s: LearnerState) -> None:
    """What acts follows what is to act, no faster than it may."""
    s.applied += np.minimum(np.maximum(s.aim - s.applied, -FASTEST), FASTEST)


def move(s: LearnerState, acts: bool, learned: Array, now: int, belt_variance: float) -> None:
    """Write what acts into the memory of a session, see `estimator.columns`.

    Parameters
    ----------
    now
        The second it is: since the last that was learned from, belts have become less sure.
    belt_variance
        Of the belts' temperature where no torque tells of it [K^2].
    """
    if not (acts and s.applied.any()):
        learned[: at.Learned.slow] = 0.0
        return
    learned[at.Learned.on] = 1.0
    learned[at.Learned.departures] = s.applied
    learned[at.Learned.torque] = s.lasting_nm
    unexplained = s.mean[STEP] - s.lasting_nm if s.step_s < math.inf else 0.0
    learned[at.Learned.slow] = math.sqrt(s.slow_std**2 + s.hills_variance + unexplained**2)
    learned[at.Learned.factor] = factor(s, max(now - s.second, 0), belt_variance).ravel()


def belt_keeps(seconds: float) -> float:
    """What is left of a belt's departure after so long."""
    return math.exp(-seconds / BELT_S)


def factor(s: LearnerState, unseen_s: float, belt_variance: float) -> Array:
    """Lower factor of the covariance about what acts, shape (LEARNABLE, LEARNABLE); see `move`."""
    off = s.mean[: at.LEARNABLE] - s.applied
    covariance = s.covariance[: at.LEARNABLE, : at.LEARNABLE] + off[:, None] * off[None, :]
    covariance[np.diag_indices_from(covariance)] += 1e-12
    forgotten = 1.0 - belt_keeps(unseen_s) ** 2
    covariance[at.OF_BELT, at.OF_BELT] += forgotten * max(belt_variance - covariance[at.OF_BELT, at.OF_BELT], 0.0)
    return np.asarray(np.linalg.cholesky(covariance))
