# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads a vehicle file into a checked, frozen description with units and provenance."""

from trackres_ros.vehicle.description import (
    Assembly,
    Axle,
    Beam,
    Belt,
    Chassis,
    Disturbance,
    Drift,
    Quantity,
    RoadWheels,
    Rubber,
    Spells,
    Track,
    Vehicle,
    WrappedWheel,
)
from trackres_ros.vehicle.loading import load, variants
from trackres_ros.vehicle.road import AnyVehicle, RoadVehicle, files_of, load_any
from trackres_ros.vehicle.surroundings import with_surroundings

__all__ = [
    "AnyVehicle", "Assembly", "Axle", "Beam", "Belt", "Chassis", "Disturbance", "Drift", "Quantity", "RoadVehicle", "RoadWheels",
    "Rubber", "Spells", "Track", "Vehicle", "WrappedWheel", "files_of", "load", "load_any", "variants", "with_surroundings",
]  # fmt: skip
