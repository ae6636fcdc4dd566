# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Spells, a torque that comes and goes without a known cause; and a drifting torque.

Means of the residual over a few seconds follow two random levels (a hidden Markov chain) or a drifting level (Ornstein
and Uhlenbeck), with white noise. The likelihoods decide.

Source: Rabiner (1989) for the chain, by expectation-maximisation; Kalman for the drifting level.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from trackres_ros.diagnosis.prepare.session import Array, Mask
from trackres_ros.estimator.disturbance import BLOCK_S, predict_level, update_level
from trackres_ros.kernels.marks import entry

FEWEST_SAMPLES = 2  # of a block
INNER = (0.03, 0.97)  # quantiles: a mean is limited to once their distance beyond them
TURNS, ENOUGH = 60, 1e-3  # of expectation-maximisation, and a negligible gain
STARTS = (-2.5, -1.2, 1.2, 2.5)  # standard deviations: initial values of the second level
SHORTEST_S, LONGEST_S = 10.0, 1200.0  # of a spell, on average
LEAST_SHARE, MOST_SHARE = 0.03, 0.97  # of the time


@dataclass(frozen=True, eq=False)
class Blocks:
    """Means of a residual over blocks, all sessions concatenated; shape (n,)."""

    mean: Array
    count: Array  # of samples in each block
    first: Mask  # whether a block has no predecessor: a chain starts there
    session: NDArray[np.int64]  # index
    begin: NDArray[np.int64]  # index of its first sample
    end: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Chain:
    """Two levels: none and `level` [Nm], with transition probabilities per block, and the noise of one sample [Nm]."""

    level: float
    rest: float  # level without a spell: the fit's mean includes both
    come_rate: float
    go_rate: float
    noise: float

    def for_blocks(self, seconds: float) -> Chain:
        """The same for blocks of another length, shorter than its spells."""
        return replace(self, come_rate=self.come_rate * seconds / BLOCK_S, go_rate=self.go_rate * seconds / BLOCK_S)

    @property
    def mean_s(self) -> float:
        """Mean duration of a spell [s]."""
        return BLOCK_S / self.go_rate

    @property
    def share(self) -> float:
        """Share of time in a spell."""
        return self.come_rate / (self.come_rate + self.go_rate)


def blocks(residuals: Sequence[Array], masks: Sequence[Mask], step: float, seconds: float = BLOCK_S) -> Blocks:
    """Cut residuals into blocks of `seconds`; outliers among the means are limited."""
    length = max(1, round(seconds / step))
    least_count = min(FEWEST_SAMPLES, length)
    rows: list[tuple[float, float, bool, int, int, int]] = []
    for i, (residual, mask) in enumerate(zip(residuals, masks, strict=True)):
        is_first = True
        for begin in range(0, len(residual), length):
            end = min(begin + length, len(residual))
            used_steps = mask[begin:end] & np.isfinite(residual[begin:end])
            if used_steps.sum() < least_count:
                continue
            rows.append((float(residual[begin:end][used_steps].mean()), float(used_steps.sum()), is_first, i, begin, end))
            is_first = False
    mean, count, first_flags, session, begin_, end_ = (np.array(x) for x in zip(*rows, strict=True))
    low, high = (float(q) for q in np.quantile(mean, INNER))
    return Blocks(np.clip(mean, low - (high - low), high + (high - low)), count, first_flags, session, begin_, end_)


def find_chain(b: Blocks) -> tuple[Chain, Array, float]:
    """The most likely chain, its probability of a spell in each block, and the log-likelihood."""
    spread, scale = float(np.std(b.mean * np.sqrt(b.count))), float(np.std(b.mean))
    chains = (Chain(start * scale, 0.0, 0.05, 0.1, 0.7 * spread) for start in STARTS)
    return max((_expectation_maximisation(b, chain) for chain in chains), key=lambda result: result[2])


