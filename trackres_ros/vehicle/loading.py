# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Assembles a `Vehicle` from a checked file, and checks the consistency of its parts."""

from __future__ import annotations

import csv
import logging
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from trackres_ros.effects.effect import Active, VehicleKind
from trackres_ros.effects.registry import catalogue, check_effects
from trackres_ros.errors import InputError
from trackres_ros.files.documents import is_there, read_text, read_yaml
from trackres_ros.files.resources import config_dir, find_vehicle
from trackres_ros.text import figures
from trackres_ros.units import GRAVITY
from trackres_ros.vehicle import schema
from trackres_ros.vehicle.belt_bulk import arc_length
from trackres_ros.vehicle.description import (
    Assembly,
    Axle,
    Beam,
    Belt,
    Chassis,
    QuantityLimits,
    RoadWheels,
    Rubber,
    Track,
    Vehicle,
    WrappedWheel,
)
from trackres_ros.vehicle.reading import Known, ValueReader, read_disturbance

TOP_KEYS = ("schema", "name", "title", "model", "rubber", "chassis", "assemblies", "tracks")
EFFECT_KEYS = ("effects", "effect_files")
DISTURBANCE = "disturbance"
RUBBER_COLUMNS = ("T_degC", "E_storage_MPa", "E_loss_MPa")
AT_10_HZ = "_10Hz"  # possible endings of the moduli's names, as in the shipped file; the frequency is in the vehicle file
MOST_RUBBER_BYTES = 1 << 20  # a sweep has some tens of rows
OF_AXLE = r"[A-Za-z0-9_-]+", "letters a to z or A to Z, digits, _ and -"  # as in a role of a topics file
OF_ASSEMBLY = r"[A-Za-z][A-Za-z0-9_]*", "a letter a to z or A to Z, then such letters, digits and _"  # part of names of topics
CLOSED_LOOP_TOLERANCE_RAD = 0.05


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
    content, known = {key: value for key, value in read_yaml(vehicle.source).items() if key not in EFFECT_KEYS}, Known()
    return lambda overrides: replace(
        build(vehicle.source, content, overrides, known),
        hysteresis=vehicle.hysteresis,
        thermal=vehicle.thermal,
        effects=vehicle.effects,
        surroundings=vehicle.surroundings,
        route=vehicle.route,
    )


def build(
    path: Path, content: Mapping[str, Any], overrides: Mapping[str, float] | None = None, known: Known | None = None
) -> Vehicle:
    """Check the content of a vehicle file and assemble its description; see `load` and `ValueReader`."""
    reader = ValueReader(path, overrides, known)
    if isinstance(content.get("road_load"), dict):
        raise InputError(str(path), "a vehicle of the base model road_load, which has no belts", "a track vehicle")
    reader.keys(content, "", TOP_KEYS, (*EFFECT_KEYS, DISTURBANCE))
    if content["schema"] != 1:
        raise InputError(reader.where("schema"), content["schema"], "1")
    model = reader.keys(content["model"], "model", tuple(schema.MODEL_CHOICES))
    chassis, axles = _chassis(reader, content["chassis"])
    if not isinstance(content["tracks"], dict) or not content["tracks"]:
        raise InputError(reader.where("tracks"), content["tracks"], "a mapping with at least one kind of track by name")
    tracks = {str(name): _track(reader, str(name), entry) for name, entry in content["tracks"].items()}
    rubber, rubber_source = _rubber(reader, content["rubber"])
    vehicle = Vehicle(
        name=reader.text(content["name"], "name"),
        title=reader.text(content["title"], "title"),
        source=path,
        hysteresis=reader.text(model["hysteresis"], "model.hysteresis", schema.MODEL_CHOICES["hysteresis"]),
        thermal=reader.text(model["thermal"], "model.thermal", schema.MODEL_CHOICES["thermal"]),
        rubber=rubber,
        rubber_source=rubber_source,
        chassis=chassis,
        axles=axles,
        assemblies=_assemblies(reader, content["assemblies"], axles, tracks),
        tracks=MappingProxyType(tracks),
        parameters=MappingProxyType(reader.parameters),
        disturbance=read_disturbance(path, content[DISTURBANCE]) if DISTURBANCE in content else None,
    )
    vehicle = replace(vehicle, effects=listed_effects(reader, content, vehicle.size, vehicle.kind, "vehicle"))
    reader.check_overrides_used()
    return vehicle


