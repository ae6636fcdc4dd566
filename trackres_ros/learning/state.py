# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Holds the state of learning as plain values, all saved across a restart, and means over blocks of seconds.

Blocks show drift and steps of the residual, and whether the file or the learned parameters predict new data better. They separate
a torque step or drift from the vehicle's parameters: while one lasts, learning pauses.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from trackres_ros.arrays import Array
from trackres_ros.estimator import columns as layout
from trackres_ros.learning.ground import Ground
from trackres_ros.learning.parameters import GAIN, HEIGHT, SLOPE, SLOW, STATES, STEP, WANDERING_SHARE, Prior, expected_residual
from trackres_ros.units import MAD_TO_STD
from trackres_ros.vehicle import Disturbance, Spells

# Blocks

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

    def add(self, residual: float, learned: float, sign: float, sensitivities: Array, weight: float) -> None:
        """Add a second with a weight; `learned` is its residual explained by learned values [Nm]."""
        self.seconds += 1
        self.weight += weight
        share = weight / self.weight
        self.residual += share * (residual - self.residual)
        self.gain += share * (abs(residual) - abs(residual - learned) - self.gain)
        self.sign += share * (sign - self.sign)
        self.looks += share * (sensitivities - self.looks)


@dataclass
class Wandering:
    """Scatter of residuals from block to block: mean of the squares, outliers with reduced weight."""

    blocks: int = 0
    variance: float = 0.0  # of a difference [Nm^2]

    def add(self, difference: float, least_variance: float) -> None:
        """Add a difference of two blocks [Nm]; the assumed scatter is its prior."""
        if not self.blocks:
            self.variance = least_variance
        bound = OUTLIER * OUTLIER * max(self.variance, least_variance)
        self.blocks += 1
        share = max(1.0 / (self.blocks + 3.0), 1.0 / MEMORY)
        self.variance += share * (min(difference * difference, bound) - self.variance)

    def std(self, least_variance: float) -> float:
        """Standard deviation of a difference [Nm]."""
        return math.sqrt(max(self.variance, least_variance))


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

    def add(self, level: float, share: float) -> None:
        """Add a block and estimate the slow disturbance. `share` of it remains from block to block."""
        self.numbers[self.last % PAST], self.levels[self.last % PAST] = self.last, level
        self.last += 1
        order = np.argsort(self.numbers, kind="stable")
        order = order[self.numbers[order] >= 0.0]
        numbers, departures = self.numbers[order], self.levels[order]
        size = MAD_TO_STD * float(np.median(np.abs(departures)))
        departures = np.clip(departures, -PAST_OUTLIER * size, PAST_OUTLIER * size)
        is_next = numbers[1:] - numbers[:-1] == 1.0
        if is_next.sum() < LEAST_PAIRS:
            return
        half_step_variance = 0.5 * float(((departures[1:] - departures[:-1])[is_next] ** 2).mean())
        product_sum, count = 0.0, 0
        for lag in LAGS:
            pairs = numbers[lag:] - numbers[:-lag] == lag
            product_sum += float((departures[lag:] * departures[:-lag])[pairs].sum()) / share**lag
            count += int(pairs.sum())
        if count < LEAST_PAIRS:
            return
        lower_bound = product_sum / count - half_step_variance / math.sqrt(count)  # of levels that are not tied a sixth is beyond
        self.slow = min(max(lower_bound, 0.0), half_step_variance / (1.0 - share))
        self.white = max(half_step_variance - self.slow * (1.0 - share), 0.0)

    def recent_level(self) -> tuple[float, float]:
        """Mean of the last blocks [Nm] and its standard deviation due to short disturbances; nan with too few blocks."""
        if math.isnan(self.white):
            return math.nan, math.nan
        recent_places = [(self.last - 1 - lag) % PAST for lag in range(LATE)]
        if any(self.numbers[place] != self.last - 1 - lag for lag, place in enumerate(recent_places)):
            return math.nan, math.nan
        return float(self.levels[recent_places].mean()), math.sqrt(self.white / LATE)


