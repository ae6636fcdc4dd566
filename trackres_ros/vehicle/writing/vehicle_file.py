# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes the results of a diagnosis for use: the vehicle file with the learned changes, and the surroundings' file.

The rubber's file and those of a user's own effects are copied to the same folder, so that it can be moved as a whole.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from trackres_ros.effects.effect import Active
from trackres_ros.errors import InputError
from trackres_ros.files.dataclass_reader import Limits
from trackres_ros.files.documents import MOST_BYTES, read_text, read_yaml
from trackres_ros.files.file_sets import file_set, is_free, present_content
from trackres_ros.files.own_files import remove, write
from trackres_ros.route.learned import RouteMap
from trackres_ros.route.table import write_route
from trackres_ros.vehicle import Quantity, RoadVehicle, Vehicle
from trackres_ros.vehicle.belt_bulk import heat_capacity
from trackres_ros.vehicle.description import BELT, CHASSIS, DISTURBANCES, FITTED, RUBBER
from trackres_ros.vehicle.road import ROAD_LOAD, SECTION
from trackres_ros.vehicle.writing.changes import DIAGNOSE, FileChanges, LearnedDisturbance
from trackres_ros.vehicle.writing.yaml_edit import Document, flow

REFITTED = "re-fitted by"
FOUND = f"found by {DIAGNOSE}"
DIAGNOSED = f"# Written by {DIAGNOSE}"
WRITTEN = DIAGNOSED, "# Written by trackres coastdown"
SURROUNDINGS_FILE = "surroundings.yaml"
ROUTE_FILE = "route.csv"
FIGURES = 6

Range = tuple[float, float] | None


@file_set()
def write_track_vehicle(vehicle: Vehicle, path: Path, changes: FileChanges, text: str) -> list[Path]:
    """Write a track vehicle with the accepted changes, and what a diagnosis found of the surroundings; return all its files.

    The first is the vehicle file. Of a diagnosis the surroundings are next, if there are any. `text` is their origin, for the
    comments.
    """
    document = open_document(vehicle.source)
    rubber = copy_pairs(vehicle.rubber_source, path.parent, Path("rubber") / vehicle.rubber_source.name)
    document.set(("rubber", "file"), rubber)
    for key, method in (("hysteresis", vehicle.hysteresis), ("thermal", vehicle.thermal)):
        document.set(("model", key), method)
    if changes.values is not None:
        _set_values(document, vehicle, changes.values, changes)
    files = finish(
        document, vehicle.name, _effect_files(vehicle.source), vehicle.surroundings, path, changes, text, vehicle.route
    )
    return [*files, path.parent / rubber]


@file_set()
def write_road_vehicle(vehicle: RoadVehicle, path: Path, changes: FileChanges, text: str) -> list[Path]:
    """The same of a vehicle on wheels."""
    document = open_document(vehicle.source)
    for name, value in (changes.values or {}).items():
        quantity = vehicle.parameters[f"{SECTION}.{name}"]
        set_quantity(document, (SECTION, name), quantity, value, changes.range_of(name), ROAD_LOAD[name], changes.command)
    return finish(document, vehicle.name, _effect_files(vehicle.source), vehicle.surroundings, path, changes, text, vehicle.route)


def _set_values(document: Document, vehicle: Vehicle, values: Mapping[str, float], changes: FileChanges) -> None:
    def set_value(path: tuple[str, ...], value: float, interval: Range, limits: Mapping[str, Limits]) -> None:
        set_quantity(document, path, vehicle.parameters[".".join(path)], value, interval, limits[path[-1]], changes.command)

    for section, name, limits in (
        ("rubber", "loss_modulus_scale", RUBBER),
        ("chassis", "bearing_friction", CHASSIS),
        ("chassis", "drag_coefficient", CHASSIS),
        ("rubber", "conductivity", RUBBER),
    ):
        if name in values:
            set_value((section, name), values[name], changes.range_of(name), limits)

    def scaled(name: str, old_value: float) -> list[float]:  # its value, and the ends of its interval
        return [old_value * scale for scale in (values.get(name, 1.0), *(changes.range_of(name) or ()))]

    capacity = [_heat_capacity(vehicle, scale) for scale in scaled("capacity_scale", 1.0)]
    set_value(("rubber", "heat_capacity"), capacity[0], _range(capacity[1:]), RUBBER)
    first_belt = vehicle.track_of(vehicle.assemblies[0]).belt
    for name, track in vehicle.tracks.items():
        belt, over_first = ("tracks", name, "belt"), track.belt.surface_share / first_belt.surface_share
        for film, old_value in (("film_offset", track.belt.film_offset), ("film_slope", track.belt.film_slope)):
            value, *ends = scaled("film_scale", old_value)
            set_value((*belt, film), value, _range(ends if old_value else ()), BELT)  # 0 stays as uncertain as it is
        if "surface_share" in values:
            share, *ends = (over_first * x for x in (values["surface_share"], *(changes.range_of("surface_share") or ())))
            set_value((*belt, "surface_share"), share, _range(ends), BELT)


