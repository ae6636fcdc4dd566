# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Applies the learned parameters to the step, within limits, with their uncertainty."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from trackres_ros.arrays import Array, Mask
from trackres_ros.estimator import columns as at
from trackres_ros.learning.filter import given_others
from trackres_ros.learning.learned import LearnerState
from trackres_ros.learning.parameters import REACH_STD, STEP, Prior

RATE_PER_HOUR = 1.0  # of the file's value: limit on the rate of acting values
FASTEST = np.full(at.LEARNABLE, RATE_PER_HOUR / 3600.0)  # in a second
FASTEST[at.OF_BELT] = 1.0  # K
BELT_S = 900.0  # of a belt's temperature: heat capacity over cooling
ACCEL_DOUBT = 0.04  # of an acceleration filtered out of a speed; of simulated drives a right mass comes out by so much too large
TAKE_UP_A_RISE = (at.OF_BEARING, at.OF_DRAG)


def reported_stds(covariance: Array, prior: Prior, own: Sequence[int], seen: Array) -> Array:
    """Reported standard deviations of the filter's first states, with errors that their covariance does not include.

    One is that of accelerations, for the mass. The other is that of a rolling coefficient's rise over speed: coefficient and drag
    take it up by least squares, within their bounds.

    Parameters
    ----------
    own
        Departures of the vehicle that are learned; the others have the file's values.
    seen
        Torques by `parameters.rise_torques` in the driving so far, over their noise, shape (3, speeds).
    """
    errors = np.zeros(len(covariance))
    errors[at.OF_MASS] = ACCEL_DOUBT
    among = [state for state in TAKE_UP_A_RISE if state in own]
    by = seen[[TAKE_UP_A_RISE.index(state) for state in among]]
    variances = np.diag(prior.covariance)[among]
    taken_up = np.abs(np.linalg.solve(by @ by.T + np.diag(1.0 / variances), by @ seen[-1]))
    errors[among] = np.minimum(taken_up, REACH_STD * np.sqrt(variances))
    return np.hypot(np.sqrt(np.maximum(np.diag(covariance), 0.0)), errors)


def well_known(s: LearnerState, prior: Prior) -> Mask:
    """Which departures are known twice as well as by the vehicle file, shape (LEARNABLE,)."""
    variances = np.diag(s.covariance)[: at.LEARNABLE]
    return np.asarray(variances < 0.25 * np.diag(prior.covariance)[: at.LEARNABLE])


def target_departures(s: LearnerState, prior: Prior, counted: Mask) -> Array:
    """Target of the acting departures, (LEARNABLE,): all accepted ones, with the file's values for the rest."""
    if not counted.any():
        return np.zeros(at.LEARNABLE)
    of_vehicle = counted.copy()
    of_vehicle[at.OF_BELT] = True
    found = given_others(s.mean[: at.LEARNABLE], s.covariance[: at.LEARNABLE, : at.LEARNABLE], of_vehicle)
    return np.clip(found, prior.low[: at.LEARNABLE], prior.high[: at.LEARNABLE])


def approach_target(s: LearnerState) -> None:
    """Move acting departures towards their target within the rate limit."""
    s.applied += np.minimum(np.maximum(s.aim - s.applied, -FASTEST), FASTEST)


def fade_belts(s: LearnerState, seconds: float) -> None:
    """Let the acting departure of the belts' temperature fade over a time that did not renew it: it holds for the moment only."""
    for departures in (s.aim, s.applied):
        departures[at.OF_BELT] *= belt_share_left(seconds)


def apply_departures(s: LearnerState, acts: bool, learned: Array, now: int, belt_variance: float) -> None:
    """Write the acting departures into the memory of a session, see `estimator.columns`.

    `now` is the present second: belts have become less certain since the last second used. `belt_variance` is that of their
    temperature without a torque measurement [K^2].
    """
    if not (acts and s.applied.any()):
        learned[: at.Learned.slow] = 0.0
        return
    learned[at.Learned.on] = 1.0
    learned[at.Learned.departures] = s.applied
    learned[at.Learned.torque] = s.lasting_nm
    unexplained = s.mean[STEP] - s.lasting_nm if s.step_s < math.inf else 0.0
    learned[at.Learned.slow] = math.sqrt(s.slow_std**2 + s.hills_variance + unexplained**2)
    learned[at.Learned.factor] = covariance_factor(s, max(now - s.second, 0), belt_variance).ravel()


def use_file(learned: Array) -> None:
    """Let a session use the vehicle file, until `apply_departures` is called again; the sensitivities of its last step stay."""
    learned[: at.Learned.sensitivities.start] = 0.0


def belt_share_left(seconds: float) -> float:
    """Remaining share of a belt's departure after some time."""
    return math.exp(-seconds / BELT_S)


def covariance_factor(s: LearnerState, unseen_s: float, belt_variance: float) -> Array:
    """Lower factor of the covariance about the acting departures, shape (LEARNABLE, LEARNABLE); see `apply_departures`."""
    keeps = belt_share_left(unseen_s)
    off = s.mean[: at.LEARNABLE] - s.applied
    off[at.OF_BELT] = keeps * s.mean[at.OF_BELT] - s.applied[at.OF_BELT]
    covariance = s.covariance[: at.LEARNABLE, : at.LEARNABLE] + off[:, None] * off[None, :]
    covariance[np.diag_indices_from(covariance)] += 1e-12
    covariance[at.OF_BELT, at.OF_BELT] += (1.0 - keeps**2) * max(belt_variance - covariance[at.OF_BELT, at.OF_BELT], 0.0)
    return np.asarray(np.linalg.cholesky(covariance))
