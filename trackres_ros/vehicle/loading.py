# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads the file of a track vehicle, where every value must be stated, and checks the consistency of its parts."""

from __future__ import annotations

import csv
import logging
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from trackres_ros import checks
from trackres_ros.arrays import Array
from trackres_ros.effects.effect import Active, VehicleKind
from trackres_ros.effects.registry import catalogue, check_effects
from trackres_ros.errors import InputError, nearest
from trackres_ros.files.dataclass_reader import DataReader, Limits
from trackres_ros.files.documents import is_there, read_text, read_yaml
from trackres_ros.files.resources import config_dir, find_vehicle
from trackres_ros.text import figures
from trackres_ros.vehicle.belt_bulk import arc_length
from trackres_ros.vehicle.description import (
    CHASSIS,
    RUBBER,
    SPROCKET,
    Chassis,
    Disturbance,
    Flag,
    Quantity,
    Rubber,
    RubberSection,
    Spells,
    Track,
    TrackVehicleFile,
    Vehicle,
)

EFFECT_KEYS = ("effects", "effect_files")
DISTURBANCE = "disturbance"
RUBBER_COLUMNS = ("T_degC", "E_storage_MPa", "E_loss_MPa")
AT_10_HZ = "_10Hz"  # possible endings of the moduli's names, as in the shipped file; the frequency is in the vehicle file
MOST_RUBBER_BYTES = 1 << 20  # a sweep has some tens of rows
CLOSED_LOOP_TOLERANCE_RAD = 0.05

# The temperature sweep. A rubber is glassy at some GPa at most, and at the warm end no rubber above 1 GPa; filled or not its
# loss over storage modulus stays within tan delta (Mark, Erman, Roland: The Science and Technology of Rubber, 4th ed., ch. 3).
SWEEP_DEGC = Limits("degC", -150.0, 300.0, "temperature of a row")
SWEEP_STORAGE = Limits("MPa", 0.05, 2e4, "storage modulus")
SWEEP_LOSS = Limits("MPa", 1e-4, 1e4, "loss modulus")
SWEEP_TAN_DELTA = Limits("1", 1e-4, 5.0, "loss over storage modulus")
WARM_STORAGE = Limits("MPa", 0.05, 1e3, "storage modulus at the warm end, where it is a rubber")


@dataclass(frozen=True, slots=True)
class ReadCache:
    """What several vehicles of one content have in common, once it is read and checked."""

    quantities: dict[str, tuple[Any, Quantity]] = field(default_factory=dict)  # by path, each with its entry in the content
    sweeps: dict[Path, tuple[Array, Array, Array]] = field(default_factory=dict)  # of rubber files


@dataclass(frozen=True, slots=True)
class QuantityEntry:
    """A quantity in a vehicle file."""

    value: Any
    unit: Any
    flag: Flag
    range: Any
    reason: str


