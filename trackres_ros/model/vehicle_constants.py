# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Gathers the constants of a vehicle that effects may use."""

from __future__ import annotations

from trackres_ros.effects.effect import VehicleConstants
from trackres_ros.model.belt import cooled_area
from trackres_ros.vehicle import AnyVehicle, RoadVehicle


def vehicle_constants(vehicle: AnyVehicle) -> VehicleConstants:
    """The constants of a vehicle; of its first kind of track if there are several."""
    if isinstance(vehicle, RoadVehicle):
        return vehicle.constants
    chassis, first = vehicle.chassis, vehicle.track_of(vehicle.assemblies[0])
    area = cooled_area(first.belt)
    return VehicleConstants(
        radius=first.sprocket_radius,
        weight=vehicle.weight,
        drag_area=chassis.drag_coefficient * chassis.frontal_area,
        air_density=chassis.air_density,
        contact_length=first.road_wheels.ground_run,
        assemblies=len(vehicle.assemblies),
        cooled_area=area,
        tension=first.belt.pretension,
        cooling=first.belt.film_offset * area,
        cooling_by_speed=first.belt.film_slope * area,
    )