def listed_effects(
    reader: ValueReader, content: Mapping[str, Any], size: float, kind: VehicleKind, belongs_to: str
) -> tuple[Active, ...]:
    """The effects that a file switches on, including those of its `effect_files`; see `catalogue` and `check_effects`.

    Only Python files named there are run, relative to the file that names them.
    """
    given = content.get("effect_files", [])
    if not isinstance(given, list):
        raise InputError(reader.where("effect_files"), given, "a list of Python files")
    files = [reader.path.parent / reader.text(name, f"effect_files[{i}]") for i, name in enumerate(given)]
    if not files and "effects" not in content:
        return ()
    for file in files:
        if not (is_there(file) and file.is_file()):
            raise InputError(reader.where("effect_files"), str(file), "existing Python files, relative to this file")
    known = catalogue(size=size, on_tyres=not kind.has_belt, files=files)
    return check_effects(content.get("effects", {}), reader.where("effects"), known, belongs_to, size, kind)


def _rubber(reader: ValueReader, given: Any) -> tuple[Rubber, Path]:
    values = reader.table(given, "rubber", schema.RUBBER, others=("file",))
    file = Path(reader.text(given["file"], "rubber.file"))
    path, shipped = reader.path.parent / file, config_dir() / "rubber" / file.name
    if not is_there(path) and not file.is_absolute() and is_there(shipped):
        _say_shipped(path, shipped)
        path = shipped
    if not (is_there(path) and path.is_file()):
        raise InputError(reader.where("rubber.file"), str(path), "a readable CSV with a temperature sweep, relative to this file")
    if path not in reader.known.sweeps:
        reader.known.sweeps[path] = read_rubber_sweep(path)
    sweep_degc, storage_pa, loss_pa = reader.known.sweeps[path]
    return Rubber(sweep_degc, storage_pa, loss_pa, **values), path


@cache
def _say_shipped(path: Path, shipped: Path) -> None:
    """Log, once, that the shipped file is used in place of a missing one of that name."""
    logging.getLogger("trackres").warning("trackres: %s does not exist: the shipped %s is used", path, shipped)


