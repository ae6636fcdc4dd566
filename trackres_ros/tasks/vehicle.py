# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Checks, lists, creates and compares vehicle files; lists the effects that they may have."""

from __future__ import annotations

import hashlib
import re
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import click
import numpy as np

from trackres_ros.effects import catalogue
from trackres_ros.errors import InputError, nearest
from trackres_ros.estimator.constants import check_own_effects, spread
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.files.documents import read_yaml
from trackres_ros.files.file_sets import file_set
from trackres_ros.files.own_files import write
from trackres_ros.files.resources import config_dir, find_vehicle, shipped_road_vehicles, shipped_vehicles
from trackres_ros.model import belt as belt_model
from trackres_ros.model.contact import hinge_position, wheel_loads
from trackres_ros.model.coverage import check_heat, coverage
from trackres_ros.model.loss_table import LossTable, drive_share, interpolation_error, loss_table, reverse_share
from trackres_ros.model.track import TrackModel, load_range, steady_tension, track_model
from trackres_ros.tasks import options
from trackres_ros.tasks.arguments import VehicleGiven, as_vehicle, limited
from trackres_ros.tasks.results import Content
from trackres_ros.tasks.terminal import Command, Commands, emit
from trackres_ros.text import figures, listed, panel, table
from trackres_ros.vehicle import AnyVehicle, RoadVehicle, Vehicle
from trackres_ros.vehicle.belt_bulk import heat_capacity, mass_per_length
from trackres_ros.vehicle.description import FITTED, FLAGS
from trackres_ros.vehicle.writing.vehicle_file import copy_pairs
from trackres_ros.vehicle.writing.yaml_edit import Document

SHOWN_SPEED_SHARES = (0.05, 0.25, 1.0)  # of the greatest speed
SLOWEST = 0.05  # m/s: the softest belt is a hot one that creeps
LARGEST_ERROR = 0.01  # of the loss, between its table and the exact method
DEEP_STRAIN = 0.5  # of the thickness below a wheel: above it a layer is no longer an elastic foundation
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,63}")
RUNS_ON = {"tracks": "tracks", "road_load": "wheels, without belts"}
LONGEST = 24  # of a text in a table of numbers
DIGITS = 12  # of the digest of a file


@limited(points=(10, 100_000, ""))
def check_vehicle(vehicle: VehicleGiven, *, points: int = 400) -> VehicleCheck:
    """Check a vehicle and derive wheel loads [N], masses [kg], tension [N], data coverage and table errors.

    Parameters
    ----------
    vehicle
        A vehicle, the path of its file, or the name of a shipped one.
    points
        Number of random points for comparing the loss table with the exact method.

    Returns
    -------
    VehicleCheck
        A mapping; it prints as `trackres vehicle check` does.

    Raises
    ------
    InputError
        As `load_vehicle`, and for a physically impossible value.
    """
    return VehicleCheck(derived_values(as_vehicle(vehicle), points))


def derived_values(vehicle: AnyVehicle, points: int) -> dict[str, Any]:
    """Derived values of a vehicle, ready for JSON; tables of belts are compared with the exact method at random points.

    Raises InputError if the physics excludes a value.
    """
    if isinstance(vehicle, RoadVehicle):
        return _check_road(vehicle)
    check_own_effects(vehicle)
    rubber = vehicle.rubber
    tracks, remarks = {}, []
    for name, track in vehicle.tracks.items():
        model, loads = track_model(vehicle, name), load_range(vehicle, name)
        begin_s = time.perf_counter()
        table = loss_table(vehicle, name)
        took = time.perf_counter() - begin_s
        errors = np.abs(interpolation_error(model, table, loads, vehicle.chassis.max_speed, points))
        physics, messages = _physics(vehicle, name, model, table)
        remarks += messages
        if errors.max() > LARGEST_ERROR:
            remarks.append(
                f"track {name}: the loss in estimates and exports is up to {errors.max():.1%} off. The rubber's moduli change "
                "too steeply for its table: check the rubber file and the WLF constants"
            )
        stiffness = float(belt_model.axial_stiffness(track.belt, model.rubber.dynamic_modulus(10.0, vehicle.chassis.ambient)))
        tension, mass = steady_tension(model, vehicle.chassis.ambient), mass_per_length(track.belt, rubber)
        uncertain_names = ("loss", "cooling", "heat_capacity", "sprocket_radius")
        tracks[name] = {
            "wheel_loads_n": wheel_loads(track, loads.nominal).tolist(),
            "hinge_position_m": hinge_position(track),
            "belt_mass_kg": mass * track.belt.loop_length,
            "mass_per_length_kg_m": mass,
            "heat_capacity_j_k": heat_capacity(track.belt, rubber),
            "cooled_area_m2": belt_model.cooled_area(track.belt),
            "axial_stiffness_n": stiffness,
            "tension_n": tension,
            "sag_m": float(belt_model.catenary_sag(tension, mass, track.belt.sag_half_span, stiffness)),
            "uncertainty": dict(zip(uncertain_names, spread(vehicle, name).relative.tolist(), strict=True)),
            "table": {
                "seconds": took,
                "load_range_n": [loads.low, loads.high],
                "largest_error": float(errors.max()),
                "rms_error": float(np.sqrt((errors**2).mean())),
                "points": points,
                "drive_torque_share": drive_share(table, loads, track.sprocket_radius),
                "reverse_share": reverse_share(table, loads, track.sprocket_radius),
            },
            **physics,
        }
    return {
        **_common(vehicle),
        "assemblies": {a.name: float(n) for a, n in zip(vehicle.assemblies, vehicle.nominal_loads(), strict=True)},
        "rubber_file": str(vehicle.rubber_source),
        "tracks": tracks,
        "remarks": remarks,
    }


