"""Which base model a vehicle file asks for."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from pathlib import Path

from trackres_ros.diagnosis.base import Base
from trackres_ros.diagnosis.gate import Known
from trackres_ros.diagnosis.road_base import RoadBase, load_road_vehicle
from trackres_ros.diagnosis.track_base import TrackBase
from trackres_ros.estimator.settings import Settings
from trackres_ros.model.track import with_methods
from trackres_ros.resources import find_vehicle
from trackres_ros.topic_settings import settings_for
from trackres_ros.topics import Topics
from trackres_ros.vehicle import load, with_surroundings
from trackres_ros.yamls import read_yaml


@dataclass(frozen=True, eq=False)
class LoadedBase:
    """A base model, the vehicle's title, and what the gate needs to know of it."""

    base: Base
    title: str
    known: Known


def load_base(
    vehicle: str | PathLike[str],
    hysteresis: str | None = None,
    thermal: str | None = None,
    topics: Topics | None = None,
    surroundings: Path | None = None,
) -> LoadedBase:
    """Load the base model of a vehicle file: `road_load` where it has that section, else `track`.

    A topics file says what a measured belt temperature shows; `surroundings` is the file of what holds where it was driven.

    Raises
    ------
    InputError
        If the file cannot be used.
    """
    path = find_vehicle(vehicle)
    content = read_yaml(path)
    if "road_load" in content:
        road = load_road_vehicle(path, content, surroundings)
        base = RoadBase(road)
        known = Known(
            base.facts.weight,
            road.values["max_speed"],
            road.values["ambient"],
            road.friction_brakes,
            torque_scale=road.torque_shown,
        )
        return LoadedBase(base, road.title, known)
    track = with_surroundings(with_methods(load(path), hysteresis, thermal), surroundings)
    settings = settings_for(Settings(), topics)
    known = Known(
        track.weight,
        track.chassis.max_speed,
        track.chassis.ambient,
        False,
        settings.belt_sensor == "surface",
        track.chassis.motor_ratio,
    )
    return LoadedBase(TrackBase(track), track.title, known)
