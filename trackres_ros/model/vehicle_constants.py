# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Gathers the constants of a vehicle that effects may use."""

from __future__ import annotations

from trackres_ros.effects.effect import VehicleConstants
from trackres_ros.model.thermal import thermal_network
from trackres_ros.vehicle import AnyVehicle, RoadVehicle
from trackres_ros.vehicle.description import mean_of


def vehicle_constants(vehicle: AnyVehicle) -> VehicleConstants:
    """The constants of a vehicle; of several kinds of track the means with which sums over the assemblies are right."""
    if isinstance(vehicle, RoadVehicle):
        return vehicle.constants
    chassis, tracks, radii = vehicle.chassis, [vehicle.track_of(one) for one in vehicle.assemblies], vehicle.sprocket_radii
    belts = [thermal_network(vehicle.thermal, track.belt, vehicle.rubber) for track in tracks]
    return VehicleConstants(
        radius=vehicle.arm,
        weight=vehicle.weight,
        drag_area=chassis.drag_coefficient * chassis.frontal_area,
        air_density=chassis.air_density,
        contact_length=mean_of([track.road_wheels.ground_run for track in tracks], vehicle.nominal_loads() * radii),
        assemblies=len(tracks),
        cooled_area=mean_of([belt.area for belt in belts]),
        tension=mean_of([track.belt.pretension for track in tracks], radii) * (mean_of(radii) / vehicle.arm),
        cooling=mean_of([belt.film_offset * belt.area for belt in belts]),
        cooling_by_speed=mean_of([belt.film_slope * belt.area for belt in belts]),
    )
