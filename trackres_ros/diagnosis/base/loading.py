# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Loads the base model of a vehicle file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path

from trackres_ros.diagnosis.base.base import Base
from trackres_ros.diagnosis.base.own import OwnBase, OwnModel
from trackres_ros.diagnosis.base.road_load import RoadBase
from trackres_ros.diagnosis.base.track import TrackBase
from trackres_ros.diagnosis.prepare.session import GateSettings
from trackres_ros.effects.effect import Active
from trackres_ros.errors import InputError
from trackres_ros.estimator.settings import Settings, settings_for
from trackres_ros.model.track import with_methods
from trackres_ros.recording.bindings import Topics
from trackres_ros.route.learned import RouteMap
from trackres_ros.vehicle import RoadVehicle, Vehicle, load, load_any, with_surroundings
from trackres_ros.vehicle.gears import gears_of


@dataclass(frozen=True, eq=False)
class LoadedBase:
    """A base model, the vehicle's title, settings for the gate, and the surroundings: effects, ground by place, and the file."""

    base: Base
    title: str
    known: GateSettings
    surroundings: tuple[Active, ...] = ()
    route: tuple[RouteMap, ...] = ()
    source: Path | None = None

    def with_topics(self, topics: Topics | None) -> LoadedBase:
        """The same with the belt sensor and the mass of a passenger of a topics file, except for a model of the user's own.

        Raises InputError as `settings_for`.
        """
        if isinstance(self.base, OwnBase):
            return self
        settings = settings_for(Settings(), topics)
        shows_surface = self.known.has_belt and settings.belt_sensor == "surface"
        return replace(self, known=replace(self.known, belt_shows_surface=shows_surface, passenger_kg=settings.passenger_kg))


def load_base(
    vehicle: str | PathLike[str] | Vehicle | RoadVehicle | OwnModel,
    hysteresis: str | None = None,
    thermal: str | None = None,
    surroundings: str | PathLike[str] | None = None,
) -> LoadedBase:
    """Base model of a vehicle: `road_load` where its file has that section, else `track`; or a user model.

    `surroundings` is the file of the site.

    Raises
    ------
    InputError
        If the file cannot be used, or the vehicle has other values than its file.
    """
    if isinstance(vehicle, OwnModel):
        for name, value in (("surroundings", surroundings), ("method", hysteresis), ("thermal", thermal)):
            if value is not None:
                raise InputError(name, str(value), "none with a model of your own", "it is part of the model")
        return LoadedBase(OwnBase(vehicle), vehicle.name, vehicle.known)
    if isinstance(vehicle, Vehicle):
        _check_as_in_its_file(vehicle)
    elif not isinstance(vehicle, RoadVehicle):
        vehicle = load_any(vehicle)
    vehicle = with_surroundings(with_methods(vehicle, hysteresis, thermal), surroundings)
    if isinstance(vehicle, RoadVehicle):
        return _road(vehicle)
    base = TrackBase(vehicle)
    return LoadedBase(base, vehicle.title, gate_settings(vehicle), vehicle.surroundings, vehicle.route, vehicle.source)


def _road(road: RoadVehicle) -> LoadedBase:
    return LoadedBase(RoadBase(road), road.title, gate_settings(road), road.surroundings, road.route, road.source)


def gate_settings(vehicle: Vehicle | RoadVehicle) -> GateSettings:
    """Facts of a vehicle for the checks of its recordings."""
    if isinstance(vehicle, RoadVehicle):
        road = RoadBase(vehicle)
        return GateSettings(
            road.facts.weight,
            vehicle.values["max_speed"],
            vehicle.values["ambient"],
            vehicle.friction_brakes or (False if road.rolls else None),  # a sliding machine has none
            torque_scale=road.torque_scale,
            torque_share=vehicle.torque_share,
            is_vehicle=road.rolls,
            track_width=vehicle.values.get("track_width"),
            gears=gears_of(vehicle),
        )
    loads = vehicle.nominal_loads().tolist()
    return GateSettings(
        vehicle.weight,
        vehicle.chassis.max_speed,
        vehicle.chassis.ambient,
        False,
        gears=gears_of(vehicle),
        has_belt=True,
        axles={
            axle.name: {vehicle.assemblies[i].name: loads[i] for i in vehicle.assemblies_of(axle.name)} for axle in vehicle.axles
        },
    )


def _check_as_in_its_file(vehicle: Vehicle) -> None:
    """Refuse a vehicle changed in memory, because results are written into a copy of its file."""
    in_file = load(vehicle.source)
    changed_paths = [path for path, q in vehicle.parameters.items() if q.value != in_file.parameters[path].value]
    effects = [{a.effect.name: dict(a.values) for a in v.effects} for v in (vehicle, in_file)]
    changed_paths += ["effects"] if effects[0] != effects[1] else []
    if changed_paths:
        statement = f"other values than {vehicle.source} has: {changed_paths[0]}"
        raise InputError("vehicle", statement, "a vehicle as its file has it", "write them into a file of their own")
