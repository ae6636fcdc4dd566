# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Means over blocks of seconds: the residual's drift and steps, and whether the file or the learned parameters predict new
data better.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from trackres_ros.learning.parameters import STATES
from trackres_ros.units import MAD_TO_STD

Array = NDArray[np.float64]

BLOCK_S = 20  # seconds that count
MEMORY = 45.0  # blocks: a quarter of an hour
CONTEST_MEMORY, SURELY = 90.0, 2.0  # blocks; standard errors by which what was learned has to be better before it acts
LEAST_BLOCKS = 6
OUTLIER = 4.0  # typical differences of blocks
STEP_SHARE = 0.03  # of what rolling takes: less is no step
STEP_STDS = 5.0  # typical differences of blocks
PAST = 90  # blocks that are kept
LAGS = (2, 3)  # blocks
LEAST_PAIRS = 6
LATE = 3  # blocks: a minute
PAST_OUTLIER = 3.0  # typical levels: at first not much is known
CONFIRMED = 0.6  # of a step is still there a block later


@dataclass
class ResidualBlock:
    """Weighted means over a block."""

    seconds: int = 0
    weight: float = 0.0
    residual: float = 0.0  # measured less what the file expects [Nm]
    gain: float = 0.0  # by how much less of a second is left with what was learned by then than with the file [Nm]
    sign: float = 0.0
    looks: Array = field(default_factory=lambda: np.zeros(STATES))

    def add(self, residual: float, learned: float, sign: float, looks: Array, weight: float) -> None:
        """Take in a second with a weight; `learned` is what was learned by then explains of it [Nm]."""
        self.seconds += 1
        self.weight += weight
        share = weight / self.weight
        self.residual += share * (residual - self.residual)
        self.gain += share * (abs(residual) - abs(residual - learned) - self.gain)
        self.sign += share * (sign - self.sign)
        self.looks += share * (looks - self.looks)


@dataclass
class Wandering:
    """How much what is left differs from block to block: mean of the squares, outliers in part."""

    blocks: int = 0
    variance: float = 0.0  # of a difference [Nm^2]

    def see(self, difference: float, least: float) -> None:
        """Take in a difference of two blocks [Nm], which at first are thought to differ by so much as is assumed."""
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
    """What the blocks of half an hour have left, and how much of it goes on.

    What comes and goes within a block, as bumps of the road do, is no more two blocks later; what wanders slowly is. So the
    products of levels that far apart tell the one from the other.

    Attributes
    ----------
    numbers
        Of each block; those that follow each other are neighbours. Negative: none yet.
    levels
        Measured less what was known when the block was full, but for disturbances, against travel [Nm].
    """

    last: int = 0  # number of the last block
    slow: float = math.nan  # variance of what wanders [Nm^2]
    white: float = math.nan  # of what comes and goes, over a block [Nm^2]
    numbers: Array = field(default_factory=lambda: np.full(PAST, -1.0))
    levels: Array = field(default_factory=lambda: np.zeros(PAST))

    def pause(self) -> None:
        """The next block does not follow the last."""
        self.last += 1 + LAGS[-1]

    def see(self, level: float, keep: float) -> None:
        """Take in a block; tell what wanders, of which a share is kept from a block to the next."""
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
        """Mean of the last blocks [Nm] and its standard deviation by what comes and goes; nan where they are too few."""
        if math.isnan(self.white):
            return math.nan, math.nan
        late = [(self.last - 1 - back) % PAST for back in range(LATE)]
        if any(self.numbers[place] != self.last - 1 - back for back, place in enumerate(late)):
            return math.nan, math.nan
        return float(self.levels[late].mean()), math.sqrt(self.white / LATE)


@dataclass
class Contest:
    """By how much less is left with what was learned than with the file, over blocks that neither has seen: running mean [Nm]."""

    blocks: int = 0
    gain: float = 0.0
    variance: float = 0.0
    better: bool = False

    def see(self, gain: float) -> None:
        """Take in a block: what the file leaves less what is left with what was learned, in size [Nm]."""
        self.blocks += 1
        share = max(1.0 / self.blocks, 1.0 / CONTEST_MEMORY)
        departure = gain - self.gain
        self.gain += share * departure
        self.variance += share * (departure * departure - self.variance)
        error = math.sqrt(self.variance / min(float(self.blocks), CONTEST_MEMORY))
        if self.blocks < LEAST_BLOCKS:
            return
        self.better = self.gain > (-error if self.better else SURELY * error)
