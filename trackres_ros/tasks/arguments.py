# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Converts the arguments of the public functions to vehicles, paths and topics."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, Union

from trackres_ros import checks
from trackres_ros.errors import InputError

if TYPE_CHECKING:
    from trackres_ros.recording.bindings import Topics
    from trackres_ros.recording.recording import Recording
    from trackres_ros.vehicle import AnyVehicle, RoadVehicle, Vehicle


StrPath: TypeAlias = str | PathLike[str]
VehicleGiven: TypeAlias = Union["Vehicle", "RoadVehicle", StrPath]
TopicsGiven: TypeAlias = Union["Topics", Mapping[str, Mapping[str, Any]], StrPath]

AMBIENT, BELT, SPEED, WEIGHT = (-60.0, 60.0, "degC"), (-60.0, 150.0, "degC"), (-200.0, 200.0, "km/h"), (0.1, 1e5, "kN")
LIMITS: dict[str, dict[str, tuple[float, float, str]]] = {
    "simulate": {
        "speed_kmh": SPEED, "ramp_s": (0.0, 1e5, "s"), "duration_s": (1e-3, 1e7, "s"), "ambient_degc": AMBIENT,
        "initial_degc": BELT, "weight_kn": WEIGHT, "dt": (1e-4, 10.0, "s"),
    },
    "explain": {"speed_kmh": SPEED, "belt_degc": BELT, "ambient_degc": AMBIENT, "weight_kn": WEIGHT},
    "record_sample": {"speed_kmh": (1.0, 50.0, "km/h"), "laps": (1, 1000, ""), "ambient_degc": AMBIENT},
    "check_vehicle": {"points": (10, 100_000, "")},
}  # fmt: skip
"""Least and greatest value of numeric arguments, by function; of whole numbers the limits are whole. Options have the same."""


def check_numbers(function: str, **given: object) -> None:
    """Check numeric arguments of a public function by their names."""
    for name, value in given.items():
        low, high, unit = LIMITS[function][name]
        if isinstance(low, int) and isinstance(high, int):
            checks.whole(value, name, low, high, unit)
        else:
            checks.number(value, name, low, high, unit)


def if_given(**optional: object) -> dict[str, object]:
    """Those that are not None, the default of an argument that may be absent."""
    return {name: value for name, value in optional.items() if value is not None}


def as_vehicle(vehicle: VehicleGiven) -> AnyVehicle:
    """A vehicle, from a `Vehicle` or its file."""
    from trackres_ros.vehicle import RoadVehicle, Vehicle, load_any

    if isinstance(vehicle, str | PathLike):
        return load_any(vehicle)
    if not isinstance(vehicle, Vehicle | RoadVehicle):
        raise InputError("vehicle", vehicle, "a vehicle, its file, or its name")
    return vehicle


def as_track_vehicle(vehicle: VehicleGiven) -> Vehicle:
    """The same, of a vehicle on tracks."""
    from trackres_ros.vehicle import Vehicle

    described = as_vehicle(vehicle)
    if not isinstance(described, Vehicle):
        raise InputError("vehicle", f"{described.name} of the base model road_load, which has no belts", "a track vehicle")
    return described


def as_path(given: Any, where: str, allowed: str = "a path, or what read gave") -> Path:
    """The path of a recording; the error for data in memory says how to give them."""
    if _is_data(given):
        remedy = "write the data to a file first, such as a DataFrame with to_csv or to_parquet"
        raise InputError(where, f"a {type(given).__name__}", allowed, remedy)
    return checks.path(given, where, allowed)


def as_paths(recording: Any) -> list[Path]:
    """One path or several."""
    several = _holds_paths(recording) or (isinstance(recording, Sequence) and not isinstance(recording, str | bytes))
    return [
        as_path(path, "recording", "a path, several paths, or what read gave") for path in (recording if several else [recording])
    ]


def as_recordings(recordings: Any) -> list[Any]:
    """One recording or several, each read or a path."""
    from trackres_ros.recording.recording import Recording

    listed = [recordings] if _is_data(recordings) else _listed(recordings)
    if not listed:
        raise InputError("recordings", "none", "at least one")
    return [r if isinstance(r, Recording) else as_path(r, "recordings", "paths, and what read gave") for r in listed]


def _is_data(given: object) -> bool:
    """Whether it is a table, an array, or columns by name."""
    if isinstance(given, str | PathLike) or _holds_paths(given):
        return False
    return hasattr(given, "__array__") or isinstance(given, Mapping)


def _holds_paths(given: Any) -> bool:
    """Whether it is an array or a column of paths."""
    shape: tuple[int, ...] = getattr(given, "shape", ())
    return len(shape) == 1 and shape[0] > 0 and all(isinstance(one, str | PathLike) for one in given)


def as_names(names: object, where: str) -> tuple[str, ...]:
    """One name or several."""
    listed = _listed(names)
    if not all(isinstance(name, str) and name for name in listed):
        raise InputError(where, names, "a name, or several")
    return tuple(listed)


def _listed(given: Any) -> list[Any]:
    return list(given) if isinstance(given, Iterable) and not isinstance(given, str | bytes) else [given]


def paths_of(recordings: Sequence[Recording]) -> list[Path]:
    """Paths of recordings, or their names where they were made in memory."""
    return [path for one in recordings for path in (one.paths or (Path(one.name),))]


def input_files(topics: Topics | None, *others: object) -> list[Path]:
    """The files of topics, and all paths among other arguments: no output may replace them."""
    of_topics = [] if topics is None else [Path(topics.origin), *(file for _, file in topics.dbc)]
    return [*of_topics, *(Path(one) for one in others if isinstance(one, str | PathLike))]


def as_topics(topics: TopicsGiven | None) -> Topics | None:
    """A topics file, its content as a mapping, or None."""
    if topics is None:
        return None
    from trackres_ros.recording.bindings import Topics

    if isinstance(topics, Topics):
        return topics
    return Topics.load(topics) if isinstance(topics, str | PathLike) else Topics.parse(topics)
