# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Step 8: the error of the improved model on the hold-out laps, and its grade."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.prepare.session import Array, DriveSession, Mask, lap_name
from trackres_ros.diagnosis.prepare.torque_checks import SMALL_ERROR
from trackres_ros.errors import InputError

STAGES = ("nominal", "refitted", "with_effects")
RESAMPLES = 10_000
FEWEST_LAPS, PIECE_S = 8, 60.0  # with fewer laps pieces are resampled: a handful of laps does not show their variation
NO_WORSE = 1.01  # times the error before: an increase of over 1 % refutes
MUCH_LARGER = 1.05  # times the error with the assumed errors of the torque sensor
SMALL_SHARE = 0.02  # of the mean error: a smaller improvement is small
CONFIRMED, SUSPECTED, REFUTED = "confirmed", "suspected", "refuted"


@dataclass(frozen=True, slots=True)
class Improvement:
    """Reduction of the mean error on hold-out laps [Nm] by one model over another.

    The level score, see `search.cross_validation`, separates an effect from noise earlier than the mean error, which is mostly
    noise.
    """

    before: float  # mean absolute error of the other model
    after: float  # and of this one
    low: float  # 95 % interval of the difference, over laps
    high: float
    likelihood_bound: float = -np.inf  # lower bound of the level score; negative infinity where not requested
    level_gain: float = np.nan  # the level score; nan where not requested

    @property
    def grade(self) -> str:
        """Grade by the hold-out laps.

        `refuted` if the error grows, significantly or by over 1 %. `confirmed` if it does not grow and the level score is
        significantly above zero, or if it falls significantly: with level scores by at least `SMALL_SHARE`, and with a score
        above zero. Else `suspected`.
        """
        if self.after > NO_WORSE * self.before or self.high < 0.0:
            return REFUTED
        is_sure = self.likelihood_bound > 0.0 or (self._is_smaller and not self.level_gain <= 0.0)
        return CONFIRMED if self.after <= self.before and is_sure else SUSPECTED

    @property
    def less_likely(self) -> bool:
        """Whether only the level score prevents a confirmation: it falls although the mean error significantly falls too."""
        return self._is_smaller and self.level_gain <= 0.0

    @property
    def _is_smaller(self) -> bool:
        """Whether the mean error falls significantly, with level scores by at least `SMALL_SHARE`."""
        least_gain = 0.0 if np.isinf(self.likelihood_bound) else SMALL_SHARE * self.before
        return self.low > 0.0 and self.before - self.after >= least_gain

    @property
    def confirmed(self) -> bool:
        """Whether the laps confirm it."""
        return self.grade == CONFIRMED


class HeldOutLaps:
    """Comparison of models on the hold-out samples of each session; an `InputError` if there are none."""

    def __init__(self, sessions: Sequence[DriveSession], masks: Sequence[Mask], rng: np.random.Generator) -> None:
        if not any(m.any() for m in masks):
            reason = "hold-out laps without a comparable sample"
            allowed = "laps of driving with a measured torque"
            raise InputError(", ".join(s.name for s in sessions), reason, allowed, "choose them with --holdout")
        self._masks = masks
        self.measured = self.samples([s.torque for s in sessions])
        self.blocks = np.concatenate([s.block[m] for s, m in zip(sessions, masks, strict=True)])
        self.names = {int(b): lap_name(s, int(b)) for s in sessions for b in np.unique(s.block)}
        _, self._piece = np.unique(self.samples(number_pieces(sessions, masks, FEWEST_LAPS)), return_inverse=True)
        self._count = np.bincount(self._piece)
        n = len(self._count)
        self._draws = rng.multinomial(n, np.full(n, 1.0 / n), size=RESAMPLES)

    def samples(self, series: Sequence[NDArray[Any]]) -> NDArray[Any]:
        """The hold-out samples of a series of each session."""
        return np.concatenate([x[m] for x, m in zip(series, self._masks, strict=True)])

    def improvement(self, torques_before: Sequence[Array], torques_after: Sequence[Array]) -> Improvement:
        """Improvement by one predicted torque of each session over another [Nm]."""
        errors = [np.abs(self.measured - self.samples(x)) for x in (torques_before, torques_after)]
        decrease = np.bincount(self._piece, weights=errors[0] - errors[1])
        means = (self._draws @ decrease) / (self._draws @ self._count)  # over resampled laps
        low, high = np.quantile(means, (0.025, 0.975))
        return Improvement(float(errors[0].mean()), float(errors[1].mean()), float(low), float(high))

    def predicts(self, fit: Fit) -> bool:
        """Whether a fit predicts better than the mean torque, or with a small error: in a steady drive it hardly varies."""
        error = self.measured - self.samples([p.torque for p in fit.predicted])
        is_small = float(np.abs(error).mean()) < SMALL_ERROR * float(np.abs(self.measured).mean())
        return is_small or _r2(self.measured, error) >= 0.0

    def improvement_of(self, fit_before: Fit, fit_after: Fit) -> Improvement:
        """Improvement by one fit over another."""
        return self.improvement(*([p.torque for p in fit.predicted] for fit in (fit_before, fit_after)))


