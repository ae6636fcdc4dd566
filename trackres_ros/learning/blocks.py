# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Means over blocks of seconds: how fast what is left wanders, whether it came at once, and whether the file or what was learned
fits better what neither has seen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from trackres_ros.learning.parameters import STATES

Array = NDArray[np.float64]

BLOCK_S = 20  # seconds that count
MEMORY = 45.0  # blocks: a quarter of an hour
LEAST_BLOCKS = 6
OUTLIER = 4.0  # typical differences of blocks
STEP_SHARE = 0.03  # of what rolling takes: less is no step
STEP_STDS = 5.0  # typical differences of blocks
CONFIRMED = 0.6  # of a step is still there a block later


@dataclass
class Block:
    """Weighted means over a block."""

    seconds: int = 0
    weight: float = 0.0
    residual: float = 0.0  # measured less what the file expects [Nm]
    learned: float = 0.0  # of it what was learned by then explains [Nm]
    sign: float = 0.0
    looks: Array = field(default_factory=lambda: np.zeros(STATES))

    def begin(self) -> None:
        """Begin anew."""
        self.seconds, self.weight, self.residual, self.learned, self.sign = 0, 0.0, 0.0, 0.0, 0.0
        self.looks[:] = 0.0

    def add(self, residual: float, learned: float, sign: float, looks: Array, weight: float) -> None:
        """Take in a second with a weight."""
        self.seconds += 1
        self.weight += weight
        share = weight / self.weight
        self.residual += share * (residual - self.residual)
        self.learned += share * (learned - self.learned)
        self.sign += share * (sign - self.sign)
        self.looks += share * (looks - self.looks)

    def take(self, other: Block) -> None:
        """Be as another is."""
        self.seconds, self.weight, self.residual = other.seconds, other.weight, other.residual
        self.learned, self.sign = other.learned, other.sign
        self.looks[:] = other.looks


@dataclass
class Wandering:
    """How much what is left differs from block to block: mean of the squares, outliers in part."""

    blocks: int = 0
    variance: float = 0.0  # of a difference [Nm^2]

    def see(self, difference: float, least: float) -> None:
        """Take in a difference of two blocks [Nm]."""
        bound = OUTLIER * OUTLIER * max(self.variance, least)
        self.blocks += 1
        share = max(1.0 / (self.blocks + 3.0), 1.0 / MEMORY)
        self.variance += share * (min(difference * difference, bound) - self.variance)

    def std(self, least: float) -> float:
        """Standard deviation of a difference [Nm]."""
        return math.sqrt(max(self.variance, least))


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
        share = max(1.0 / self.blocks, 1.0 / MEMORY)
        departure = gain - self.gain
        self.gain += share * departure
        self.variance += share * (departure * departure - self.variance)
        error = math.sqrt(self.variance / min(float(self.blocks), MEMORY))
        if self.blocks < LEAST_BLOCKS:
            return
        self.better = self.gain > (-error if self.better else error)
