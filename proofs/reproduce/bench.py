# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Prepares one vehicle with every combination of loss method and thermal model, and the drives run on them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trackres_ros.estimator.drives import SimulatedDrive, ramp_and_hold, simulate
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.model.track import with_methods
from trackres_ros.vehicle import Vehicle

Array = NDArray[np.float64]
Series = dict[str, Array]
Runs = dict[str, Series]

METHODS = ("spectral", "rainflow")
THERMAL = ("lumped", "core_surface")
COMBINATIONS = tuple(f"{method}/{thermal}" for method in METHODS for thermal in THERMAL)
STEADY_AFTER_S = 20_000.0  # at constant speed; the slowest time constant is under 2000 s
STEADY_STEP_S = 20.0  # the step follows the linearised model exactly, so the end point does not depend on it


class Stable(NamedTuple):
    """Steady state of a drive at constant speed."""

    torque_nm: float
    hysteresis_nm: float
    belt_degc: float


@dataclass
class Bench:
    """The vehicle as its file names the methods, and as every other combination."""

    vehicle: Vehicle
    dt: float  # time step of the drives [s]
    advance: Callable[[str], None]  # called after each run with what was run
    _estimators: dict[str, Estimator] = field(default_factory=dict)

    @property
    def shipped(self) -> str:
        """The combination that the vehicle file names."""
        return f"{self.vehicle.hysteresis}/{self.vehicle.thermal}"

    def estimator(self, combination: str) -> Estimator:
        """The estimator of a combination, made once."""
        if combination not in self._estimators:
            method, thermal = combination.split("/")
            self._estimators[combination] = Estimator(with_methods(self.vehicle, method, thermal))
        return self._estimators[combination]

    def run(self, name: str, drive: SimulatedDrive, weight_n: float | None = None, ambient_degc: float | None = None) -> Runs:
        """The series of `simulate.series_of` along a drive, by combination."""
        runs = {}
        for combination in COMBINATIONS:
            runs[combination] = simulate(self.estimator(combination), drive, weight_n, ambient_degc)
            self.advance(f"{name}, {combination}")
        return runs

    def stable(self, combination: str, speed: float, weight_n: float | None = None, ambient_degc: float | None = None) -> Stable:
        """Torques and belt temperature that a constant speed [m/s] tends to."""
        drive = ramp_and_hold(speed, 0.0, STEADY_AFTER_S, STEADY_STEP_S)
        series = simulate(self.estimator(combination), drive, weight_n, ambient_degc)
        return Stable(*(float(series[name][-1]) for name in ("resistance_torque_nm", "hysteresis_nm", "belt_degc")))


def at_times(series: Series, column: str, times_s: ArrayLike) -> Array:
    """Values of a column at times [s], shape of `times_s`."""
    return np.asarray(np.interp(np.asarray(times_s, float), series["time_s"], series[column]))