def _common(vehicle: AnyVehicle) -> dict[str, Any]:
    """Values common to all vehicle files."""
    flags = [quantity.flag for quantity in vehicle.parameters.values()]
    return {
        "vehicle": vehicle.name,
        "title": vehicle.title,
        "file": str(vehicle.source),
        "hysteresis": vehicle.hysteresis,
        "thermal": vehicle.thermal,
        "weight_n": vehicle.weight,
        "quantities": {flag: flags.count(flag) for flag in FLAGS},
        "effects": {a.effect.name: dict(a.values) for a in vehicle.effects},
    }


def _check_road(vehicle: RoadVehicle) -> dict[str, Any]:
    """Derived values without belts: resistance, its standard deviation and power at some speeds, on level ground."""
    estimator, points = Estimator(vehicle), []
    for share in SHOWN_SPEED_SHARES:
        inputs = estimator.inputs(share * vehicle.chassis.max_speed, acceleration=0.0)
        _, estimate = estimator.step(estimator.cold_start(inputs), inputs, 0.0)
        torque = estimate.resistance_torque_nm
        points.append(
            {
                "speed_mps": inputs.speed,
                "resistance_torque_nm": torque,
                "resistance_std_nm": estimate.resistance_std_nm,
                "power_w": torque / vehicle.constants.radius * inputs.speed,
            }
        )
    return {**_common(vehicle), "friction_brakes": vehicle.friction_brakes, "level_ground": points, "remarks": []}


def _physics(vehicle: Vehicle, name: str, model: TrackModel, table: LossTable) -> tuple[dict[str, Any], list[str]]:
    """Range of the rubber data for one kind of track, its steady belt temperature, and remarks on both."""
    chassis, rubber_data = vehicle.chassis, coverage(vehicle, name)
    heat_balance = check_heat(vehicle, name, table)
    strain = float(model.loss.contacts(SLOWEST, rubber_data.hottest, load_range(vehicle, name).nominal).largest_strain.max())
    if strain >= 1.0:
        raise InputError(
            f"{vehicle.source}: tracks.{name}",
            f"a road wheel that indents the belt by {strain:.0%} of its thickness",
            "less than 100 %",
            "check the unit of the moduli, the thickness, and radius, number and contact length of the road wheels",
        )
    speeds = [share * chassis.max_speed for share in SHOWN_SPEED_SHARES]
    coldest_degc = [rubber_data.coldest(model.rubber, speed) for speed in speeds]
    remarks = []
    ambient = vehicle.parameters["chassis.ambient"].low
    if coldest_degc[-1] > ambient:
        remarks.append(
            f"track {name}: the rubber data end at {coldest_degc[-1]:.0f} degC at {chassis.max_speed * 3.6:.0f} km/h, and the "
            f"file's ambient temperature begins at {ambient:g} degC. Below, the end values are used, and the status "
            "shows OUTSIDE_TABLE"
        )
    if heat_balance > rubber_data.hottest:
        remarks.append(
            f"track {name}: at {chassis.max_speed * 3.6:.0f} km/h the belt settles at {heat_balance:.0f} degC, and the data or "
            f"the life of its rubber end at {rubber_data.hottest:.0f} degC. Above, the status shows OUTSIDE_TABLE"
        )
    if strain > DEEP_STRAIN:
        remarks.append(
            f"track {name}: a road wheel indents a hot belt by {strain:.0%} of its thickness: too deep for the contact model"
        )
    physics = {
        "balance_degc": heat_balance,
        "largest_strain": strain,
        "rubber_data": {"speed_mps": speeds, "coldest_degc": coldest_degc, "hottest_degc": rubber_data.hottest},
    }
    return physics, remarks