def _expectation_maximisation(b: Blocks, chain: Chain) -> tuple[Chain, Array, float]:
    """Estimate a chain by expectation-maximisation from an initial one; see `find_chain` for the result."""
    previous_likelihood = -math.inf
    for _ in range(TURNS):
        probability, pairs, likelihood = _forward_backward(b, chain)
        if likelihood - previous_likelihood < ENOUGH:
            break
        previous_likelihood = likelihood
        level, rest, noise = spell_levels(b, probability)
        come_rate, go_rate = ((pairs[i, 1 - i] + 0.5) / (pairs[i].sum() + 1.0) for i in (0, 1))
        chain = Chain(level, rest, float(come_rate), float(go_rate), noise)
    return chain, probability, likelihood


def is_spells(chain: Chain) -> bool:
    """Whether a chain has spells: neither moments nor hours, neither hardly ever nor nearly always."""
    return SHORTEST_S <= chain.mean_s <= LONGEST_S and LEAST_SHARE <= chain.share <= MOST_SHARE


def gain_over_drift(b: Blocks, chain: Chain, probability: Array) -> float:
    """Log-likelihood gain of spells plus drift over drift alone.

    Each transition costs its negative log-probability under the chain; the residual without the spells may drift too.
    """
    remainder = replace(b, mean=b.mean - np.where(probability > 0.5, chain.level, chain.rest))
    return find_drifting_level(remainder)[1] - find_drifting_level(b)[1] - path_cost(b, chain, probability)


def path_cost(b: Blocks, chain: Chain, probability: Array) -> float:
    """Cost of the spells' transitions: their negative log-probability under the Markov chain."""
    is_spell = probability > 0.5
    step = ((1.0 - chain.come_rate, chain.come_rate), (chain.go_rate, 1.0 - chain.go_rate))
    start = (1.0 - chain.share, chain.share)
    steps = [
        start[state] if is_first else step[state_before][state]
        for state_before, state, is_first in zip(
            [False, *is_spell[:-1].tolist()], is_spell.tolist(), b.first.tolist(), strict=True
        )
    ]
    return -float(np.log(steps).sum())


def spell_probability(b: Blocks, chain: Chain) -> Array:
    """Probability of a spell in each block for a given chain."""
    return _forward_backward(b, chain)[0]


def _forward_backward(b: Blocks, chain: Chain) -> tuple[Array, Array, float]:
    """Forward-backward pass: probability of a spell, expected transition counts, log-likelihood."""
    variance = chain.noise**2 / b.count
    logs = [-0.5 * ((b.mean - level) ** 2 / variance + np.log(2.0 * math.pi * variance)) for level in (chain.rest, chain.level)]
    top = np.maximum(*logs)
    likelihoods = [np.exp(x - top) for x in logs]
    n = len(b.mean)
    forward, backward, scales = np.empty((n, 2)), np.ones((n, 2)), np.empty(n)
    _pass(likelihoods[0], likelihoods[1], b.first, chain.come_rate, chain.go_rate, chain.share, forward, backward, scales)
    probability = forward * backward
    probability /= probability.sum(axis=1, keepdims=True)
    inner_blocks = np.flatnonzero(~b.first)
    step = np.array([[1.0 - chain.come_rate, chain.come_rate], [chain.go_rate, 1.0 - chain.go_rate]])
    next_weights = (
        np.stack([likelihoods[0][inner_blocks], likelihoods[1][inner_blocks]], axis=1)
        * backward[inner_blocks]
        / scales[inner_blocks, np.newaxis]
    )
    pairs = step * (forward[inner_blocks - 1].T @ next_weights)
    return probability[:, 1], pairs, float(np.log(scales).sum() + top.sum())


