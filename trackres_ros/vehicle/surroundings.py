# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads the file of the surroundings: effects of site, weather and ground, which hold here and today, not for the vehicle."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

from trackres_ros.effects.effect import Active
from trackres_ros.errors import InputError
from trackres_ros.files.yamls import read_yaml
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
    return replace(vehicle, surroundings=load_surroundings(Path(file), vehicle.name, size, False))


def load_surroundings(path: Path, vehicle: str, size: float, on_tyres: bool) -> tuple[Active, ...]:
    """Effects of the surroundings, for a vehicle of a name and of a weight times wheel radius [Nm], on tracks or on tyres.

    Raises
    ------
    InputError
        If the file cannot be read, was made for another vehicle, or lists what is not of the surroundings.
    """
    reader, content = Reader(path), read_yaml(path)
    reader.keys(content, "", KEYS, ("effect_files",))
    if content["schema"] != SCHEMA:
        raise InputError(reader.where("schema"), content["schema"], str(SCHEMA))
    if reader.text(content["vehicle"], "vehicle") != vehicle:
        remedy = "surroundings are fitted together with a vehicle: run trackres diagnose with this one"
        raise InputError(reader.where("vehicle"), content["vehicle"], vehicle, remedy)
    return listed_effects(reader, content, size, on_tyres, "surroundings")