class VehicleCheck(Content):
    """A checked vehicle file; see `trackres_ros.check_vehicle`. A mapping with the content of `as_dict`."""

    @property
    def _model(self) -> str:
        return f"hysteresis {self['hysteresis']}, thermal {self['thermal']}" if "tracks" in self else "base model road_load"

    @property
    def _runs_on(self) -> str:
        return ", ".join(f"{k} {v / 1e3:.1f} kN" for k, v in self["assemblies"].items()) if "tracks" in self else "wheels"

    def __repr__(self) -> str:
        quantities = self["quantities"]
        lines = [
            f"{self['title']} ({self['file']}): all values are within their limits" + (", but:" if self["remarks"] else ""),
            *(f"  ! {remark}" for remark in self["remarks"]),
            f"  {quantities['P']} values from the paper, {quantities['L']} from literature, {quantities['A']} assumed, "
            f"{quantities['F']} fitted; " + self._model,
            *([f"  rubber of {self['rubber_file']}"] if "tracks" in self else []),
            f"  weight {self['weight_n'] / 1e3:.1f} kN on " + self._runs_on,
        ]
        if self["effects"]:
            lines.append(f"  with {', '.join(self['effects'])}")
        if "tracks" not in self:
            head = ("speed\nkm/h", "resistance\nNm", "+-\nNm", "power\nkW")
            names = {"speed_mps": 3.6, "resistance_torque_nm": 1.0, "resistance_std_nm": 1.0, "power_w": 1e-3}
            rows = [[figures(p[name] * factor) for name, factor in names.items()] for p in self["level_ground"]]
            return "\n".join([*lines, "On level ground", table(rows, head, indent=2)])
        for name, t in self["tracks"].items():
            errors, uncertainty, data = t["table"], t["uncertainty"], t["rubber_data"]
            ends = zip(data["speed_mps"], data["coldest_degc"], strict=True)
            facts = {
                "wheel loads": ", ".join(f"{load:.0f}" for load in t["wheel_loads_n"]) + " N",
                "hinge": f"{t['hinge_position_m']:.3f} m behind the front end of the ground run",
                "belt mass": f"{t['belt_mass_kg']:.1f} kg ({t['mass_per_length_kg_m']:.2f} kg/m)",
                "heat capacity": f"{t['heat_capacity_j_k'] / 1e3:.1f} kJ/K",
                "cooled area": f"{t['cooled_area_m2']:.2f} m2",
                "axial stiffness": f"{t['axial_stiffness_n'] / 1e6:.1f} MN",
                "tension": f"{t['tension_n']:.0f} N, sag {t['sag_m'] * 1e3:.1f} mm",
                "one standard deviation of": ", ".join(f"{k} {v:.0%}" for k, v in uncertainty.items())
                + " (from the ranges in the file)",
                "loss table": f"error at most {errors['largest_error']:.3%}, rms {errors['rms_error']:.3%} at {errors['points']} "
                f"points, loads {errors['load_range_n'][0] / 1e3:.1f} to {errors['load_range_n'][1] / 1e3:.1f} kN, "
                f"computed in {errors['seconds']:.2f} s",
                "drive torque": f"changes the loss by at most {errors['drive_torque_share']:.4%}; "
                f"forward and reverse differ by at most {errors['reverse_share']:.4%}",
                "rubber data": "cover belts of "
                + ", ".join(f"{low:.0f} degC at {v * 3.6:.0f} km/h" for v, low in ends)
                + f" and warmer, to {data['hottest_degc']:.0f} degC",
                "heat": f"settles at {t['balance_degc']:.0f} degC at the greatest speed and nominal load",
            }
            lines += [f"Track {name}", table(facts.items(), indent=2, numbers=False)]
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        head, *lines = repr(self).splitlines()
        remarks = [line.strip(" !") for line in lines if line.startswith("  !")]
        body = [line for line in lines if not line.startswith("  !")]
        return panel(head, listed("Remarks", remarks), f"<pre>{escape(chr(10).join(body))}</pre>")


def shipped() -> list[dict[str, str]]:
    """Name, title and model of each shipped vehicle: ``tracks``, or ``road_load`` of one without belts."""
    rows = []
    for model, vehicles in (("tracks", shipped_vehicles()), ("road_load", shipped_road_vehicles())):
        for name, path in vehicles.items():
            rows.append({"name": name, "title": str(read_yaml(path).get("title", "")), "model": model, "file": str(path)})
    return rows


