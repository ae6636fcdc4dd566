# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Means over blocks of seconds: the residual's drift and steps, and whether the file or the learned parameters predict new
data better.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from trackres_ros.arrays import Array
from trackres_ros.learning.parameters import STATES
from trackres_ros.units import MAD_TO_STD

BLOCK_S = 20  # valid seconds
MEMORY = 45.0  # blocks: a quarter of an hour
CONTEST_MEMORY, SURELY = 90.0, 2.0  # blocks; standard errors by which learned values must be better before they act
LEAST_BLOCKS = 6
LEAST_SINCE_PAUSE = 2
OUTLIER = 4.0  # typical differences of blocks
STEP_SHARE = 0.03  # of the rolling resistance: less is no step
STEP_STDS = 5.0  # typical differences of blocks
PAST = 90  # blocks that are kept
LAGS = (2, 3)  # blocks
LEAST_PAIRS = 6
LATE = 3  # blocks: a minute
PAST_OUTLIER = 3.0  # typical levels: larger ones are clipped
CONFIRMED = 0.6  # of a step is still there a block later


@dataclass
class ResidualBlock:
    """Weighted means over a block."""

    seconds: int = 0
    weight: float = 0.0
    residual: float = 0.0  # measured less the file's expectation and the slope that an altitude or an IMU shows [Nm]
    gain: float = 0.0  # how much smaller a second's residual is with values learned by then than with the file [Nm]
    sign: float = 0.0
    looks: Array = field(default_factory=lambda: np.zeros(STATES))

    def add(self, residual: float, learned: float, sign: float, looks: Array, weight: float) -> None:
        """Add a second with a weight; `learned` is its residual explained by learned values [Nm]."""
        self.seconds += 1
        self.weight += weight
        share = weight / self.weight
        self.residual += share * (residual - self.residual)
        self.gain += share * (abs(residual) - abs(residual - learned) - self.gain)
        self.sign += share * (sign - self.sign)
        self.looks += share * (looks - self.looks)


@dataclass
class Wandering:
    """Scatter of residuals from block to block: mean of the squares, outliers with reduced weight."""

    blocks: int = 0
    variance: float = 0.0  # of a difference [Nm^2]

    def see(self, difference: float, least: float) -> None:
        """Add a difference of two blocks [Nm]; the assumed scatter is its prior."""
        if not self.blocks:
            self.variance = least
        bound = OUTLIER * OUTLIER * max(self.variance, least)
        self.blocks += 1
        share = max(1.0 / (self.blocks + 3.0), 1.0 / MEMORY)
        self.variance += share * (min(difference * difference, bound) - self.variance)

    def std(self, least: float) -> float:
        """Standard deviation of a difference [Nm]."""
        return math.sqrt(max(self.variance, least))


@dataclass
class Past:
    """Residuals of the blocks of half an hour, and the lasting part.

    Short disturbances within a block, such as bumps of the road, are over two blocks later; slow ones are not. So the
    products of levels that far apart separate the two.
    """

    last: int = 0  # number of the last block
    slow: float = math.nan  # variance of the slow disturbance [Nm^2]
    white: float = math.nan  # variance of the short disturbances, over a block [Nm^2]
    # Number of each block: neighbours have consecutive ones; negative for none yet.
    numbers: Array = field(default_factory=lambda: np.full(PAST, -1.0))
    # Measured less the estimate when the block was full, without disturbances, against travel [Nm].
    levels: Array = field(default_factory=lambda: np.zeros(PAST))

    def pause(self) -> None:
        """The next block does not follow the last."""
        self.last += 1 + LAGS[-1]

    def see(self, level: float, keep: float) -> None:
        """Add a block; estimate the slow disturbance, of which a share is kept from block to block."""
        self.numbers[self.last % PAST], self.levels[self.last % PAST] = self.last, level
        self.last += 1
        order = np.argsort(self.numbers, kind="stable")
        order = order[self.numbers[order] >= 0.0]
        numbers, left = self.numbers[order], self.levels[order]
        size = MAD_TO_STD * float(np.median(np.abs(left)))
        left = np.clip(left, -PAST_OUTLIER * size, PAST_OUTLIER * size)
        follow = numbers[1:] - numbers[:-1] == 1.0
        if follow.sum() < LEAST_PAIRS:
            return
        differs = 0.5 * float(((left[1:] - left[:-1])[follow] ** 2).mean())
        tied, count = 0.0, 0
        for lag in LAGS:
            pairs = numbers[lag:] - numbers[:-lag] == lag
            tied += float((left[lag:] * left[:-lag])[pairs].sum()) / keep**lag
            count += int(pairs.sum())
        if count < LEAST_PAIRS:
            return
        surely = tied / count - differs / math.sqrt(count)  # of levels that are not tied a sixth is beyond
        self.slow = min(max(surely, 0.0), differs / (1.0 - keep))
        self.white = max(differs - self.slow * (1.0 - keep), 0.0)

    def of_late(self) -> tuple[float, float]:
        """Mean of the last blocks [Nm] and its standard deviation due to short disturbances; nan with too few blocks."""
        if math.isnan(self.white):
            return math.nan, math.nan
        late = [(self.last - 1 - back) % PAST for back in range(LATE)]
        if any(self.numbers[place] != self.last - 1 - back for back, place in enumerate(late)):
            return math.nan, math.nan
        return float(self.levels[late].mean()), math.sqrt(self.white / LATE)


@dataclass
class Contest:
    """How much smaller the residual is with learned values than with the file, over blocks unused by both: running mean [Nm]."""

    blocks: int = 0
    gain: float = 0.0
    variance: float = 0.0
    better: bool = False

    def see(self, gain: float) -> None:
        """Add a block: size of the file's residual less that of the learned one [Nm]."""
        self.blocks += 1
        share = max(1.0 / self.blocks, 1.0 / CONTEST_MEMORY)
        departure = gain - self.gain
        self.gain += share * departure
        self.variance += share * (departure * departure - self.variance)
        error = math.sqrt(self.variance / min(float(self.blocks), CONTEST_MEMORY))
        if self.blocks < LEAST_BLOCKS:  # too few for a standard error
            self.better &= self.blocks < LEAST_SINCE_PAUSE or self.gain > 0.0
            return
        self.better = self.gain > (-error if self.better else SURELY * error)

    def since_pause(self, last: Contest) -> Contest:
        """The contest after a pause, as the vehicle may have changed: values that are better over all drives need fresh evidence.
        The others go on with all that there is. `last` is that since the pause before.
        """
        if last.blocks < LEAST_SINCE_PAUSE:
            return last
        return Contest(gain=self.gain, better=True) if self.better else replace(self)
