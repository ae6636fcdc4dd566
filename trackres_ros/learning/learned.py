# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The state of learning as plain values, all saved across a restart."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from trackres_ros.arrays import Array
from trackres_ros.estimator import columns as at
from trackres_ros.learning.blocks import BLOCK_S, Contest, Past, ResidualBlock, Wandering
from trackres_ros.learning.ground import Ground
from trackres_ros.learning.parameters import HEIGHT, SLOPE, SLOW, STATES, WANDERING_SHARE, Prior

SLOW_S = 180.0  # time constant of the slow disturbance
SLOW_KEEPS = math.exp(-BLOCK_S / SLOW_S)  # of it from one block to the next
FIRST_NOISE_SHARE = 0.03  # of the rolling resistance, of the mean over a second
LEAST_NOISE_SHARE = 0.005
BUMPS_SHARE = 0.06  # of the rolling resistance: a larger scatter of blocks comes from hills
LEAST_WANDERING_SHARE = 0.003  # assumed: of the rolling resistance; no model is better


@dataclass
class LearnerState:
    """The state of learning; all of it is saved across a restart."""

    mean: Array  # of the filter's states, (STATES,)
    covariance: Array  # (STATES, STATES)
    # The same at the end of the last block without a suspicion, and of the one before it: a step is found a block late, and may
    # have come within one.
    recent_mean: Array
    recent_covariance: Array
    before_mean: Array
    before_covariance: Array
    aim: Array  # target departures, (LEARNABLE,)
    applied: Array  # those that act or would
    second: int = -1  # the filter is of this one
    seconds: float = 0.0  # driven and learned from
    rolling: float = 0.0  # size of the torque that rolling takes [Nm]
    noise: float = 0.0  # variance of a second's mean [Nm^2]
    last_left: float = math.nan  # residual of the last second [Nm]
    disagrees: float = 0.0  # share of samples of late that disagree with the others
    suspect: float = 0.0  # a step that is not yet confirmed [Nm]
    suspect_level: float = 0.0  # from which [Nm]
    step_s: float = math.inf  # driving since a step
    step_nm: float = 0.0
    disturbance_nm: float = 0.0  # reported torque outside the vehicle's parameters; 0 for none
    disturbed_s: float = 0.0  # driving with it
    lasting_s: float = 0.0
    lasting_nm: float = 0.0
    blocks: int = 0  # since the estimate began: during warm-up the residual changes without a step
    block: ResidualBlock = field(default_factory=ResidualBlock)
    last_block: ResidualBlock = field(default_factory=ResidualBlock)
    past: Past = field(default_factory=Past)
    wandering: Wandering = field(default_factory=Wandering)
    contest: Contest = field(default_factory=Contest)  # over all drives
    fresh: Contest = field(default_factory=Contest)  # since a pause: it decides whether the values act
    ground: Ground = field(default_factory=Ground)

    def keep_before(self) -> None:
        """Store the present estimate, to which a later step detection returns."""
        if self.suspect:
            return
        self.before_mean[:], self.before_covariance[:] = self.recent_mean, self.recent_covariance
        self.recent_mean[:], self.recent_covariance[:] = self.mean, self.covariance

    def doubt(self) -> None:
        """After a pause, in which the vehicle may have changed: learned values need fresh evidence."""
        self.fresh = self.contest.since_pause(self.fresh)

    def begin_anew(self, prior: Prior) -> None:
        """Reset belts and slow disturbance to their priors; keep the vehicle's parameters."""
        self.second, self.last_left, self.suspect, self.disagrees, self.blocks = -1, math.nan, 0.0, 0.0, 0
        self.lasting_s = self.lasting_nm = 0.0
        self.disturbance_nm = 0.0
        self.block, self.last_block = ResidualBlock(), ResidualBlock()
        self.past.pause()
        self.doubt()
        self.ground.restart()
        for state in (at.OF_BELT, SLOW, SLOPE, HEIGHT):
            self.mean[state] = 0.0
            self.covariance[state, :] = self.covariance[:, state] = 0.0
            self.covariance[state, state] = prior.covariance[state, state]
        self.aim[at.OF_BELT] = self.applied[at.OF_BELT] = 0.0
        if self.ground.feels:
            self.covariance[SLOPE, SLOPE] = self.ground.slope_variance
        self.keep_before()
        self.keep_before()

    @property
    def least_variance(self) -> float:
        """Bound of the variance of a mean over a second or a block [Nm^2]."""
        return (LEAST_NOISE_SHARE * self.rolling) ** 2

    @property
    def slow_std(self) -> float:
        """Standard deviation of the slow disturbance [Nm]."""
        if math.isnan(self.past.slow):
            return WANDERING_SHARE * self.rolling
        return min(max(math.sqrt(self.past.slow), LEAST_WANDERING_SHARE * self.rolling), 0.5 * self.rolling)

    @property
    def hills_variance(self) -> float:
        """Variance of short disturbances beyond bumps of a road [Nm^2]."""
        if math.isnan(self.past.white):
            return 0.0
        return max(self.past.white - (BUMPS_SHARE * self.rolling) ** 2, 0.0)

    @property
    def second_variance(self) -> float:
        """Variance of a second's mean, scaled to the uncertainty of means over blocks [Nm^2]."""
        return self.noise if math.isnan(self.past.white) else max(BLOCK_S * self.past.white, self.least_variance)


def nothing_learned(prior: Prior) -> LearnerState:
    """The state before learning."""
    mean, covariance = np.zeros(STATES), prior.covariance
    found = LearnerState(
        *(mean, covariance.copy()),
        *(mean.copy(), covariance.copy()),
        *(mean.copy(), covariance.copy()),
        *(np.zeros(at.LEARNABLE), np.zeros(at.LEARNABLE)),
        rolling=prior.rolling_nm,
    )
    found.noise = (FIRST_NOISE_SHARE * prior.rolling_nm) ** 2
    return found
