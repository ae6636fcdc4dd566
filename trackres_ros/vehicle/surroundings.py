# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads the file of the surroundings: effects of site, weather and ground, which are valid here and today, and learned values
by place on a route. None of them belong to the vehicle.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np

from trackres_ros import checks
from trackres_ros.effects.effect import Active, VehicleKind
from trackres_ros.errors import InputError
from trackres_ros.files.documents import read_yaml
from trackres_ros.route.learned import TORQUE, RouteMap, of_kind
from trackres_ros.route.table import read_route
from trackres_ros.text import figures
from trackres_ros.vehicle.loading import VehicleReader, listed_effects
from trackres_ros.vehicle.road import AnyVehicle

Kind = TypeVar("Kind", bound=AnyVehicle)
MOST_SHARE = 0.5  # of weight times wheel radius: limit of a torque by place, as a slope of 50 %


@dataclass(frozen=True, slots=True)
class SurroundingsFile:
    """The content of a file of the surroundings; `route` names the table of values by place."""

    schema: Literal[1]
    vehicle: str
    effects: Mapping[str, Any]
    effect_files: tuple[str, ...] = ()
    route: str = ""


def with_surroundings(vehicle: Kind, file: str | os.PathLike[str] | None) -> Kind:
    """The vehicle in the surroundings of a file; unchanged without one.

    Raises
    ------
    InputError
        See `load_surroundings`.
    """
    if file is None or (isinstance(file, str) and not file):
        return vehicle
    path, size = checks.path(file, "surroundings"), vehicle.size
    effects = load_surroundings(path, vehicle.name, size, vehicle.kind)
    return replace(vehicle, surroundings=effects, surroundings_source=path, route=load_route(path, size))


def load_surroundings(path: Path, vehicle: str, size: float, kind: VehicleKind) -> tuple[Active, ...]:
    """Effects of the surroundings, for a vehicle of a name, of a weight times wheel radius [Nm], and of a kind.

    Raises
    ------
    InputError
        If the file cannot be read, was made for another vehicle, or lists effects other than of the surroundings or of its kind.
    """
    reader, file = _read_file(path)
    if file.vehicle != vehicle:
        remedy = "surroundings are fitted for one vehicle: run trackres diagnose with this vehicle"
        raise InputError(reader.where("vehicle"), file.vehicle, vehicle, remedy)
    return listed_effects(reader, file.effects, file.effect_files, size, kind, "surroundings")


def _read_file(path: Path) -> tuple[VehicleReader, SurroundingsFile]:
    reader = VehicleReader(path)
    return reader, reader.part(SurroundingsFile, read_yaml(path))


def load_route(path: Path, size: float) -> tuple[RouteMap, ...]:
    """Slope and torque by place in a file of the surroundings, for a vehicle of a weight times wheel radius [Nm]; empty without
    any.

    Raises
    ------
    InputError
        If its table cannot be read, or has a torque too large for any ground.
    """
    name = _read_file(path)[1].route
    if not name:
        return ()
    file = path.parent / name
    route, limit = read_route(file), MOST_SHARE * size
    torques = of_kind(route, TORQUE)
    peak = 0.0 if torques is None else float(np.nanmax(np.abs(torques.value)))
    if peak > limit:
        raise InputError(str(file), f"a torque by place of {figures(peak)} Nm", f"at most {figures(limit)} Nm of this vehicle")
    return route