@entry
def _pass(
    absent_weights: Array,
    present_weights: Array,
    starts: Mask,
    come_rate: float,
    go_rate: float,
    share: float,
    forward: Annotated[Array, (None, 2)],
    backward: Annotated[Array, (None, 2)],
    scales: Array,
) -> None:
    """Forward pass, with the scale of each block, and backward pass, over the likelihoods without and with a spell."""
    stay0, stay1, n = 1.0 - come_rate, 1.0 - go_rate, len(absent_weights)
    f0 = f1 = 0.0
    for i in range(n):
        if starts[i]:
            p0, p1 = 1.0 - share, share
        else:
            p0, p1 = f0 * stay0 + f1 * go_rate, f0 * come_rate + f1 * stay1
        p0, p1 = p0 * absent_weights[i], p1 * present_weights[i]
        total = p0 + p1
        f0, f1 = p0 / total, p1 / total
        forward[i, 0], forward[i, 1], scales[i] = f0, f1, total
    b0 = b1 = 1.0
    for i in range(n - 2, -1, -1):
        if starts[i + 1]:
            b0 = b1 = 1.0
        else:
            a, p, scale = absent_weights[i + 1] * b0, present_weights[i + 1] * b1, scales[i + 1]
            b0, b1 = (stay0 * a + come_rate * p) / scale, (go_rate * a + stay1 * p) / scale
        backward[i, 0], backward[i, 1] = b0, b1


def spell_levels(b: Blocks, probability: Array) -> tuple[float, float, float]:
    """The spell's level, the other level and the noise of one sample [Nm], from the probability of a spell in each block."""
    level, rest = (float(np.average(b.mean, weights=b.count * w + 1e-12)) for w in (probability, 1.0 - probability))
    squares = probability * (b.mean - level) ** 2 + (1.0 - probability) * (b.mean - rest) ** 2
    return level, rest, float(np.sqrt(np.mean(b.count * squares)))


@dataclass(frozen=True, slots=True)
class DriftingLevel:
    """A drifting level: its standard deviation [Nm] and time constant [s], and the noise of one sample [Nm]."""

    size: float
    seconds: float
    noise: float


def find_drifting_level(b: Blocks) -> tuple[DriftingLevel, float]:
    """The most likely drifting level, and its log-likelihood."""
    scale = float(np.std(b.mean))
    typical_count = float(np.sqrt(np.median(b.count)))

    def drifting_level(logs: Array) -> DriftingLevel:
        size, seconds, noise = np.exp(np.clip(logs, -12.0, 15.0))
        return DriftingLevel(float(size), float(seconds), float(noise))

    def cost(logs: Array) -> float:
        level, spread = expected_level(b, drifting_level(logs))
        return 0.5 * float(np.sum((b.mean - level) ** 2 / spread + np.log(2.0 * math.pi * spread)))

    options = {"maxiter": 150, "xatol": 0.02, "fatol": 0.05}
    starts = [np.log([0.7 * scale, seconds, 0.7 * scale * typical_count]) for seconds in (10.0, 120.0)]
    results = [minimize(cost, start, method="Nelder-Mead", options=options) for start in starts]
    best_result = min(results, key=lambda result: float(result.fun))
    return drifting_level(best_result.x), -float(best_result.fun)


def expected_level(b: Blocks, w: DriftingLevel) -> tuple[Array, Array]:
    """Forecast of each block's mean from the blocks before it [Nm], and its variance."""
    level, spread = np.empty(len(b.mean)), np.empty(len(b.mean))
    _follow_level(b.mean, w.noise**2 / b.count, b.first, math.exp(-BLOCK_S / w.seconds), w.size, level, spread)
    return level, spread


@entry
def _follow_level(mean: Array, noise: Array, is_first: Mask, keep: float, size: float, levels: Array, spread: Array) -> None:
    level, variance = 0.0, size * size
    for i in range(len(mean)):
        if is_first[i]:
            level, variance = 0.0, size * size
        else:
            level, variance = predict_level(level, variance, keep, size)
        levels[i], spread[i] = level, variance + noise[i]
        level, variance = update_level(level, variance, mean[i], noise[i])