def shipped_text(vehicles: Iterable[Mapping[str, str]]) -> str:
    """The same for people."""
    rows = [(v["name"], v["title"], RUNS_ON[v["model"]]) for v in vehicles]
    return table(rows, ("name", "description", "runs on"), numbers=False)


@file_set()
def new_vehicle(name: str, folder: Path, template: str) -> list[Path]:
    """Write a copy of a shipped vehicle under another name, with the files it needs, as a template; return all their paths.

    Raises InputError if the name is invalid, no such vehicle is shipped, or the file exists.
    """
    if not NAME.fullmatch(name):
        raise InputError("NAME", name, "a letter and at most 63 more letters, digits, _ and -")
    templates = shipped_vehicles() | shipped_road_vehicles()
    if template not in templates:
        raise InputError("--like", template, f"one of {', '.join(templates)}", nearest(template, list(templates)))
    target, source = folder / f"{name}.yaml", templates[template]
    if target.exists():
        raise InputError(str(target), "a file that already exists", "another name or another folder")
    document, content = Document(source.read_text(encoding="utf-8")), read_yaml(source)
    document.set(("name",), name)
    paths = [target]
    rubber = content.get("rubber", {}).get("file")
    if rubber:
        place = copy_pairs(source.parent / rubber, folder, Path(rubber))
        paths.append(folder / place)
        if place != rubber:
            document.set(("rubber", "file"), place)
    try:
        write(target, (document.text() or document.plain()).encode())
    except OSError as error:
        raise InputError("-o", f"{folder}: {error.strerror or error}", "a writable folder") from error
    return paths


def differences(first_vehicle: str, second_vehicle: str) -> list[dict[str, Any]]:
    """Differences of two vehicle files: path, unit, both values, the second over the first if both are numbers with a
    true zero, ranges, and flags if only one value is fitted: its uncertainty then is the whole one.

    Files that both name, such as that of the rubber, are compared by a digest of their content. Raises InputError if one is
    no vehicle file.
    """
    places = [find_vehicle(name) for name in (first_vehicle, second_vehicle)]
    contents = [read_yaml(place) for place in places]
    sides = [
        {**dict(_leaf_values(content)), **_digests(content, place.parent)}
        for content, place in zip(contents, places, strict=True)
    ]
    rows = []
    for path in dict.fromkeys([*sides[0], *sides[1]]):
        quantities = [side.get(path) for side in sides]
        if quantities[0] == quantities[1]:
            continue
        values = [q.get("value") if isinstance(q, Mapping) else q for q in quantities]
        ranges, flags = ([q.get(key) if isinstance(q, Mapping) else None for q in quantities] for key in ("range", "flag"))
        units = [q["unit"] for q in quantities if isinstance(q, Mapping) and "unit" in q]
        numbers = "degC" not in units and all(isinstance(v, float | int) and not isinstance(v, bool) for v in values)
        rows.append(
            {
                "path": path,
                "unit": str(units[0]) if units else "",
                "one": values[0],
                "other": values[1],
                "ratio": values[1] / values[0] if numbers and values[0] else None,
                "ranges": ranges if ranges[0] != ranges[1] else None,
                "flags": flags if flags[0] != flags[1] else None,
            }
        )
    return rows


def differences_text(first_vehicle: str, second_vehicle: str, rows: Sequence[Mapping[str, Any]]) -> str:
    """The same for people."""

    def cells(d: Mapping[str, Any]) -> tuple[str, ...]:
        ratio = "" if d["ratio"] is None else f"{100.0 * (d['ratio'] - 1.0):+.1f} %"
        spans = ["" if span is None else f"{figures(span[0])} to {figures(span[1])}" for span in d["ranges"] or (None, None)]
        flag_texts = ["" if flag is None else f" ({flag})" for flag in d["flags"] or (None, None)]
        values = [f"{_value_text(d[side])}{fit}" for side, fit in zip(("one", "other"), flag_texts, strict=True)]
        return d["path"], d["unit"], *values, ratio, *spans

    head = ("value", "unit", first_vehicle, second_vehicle, "change", f"range of {first_vehicle}", f"range of {second_vehicle}")
    return table(map(cells, rows), head, numbers=False) if rows else "They have the same values."


def _value_text(value: Any) -> str:
    if isinstance(value, float | int) and not isinstance(value, bool):
        return figures(value)
    text = "-" if value is None else str(value)
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}..."


