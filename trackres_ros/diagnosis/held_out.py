"""Step 8: what the better model is worth on laps that were never used."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.fitting import Fit
from trackres_ros.diagnosis.session import Mask

Array = NDArray[np.float64]

STAGES = ("nominal", "refitted", "with_effects")
RESAMPLES = 2000


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Errors on held-out laps by stage: mean absolute error [Nm], R2, mean error [Nm]; and by how much the effects take the
    error of the re-fitted base down [Nm], with a 95 % interval over laps.
    """

    laps: tuple[str, ...]
    mae: dict[str, float]
    r2: dict[str, float]
    bias: dict[str, float]
    by_lap: dict[str, dict[str, Array]]  # mae, r2 and bias by stage, shape (laps,)
    improvement_ci95: tuple[float, float]


def held_out(nominal: Sequence[Array], refitted: Fit, final: Fit, masks: Sequence[Mask], rng: np.random.Generator) -> HeldOut:
    """Compare the three stages.

    Parameters
    ----------
    nominal
        Torque of each session with the values of the vehicle file [Nm].
    masks
        The held-out samples of each session.
    """
    sessions = final.problem.sessions
    measured = np.concatenate([s.torque[m] for s, m in zip(sessions, masks, strict=True)])
    blocks = np.concatenate([s.block[m] for s, m in zip(sessions, masks, strict=True)])
    names = {int(b): f"{s.name}: {b - s.block[0] + 1}" for s in sessions for b in np.unique(s.block)}
    expected = dict(
        zip(
            STAGES,
            (
                np.concatenate([t[m] for t, m in zip(torques, masks, strict=True)])
                for torques in (nominal, [p.torque for p in refitted.predicted], [p.torque for p in final.predicted])
            ),
            strict=True,
        )
    )
    laps = np.unique(blocks)
    count = np.array([(blocks == b).sum() for b in laps])
    error = {stage: measured - e for stage, e in expected.items()}
    by_lap = {
        "mae": {stage: np.array([np.abs(e[blocks == b]).mean() for b in laps]) for stage, e in error.items()},
        "r2": {stage: np.array([_r2(measured[blocks == b], e[blocks == b]) for b in laps]) for stage, e in error.items()},
        "bias": {stage: np.array([e[blocks == b].mean() for b in laps]) for stage, e in error.items()},
    }
    gained = (by_lap["mae"]["refitted"] - by_lap["mae"]["with_effects"]) * count
    draws = rng.multinomial(len(laps), np.full(len(laps), 1.0 / len(laps)), size=RESAMPLES)
    means = draws @ gained / np.maximum(draws @ count, 1)
    low, high = np.quantile(means, (0.025, 0.975))
    return HeldOut(
        tuple(names[int(b)] for b in laps),
        {stage: float(np.abs(e).mean()) for stage, e in error.items()},
        {stage: _r2(measured, e) for stage, e in error.items()},
        {stage: float(e.mean()) for stage, e in error.items()},
        by_lap,
        (float(low), float(high)),
    )


def _r2(measured: Array, error: Array) -> float:
    return float(1.0 - (error**2).sum() / max(((measured - measured.mean()) ** 2).sum(), 1e-12))
