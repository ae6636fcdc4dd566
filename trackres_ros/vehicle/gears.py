# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Gears between motor and sprockets: a torque at the motor comes in, one at the sprockets goes out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trackres_ros.arrays import Array
from trackres_ros.errors import InputError
from trackres_ros.vehicle.description import Vehicle
from trackres_ros.vehicle.road import RoadVehicle

RATIO_LINE = 'motor_ratio: {value: 30.0, unit: "1", flag: A, range: [29.0, 31.0], reason: "data sheet"}'
EFFICIENCY_LINE = 'motor_efficiency: {value: 0.9, unit: "1", flag: A, range: [0.8, 0.97], reason: "data sheet"}'


@dataclass(frozen=True, slots=True)
class Gears:
    """Gears of a vehicle file."""

    ratio: float  # motor speed over sprocket speed
    efficiency: float  # 1 where the model of the vehicle has the loss itself (`efficiency` of a road load)

    def at_sprockets(self, torque: Array, speed: Array) -> Array:
        """Torque at the sprockets [Nm] of one at the motor [Nm] at a speed [m/s], arrays of one shape.

        The gears lose a share of the power: what the motor drives with, or what it brakes with. At rest there is no power to
        lose. The twin in the estimator is `guards.at_sprockets`.
        """
        power, lossless = torque * speed, torque * self.ratio
        return np.select([power > 0.0, power < 0.0], [lossless * self.efficiency, lossless / self.efficiency], lossless)


def gears_of(vehicle: Vehicle | RoadVehicle) -> Gears | None:
    """The gears of a vehicle; None if its file has no ratio."""
    ratio, efficiency = vehicle.chassis.motor_ratio, vehicle.chassis.motor_efficiency
    return None if ratio is None or efficiency is None else Gears(ratio, efficiency)


def no_gears(where: str, on_tracks: bool) -> InputError:
    """The error for a torque at the motor without a ratio in the vehicle file, with the lines to add."""
    section, lines = ("chassis", f"{RATIO_LINE} and {EFFICIENCY_LINE}") if on_tracks else ("road_load", RATIO_LINE)
    return InputError(
        where,
        "a torque at the motor, but a vehicle file without motor_ratio",
        f"a vehicle file with {'motor_ratio and motor_efficiency' if on_tracks else 'motor_ratio'}",
        f"add under {section}, with your values: {lines}",
    )