def _set_disturbance(document: Document, disturbance: LearnedDisturbance) -> None:
    """Write the disturbance to watch for; it replaces the disturbance of an earlier file."""
    form, limits = disturbance.disturbance.form, DISTURBANCES[disturbance.disturbance.form]
    entries: dict[str, Any] = {"form": form}
    for name, limit in limits.items():
        value, (low, high) = _figures(getattr(disturbance.disturbance, name)), disturbance.ranges[name]
        entries[name] = {
            "value": value,
            "unit": limit.unit,
            "flag": FITTED,
            "range": [_figures(min(low, value)), _figures(max(high, value))],
            "reason": FOUND,
        }
    document.put_section("disturbance", entries)


def _range(pair: Sequence[float]) -> Range:
    return (min(pair), max(pair)) if pair else None


def _heat_capacity(vehicle: Vehicle, scale: float) -> float:
    """Specific heat capacity of the rubber [J/kg/K] that gives the first belt, with its cords, `scale` times its capacity."""
    share = rubber_share(vehicle, vehicle.assemblies[0].track)
    return vehicle.rubber.heat_capacity * (scale - 1.0 + share) / share


def rubber_share(vehicle: Vehicle, track: str = "") -> float:
    """Share of the rubber, without cords, in the heat capacity of the belt of a track, by default of all belts together."""
    belts = [vehicle.tracks[track or assembly.track].belt for assembly in vehicle.assemblies]
    cords, total = (
        sum(heat_capacity(belt, rubber) for belt in belts)
        for rubber in (replace(vehicle.rubber, heat_capacity=0.0), vehicle.rubber)
    )
    return float(1.0 - cords / total)


def open_document(source: Path) -> Document:
    """A vehicle file to be changed, without the comment of an earlier fit at its top."""
    lines = read_text(source, "YAML file", MOST_BYTES).splitlines(keepends=True)
    comments = next((i for i, line in enumerate(lines) if not line.startswith("#")), len(lines))
    start = next((i for i in range(comments) if lines[i].startswith(WRITTEN)), -1)
    return Document("".join(lines[start + 1 :]))


def set_quantity(
    document: Document, path: Sequence[str], quantity: Quantity, value: float, interval: Range, limits: Limits, command: str
) -> None:
    """A fitted value with its interval as the range, which is read as +-2 standard deviations. Without one it keeps the old
    range, and unchanged values keep their notation.

    `command` is the command that found it.
    """
    if interval is None and isinstance(quantity.value, float) and _figures(value) == _figures(quantity.value):
        return
    low, high = (quantity.low, quantity.high) if interval is None else interval
    low, high = (min(max(x, limits.low), limits.high) for x in (low, high))
    span = [_figures(min(low, value)), _figures(max(high, value))]
    is_refit = quantity.reason.startswith(REFITTED) and "; before it " in quantity.reason
    origin = (
        quantity.reason.partition("; before it ")[2] if is_refit else f"{quantity.value:g} ({quantity.flag}): {quantity.reason}"
    )
    reason = f"{REFITTED} {command}; before it {origin}"
    entries = {"value": _figures(value), "range": span, "flag": "A" if interval is None else FITTED, "reason": reason}
    for key, entry in entries.items():
        document.set((*path, key), entry)