class VehicleReader(DataReader):
    """Reads a vehicle file: what has limits is a quantity there, and recorded by its path.

    The quantities of a disturbance are not recorded, as it affects neither the estimate, nor its uncertainty, nor the validity of
    a stored state. `read_cache`: shared by readers of one content, so that each checks only what an override changes.
    """

    def __init__(self, path: Path, overrides: Mapping[str, float] | None = None, read_cache: ReadCache | None = None) -> None:
        super().__init__(path)
        self.path = path
        self.read_cache = ReadCache() if read_cache is None else read_cache
        self.parameters: dict[str, Quantity] = {}
        self._overrides = dict(overrides or {})

    def read_noted(self, kind: Any, note: Any, value: Any, key: str) -> Any:
        """Read a quantity, or another value with a note."""
        if not isinstance(note, Limits):
            return super().read_noted(kind, note, value, key)
        entry, quantity = self.read_cache.quantities.get(key, (None, None))
        if quantity is None or entry is not value or key in self._overrides:
            quantity = self._quantity(value, key, note)
            if key not in self._overrides:
                self.read_cache.quantities[key] = value, quantity
        if not key.startswith(f"{DISTURBANCE}."):
            self.parameters[key] = quantity
        if kind == tuple[float, ...]:
            return quantity.value if isinstance(quantity.value, tuple) else (quantity.value,)
        if isinstance(quantity.value, tuple):
            raise InputError(self.where(f"{key}.value"), list(quantity.value), "one number")
        return quantity.value

    def _quantity(self, content: Any, key: str, limits: Limits) -> Quantity:
        entry: QuantityEntry = self.part(QuantityEntry, content, key)
        place = self.where(f"{key}.value")
        if entry.unit != limits.unit:
            raise InputError(self.where(f"{key}.unit"), entry.unit, limits.unit, "convert the value to this unit")
        low, high = checks.span(entry.range, self.where(f"{key}.range"), limits.low, limits.high, limits.unit)
        value: float | tuple[float, ...]
        if key in self._overrides and not isinstance(entry.value, list):  # a fit may leave the file's range, never the limits
            value = checks.number(self._overrides[key], self.where(key), limits.low, limits.high, limits.unit)
            return Quantity(value, limits.unit, entry.flag, min(low, value), max(high, value), entry.reason)
        values = entry.value if isinstance(entry.value, list) else [entry.value]
        if not values:
            raise InputError(place, values, "at least one number")
        remedy = "correct the value, or widen its range if you trust the value"
        numbers = tuple(checks.number(item, place, low, high, limits.unit, if_outside=remedy) for item in values)
        value = numbers if isinstance(entry.value, list) else numbers[0]
        return Quantity(value, limits.unit, entry.flag, low, high, entry.reason)

    def check_overrides_used(self) -> None:
        """Refuse overrides whose path is not in the file."""
        for key in self._overrides:
            if key not in self.parameters or isinstance(self.parameters[key].value, tuple):
                allowed = "the path of a scalar quantity in this file"
                raise InputError(self.where(key), key, allowed, nearest(key, self.parameters))


def load(path_or_name: str | os.PathLike[str], overrides: Mapping[str, float] | None = None) -> Vehicle:
    """Load a vehicle file.

    Parameters
    ----------
    path_or_name
        Path of a vehicle file, or the name of a shipped vehicle such as ``xgd24d``.
    overrides
        Values that replace those of the file, by path, such as ``{"tracks.triangular.belt.thickness": 0.03}`` (SI).

    Raises
    ------
    InputError
        On a missing, unknown, non-finite or implausible value; names file, key, the given and the allowed values.
    """
    path = find_vehicle(path_or_name)
    return build(path, read_yaml(path), overrides)


def variants(vehicle: Vehicle) -> Callable[[Mapping[str, float]], Vehicle]:
    """A function that makes the same vehicle with other values, by path; it reads the file only once, and effects stay."""
    content, read_cache = {key: value for key, value in read_yaml(vehicle.source).items() if key not in EFFECT_KEYS}, ReadCache()
    return lambda overrides: replace(
        build(vehicle.source, content, overrides, read_cache),
        hysteresis=vehicle.hysteresis,
        thermal=vehicle.thermal,
        effects=vehicle.effects,
        surroundings=vehicle.surroundings,
        route=vehicle.route,
    )


def build(
    path: Path, content: Mapping[str, Any], overrides: Mapping[str, float] | None = None, read_cache: ReadCache | None = None
) -> Vehicle:
    """Check the content of a vehicle file and assemble its description; see `load` and `VehicleReader`."""
    if isinstance(content.get("road_load"), dict):
        raise InputError(str(path), "a vehicle of the base model road_load, which has no belts", "a track vehicle")
    reader = VehicleReader(path, overrides, read_cache)
    file: TrackVehicleFile = reader.part(TrackVehicleFile, content)
    if (file.chassis.motor_ratio is None) != (file.chassis.motor_efficiency is None):
        raise InputError(reader.where("chassis.motor_ratio"), "one of motor_ratio and motor_efficiency", "both or neither")
    _check_assemblies(reader, file)
    rubber, rubber_source = _rubber(reader, file.rubber)
    vehicle = Vehicle(
        name=file.name,
        title=file.title,
        source=path,
        hysteresis=file.model.hysteresis,
        thermal=file.model.thermal,
        rubber=rubber,
        rubber_source=rubber_source,
        chassis=Chassis(**{name: getattr(file.chassis, name) for name in CHASSIS}),
        axles=file.chassis.axles,
        assemblies=file.assemblies,
        tracks=MappingProxyType({name: _track(reader, track) for name, track in file.tracks.items()}),
        parameters=MappingProxyType(reader.parameters),
        disturbance=checked_disturbance(reader, file.disturbance),
    )
    vehicle = replace(
        vehicle, effects=listed_effects(reader, file.effects, file.effect_files, vehicle.size, vehicle.kind, "vehicle")
    )
    reader.check_overrides_used()
    return vehicle


