# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads the file of the surroundings: effects of site, weather and ground, which hold here and today, not for the vehicle, and
the slopes of a route.
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

from trackres_ros.effects.effect import Active
from trackres_ros.errors import InputError
from trackres_ros.files.yamls import read_yaml
from trackres_ros.route.learned import RouteMap
from trackres_ros.route.table import read_route
from trackres_ros.vehicle.description import Vehicle
from trackres_ros.vehicle.loading import listed_effects
from trackres_ros.vehicle.reading import Reader

SCHEMA = 1
KEYS = ("schema", "vehicle", "effects")


def with_surroundings(vehicle: Vehicle, file: str | os.PathLike[str] | None) -> Vehicle:
    """The vehicle in the surroundings of a file; as it is where none is named.

    Raises
    ------
    InputError
        See `load_surroundings`.
    """
    if not file:
        return vehicle
    size = vehicle.weight * vehicle.track_of(vehicle.assemblies[0]).sprocket_radius
    path = Path(file)
    return replace(vehicle, surroundings=load_surroundings(path, vehicle.name, size, False), route=load_route(path))


def load_surroundings(path: Path, vehicle: str, size: float, on_tyres: bool) -> tuple[Active, ...]:
    """Effects of the surroundings, for a vehicle of a name and of a weight times wheel radius [Nm], on tracks or on tyres.

    Raises
    ------
    InputError
        If the file cannot be read, was made for another vehicle, or lists what is not of the surroundings.
    """
    reader, content = Reader(path), read_yaml(path)
    reader.keys(content, "", KEYS, ("effect_files", "route"))
    if content["schema"] != SCHEMA:
        raise InputError(reader.where("schema"), content["schema"], str(SCHEMA))
    if reader.text(content["vehicle"], "vehicle") != vehicle:
        remedy = "surroundings are fitted together with a vehicle: run trackres diagnose with this one"
        raise InputError(reader.where("vehicle"), content["vehicle"], vehicle, remedy)
    return listed_effects(reader, content, size, on_tyres, "surroundings")


def load_route(path: Path) -> RouteMap | None:
    """The slope by place that a file of the surroundings names; None where it names none.

    Raises
    ------
    InputError
        If its table cannot be read.
    """
    name = read_yaml(path).get("route")
    return None if name is None else read_route(path.parent / Reader(path).text(name, "route"))