def finish(
    document: Document,
    name: str,
    effect_files: Sequence[Path],
    surroundings: Sequence[Active],
    path: Path,
    changes: FileChanges,
    text: str,
    route: Sequence[RouteMap] = (),
) -> list[Path]:
    """Write the file of a vehicle of a name, with its present effect files, surroundings and route; see `write_track_vehicle`.

    Only a diagnosis writes, replaces or removes surroundings. For any other command the given ones stay where they are: they
    hold for the new vehicle file too.
    """
    if changes.disturbance is not None:
        _set_disturbance(document, changes.disturbance)
    diagnosed = changes.command == DIAGNOSE
    effects = changes.effects_of("vehicle")
    site_effects = [*surroundings, *changes.effects_of("surroundings")] if diagnosed else []
    own_files = [*effect_files, *sources_of(effects)]
    names = _copy_files([*own_files, *sources_of(site_effects)], path.parent)
    document.add("effects", {active.effect.name: _values(active) for active in effects})
    if own_files:
        document.set(("effect_files",), _copy_names(own_files, names))
    document_text = document.text()
    note = "" if document_text is not None else "Its comments could not be kept: they stand in the file it was made from.\n"
    write(path, changes.amend(_comment(note + text) + (document_text or document.plain())).encode())
    copies = [path.parent / name for name in names.values()]
    if not diagnosed:
        return [path, *copies]
    site_file, route_file = _free_places(path)
    kinds = {route_map.kind for route_map in changes.route}
    route = [*changes.route, *(route_map for route_map in route if route_map.kind not in kinds)]
    if not site_effects and not route:
        old_text = _text(site_file)
        if DIAGNOSED in old_text:
            remove(site_file)  # of an earlier diagnosis: it would look like this one's
            if f"route: {route_file.name}\n" in old_text:
                remove(route_file)
        return [path, *copies]
    lines = ["schema: 1", f"vehicle: {flow(name)}"]
    files = _copy_names(sources_of(site_effects), names)
    lines += [f"effect_files: {flow(files)}"] if files else []
    lines += [f"route: {route_file.name}"] if route else []
    lines += ["effects:" if site_effects else "effects: {}"]
    lines += [f"  {active.effect.name}: {flow(_values(active))}" for active in site_effects]
    if route:
        write_route(route_file, route)  # before the file that names it
    write(site_file, (_comment(text) + "\n".join(lines) + "\n").encode())
    return [path, site_file, *([route_file] if route else []), *copies]


def _free_places(path: Path) -> tuple[Path, Path]:
    """Where surroundings and route go beside a vehicle file: into those of an earlier diagnosis, but into no other file."""
    for count in itertools.count(1):
        site, route = (path.with_name(_numbered_path(Path(name), count).name) for name in (SURROUNDINGS_FILE, ROUTE_FILE))
        old_text = _text(site)
        is_own = DIAGNOSED in old_text
        if (is_own or is_free(site)) and ((is_own and f"route: {route.name}\n" in old_text) or is_free(route)):
            break
    return site, route


def _text(path: Path) -> str:
    return (present_content(path) or b"").decode(errors="replace")


def _numbered_path(path: Path, count: int) -> Path:
    """The path with a number in its name, from 2 on."""
    return path if count == 1 else path.with_stem(f"{path.stem}_{count}")


def _comment(text: str) -> str:
    return "".join(f"# {line}\n" for line in text.splitlines())


def _values(active: Active) -> dict[str, Any]:
    entries: dict[str, Any] = {}
    for q in (q for q in active.effect.parameters if not q.is_fixed):
        value = _short_value(active.values[q.name], q.low, q.high)
        span = active.ranges.get(q.name)
        span_values = [_short_value(x, q.low, q.high) for x in span] if span else []
        entries[q.name] = {"value": value, "range": span_values} if span_values else value
    return entries


def _short_value(value: float, low: float, high: float) -> float:
    """With few figures, unless that exceeds the bounds."""
    value = min(max(value, low), high)
    rounded = _figures(value)
    return rounded if low <= rounded <= high else value


def _figures(value: float) -> float:
    return float(f"{value:.{FIGURES}g}")


def _effect_files(source: Path) -> list[Path]:
    """Files of a user's own effects that a vehicle file names, also those none of whose effects acts."""
    return [(source.parent / name).resolve() for name in read_yaml(source).get("effect_files", [])]


def sources_of(effects: Iterable[Active]) -> list[Path]:
    """Files of effects of the user's own."""
    return [active.effect.source for active in effects if active.effect.source is not None]


def _copy_files(sources: Iterable[Path], folder: Path) -> dict[Path, str]:
    """Copies the files of effects of the user's own; the name of each copy, relative to the folder."""
    return {source: copy_pairs(source, folder, Path("effects") / source.name) for source in dict.fromkeys(sources)}


def _copy_names(sources: Iterable[Path], names: Mapping[Path, str]) -> list[str]:
    return list(dict.fromkeys(names[source] for source in sources))


def copy_pairs(source: Path, folder: Path, relative: Path) -> str:
    """Copy a file into a folder; return its place for the vehicle file.

    Another file of that name stays: the copy then has a number in its name.
    """
    try:
        content = present_content(source)  # that of a compound is in the same set
        return (
            write_numbered(folder / relative, source.read_bytes() if content is None else content).relative_to(folder).as_posix()
        )
    except OSError as error:
        raise InputError(str(folder / relative), error.strerror or str(error), f"a place for a copy of {source}") from error


def write_numbered(path: Path, content: bytes) -> Path:
    """Write a file, if it is not there yet; return its path. Another file of that name stays: the new one then has a number in
    its name.
    """
    for count in itertools.count(1):
        place = _numbered_path(path, count)
        if is_free(place):
            with file_set():
                write(place, content)
            break
        if present_content(place) == content:
            break
    return place