def _digests(content: Mapping[str, Any], folder: Path) -> dict[str, str]:
    """Digests of the files that a vehicle file in a folder names; as in loading, a missing rubber file is the shipped one."""
    rubber, effect_files = content.get("rubber"), content.get("effect_files")
    candidates = {
        f"effect_files.{i}": [folder / str(name)] for i, name in enumerate(effect_files if isinstance(effect_files, list) else [])
    }
    if isinstance(rubber, Mapping) and isinstance(name := rubber.get("file"), str):
        candidates["rubber.file"] = [folder / name, config_dir() / "rubber" / Path(name).name]
    digests = {}
    for path, places in candidates.items():
        if (place := next(filter(Path.is_file, places), None)) is not None:
            digests[f"content of {path}"] = f"sha256 {hashlib.sha256(place.read_bytes()).hexdigest()[:DIGITS]}"
    return digests


def _leaf_values(node: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Quantities and plain values by their paths; parts of a list by their names."""
    if isinstance(node, Mapping) and "value" in node:
        # A reason does not define a vehicle, nor a flag other than F.
        yield path, {k: v for k, v in node.items() if k != "reason" and (k != "flag" or v == FITTED)}
    elif isinstance(node, Mapping):
        for key, value in node.items():
            if key != "name" or not path:
                yield from _leaf_values(value, f"{path}.{key}" if path else str(key))
    elif isinstance(node, list):
        for i, value in enumerate(node):
            name = value.get("name", i) if isinstance(value, Mapping) else i
            yield from _leaf_values(value, f"{path}.{name}")
    else:
        yield path, node


@click.group("vehicle", cls=Commands)
def vehicle_command() -> None:
    """Vehicle files."""


@vehicle_command.command("check", cls=Command)
@click.argument("file", metavar="FILE|NAME")
@options.argument_option(
    check_vehicle,
    "points",
    "Number of random points for comparing the loss table with the exact method.",
)
@options.json
def check_command(file: str, points: int, as_json: bool) -> None:
    """Check a vehicle file and print the derived values with units.

    \b
    trackres vehicle check xgd24d
    trackres vehicle check my_vehicle.yaml --json
    """
    result = check_vehicle(file, points=points)
    emit(result.as_dict(), as_json, lambda: repr(result))


@vehicle_command.command("list", cls=Command)
@options.json
def list_command(as_json: bool) -> None:
    """List the shipped vehicles; commands accept their names instead of a path."""
    rows = shipped()
    emit({"vehicles": rows}, as_json, lambda: shipped_text(rows))


@vehicle_command.command("new", cls=Command)
@click.argument("name", metavar="NAME")
@click.option("--like", default="xgd24d", metavar="VEHICLE", help="The shipped vehicle to start from.")
@click.option(
    "-o", "--output", type=options.FOLDER, default=Path(), show_default="here", metavar="DIR", help="Folder to write into."
)
@options.json
def new_command(name: str, like: str, output: Path, as_json: bool) -> None:
    """Write a vehicle file to start from: a copy of a shipped vehicle under a new name.

    \b
    trackres vehicle new truck7 -o vehicles
    trackres vehicle new loader --like agri3t
    """
    paths = new_vehicle(name, output, like)
    text = f"Written: {', '.join(map(str, paths))}\nNext: change its values, then trackres vehicle check {paths[0]}"
    emit({"written": [str(path) for path in paths]}, as_json, lambda: text)


@vehicle_command.command("diff", cls=Command)
@click.argument("one", metavar="A")
@click.argument("other", metavar="B")
@options.json
def diff_command(one: str, other: str, as_json: bool) -> None:
    """Show the values in which two vehicle files differ.

    \b
    trackres vehicle diff xgd24d report/vehicle.yaml
    """
    rows = differences(one, other)
    emit({"differences": rows}, as_json, lambda: differences_text(one, other, rows))


@click.command("effects", cls=Command)
@click.option("--effects", type=options.PATH, metavar="DIR", help="Folder with your own effects.")
@options.json
def effects_command(effects: Path | None, as_json: bool) -> None:
    """List the catalogue of effects with descriptions and parameters."""
    effects_list = [effect.describe() for effect in catalogue(effects).values()]

    def text() -> str:
        lines = []
        for effect in effects_list:
            subject = f"{effect['acts_on']}, of the {effect['belongs_to']}"
            lines.append(f"{effect['name']} ({subject}): {effect['text']}; needs {', '.join(effect['needs'])}")
            lines += [
                f"    {name} {q['low']:g} to {q['high']:g} {q['unit']}: {q['text']}" for name, q in effect["parameters"].items()
            ]
        return "\n".join(lines)

    emit({"effects": effects_list}, as_json, text)