def read_rubber_sweep(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Read a temperature sweep: T [degC], storage and loss modulus [Pa], each of shape (temperatures,).

    The file is a CSV with the columns T_degC, E_storage_MPa and E_loss_MPa, or E_storage_MPa_10Hz and E_loss_MPa_10Hz; the
    sweep's frequency is in the vehicle file. Further columns are allowed, and lines that begin with # are comments.
    """
    text = read_text(path, "CSV with a temperature sweep", MOST_RUBBER_BYTES)
    numbered = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip() and line[0] != "#"]
    try:
        rows = list(csv.DictReader(line for _, line in numbered))
    except csv.Error as error:
        raise InputError(f"{path}", str(error), "a CSV with a temperature sweep") from None
    given = list(rows[0]) if rows else []
    columns = [name if name in given else f"{name}{AT_10_HZ}" for name in RUBBER_COLUMNS]
    missing = [name for name, column in zip(RUBBER_COLUMNS, columns, strict=True) if column not in given]
    if len(rows) < 4 or missing:
        # A vehicle file may name any file: if it is no rubber file, the error shows no content.
        raise InputError(
            f"{path}",
            f"{len(rows)} rows {f'without the column {missing[0]}' if missing else 'below the column names'}",
            f"at least four rows with the columns {', '.join(RUBBER_COLUMNS)} (or with {AT_10_HZ} behind the last two)",
            "trackres compound fit reads the file of a DMA instrument",
        )
    table = np.empty((len(rows), 3))
    for i, row in enumerate(rows):
        for j, name in enumerate(columns):
            try:
                table[i, j] = float(row[name])
            except (TypeError, ValueError):
                raise InputError(f"{path}: row {numbered[i + 1][0]}, {name}", row[name], "a number") from None
    if not np.isfinite(table).all() or (np.diff(table[:, 0]) <= 0).any():
        refused = "temperatures that do not increase, or values that are not finite"
        raise InputError(f"{path}", refused, "finite numbers with T_degC increasing from row to row")
    _check_sweep(path, table, columns)
    return table[:, 0].copy(), table[:, 1] * 1e6, table[:, 2] * 1e6


def _check_sweep(path: Path, table: np.ndarray, names: Sequence[str]) -> None:
    """Refuse moduli impossible for rubber, such as values in Pa below a header in MPa."""
    degc, storage, loss = table.T
    moduli = "the columns are in MPa: divide values in Pa by 1e6, multiply values in GPa by 1000"
    for what, values, limits, remedy in (
        (names[0], degc, schema.SWEEP_DEGC, "subtract 273.15 from values in kelvin"),
        (names[1], storage, schema.SWEEP_STORAGE, moduli),
        (names[2], loss, schema.SWEEP_LOSS, moduli),
    ):
        _within(path, what, values, limits, remedy)
    columns = "check that both columns are of one test and in one unit"
    with np.errstate(over="ignore"):
        _within(path, "loss over storage modulus", loss / storage, schema.SWEEP_TAN_DELTA, columns)
    _within(path, f"storage modulus at {degc[-1]:g} degC", storage[-1:], schema.WARM_STORAGE, moduli)


def _within(path: Path, what: str, values: np.ndarray, limits: QuantityLimits, remedy: str) -> None:
    if values.min() < limits.low or values.max() > limits.high:
        given = f"{figures(values.min(), 4)} to {figures(values.max(), 4)} {limits.unit}"
        raise InputError(f"{path}: {what}", given, f"{limits.low:g} to {limits.high:g} {limits.unit}", remedy)


def _chassis(reader: ValueReader, given: Any) -> tuple[Chassis, tuple[Axle, ...]]:
    values: dict[str, Any] = reader.table(given, "chassis", schema.CHASSIS, others=("axles",))
    values.setdefault("max_acceleration", GRAVITY)  # limit of friction on the ground
    values.setdefault("motor_ratio", None)
    values.setdefault("motor_efficiency", None)
    if (values["motor_ratio"] is None) != (values["motor_efficiency"] is None):
        raise InputError(reader.where("chassis.motor_ratio"), "one of motor_ratio and motor_efficiency", "both or neither")
    axles = []
    for i, entry in enumerate(reader.items(given["axles"], "chassis.axles")):
        reader.keys(entry, f"chassis.axles[{i}]", ("name", "load"))
        name = reader.name(entry["name"], f"chassis.axles[{i}].name", OF_AXLE)
        axles.append(Axle(name, reader.quantity(entry["load"], f"chassis.axles.{name}.load", schema.AXLE_LOAD)))
    _refuse_repeats(reader, "chassis.axles", [axle.name for axle in axles])
    return Chassis(**values), tuple(axles)


def _assemblies(reader: ValueReader, given: Any, axles: tuple[Axle, ...], tracks: Mapping[str, Track]) -> tuple[Assembly, ...]:
    assemblies = []
    names = tuple(axle.name for axle in axles)
    for i, entry in enumerate(reader.items(given, "assemblies")):
        key = f"assemblies[{i}]"
        reader.keys(entry, key, ("name", "axle", "track"))
        assemblies.append(
            Assembly(
                reader.name(entry["name"], f"{key}.name", OF_ASSEMBLY),
                reader.text(entry["axle"], f"{key}.axle", names),
                reader.text(entry["track"], f"{key}.track", tuple(tracks)),
            )
        )
    _refuse_repeats(reader, "assemblies", [a.name for a in assemblies] + list(names))
    for name in names:
        if all(a.axle != name for a in assemblies):
            raise InputError(reader.where("assemblies"), f"no assembly on axle {name}", "at least one assembly an axle")
    for name in tracks:
        if all(a.track != name for a in assemblies):
            raise InputError(
                reader.where("assemblies"), f"no assembly of the track {name}", "at least one assembly a kind of track"
            )
    return tuple(assemblies)


def _refuse_repeats(reader: ValueReader, key: str, names: list[str]) -> None:
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise InputError(reader.where(key), ", ".join(repeated), "unique names of axles and assemblies")


def _track(reader: ValueReader, name: str, given: Any) -> Track:
    key = f"tracks.{name}"
    values = reader.table(given, key, schema.TRACK, others=("belt", "road_wheels", "wrapped_wheels", "beams"))
    belt_values = reader.table(given["belt"], f"{key}.belt", schema.BELT, others=("film_speed_unit",))
    unit = reader.text(given["belt"]["film_speed_unit"], f"{key}.belt.film_speed_unit", schema.FILM_SPEED_UNITS)
    wheels = reader.keys(given["road_wheels"], f"{key}.road_wheels", tuple(schema.ROAD_WHEELS))
    road_wheels = RoadWheels(
        positions=reader.quantities(wheels["positions"], f"{key}.road_wheels.positions", schema.ROAD_WHEELS["positions"]),
        **{
            part: reader.quantity(wheels[part], f"{key}.road_wheels.{part}", schema.ROAD_WHEELS[part])
            for part in ("radius", "contact_length", "ground_run")
        },
    )
    track = Track(
        name=name,
        belt=Belt(film_speed_unit=unit, **belt_values),
        road_wheels=road_wheels,
        wrapped_wheels=_wrapped_wheels(reader, key, given["wrapped_wheels"], values["sprocket_radius"]),
        beams=_beam(reader, f"{key}.beams", given["beams"], top=True),
        **values,
    )
    _check_geometry(reader, key, track)
    return track


def _wrapped_wheels(reader: ValueReader, key: str, given: Any, sprocket_radius: float) -> tuple[WrappedWheel, ...]:
    wheels = []
    for i, entry in enumerate(reader.items(given, f"{key}.wrapped_wheels")):
        place = f"{key}.wrapped_wheels[{i}]"
        sprocket = isinstance(entry, dict) and entry.get("kind") == "sprocket"
        reader.keys(entry, place, ("name", "kind", "wrap_angle") if sprocket else ("name", "kind", "radius", "wrap_angle"))
        name = reader.text(entry["name"], f"{place}.name")
        kind = reader.text(entry["kind"], f"{place}.kind", schema.WHEEL_KINDS)
        path = f"{key}.wrapped_wheels.{name}"
        radius = sprocket_radius
        if not sprocket:
            radius = reader.quantity(entry["radius"], f"{path}.radius", schema.WRAPPED_WHEEL["radius"])
        wrap = reader.quantity(entry["wrap_angle"], f"{path}.wrap_angle", schema.WRAPPED_WHEEL["wrap_angle"])
        wheels.append(WrappedWheel(name, kind, radius, wrap))
    if sum(wheel.kind == "sprocket" for wheel in wheels) != 1:
        raise InputError(reader.where(f"{key}.wrapped_wheels"), [wheel.kind for wheel in wheels], "exactly one sprocket")
    return tuple(wheels)


def _beam(reader: ValueReader, key: str, given: Any, top: bool = False) -> Beam | int:
    if isinstance(given, int) and not isinstance(given, bool):
        return given - 1
    names = ("split", "front", "rear")
    reader.keys(given, key, names, ("own_weight_split",) if top else ())
    split = reader.quantity(given["split"], f"{key}.split", schema.BEAM["split"])
    own = split
    if "own_weight_split" in given:
        own = reader.quantity(given["own_weight_split"], f"{key}.own_weight_split", schema.BEAM["own_weight_split"])
    return Beam(split, own, _beam(reader, f"{key}.front", given["front"]), _beam(reader, f"{key}.rear", given["rear"]))


def _check_geometry(reader: ValueReader, key: str, track: Track) -> None:
    """Refuse a track whose parts do not fit each other."""
    belt, wheels = track.belt, track.road_wheels

    def refused(part: str, given: object, allowed: str, remedy: str = "") -> InputError:
        return InputError(reader.where(f"{key}.{part}"), given, allowed, remedy)

    positions = np.array(wheels.positions)
    count = len(positions)
    if (np.diff(positions) <= 0).any() or positions[-1] > wheels.ground_run:
        allowed = f"rising positions on the ground run of {wheels.ground_run:g} m"
        raise refused("road_wheels.positions", list(wheels.positions), allowed)
    hung = [track.beams] if isinstance(track.beams, int) else list(track.beams.wheels())
    if sorted(hung) != list(range(count)):
        raise refused("beams", [wheel + 1 for wheel in hung], f"each road wheel 1 to {count} on exactly one beam end")
    if belt.cord_height >= belt.thickness:
        raise refused("belt.cord_height", belt.cord_height, f"less than the thickness {belt.thickness:g} m")
    if wheels.contact_length > belt.width:
        raise refused("road_wheels.contact_length", wheels.contact_length, f"at most the belt width {belt.width:g} m")
    reach = 2 * wheels.radius * (1 - 1e-9)
    abreast = max(int(np.count_nonzero((positions >= at) & (positions < at + reach))) for at in positions)  # if they interleave
    if abreast * wheels.contact_length > belt.width:
        raise refused(
            "road_wheels.positions",
            f"{abreast} wheels of radius {wheels.radius:g} m that overlap along the track, with contacts of "
            f"{wheels.contact_length:g} m each on a belt {belt.width:g} m wide",
            f"wheels at least {2 * wheels.radius:g} m apart, or so narrow that overlapping wheels fit side by side",
            "check radius (not diameter) and positions",
        )
    tread = belt.tread_depth * belt.width * belt.tread_land_ratio
    if tread > belt.lug_section:
        raise refused("belt.lug_section", belt.lug_section, f"at least the tread bars {figures(tread, 4)} m^2")
    if belt.cord_section >= belt.width * belt.thickness / 2:
        raise refused("belt.cord_section", belt.cord_section, "less than half the belt section")
    wraps = sum(wheel.wrap_angle for wheel in track.wrapped_wheels)
    if abs(wraps - 2 * math.pi) > CLOSED_LOOP_TOLERANCE_RAD:
        allowed = f"a closed loop: 2 pi within {CLOSED_LOOP_TOLERANCE_RAD} rad"
        raise refused("wrapped_wheels", f"wrap angles that sum to {wraps:.3f} rad", allowed)
    arcs = sum(arc_length(wheel.radius, wheel.wrap_angle, belt) for wheel in track.wrapped_wheels)
    if wheels.ground_run + arcs >= belt.loop_length:
        allowed = f"more than the ground run and the wraps together, {wheels.ground_run + arcs:.3f} m"
        raise refused("belt.loop_length", belt.loop_length, allowed)
