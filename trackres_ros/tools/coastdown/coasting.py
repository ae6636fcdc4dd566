# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A base model while it coasts: without a torque sensor where no torque is measured, and on slopes that are not recorded."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.base.base import Base, BaseParameter, Predicted, Values
from trackres_ros.diagnosis.base.instrument import instrument
from trackres_ros.diagnosis.prepare.session import Array, DriveSession
from trackres_ros.effects.effect import Active
from trackres_ros.vehicle.writing.changes import FileChanges

SLOPE_STD, MOST_SLOPE = 0.01, 0.1  # of a straight road without a recorded slope; assumed, the coast-downs decide
SLOPE = "slope of coast-downs "


class CoastingBase(Base):
    """Another base with only some parameters free, and one slope of each pair of consecutive coast-downs.

    The second of a pair meets the slope from the other side. Downhill lasts longer than uphill, so without these slopes the
    mean of both would not be that of level ground.
    """

    def __init__(self, base: Base, names: Collection[str], unpaired_count: int = 0) -> None:
        """Make it with the parameters `free`, for a number of coast-downs on an unknown slope."""
        super().__init__()
        self._base, self.name, self.facts = base, base.name, base.facts
        self.has_belt, self.rolls, self.rotating_mass_factor = base.has_belt, base.rolls, base.rotating_mass_factor
        self.includes = (*base.includes, *(effect.name for effect in instrument(base)))
        self.slopes = tuple(f"{SLOPE}{number + 1}" for number in range(0, unpaired_count if unpaired_count > 1 else 0, 2))
        slopes = (BaseParameter(name, "1", 0.0, SLOPE_STD, -MOST_SLOPE, MOST_SLOPE) for name in self.slopes)
        self.parameters = (*(q for q in base.parameters if q.name in names), *slopes)

    @property
    def level(self) -> CoastingBase:
        """The same without slopes."""
        return CoastingBase(self._base, [q.name for q in self.parameters])

    def predict(self, sessions: Sequence[DriveSession], values: Values, effects: Sequence[Active]) -> list[Predicted]:
        """See `base.Base`; values that are not given are the file's, or level ground."""
        slopes = np.array([*(values.get(name, 0.0) for name in self.slopes), 0.0])
        of_base = {name: value for name, value in values.items() if not name.startswith(SLOPE)}
        predictions = self._base.predict(sessions, {**self._base.nominal, **of_base}, effects)
        return [self._coasting(session, prediction, slopes) for session, prediction in zip(sessions, predictions, strict=True)]

    def _coasting(self, session: DriveSession, prediction: Predicted, slopes: Array) -> Predicted:
        """The torque of a session as it is compared; `slopes` are those of the pairs, then a zero for all other steps."""
        torque = prediction.torque if "torque" in session.given else prediction.at_sprockets
        pair, uphill_steps = self._uphill(session)
        return replace(prediction, torque=torque + slopes[pair] * uphill_steps)

    def _uphill(self, session: DriveSession) -> tuple[NDArray[np.int64], Array]:
        """Number of the pair of each step, and its torque of a slope of one [Nm]."""
        pair = np.where((session.block < 0) | (not self.slopes), len(self.slopes), session.block // 2)
        sign = np.where(session.block % 2 == 0, 1.0, -1.0)
        return pair, session.weight * self.facts.radius * np.sign(session.speed) * sign

    def on_slopes(self, sessions: Sequence[DriveSession], torques: Sequence[Array]) -> list[Array]:
        """Torques predicted for level ground [Nm], with the slope of each pair that fits the measured ones best."""
        of_steps = [self._uphill(session) for session in sessions]
        best_fit = np.zeros((2, len(self.slopes) + 1))
        for session, torque, (pair, uphill_steps) in zip(sessions, torques, of_steps, strict=True):
            for sums, weights in zip(best_fit, (uphill_steps * (session.torque - torque), uphill_steps**2), strict=True):
                sums += np.bincount(pair[session.used], weights[session.used], len(sums))
        slopes = best_fit[0] / np.maximum(best_fit[1], 1.0)
        slopes[-1] = 0.0
        return [torque + slopes[pair] * uphill_steps for torque, (pair, uphill_steps) in zip(torques, of_steps, strict=True)]

    def write(self, path: Path, changes: FileChanges, text: str) -> list[Path]:
        """See `base.Base`."""
        return self._base.write(path, changes, text)
