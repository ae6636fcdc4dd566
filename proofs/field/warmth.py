# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Start temperatures of several drives: fitted to each alone, and jointly with one time constant of cooling at rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import spearmanr

from proofs.field.data import Array
from trackres_ros.diagnosis.base.base import Predicted
from trackres_ros.diagnosis.inference.fitting import Fit, fit, with_levels
from trackres_ros.effects.vehicle.warmup import WarmUp
from trackres_ros.units import MAD_TO_STD

SHORTEST_S, LONGEST_S, CONSTANTS = 60.0, 4e5, 40  # time constants of cooling at rest that are tried
SPREADS = np.concatenate(([0.0], np.geomspace(0.05, 2.0, 20)))  # standard deviations of start states about the model
DRAWS = 500
NEAR_BEST = 1.92  # in log-likelihood: 95 % of one parameter
WARM_AFTER_S = 600.0
EVERY_STEPS, FEWEST_APART = 60, 10  # between samples of warm driving
LEAST_KNOWN = 0.2  # of a shape's square
OUTLIER = 4.0  # standard deviations
SURE_STD = 1.0  # of a start state: a less certain one is of a drive whose beginning could hardly be compared


@dataclass(frozen=True, eq=False)
class Starts:
    """Start states of drives, 0 as warm as after a drive like it, 1 as cold as the ambient; arrays of shape (drives,)."""

    alone: Array  # fitted to each drive alone
    alone_std: Array
    stood_s: Array  # standing time before


@dataclass(frozen=True, eq=False)
class PooledStarts:
    """Joint start states of drives: A (1 - exp(-stood / tau)), with a scatter about it."""

    time_constant_s: float  # tau
    low_s: float  # its 95 % interval, which is open at an end of the search range
    high_s: float
    height: float  # A
    spread: float  # standard deviation of start states about the model
    state: Array  # joint estimate of each drive's start state
    std: Array
    rank_together: float  # rank correlation of the standing time with the start states, fitted together
    chance: float  # share of random permutations of the standing times that fit the start states as well
    reached: float  # probability that the rank correlation of states fitted alone reaches `WANTED_RANK` under this model

    @property
    def settled(self) -> bool:
        """Whether the time constant is inside the search range, not at an end."""
        return self.low_s > SHORTEST_S and self.high_s < LONGEST_S


WANTED_RANK = 0.6


def warming(refitted: Fit) -> Fit:
    """A re-fitted base with a warm-up, whatever was named, and values by levels."""
    base = refitted.problem.base
    effect = WarmUp().for_size(base.facts.weight * base.facts.radius, not base.has_belt)
    return with_levels(fit(refitted.problem, [effect], refitted.at))


def start_states(fitted: Fit, stood_s: Sequence[float]) -> Starts:
    """The start state of each drive by least squares: the share of a cold start's extra torque over a warm one.

    The fit has an effect that warms up, and values by levels; an unknown standing time is nan.

    Notes
    -----
    The residual of a vehicle model has correlations over minutes, with the street for one. So the uncertainty of a start state
    comes from the same sum over the residuals of all drives from ten minutes on, when they are warm.
    """
    sessions = fitted.problem.sessions

    def begun(gap: float, unseen: bool) -> list[Predicted]:
        changed = [replace(s, gap=gap, after_unseen=unseen) for s in sessions]
        return fitted.problem.base.predict(changed, fitted.base_values, fitted.acting)

    cold, warm = begun(np.inf, False), begun(0.0, True)
    every = np.concatenate([r[s.used] for r, s in zip(fitted.residuals, sessions, strict=True)])
    most = OUTLIER * MAD_TO_STD * float(np.median(np.abs(every - np.median(every))))
    later = [
        np.where(s.used & (s.time >= WARM_AFTER_S), np.clip(r, -most, most), np.nan)
        for r, s in zip(fitted.residuals, sessions, strict=True)
    ]
    states, stds = [], []
    for session, at_cold, at_warm in zip(sessions, cold, warm, strict=True):
        extra = at_cold.torque - at_warm.torque
        shape = np.where(session.time < WARM_AFTER_S, extra, 0.0)[: int(WARM_AFTER_S / session.step)]
        left = np.where(session.used, np.clip(session.torque - at_warm.torque, -most, most + np.abs(extra)), np.nan)
        states.append(_share(shape, left[: len(shape)]))
        apart = [_share(shape, row[i : i + len(shape)]) for row in later for i in range(0, len(row) - len(shape), EVERY_STEPS)]
        known = np.array(apart)[np.isfinite(apart)]
        stds.append(float(np.sqrt(np.mean(known**2))) if len(known) >= FEWEST_APART else np.inf)
    return Starts(np.array(states), np.array(stds), np.array(stood_s))


def _share(shape: Array, left: Array) -> float:
    """Amount of a shape in the residual, nan if less than half of the shape is known."""
    known = np.isfinite(left)
    size = float(shape[known] @ shape[known])
    return float(shape[known] @ left[known]) / size if size > LEAST_KNOWN * float(shape @ shape) else np.nan


def pool(starts: Starts, rng: np.random.Generator) -> PooledStarts:
    """All drives with a known standing time and an identifiable start, together."""
    sure = np.isfinite(starts.stood_s) & np.isfinite(starts.alone) & (starts.alone_std < SURE_STD)
    alone, std, stood = starts.alone[sure], starts.alone_std[sure], starts.stood_s[sure]
    constants = np.geomspace(SHORTEST_S, LONGEST_S, CONSTANTS)
    likelihood, heights = _likelihood(alone, std, stood, constants)
    best = np.unravel_index(int(np.argmax(likelihood)), likelihood.shape)
    height, spread = float(heights[best]), float(SPREADS[best[1]])
    near = constants[likelihood.max(axis=1) > likelihood[best] - NEAR_BEST]
    expected = height * -np.expm1(-starts.stood_s / constants[best[0]])
    trust = spread**2 / (spread**2 + starts.alone_std**2)
    state = expected + np.where(sure, trust * (starts.alone - expected), 0.0)
    as_good = [_likelihood(alone, std, rng.permutation(stood), constants)[0].max() >= likelihood[best] for _ in range(DRAWS)]
    drawn = expected[sure] + np.hypot(std, spread) * rng.normal(size=(DRAWS, len(alone)))
    rank_together = float(spearmanr(stood, state[sure]).statistic)
    reached = float(np.mean([spearmanr(stood, row).statistic >= WANTED_RANK for row in drawn]))
    return PooledStarts(
        float(constants[best[0]]), float(near[0]), float(near[-1]), height, spread, state, np.sqrt(trust) * starts.alone_std,
        rank_together, float(np.mean(as_good)), reached,
    )  # fmt: skip


def _likelihood(alone: Array, std: Array, stood: Array, constants: Array) -> tuple[Array, Array]:
    """Logarithm of the likelihood and most likely height, each of shape (time constants, spreads)."""
    shape = -np.expm1(-stood / constants[:, np.newaxis, np.newaxis])
    weight = 1.0 / (std**2 + SPREADS[:, np.newaxis] ** 2)
    height = np.maximum((weight * shape * alone).sum(axis=-1) / np.maximum((weight * shape**2).sum(axis=-1), 1e-12), 0.0)
    left = alone - height[..., np.newaxis] * shape
    return 0.5 * (np.log(weight) - weight * left**2).sum(axis=-1), height