@dataclass
class Contest:
    """How much smaller the residual is with learned values than with the file, over blocks unused by both: running mean [Nm]."""

    blocks: int = 0
    gain: float = 0.0
    variance: float = 0.0
    better: bool = False

    def add(self, gain: float) -> None:
        """Add a block: size of the residual by the file minus size of the residual by the learned values [Nm]."""
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

    def since_pause(self, previous: Contest) -> Contest:
        """The contest after a pause, as the vehicle may have changed: values that are better over all drives need fresh evidence.
        The others go on with all that there is. `previous` is that since the pause before.
        """
        if previous.blocks < LEAST_SINCE_PAUSE:
            return previous
        return Contest(gain=self.gain, better=True) if self.better else replace(self)


# State

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

    def store_recent(self) -> None:
        """Store the present estimate, to which a later step detection returns."""
        if self.suspect:
            return
        self.before_mean[:], self.before_covariance[:] = self.recent_mean, self.recent_covariance
        self.recent_mean[:], self.recent_covariance[:] = self.mean, self.covariance

    def require_evidence(self) -> None:
        """After a pause, in which the vehicle may have changed: learned values need fresh evidence."""
        self.fresh = self.contest.since_pause(self.fresh)

    def begin_anew(self, prior: Prior) -> None:
        """Reset belts and slow disturbance to their priors; keep the vehicle's parameters."""
        self.second, self.last_left, self.suspect, self.disagrees, self.blocks = -1, math.nan, 0.0, 0.0, 0
        self.lasting_s = self.lasting_nm = 0.0
        self.disturbance_nm = 0.0
        self.block, self.last_block = ResidualBlock(), ResidualBlock()
        self.past.pause()
        self.require_evidence()
        self.ground.restart()
        for state in (layout.OF_BELT, SLOW, SLOPE, HEIGHT):
            self.mean[state] = 0.0
            self.covariance[state, :] = self.covariance[:, state] = 0.0
            self.covariance[state, state] = prior.covariance[state, state]
        self.aim[layout.OF_BELT] = self.applied[layout.OF_BELT] = 0.0
        if self.ground.has_force:
            self.covariance[SLOPE, SLOPE] = self.ground.slope_variance
        self.store_recent()
        self.store_recent()

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
    state = LearnerState(
        *(mean, covariance.copy()),
        *(mean.copy(), covariance.copy()),
        *(mean.copy(), covariance.copy()),
        *(np.zeros(layout.LEARNABLE), np.zeros(layout.LEARNABLE)),
        rolling=prior.rolling_nm,
    )
    state.noise = (FIRST_NOISE_SHARE * prior.rolling_nm) ** 2
    return state


# Disturbances

FIRST_SHARE = 0.015  # of the rolling resistance: prior difference of blocks
STEP_HOLDS_S = 600.0  # driving after a step during which no vehicle parameter is learned
GAIN_STEP_STD = 0.05  # of a sensor that was replaced
DISAGREES_SHARE, DISAGREES_S = 0.08, 60.0  # of the samples of a minute that disagree with the others
ALIKE_SHARE = 0.3  # allowed difference of a step from a spell in the vehicle file
LASTS_S = 60.0  # before a disturbance is fed forward
LASTING_SHARE = 0.02  # of the rolling resistance: limit on the feed-forward of a disturbance
SAID_SHARE, SAID_STDS = 0.02, 3.0  # of the rolling resistance, and of a minute's mean: a larger unmodelled torque is reported
FADES = 0.5  # remaining share a second later without a torque


def close_block(s: LearnerState) -> None:
    """Finish a block: check for a step, and whether learned values explain more than the file."""
    s.blocks += 1
    block, last_block = s.block, s.last_block
    s.last_block, s.block = block, ResidualBlock()
    if last_block.seconds:
        _judge_level(s, _level(s, block), _level(s, last_block))
    s.past.add(_level(s, block) - float(s.mean[STEP]), SLOW_KEEPS)
    _publish_disturbance(s)
    s.contest.add(block.gain)
    s.fresh.add(block.gain)
    s.store_recent()


def _level(s: LearnerState, block: ResidualBlock) -> float:
    """Residual of a block by present knowledge, without disturbances; against travel [Nm]."""
    return (block.residual - expected_residual(s.mean[:SLOW], block.looks[:SLOW])) * block.sign