def checked_disturbance(reader: VehicleReader, disturbance: Disturbance | None) -> Disturbance | None:
    """A disturbance, if its levels differ."""
    if isinstance(disturbance, Spells) and disturbance.level == disturbance.rest:
        raise InputError(reader.where(f"{DISTURBANCE}.level"), disturbance.level, "a torque different from that of the rest")
    return disturbance


def listed_effects(
    reader: VehicleReader,
    effects: Mapping[str, Any],
    effect_files: Sequence[str],
    size: float,
    kind: VehicleKind,
    belongs_to: str,
) -> tuple[Active, ...]:
    """The effects that a file switches on, including those of its `effect_files`; see `catalogue` and `check_effects`.

    Only Python files named there are run, relative to the file that names them.
    """
    if not effect_files and not effects:
        return ()
    files = [reader.path.parent / name for name in effect_files]
    for file in files:
        if not (is_there(file) and file.is_file()):
            raise InputError(reader.where("effect_files"), str(file), "existing Python files, relative to this file")
    effects_known = catalogue(size=size, on_tyres=not kind.has_belt, files=files)
    return check_effects(effects, reader.where("effects"), effects_known, belongs_to, size, kind)


def _rubber(reader: VehicleReader, section: RubberSection) -> tuple[Rubber, Path]:
    file = Path(section.file)
    path, package_path = reader.path.parent / file, config_dir() / "rubber" / file.name
    if not is_there(path) and not file.is_absolute() and is_there(package_path):
        _say_shipped(path, package_path)
        path = package_path
    if not (is_there(path) and path.is_file()):
        raise InputError(reader.where("rubber.file"), str(path), "a readable CSV with a temperature sweep, relative to this file")
    if path not in reader.read_cache.sweeps:
        reader.read_cache.sweeps[path] = read_rubber_sweep(path)
    sweep_degc, storage_pa, loss_pa = reader.read_cache.sweeps[path]
    values = {name: getattr(section, name) for name in RUBBER}
    return Rubber(**values, sweep_degc=sweep_degc, storage_pa=storage_pa, loss_pa=loss_pa), path


@cache
def _say_shipped(path: Path, package_path: Path) -> None:
    """Log, once, that the shipped file is used in place of a missing one of that name."""
    logging.getLogger("trackres").warning("trackres: %s does not exist: the shipped %s is used", path, package_path)


