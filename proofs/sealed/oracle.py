# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Computes the best possible result: the true structure is fitted to the same laps by the same optimiser."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from proofs.sealed.blind import opened
from proofs.sealed.drives import Array
from proofs.sealed.generate import means
from trackres_ros.diagnosis.base.base import BaseParameter, Predicted, Values
from trackres_ros.diagnosis.base.track import TrackBase
from trackres_ros.diagnosis.inference.fitting import Problem, fit, with_levels
from trackres_ros.diagnosis.prepare.gate import gate
from trackres_ros.diagnosis.prepare.session import DriveSession, split
from trackres_ros.diagnosis.selection.visibility import LEAST_KEPT, separability
from trackres_ros.effects import catalogue
from trackres_ros.effects.effect import Active
from trackres_ros.vehicle import Vehicle

LEAST_GAIN = 10.0  # in log-likelihood: 4.5 standard deviations
AS_WELL = 3.0  # a name with a gain smaller by at most this fits as well
ADDITION, LARGEST_ADDITION = "addition", 5.0  # times the true value


@dataclass(frozen=True)
class OracleAnswer:
    """Findings of an oracle in one case. Physics outside the catalogue is identifiable if its gain is clear."""

    gain: float  # in log-likelihood, of the true effects over the re-fitted base
    alike: tuple[str, ...]  # effects that look like the first true one (cosine above 0.95), or outside the catalogue fit as well
    identifiable: bool  # the gain is clear, no other effect looks alike, and the base does not absorb it
    plain_both: bool  # of two effects: each gains as much in addition to the other
    mae_base: float  # mean error on hold-out laps [Nm] without the true effects
    mae: float  # and with them


class WithAddition(TrackBase):
    """The base with an added torque known except for its size: `added` [Nm], of each session a series of at least its
    length.
    """

    def __init__(self, vehicle: Vehicle, added: Sequence[Array]) -> None:
        super().__init__(vehicle)
        self._added = added
        self.parameters += (BaseParameter(ADDITION, "1", 0.0, np.inf, -LARGEST_ADDITION, LARGEST_ADDITION),)

    def predict(self, sessions: Sequence[DriveSession], values: Values, effects: Sequence[Active]) -> list[Predicted]:
        """See `base.Base`."""
        plain = super().predict(sessions, values, effects)
        return [
            replace(p, torque=p.torque + values[ADDITION] * added[: len(p.torque)])
            for p, added in zip(plain, self._added, strict=True)
        ]


def fit_truth(folder: Path, true: Sequence[str], added: Sequence[Array] = (), rivals: Sequence[str] = ()) -> OracleAnswer:
    """Fit the true structure to the laps of a case: its effects in the catalogue, or the torque added by other physics.

    That torque is given in each second of each drive [Nm]. Of the `rivals`, those with nearly the same gain are `alike`.
    """
    _, recordings, loaded = opened(folder)
    base = loaded.base
    effects = catalogue(size=base.facts.weight * base.facts.radius)
    sessions = gate(recordings, loaded.known).sessions
    chosen = split(sessions)
    before = fit(Problem(base, sessions, tuple(chosen.training_mask(s) for s in sessions)))
    held = [chosen.held_out_mask(s) for s in sessions]
    measured = np.concatenate([s.torque[m] for s, m in zip(sessions, held, strict=True)])

    def error(predicted: Sequence[np.ndarray]) -> float:
        return float(np.abs(measured - np.concatenate([p[m] for p, m in zip(predicted, held, strict=True)])).mean())

    mae_base = error([p.torque for p in with_levels(before).predicted])
    if added:
        assert isinstance(base, TrackBase)
        by_step = [means(one, round(s.step)) for one, s in zip(added, sessions, strict=True)]
        found = fit(replace(before.problem, base=WithAddition(base.vehicle, by_step)), start=before.at, noises=before.noises)
        gain = found.log_likelihood - before.log_likelihood
        mae = error([p.torque for p in with_levels(found).predicted])
        gains = {
            name: fit(before.problem, [effects[name]], before.at, before.noises).log_likelihood - before.log_likelihood
            for name in rivals
            if name in effects
        }
        alike = tuple(name for name, gained in gains.items() if gained > gain - AS_WELL)
        return OracleAnswer(gain, alike, gain > LEAST_GAIN, False, mae_base, mae)
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