def _judge_level(s: LearnerState, level: float, last_level: float) -> None:
    """Follow the levels of the present block and of the last."""
    least_variance = s.least_variance if s.wandering.blocks else (FIRST_SHARE * s.rolling) ** 2
    threshold = max(STEP_SHARE * s.rolling, STEP_STDS * s.wandering.std(least_variance))
    if s.suspect:
        size, s.suspect = s.suspect, 0.0
        if (level - s.suspect_level) / size > CONFIRMED:
            _step_found(s, level - s.suspect_level)
        else:
            s.wandering.add(size, least_variance)
        return
    difference = level - last_level
    if min(s.wandering.blocks, s.blocks) >= LEAST_BLOCKS and abs(difference) > threshold:
        s.suspect, s.suspect_level = difference, last_level
    else:
        s.wandering.add(difference, least_variance)


def _step_found(s: LearnerState, size: float) -> None:
    """Take it for a disturbance, or for another sensor: go back to before it, and let those two take it up."""
    s.mean[:], s.covariance[:] = s.before_mean, s.before_covariance
    s.covariance[STEP, STEP] += max(size * size, (LASTING_SHARE * s.rolling) ** 2)
    s.covariance[GAIN, GAIN] += GAIN_STEP_STD**2
    s.mean[STEP] += size
    s.past.pause()
    s.ground.forget_height()
    s.step_s, s.step_nm = 0.0, size
    s.recent_mean[:], s.recent_covariance[:] = s.mean, s.covariance


def _publish_disturbance(s: LearnerState) -> None:
    """Whether the mean residual of a minute exceeds the short disturbances and the error of the slope."""
    mean, std = s.past.recent_level()
    std = math.hypot(std, math.sqrt(s.covariance[SLOPE, SLOPE]) * s.last_block.looks[SLOPE])  # a slope that is followed
    least_size = SAID_SHARE * s.rolling
    if not (abs(mean) > max(0.5 * least_size, std) and mean * s.disturbance_nm > 0.0):  # gone, or another
        s.disturbed_s = 0.0
    if s.disturbed_s or abs(mean) > max(least_size, SAID_STDS * std):
        s.disturbance_nm, s.disturbed_s = mean, s.disturbed_s + BLOCK_S
    else:
        s.disturbance_nm = 0.0


def update_lasting(s: LearnerState, has_torque: bool) -> None:
    """Feed a lasting disturbance forward, within a bound; it fades without a compared torque."""
    if not has_torque:
        s.lasting_nm *= FADES
        s.lasting_s = 0.0
        return
    disturbance = float(s.mean[SLOW] + s.mean[STEP])
    std = math.sqrt(max(float(s.covariance[SLOW, SLOW] + s.covariance[STEP, STEP]), 0.0))
    is_sure = abs(disturbance) > 2.0 * std
    s.lasting_s = s.lasting_s + 1.0 if is_sure and disturbance * s.lasting_nm >= 0.0 else 0.0
    limit = LASTING_SHARE * s.rolling
    aim = min(max(disturbance, -limit), limit) if s.lasting_s > LASTS_S else 0.0
    s.lasting_nm += 0.1 * (aim - s.lasting_nm)


def why_frozen(s: LearnerState, file_disturbance: Disturbance | None) -> str:
    """Reason why learning is paused; empty if it is not. `file_disturbance` is the disturbance of the vehicle file."""
    if s.disagrees > DISAGREES_SHARE:
        return f"{100.0 * s.disagrees:.0f} % of the measured torques disagree with the others"
    if s.suspect:
        return f"a step of {s.suspect:+.0f} Nm is being checked"
    if s.step_s < STEP_HOLDS_S:
        return f"{disturbance_sentence(s.step_nm, s.step_s, file_disturbance)}: caused by a sensor, brake, load or the ground"
    return ""


def disturbance_text(s: LearnerState, file_disturbance: Disturbance | None) -> str:
    """Text on an unmodelled torque outside the vehicle's parameters; empty without one. See `why_frozen`."""
    return disturbance_sentence(s.disturbance_nm, s.disturbed_s, file_disturbance) if s.disturbance_nm else ""


def disturbance_sentence(torque_nm: float, driven_s: float, file_disturbance: Disturbance | None) -> str:
    """A disturbance in words, with a remark if it is as large as the vehicle file's; `driven_s` is the driving with it."""
    kind = ""
    if isinstance(file_disturbance, Spells):
        size = abs(file_disturbance.level - file_disturbance.rest)
        kind = f", of the kind seen before ({file_disturbance.form})" if abs(abs(torque_nm) - size) < ALIKE_SHARE * size else ""
    return f"a disturbance of {torque_nm:+.0f} Nm for {driven_s:.0f} s{kind}"
