# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Watches the measurement for an unpredictable torque: the probability of a spell, or the size of a drift.

The diagnosis runs these filter steps over blocks of a residual, the live node runs them block by block.
Spells are a Markov chain of two levels (forward algorithm; Rabiner 1989, Proc. IEEE 77, 257). A drift is an
Ornstein-Uhlenbeck process (scalar Kalman filter). Nothing here enters the estimate or the feed-forward.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from trackres_ros.kernels.marks import kernel
from trackres_ros.units import NANOSECOND
from trackres_ros.vehicle import Disturbance, Drift, Spells

BLOCK_S = 5.0
STEADY_MPS, STEADY_MPS2 = 1.0, 0.3  # slower, or with a larger acceleration, measured and expected torque are not compared
LEAST_COMPARED_S = 1.0  # per block: less carries almost no information
LONGEST_STEP_S = 2.0  # between two residuals: over a longer pause it may not have rolled
BEGINS, ENDS = 0.9, 0.1  # probability from which a spell is reported as present or as over
LONGEST_MEANS = 7.0  # mean lengths: of spells that end by chance one in a thousand is longer
MOST_DRIFT = 2.0  # standard deviations of a drift: limit of its level
LARGEST_NM = 1e100  # larger numbers are ignored like those that are not finite: the square would overflow
OUTLIER = 5.0  # standard deviations: limit of a block's distance from a drift
BLOCK_NS = int(BLOCK_S / NANOSECOND)
MOST_LOG = 500.0  # of a ratio of likelihoods: its exponential is finite


def predict_presence(probability: float, onset_rate: float, end_rate: float, blocks: float = 1.0) -> float:
    """Predict the probability of a spell some blocks later, without a measurement.

    `onset_rate` and `end_rate` are the probabilities that it begins, or ends, from one block to the next. For fractional `blocks`
    their sum is at most 1.
    """
    share = onset_rate / (onset_rate + end_rate)
    return share + (probability - share) * math.pow(1.0 - onset_rate - end_rate, blocks)


def update_presence(probability: float, mean: float, levels: tuple[float, float], variance: float) -> float:
    """Update the probability of a spell by the mean of a block [Nm], given its noise variance [Nm^2].

    `levels` are the torques outside and inside a spell [Nm].
    """
    absent_level, present_level = levels
    log_ratio = 0.5 * ((mean - absent_level) ** 2 - (mean - present_level) ** 2) / variance
    times = math.exp(min(max(log_ratio, -MOST_LOG), MOST_LOG))
    return probability * times / (probability * times + 1.0 - probability)


@kernel
def predict_level(level: float, variance: float, share: float, size: float) -> tuple[float, float]:
    """Predict mean [Nm] and variance [Nm^2] of a drifting level.

    `share` is the share of the level that remains by then, `size` its stationary standard deviation [Nm].
    """
    return share * level, share**2 * variance + size**2 * (1.0 - share**2)


@kernel
def update_level(level: float, variance: float, mean: float, noise_variance: float) -> tuple[float, float]:
    """Update mean [Nm] and variance [Nm^2] of a level by the mean of a block, given its noise variance [Nm^2]."""
    gain = variance / (variance + noise_variance)
    return level + gain * (mean - level), variance * (1.0 - gain)


@dataclass(frozen=True, slots=True)
class Belief:
    """Belief about a disturbance at one time."""

    form: str  # `spells` or `drift`
    there: float  # probability of a spell; nan for a drift
    torque_nm: float  # expected torque against travel
    std_nm: float  # its standard deviation
    since_ns: int | None  # stamp at which the present spell began or the last one ended; None before either, and for a drift
    present: bool  # whether a spell is reported
    is_overdue: bool  # whether it lasts longer than spells do: then it is a different, lasting change

    @property
    def text(self) -> str:
        """The same in a sentence."""
        if self.form == Drift.form:
            return f"the drifting torque is estimated at {self.torque_nm:.0f} Nm against travel, +-{2.0 * self.std_nm:.0f} Nm"
        state = "present for longer than usual" if self.is_overdue else "present" if self.present else "absent"
        return f"the intermittent torque is {state} (probability {self.there:.2f}): {self.torque_nm:.0f} Nm against travel"


class _SpellsFilter:
    def __init__(self, spells: Spells) -> None:
        self._spells = spells
        self._comes, self._goes = BLOCK_S / spells.mean_away, BLOCK_S / spells.mean_there
        self.restart()

    def restart(self) -> None:
        self.probability = self._comes / (self._comes + self._goes)

    def predict(self, seconds: float) -> None:
        self.probability = predict_presence(self.probability, self._comes, self._goes, seconds / BLOCK_S)

    def update(self, mean: float, variance: float) -> None:
        self.probability = update_presence(self.probability, mean, (self._spells.rest, self._spells.level), variance)

    def belief_after(self, seconds: float) -> tuple[float, float, float]:
        probability = predict_presence(self.probability, self._comes, self._goes, seconds / BLOCK_S)
        jump = self._spells.level - self._spells.rest
        return probability, self._spells.rest + probability * jump, abs(jump) * math.sqrt(probability * (1.0 - probability))


