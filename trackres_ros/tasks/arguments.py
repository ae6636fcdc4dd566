# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Checks the arguments of the public functions, and converts them to vehicles, paths and topics."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import wraps
from inspect import signature
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypeAlias, TypeVar, Union

from trackres_ros import checks
from trackres_ros.errors import InputError
from trackres_ros.text import figures

if TYPE_CHECKING:
    from trackres_ros.recording.bindings import Topics
    from trackres_ros.recording.recording import Recording
    from trackres_ros.vehicle import AnyVehicle, RoadVehicle, Vehicle


StrPath: TypeAlias = str | PathLike[str]
VehicleGiven: TypeAlias = Union["Vehicle", "RoadVehicle", StrPath]
TopicsGiven: TypeAlias = Union["Topics", Mapping[str, Mapping[str, Any]], StrPath]

Limits: TypeAlias = tuple[float, float, str]
Given = ParamSpec("Given")
Result = TypeVar("Result")

AMBIENT: Limits = (-60.0, 60.0, "degC")
BELT: Limits = (-60.0, 150.0, "degC")
SPEED: Limits = (-200.0, 200.0, "km/h")
WEIGHT: Limits = (0.1, 1e5, "kN")
LIMITS: dict[str, dict[str, Limits]] = {}
"""Least and greatest value of numeric arguments, by function; of whole numbers the limits are whole. Options have the same."""


def limited(**limits: Limits) -> Callable[[Callable[Given, Result]], Callable[Given, Result]]:
    """Check numeric arguments of a public function before its call; None is allowed where it is the default."""

    def decorate(function: Callable[Given, Result]) -> Callable[Given, Result]:
        LIMITS[function.__name__] = limits
        optional_names = {name for name, parameter in signature(function).parameters.items() if parameter.default is None}

        @wraps(function)
        def check_and_call(*args: Given.args, **kwargs: Given.kwargs) -> Result:
            for name, (low, high, unit) in limits.items():
                if name not in kwargs or (kwargs[name] is None and name in optional_names):
                    continue
                if isinstance(low, int) and isinstance(high, int):
                    checks.whole(kwargs[name], name, low, high, unit)
                else:
                    checks.number(kwargs[name], name, low, high, unit)
            return function(*args, **kwargs)

        return check_and_call

    return decorate


def load_vehicle(
    vehicle: StrPath, *, method: str | None = None, thermal: str | None = None, surroundings: StrPath | None = None
) -> AnyVehicle:
    """Load a vehicle file.

    Parameters
    ----------
    vehicle
        Path of a vehicle file, or the name of a shipped vehicle such as ``xgd24d``.
    method
        Way from strain to heat instead of the file's: ``rainflow``, the paper's count, or ``spectral``, exact.
    thermal
        Thermal model instead of the file's: ``lumped`` or ``core_surface``.
    surroundings
        File of the current site, weather and ground, as a diagnosis writes it.

    Returns
    -------
    Vehicle or RoadVehicle
        Frozen and checked; SI units, temperatures in degC. A file with a section `road_load` gives a `RoadVehicle`.

    Raises
    ------
    InputError
        On a missing, unknown or implausible value: file and key, what was given and what is allowed.

    Examples
    --------
    >>> import trackres_ros as tr
    >>> vehicle = tr.load_vehicle("agri3t")
    >>> round(vehicle.weight)
    29400
    >>> tr.load_vehicle("agri3t", thermal="lumpy")
    Traceback (most recent call last):
    trackres_ros.errors.InputError: thermal: given 'lumpy'; allowed: one of lumped, core_surface; did you mean lumped?
    """
    from trackres_ros.model.track import with_methods
    from trackres_ros.vehicle import load_any, with_surroundings

    return with_surroundings(with_methods(load_any(vehicle), method, thermal), surroundings)


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

    track_vehicle = as_vehicle(vehicle)
    if not isinstance(track_vehicle, Vehicle):
        raise InputError("vehicle", f"{track_vehicle.name} of the base model road_load, which has no belts", "a track vehicle")
    return track_vehicle


def check_weight(vehicle: AnyVehicle, weight_kn: float | None, least_share: float, largest_share: float) -> None:
    """Check a weight [kN] by shares of the vehicle's own."""
    low, nominal, high = (share * vehicle.weight / 1e3 for share in (least_share, 1.0, largest_share))
    if weight_kn is not None and not low <= weight_kn <= high:
        raise InputError("weight_kn", weight_kn, f"{figures(low)} to {figures(high)} kN for a vehicle of {figures(nominal)} kN")


def as_path(value: Any, argument: str, allowed: str = "a path, or what read gave") -> Path:
    """The path of a recording; the error for data in memory says how to give them."""
    if _is_data(value):
        remedy = "write the data to a file first, such as a DataFrame with to_csv or to_parquet"
        raise InputError(argument, f"a {type(value).__name__}", allowed, remedy)
    return checks.path(value, argument, allowed)


def as_paths(recording: Any) -> list[Path]:
    """One path or several."""
    is_list = _holds_paths(recording) or (isinstance(recording, Sequence) and not isinstance(recording, str | bytes))
    return [
        as_path(path, "recording", "a path, several paths, or what read gave") for path in (recording if is_list else [recording])
    ]


def as_recordings(recordings: Any) -> list[Any]:
    """One recording or several, each read or a path."""
    from trackres_ros.recording.recording import Recording

    items = [recordings] if _is_data(recordings) else _as_list(recordings)
    if not items:
        raise InputError("recordings", "none", "at least one")
    return [item if isinstance(item, Recording) else as_path(item, "recordings", "paths, and what read gave") for item in items]


def _is_data(value: object) -> bool:
    """Whether it is a table, an array, or columns by name."""
    if isinstance(value, str | PathLike) or _holds_paths(value):
        return False
    return hasattr(value, "__array__") or isinstance(value, Mapping)


def _holds_paths(value: Any) -> bool:
    """Whether it is an array or a column of paths."""
    shape: tuple[int, ...] = getattr(value, "shape", ())
    return len(shape) == 1 and shape[0] > 0 and all(isinstance(item, str | PathLike) for item in value)


def as_names(names: object, argument: str) -> tuple[str, ...]:
    """One name or several."""
    items = _as_list(names)
    if not all(isinstance(name, str) and name for name in items):
        raise InputError(argument, names, "a name, or several")
    return tuple(items)


def _as_list(value: Any) -> list[Any]:
    return list(value) if isinstance(value, Iterable) and not isinstance(value, str | bytes) else [value]


def paths_of(recordings: Sequence[Recording]) -> list[Path]:
    """Paths of recordings, or their names where they were made in memory."""
    return [path for recording in recordings for path in (recording.paths or (Path(recording.name),))]


def input_files(topics: Topics | None, *arguments: object) -> list[Path]:
    """The files of topics, and all paths among other arguments: no output may replace them."""
    of_topics = [] if topics is None else [Path(topics.origin), *(file for _, file in topics.dbc)]
    return [*of_topics, *(Path(argument) for argument in arguments if isinstance(argument, str | PathLike))]


def as_topics(topics: TopicsGiven | None) -> Topics | None:
    """A topics file, its content as a mapping, or None."""
    if topics is None:
        return None
    from trackres_ros.recording.bindings import Topics

    if isinstance(topics, Topics):
        return topics
    return Topics.load(topics) if isinstance(topics, str | PathLike) else Topics.parse(topics)