def number_pieces(sessions: Sequence[DriveSession], masks: Sequence[Mask], least_count: int) -> list[NDArray[np.int64]]:
    """Number of the lap of each sample of sessions; of its piece, by lap and time, where masks have fewer than `least_count`."""
    laps = np.unique(np.concatenate([s.block[m] for s, m in zip(sessions, masks, strict=True)]))
    if len(laps) >= least_count:
        return [s.block for s in sessions]
    return [np.asarray(s.block * 10_000 + (s.time // (PIECE_S * s.pace)).astype(np.int64)) for s in sessions]


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Errors on hold-out laps by stage: mean absolute error [Nm], R2, mean error [Nm]."""

    laps: tuple[str, ...]
    mae: dict[str, float]
    r2: dict[str, float]
    bias: dict[str, float]
    by_lap: dict[str, dict[str, Array]]  # each of them by stage and lap, shape (laps,)
    of_refit: Improvement  # of the re-fitted base over the vehicle file; without assumed sensor errors, as a file is used
    of_effects: Improvement  # and of the effects over the re-fitted base
    without_sensor: float | None = None  # mean error of the last fit without its assumed sensor errors [Nm], if much larger


def held_out(laps: HeldOutLaps, torques_by_stage: Mapping[str, Sequence[Array]], as_file: Sequence[Array]) -> HeldOut:
    """Compare the three `STAGES`, by their predicted torques of each session [Nm]; `as_file` is that of the re-fitted base
    without assumed sensor errors.
    """
    numbers = np.unique(laps.blocks)
    error = {stage: laps.measured - laps.samples(torques_by_stage[stage]) for stage in STAGES}
    lap_masks = [laps.blocks == b for b in numbers]
    by_lap = {
        "mae": {stage: np.array([np.abs(e[lap]).mean() for lap in lap_masks]) for stage, e in error.items()},
        "r2": {stage: np.array([_r2(laps.measured[lap], e[lap]) for lap in lap_masks]) for stage, e in error.items()},
        "bias": {stage: np.array([e[lap].mean() for lap in lap_masks]) for stage, e in error.items()},
    }
    return HeldOut(
        tuple(laps.names[int(b)] for b in numbers),
        {stage: float(np.abs(e).mean()) for stage, e in error.items()},
        {stage: _r2(laps.measured, e) for stage, e in error.items()},
        {stage: float(e.mean()) for stage, e in error.items()},
        by_lap,
        laps.improvement(torques_by_stage["nominal"], as_file),
        laps.improvement(torques_by_stage["refitted"], torques_by_stage["with_effects"]),
    )


def _r2(measured: Array, error: Array) -> float:
    return float(1.0 - (error**2).sum() / max(((measured - measured.mean()) ** 2).sum(), 1e-12))
