# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Counts driving time by speed, belt temperature and load, to judge coverage."""

from __future__ import annotations

import numpy as np

from trackres_ros.arrays import Mask
from trackres_ros.estimator import columns as at

SPEED_SHARES = (0.2, 0.4, 0.6)  # edges, of the greatest speed
MIDDLES = (0.1, 0.3, 0.5, 0.7)
BELT_DEGC = (15.0, 30.0, 45.0)
LOAD_SHARES = (0.9, 1.1)  # of the nominal weight
SHAPE = (len(SPEED_SHARES) + 1, len(BELT_DEGC) + 1, len(LOAD_SHARES) + 1)
FILLED_S = 20.0
LEAST_S = 240.0  # of compared driving, in total
LEAST_FILLED, LEAST_WITHOUT_BELTS = 4, 2  # buckets
ACCELERATES_MPS2, LEAST_ACCELERATING_S = 0.15, 60.0


class Buckets:
    """Seconds of driving that were learned from: by speed, belt temperature and load, of `SHAPE`; and accelerating, (1,)."""

    def __init__(self, greatest_speed: float, nominal_weight: float, belts: bool) -> None:
        self._least = LEAST_FILLED if belts else LEAST_WITHOUT_BELTS
        self._speeds = [share * greatest_speed for share in SPEED_SHARES]
        self.middles = greatest_speed * np.array(MIDDLES)  # of the classes of speed
        self._weights = [share * nominal_weight for share in LOAD_SHARES]
        self.seconds, self.accelerating = np.zeros(SHAPE), np.zeros(1)

    def clear(self) -> None:
        """Empty buckets."""
        self.seconds[:], self.accelerating[:] = 0.0, 0.0

    def count(self, speed: float, belt_degc: float, weight: float, accel: float) -> None:
        """A second at a speed [m/s], a mean belt temperature [degC], a weight [N] and an acceleration [m/s^2]."""
        self.seconds[_place(self._speeds, abs(speed)), _place(BELT_DEGC, belt_degc), _place(self._weights, weight)] += 1.0
        if abs(accel) >= ACCELERATES_MPS2:
            self.accelerating += 1.0

    @property
    def filled(self) -> Mask:
        """Buckets with enough in them, shape SHAPE."""
        return np.asarray(self.seconds >= FILLED_S)

    def covered(self) -> Mask:
        """Whether each departure was excited enough, shape (LEARNABLE,)."""
        filled: Mask = self.filled
        if self.seconds.sum() < LEAST_S or filled.sum() < self._least:
            return np.zeros(at.LEARNABLE, dtype=bool)
        speeds = np.asarray(filled.any(axis=(1, 2)))
        found = np.full(at.LEARNABLE, bool(speeds.sum() >= 2))
        found[at.OF_DRAG] &= bool(speeds[-2:].any())
        found[at.OF_MASS] = self.accelerating[0] >= LEAST_ACCELERATING_S
        found[at.OF_BELT] = False  # a state, not the vehicle's own
        return found

    @property
    def share(self) -> float:
        """Share of the required driving, 0 to 1."""
        return float(min(self.seconds.sum() / LEAST_S, self.filled.sum() / self._least, 1.0))


def _place(edges: tuple[float, ...] | list[float], value: float) -> int:
    return sum(value >= edge for edge in edges)