class _DriftFilter:
    def __init__(self, drift: Drift) -> None:
        self._drift = drift
        self.restart()

    def restart(self) -> None:
        self.level, self.variance = 0.0, self._drift.size**2

    def predict(self, seconds: float) -> None:
        self.level, self.variance = self._later(seconds)

    def update(self, mean: float, variance: float) -> None:
        limit = OUTLIER * math.sqrt(self.variance + variance)
        bounded_mean = min(max(mean, self.level - limit), self.level + limit)
        self.level, self.variance = update_level(self.level, self.variance, bounded_mean, variance)

    def belief_after(self, seconds: float) -> tuple[float, float, float]:
        level, variance = self._later(seconds)
        limit = MOST_DRIFT * self._drift.size
        return math.nan, min(max(level, -limit), limit), math.sqrt(variance)

    def _later(self, seconds: float) -> tuple[float, float]:
        share = math.exp(-seconds / self._drift.time_constant)
        return predict_level(self.level, self.variance, share, self._drift.size)


class DisturbanceWatch:
    """Filters residuals one by one; `belief` is the result.

    Blocks last `BLOCK_S` of valid residuals. During standstills, pauses and dropouts of the torque, the belief decays
    towards its prior.
    """

    def __init__(self, disturbance: Disturbance) -> None:
        self.form = disturbance.form
        self._noise = disturbance.noise
        self._longest_s = LONGEST_MEANS * disturbance.mean_there if isinstance(disturbance, Spells) else math.inf
        self._filter = _SpellsFilter(disturbance) if isinstance(disturbance, Spells) else _DriftFilter(disturbance)
        self.restart()

    def restart(self) -> None:
        """Reset after a restart of the estimate."""
        self._filter.restart()
        self._block_ns: int | None = None
        self._known_ns = 0  # the filter is of this time
        self._last_ns: int | None = None
        self._sum, self._seconds = 0.0, 0.0
        self._present = False
        self._since_ns: int | None = None
        self._ahead_ns = 0

    def take(self, stamp_ns: int, residual_nm: float, speed_mps: float, ahead_ns: int = 0, clock_jump: bool = False) -> Belief:
        """Process measured less expected torque, nan where it is invalid; return the belief at that time.

        The sign of the speed is the direction of travel. The stamp is ahead of its arrival by some time [ns]. Where the clock of
        the stamps has jumped, all times move with it.
        """
        if clock_jump:
            by_ns, of_stamps = ahead_ns - self._ahead_ns, (self._block_ns, self._last_ns, self._since_ns)
            self._known_ns += by_ns
            self._block_ns, self._last_ns, self._since_ns = (None if stamp is None else stamp + by_ns for stamp in of_stamps)
        self._ahead_ns = ahead_ns
        began_ns = stamp_ns
        if self._block_ns is None:
            self._block_ns = self._known_ns = stamp_ns
        elif stamp_ns - self._block_ns >= BLOCK_NS:
            began_ns = self._block_ns
            self._close_block(began_ns + BLOCK_NS)
            self._block_ns = stamp_ns
        if not abs(residual_nm) < LARGEST_NM:
            self._last_ns = None
        elif self._last_ns is None or stamp_ns > self._last_ns:
            seconds = 0.0 if self._last_ns is None else (stamp_ns - self._last_ns) * NANOSECOND
            if seconds <= LONGEST_STEP_S:
                self._sum += residual_nm * math.copysign(1.0, speed_mps) * seconds
                self._seconds += seconds
            self._last_ns = stamp_ns
        self._turn(self.belief(stamp_ns).there, began_ns)
        return self.belief(stamp_ns)

    def belief(self, stamp_ns: int) -> Belief:
        """Belief at a time [ns], from the blocks before it."""
        seconds = 0.0 if self._block_ns is None else max(0, stamp_ns - self._known_ns) * NANOSECOND
        probability, torque, std = self._filter.belief_after(seconds)
        is_overdue = self._present and self._since_ns is not None and (stamp_ns - self._since_ns) * NANOSECOND > self._longest_s
        return Belief(self.form, probability, torque, std, self._since_ns, self._present, is_overdue)

    def _close_block(self, end_ns: int) -> None:
        self._filter.predict((end_ns - self._known_ns) * NANOSECOND)
        self._known_ns = end_ns
        if self._seconds >= LEAST_COMPARED_S:
            self._filter.update(self._sum / self._seconds, self._noise**2 * BLOCK_S / self._seconds)
        self._sum, self._seconds = 0.0, 0.0

    def _turn(self, probability: float, began_ns: int) -> None:
        """Report that a spell has begun or ended, once that is certain; never for a drift."""
        if probability > BEGINS and not self._present:
            self._present, self._since_ns = True, began_ns
        elif probability < ENDS and self._present:
            self._present, self._since_ns = False, began_ns
