# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Joins the paper's chain from load and speed to loss for one kind of track assembly, by the exact methods.

Also gathers the constants of a vehicle that effects may use.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

from trackres_ros import checks
from trackres_ros.effects.effect import VehicleConstants
from trackres_ros.errors import InputError
from trackres_ros.model import belt as belt_model
from trackres_ros.model.hysteresis import METHODS, LossMethod
from trackres_ros.model.rubber import RubberModel
from trackres_ros.model.thermal import ThermalNetwork, parting_resistance, thermal_network
from trackres_ros.vehicle import AnyVehicle, RoadVehicle, Track, Vehicle
from trackres_ros.vehicle.description import MODEL_CHOICES, mean_of

# Constants for effects


def vehicle_constants(vehicle: AnyVehicle) -> VehicleConstants:
    """The constants of a vehicle; of several kinds of track the means with which sums over the assemblies are right."""
    if isinstance(vehicle, RoadVehicle):
        return vehicle.constants
    chassis, tracks, radii = (
        vehicle.chassis,
        [vehicle.track_of(assembly) for assembly in vehicle.assemblies],
        vehicle.sprocket_radii,
    )
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


# The chain

SURE_SPEED = 5.0  # m/s at which the belt tension is stated; it hardly depends on it


@dataclass(frozen=True)
class TrackModel:
    """Everything computed once from a vehicle file for one kind of track."""

    track: Track
    rubber: RubberModel
    loss: LossMethod
    network: ThermalNetwork


class LoadRange(NamedTuple):
    """Loads on one assembly, its own weight included [N]."""

    low: float
    nominal: float
    high: float


def track_model(vehicle: Vehicle, track_name: str) -> TrackModel:
    """Build the model of one kind of track with the methods the vehicle file names."""
    track = vehicle.tracks[track_name]
    rubber = RubberModel(vehicle.rubber)
    return TrackModel(track, rubber, METHODS[vehicle.hysteresis](track, rubber), belt_network(vehicle, track_name))


def track_models(vehicle: Vehicle) -> dict[str, TrackModel]:
    """Models of all kinds of track, by name."""
    return {name: track_model(vehicle, name) for name in vehicle.tracks}


def belt_network(vehicle: Vehicle, track_name: str) -> ThermalNetwork:
    """Thermal constants of the belt of one kind of track, with the resistance inside it that effects of the vehicle add."""
    of_effects = parting_resistance(vehicle.active, vehicle_constants(vehicle))
    return thermal_network(vehicle.thermal, vehicle.tracks[track_name].belt, vehicle.rubber, of_effects)


def with_methods(vehicle: AnyVehicle, hysteresis: str | None = None, thermal: str | None = None) -> AnyVehicle:
    """The same vehicle with other methods than its file names.

    Raises InputError for an unknown method, and for any of a vehicle without belts.
    """
    for argument, choice, key in (("method", hysteresis, "hysteresis"), ("thermal", thermal, "thermal")):
        if choice is not None:
            checks.one_of(choice, argument, MODEL_CHOICES[key])
            if isinstance(vehicle, RoadVehicle):
                raise InputError(argument, choice, f"none for {vehicle.name}: the base model road_load has no belts")
    if isinstance(vehicle, RoadVehicle):
        return vehicle
    return replace(vehicle, hysteresis=hysteresis or vehicle.hysteresis, thermal=thermal or vehicle.thermal)


def load_range(vehicle: Vehicle, track_name: str) -> LoadRange:
    """Loads the tables cover for a kind of track: from just above its own weight to two and a half times nominal."""
    nominal = max(
        float(load)
        for load, assembly in zip(vehicle.nominal_loads(), vehicle.assemblies, strict=True)
        if assembly.track == track_name
    )
    own_weight = vehicle.tracks[track_name].own_weight
    return LoadRange(own_weight + 0.02 * (nominal - own_weight), nominal, 2.5 * nominal)


def steady_tension(model: TrackModel, belt_degc: float, speed: float = SURE_SPEED) -> float:
    """Steady belt tension [N] at a belt temperature [degC]."""
    belt = model.track.belt
    modulus = float(model.rubber.dynamic_modulus(abs(speed) / belt.loop_length, belt_degc))
    return belt_model.belt_tension(belt, model.rubber.rubber, modulus)