def read_rubber_sweep(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Read a temperature sweep: T [degC], storage and loss modulus [Pa], each of shape (temperatures,).

    The file is a CSV with the columns T_degC, E_storage_MPa and E_loss_MPa, or E_storage_MPa_10Hz and E_loss_MPa_10Hz; the
    sweep's frequency is in the vehicle file. Further columns are allowed, and lines that begin with # are comments.
    """
    text = read_text(path, "CSV with a temperature sweep", MOST_RUBBER_BYTES)
    lines = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip() and line[0] != "#"]
    try:
        rows = list(csv.DictReader(line for _, line in lines))
    except csv.Error as error:
        raise InputError(f"{path}", str(error), "a CSV with a temperature sweep") from None
    header = list(rows[0]) if rows else []
    columns = [name if name in header else f"{name}{AT_10_HZ}" for name in RUBBER_COLUMNS]
    missing_columns = [name for name, column in zip(RUBBER_COLUMNS, columns, strict=True) if column not in header]
    if len(rows) < 4 or missing_columns:
        # A vehicle file may name any file: if it is no rubber file, the error shows no content.
        raise InputError(
            f"{path}",
            f"{len(rows)} rows {f'without the column {missing_columns[0]}' if missing_columns else 'below the column names'}",
            f"at least four rows with the columns {', '.join(RUBBER_COLUMNS)} (or with {AT_10_HZ} behind the last two)",
            "trackres compound fit reads the file of a DMA instrument",
        )
    table = np.empty((len(rows), 3))
    for i, row in enumerate(rows):
        for j, name in enumerate(columns):
            try:
                table[i, j] = float(row[name])
            except (TypeError, ValueError):
                raise InputError(f"{path}: row {lines[i + 1][0]}, {name}", row[name], "a number") from None
    if not np.isfinite(table).all() or (np.diff(table[:, 0]) <= 0).any():
        problem = "temperatures that do not increase, or values that are not finite"
        raise InputError(f"{path}", problem, "finite numbers with T_degC increasing from row to row")
    _check_sweep(path, table, columns)
    return table[:, 0].copy(), table[:, 1] * 1e6, table[:, 2] * 1e6


def _check_sweep(path: Path, table: np.ndarray, names: Sequence[str]) -> None:
    """Refuse moduli impossible for rubber, such as values in Pa below a header in MPa."""
    degc, storage, loss = table.T
    moduli = "the columns are in MPa: divide values in Pa by 1e6, multiply values in GPa by 1000"
    for name, values, limits, remedy in (
        (names[0], degc, SWEEP_DEGC, "subtract 273.15 from values in kelvin"),
        (names[1], storage, SWEEP_STORAGE, moduli),
        (names[2], loss, SWEEP_LOSS, moduli),
    ):
        _check_limits(path, name, values, limits, remedy)
    columns = "check that both columns are of one test and in one unit"
    with np.errstate(over="ignore"):
        _check_limits(path, "loss over storage modulus", loss / storage, SWEEP_TAN_DELTA, columns)
    _check_limits(path, f"storage modulus at {degc[-1]:g} degC", storage[-1:], WARM_STORAGE, moduli)


def _check_limits(path: Path, name: str, values: np.ndarray, limits: Limits, remedy: str) -> None:
    if values.min() < limits.low or values.max() > limits.high:
        span = f"{figures(values.min(), 4)} to {figures(values.max(), 4)} {limits.unit}"
        raise InputError(f"{path}: {name}", span, f"{limits.low:g} to {limits.high:g} {limits.unit}", remedy)


def _check_assemblies(reader: VehicleReader, file: TrackVehicleFile) -> None:
    """Refuse repeated names, assemblies on unknown axles or of unknown tracks, and unused axles and tracks."""
    axles, tracks = [axle.name for axle in file.chassis.axles], list(file.tracks)
    for key, names in (("chassis.axles", axles), ("assemblies", [*(a.name for a in file.assemblies), *axles])):
        duplicates = sorted({name for name in names if names.count(name) > 1})
        if duplicates:
            raise InputError(reader.where(key), ", ".join(duplicates), "unique names of axles and assemblies")
    for assembly in file.assemblies:
        key = f"assemblies.{assembly.name}"
        checks.one_of(assembly.axle, reader.where(f"{key}.axle"), axles)
        checks.one_of(assembly.track, reader.where(f"{key}.track"), tracks)
    place = reader.where("assemblies")
    for name in axles:
        if all(assembly.axle != name for assembly in file.assemblies):
            raise InputError(place, f"no assembly on axle {name}", "at least one assembly an axle")
    for name in tracks:
        if all(assembly.track != name for assembly in file.assemblies):
            raise InputError(place, f"no assembly of the track {name}", "at least one assembly a kind of track")


def _track(reader: VehicleReader, track: Track) -> Track:
    """A track with the radius of its sprocket, if its parts fit each other."""
    key, wheels = f"tracks.{track.name}", track.wrapped_wheels
    for wheel in wheels:
        place = reader.where(f"{key}.wrapped_wheels.{wheel.name}.radius")
        if wheel.kind == SPROCKET and not math.isnan(wheel.radius):
            raise InputError(place, wheel.radius, "no radius of a sprocket: sprocket_radius of the track is its radius")
        if wheel.kind != SPROCKET and math.isnan(wheel.radius):
            raise InputError(place, "nothing", "this key is required")
    if sum(wheel.kind == SPROCKET for wheel in wheels) != 1:
        raise InputError(reader.where(f"{key}.wrapped_wheels"), [wheel.kind for wheel in wheels], "exactly one sprocket")
    top = f"{key}.beams.own_weight_split"
    for path in reader.parameters:
        if path.startswith(f"{key}.beams.") and path.endswith(".own_weight_split") and path != top:
            raise InputError(reader.where(path), "own_weight_split", "this key of the top beam alone")
    wheels = tuple(replace(wheel, radius=track.sprocket_radius) if wheel.kind == SPROCKET else wheel for wheel in wheels)
    track = replace(track, wrapped_wheels=wheels)
    _check_geometry(reader, key, track)
    return track


def _check_geometry(reader: VehicleReader, key: str, track: Track) -> None:
    """Refuse a track whose parts do not fit each other."""
    belt, wheels = track.belt, track.road_wheels

    def refusal(part: str, value: object, allowed: str, remedy: str = "") -> InputError:
        return InputError(reader.where(f"{key}.{part}"), value, allowed, remedy)

    positions = np.array(wheels.positions)
    count = len(positions)
    if (np.diff(positions) <= 0).any() or positions[-1] > wheels.ground_run:
        allowed = f"rising positions on the ground run of {wheels.ground_run:g} m"
        raise refusal("road_wheels.positions", list(wheels.positions), allowed)
    beam_wheels = [track.beams] if isinstance(track.beams, int) else list(track.beams.wheels())
    if sorted(beam_wheels) != list(range(count)):
        raise refusal("beams", [wheel + 1 for wheel in beam_wheels], f"each road wheel 1 to {count} on exactly one beam end")
    if belt.cord_height >= belt.thickness:
        raise refusal("belt.cord_height", belt.cord_height, f"less than the thickness {belt.thickness:g} m")
    if wheels.contact_length > belt.width:
        raise refusal("road_wheels.contact_length", wheels.contact_length, f"at most the belt width {belt.width:g} m")
    reach = 2 * wheels.radius * (1 - 1e-9)
    row_count = max(
        int(np.count_nonzero((positions >= position) & (positions < position + reach))) for position in positions
    )  # if they interleave
    if row_count * wheels.contact_length > belt.width:
        raise refusal(
            "road_wheels.positions",
            f"{row_count} wheels of radius {wheels.radius:g} m that overlap along the track, with contacts of "
            f"{wheels.contact_length:g} m each on a belt {belt.width:g} m wide",
            f"wheels at least {2 * wheels.radius:g} m apart, or so narrow that overlapping wheels fit side by side",
            "check radius (not diameter) and positions",
        )
    tread = belt.tread_depth * belt.width * belt.tread_land_ratio
    if tread > belt.lug_section:
        raise refusal("belt.lug_section", belt.lug_section, f"at least the tread bars {figures(tread, 4)} m^2")
    if belt.cord_section >= belt.width * belt.thickness / 2:
        raise refusal("belt.cord_section", belt.cord_section, "less than half the belt section")
    wraps = sum(wheel.wrap_angle for wheel in track.wrapped_wheels)
    if abs(wraps - 2 * math.pi) > CLOSED_LOOP_TOLERANCE_RAD:
        allowed = f"a closed loop: 2 pi within {CLOSED_LOOP_TOLERANCE_RAD} rad"
        raise refusal("wrapped_wheels", f"wrap angles that sum to {wraps:.3f} rad", allowed)
    arcs = sum(arc_length(wheel.radius, wheel.wrap_angle, belt) for wheel in track.wrapped_wheels)
    if wheels.ground_run + arcs >= belt.loop_length:
        allowed = f"more than the ground run and the wraps together, {wheels.ground_run + arcs:.3f} m"
        raise refusal("belt.loop_length", belt.loop_length, allowed)
