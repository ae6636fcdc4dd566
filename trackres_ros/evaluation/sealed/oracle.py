"""What could be known: the true structure fitted to the same laps by the same optimiser, and what tells of itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from trackres_ros.diagnosis import load_base, read_recordings
from trackres_ros.diagnosis.inference.fitting import Problem, fit
from trackres_ros.diagnosis.inference.levels import with_levels
from trackres_ros.diagnosis.prepare.gate import gate
from trackres_ros.diagnosis.prepare.split import split
from trackres_ros.diagnosis.selection.visibility import LEAST_KEPT, separability
from trackres_ros.effects import catalogue

LEAST_GAIN = 10.0  # in log-likelihood: 4.5 standard deviations


@dataclass(frozen=True)
class OracleAnswer:
    """What an oracle finds in one case.

    Attributes
    ----------
    gain
        In log-likelihood, of the true effects over the re-fitted base.
    alike
        Effects that look the same as the first true one here (cosine beyond 0.95), itself among them.
    identifiable
        Whether the gain is plain, no other effect looks alike, and the base does not take it up.
    plain_both
        Of two effects: whether each gains as much beside the other.
    mae_base, mae
        Mean error on held-out laps [Nm] without and with the true effects.
    """

    gain: float
    alike: tuple[str, ...]
    identifiable: bool
    plain_both: bool
    mae_base: float
    mae: float


def ask(folder: Path, true: Sequence[str]) -> OracleAnswer:
    """Ask the oracle about a case; `true` are the effects of the catalogue that are in it."""
    loaded = load_base(folder / "vehicle.yaml")
    base = loaded.base
    effects = catalogue(size=base.facts.weight * base.facts.radius)
    sessions = gate(read_recordings(sorted(folder.glob("drive_*.csv")), None), loaded.known).sessions
    chosen = split(sessions)
    before = fit(Problem(base, sessions, tuple(chosen.training_mask(s) for s in sessions)))
    held = [chosen.held_out_mask(s) for s in sessions]
    measured = np.concatenate([s.torque[m] for s, m in zip(sessions, held, strict=True)])

    def error(predicted: Sequence[np.ndarray]) -> float:
        return float(np.abs(measured - np.concatenate([p[m] for p, m in zip(predicted, held, strict=True)])).mean())

    mae_base = error([p.torque for p in with_levels(before).predicted])
    if not true:
        return OracleAnswer(0.0, (), False, False, mae_base, mae_base)
    wanted = [effects[name] for name in true]
    found = fit(before.problem, wanted, before.at, before.noises)
    gain = found.log_likelihood - before.log_likelihood
    seen = separability(effects, before)
    alike = seen.alike(true[0]) if true[0] in seen.names else (true[0],)
    kept = max((s.kept for s in seen.visible if s.effect.name == true[0]), default=0.0)
    plain = gain > LEAST_GAIN and len(alike) == 1 and kept >= LEAST_KEPT
    both = len(wanted) > 1 and all(
        found.log_likelihood - fit(before.problem, [e for e in wanted if e is not one], found.at, found.noises).log_likelihood
        > LEAST_GAIN
        for one in wanted
    )
    return OracleAnswer(gain, alike, plain, both, mae_base, error([p.torque for p in with_levels(found).predicted]))
