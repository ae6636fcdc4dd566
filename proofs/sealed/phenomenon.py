# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Defines the inputs and results of a phenomenon."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from proofs.sealed.data_sheet import DataSheet
from proofs.sealed.drives import Array, SealedDrive

CREEP_MPS = 0.04  # over it friction changes its sign


@dataclass(frozen=True, eq=False)
class Journey:
    """A drive as input of phenomena; `driven` is the vehicle's distance before it [m]."""

    sheet: DataSheet
    drive: SealedDrive
    driven: float

    @property
    def step(self) -> float:
        """Time between samples [s]."""
        return self.drive.step

    @property
    def speed(self) -> Array:
        """Speed [m/s], negative backwards."""
        return self.drive.speed

    @property
    def travel(self) -> Array:
        """Size of the speed [m/s]."""
        return np.abs(self.drive.speed)

    @property
    def direction(self) -> Array:
        """Sign of the speed, which changes smoothly."""
        return self.drive.speed / np.sqrt(self.drive.speed**2 + CREEP_MPS**2)

    @property
    def curvature(self) -> Array:
        """Curvature of the path without its sign [1/m]."""
        return np.abs(self.drive.yaw_rate) / np.maximum(self.travel, 0.3)

    @property
    def load(self) -> Array:
        """Weight over the nominal one."""
        return self.drive.weight / self.sheet["weight"]

    @property
    def distance(self) -> Array:
        """Distance driven so far, earlier drives included [m]."""
        return self.driven + np.cumsum(self.travel) * self.step

    def climbing(self, rise: float | Array) -> Array:
        """Torque of a slope [rise over run] at the sprockets [Nm]."""
        return np.asarray(self.drive.weight * self.sheet["track.sprocket_radius"] * np.sin(np.arctan(rise)))

    def lagged(self, target: Array, seconds: float, start: float) -> Array:
        """A series as something follows it that takes its time."""
        out, now, rate = np.empty(len(target)), start, 1.0 - np.exp(-self.step / seconds)
        for i, aim in enumerate(target):
            out[i] = now
            now += (aim - now) * rate
        return out


Adds = Callable[[Journey, Mapping[str, float], Array], Array]
"""Torque that a phenomenon adds [Nm], by the drive, the values of its parameters, and the torque without it."""
