# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes the exported files of a vehicle into a folder, with a list of their inputs, and checks such a folder."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import trackres_ros as tr
from trackres_ros.errors import InputError
from trackres_ros.estimator import columns as layout
from trackres_ros.estimator import snapshot
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.settings import Settings
from trackres_ros.files.documents import parse_json
from trackres_ros.files.file_sets import file_set
from trackres_ros.files.output_files import output_folder
from trackres_ros.files.own_files import write
from trackres_ros.files.resources import config_dir, find_vehicle
from trackres_ros.kernels.marks import sources_digest
from trackres_ros.learning.learner import ON, Learner
from trackres_ros.learning.store import continue_from
from trackres_ros.node.parameters import make_parameters, read_parameters
from trackres_ros.tools.export.c_source import CSource
from trackres_ros.tools.export.parts import Parts
from trackres_ros.vehicle import AnyVehicle

LIST = "trackres_export.json"
FORMAT, VERSION = "trackres-export", 1
SHIPPED = "shipped:"
LARGEST = 1 << 20  # bytes of a list


@functools.cache
def sources() -> str:
    """Digest of the sources of the step, and of those that translate it."""
    digest = hashlib.sha256(sources_digest().encode())
    for path in sorted(path for path in Path(__file__).parent.rglob("*") if path.suffix in (".py", ".c", ".h", ".txt", ".xml")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


@dataclass(frozen=True, slots=True)
class Request:
    """Inputs of an export."""

    vehicle: str  # path of a vehicle file, or the name of a shipped one
    surroundings: Path | None = None  # this and the next two: files as for `trackres replay`
    params: Path | None = None
    state: Path | None = None  # only learned values are used
    method: str | None = None  # models instead of those of the vehicle file
    thermal: str | None = None
    single: bool = False  # whether numbers are `float` instead of `double`, but for sums

    def load(self) -> AnyVehicle:
        """The vehicle."""
        return tr.load_vehicle(self.vehicle, method=self.method, thermal=self.thermal, surroundings=self.surroundings)


def translated(request: Request, tunable_names: tuple[str, ...] = ()) -> CSource:
    """The C of a vehicle, with tunable numbers of the kernel in its state.

    Raises
    ------
    InputError
        If a file cannot be used; with file and line, if an effect cannot be written in C.
    """
    settings = make_parameters(read_parameters(request.params)).settings()
    vehicle = request.load()
    estimator = Estimator(vehicle, settings)
    learner_values = None if request.state is None else _learned(estimator, request.state)
    begin_text = "" if request.state is None else f", starts from what {request.state.name} has learned"
    lines_of_origin = (
        f"vehicle file: {vehicle.source.name}, sha256 {_digest(find_vehicle(request.vehicle))}",
        f"values: {snapshot.key(estimator)}, of the vehicle with rubber, effects and surroundings",
        f"written by: trackres_ros {tr.__version__}, sources {sources()}",
        f"numbers: {'float' if request.single else 'double'}{begin_text}",
    )
    return CSource(Parts(estimator, learner_values, request.single, tunable_names), vehicle.title, lines_of_origin)


def _learned(estimator: Estimator, path: Path) -> Any:
    """The learned values with which a live node goes on after a restart: cold, and without what holds only for the moment."""
    saved_values, session, learner = snapshot.read_learning(estimator, path), estimator.session(), Learner(estimator, ON)
    session.begin(estimator.cold_start(estimator.inputs(0.0)))
    continue_from(path, session, learner, saved_values, off_s=0.0)
    learner.apply_learned(session)
    if not session.learned[layout.Learned.on] > 0.0:
        given, allowed = "a state without active learned parameters", "a state of a run with --learning on"
        raise InputError(f"state file {path}", given, allowed, "save it with --learning on, after enough driving")
    return session.learned


def export_c(request: Request, folder: Path) -> list[Path]:
    """Write header, source, replay program and CMake file, and the list of their inputs; return their paths.

    Raises
    ------
    InputError
        See `translated`; if the folder cannot be created, or holds such files of another program.
    """
    output_folder(folder)
    source = translated(request)
    estimator, files = source.estimator, source.files()
    if foreign_files := [name for name in files if (folder / name).exists() and not (folder / LIST).exists()]:
        given = f"a folder with another {' and '.join(foreign_files)}"
        raise InputError(str(folder), given, "a new folder, or one written by trackres export c", "choose another folder")
    list_content = {
        "format": FORMAT,
        "version": VERSION,
        "program": tr.__version__,
        "sources": sources(),
        "vehicle": _relative(find_vehicle(request.vehicle), folder),
        "vehicle_sha256": _digest(find_vehicle(request.vehicle)),
        "surroundings": None if request.surroundings is None else _relative(request.surroundings, folder),
        "method": request.method,
        "thermal": request.thermal,
        "settings": dataclasses.asdict(estimator.settings),
        "values": values_key(estimator),
        "files": {name: hashlib.sha256(text.encode()).hexdigest() for name, text in files.items()},
    }
    with file_set():
        write(folder / LIST, (json.dumps(list_content, indent=2) + "\n").encode())
        for name, text in files.items():
            write(folder / name, text.encode())
    return [folder / name for name in (*files, LIST)]


def values_key(estimator: Estimator) -> str:
    """Hash of the content of a vehicle's files, and of the files of its own effects."""
    own_sources = sorted({str(a.effect.source) for a in estimator.vehicle.active if a.effect.source is not None})
    return hashlib.sha256("".join([snapshot.key(estimator), *map(_digest, map(Path, own_sources))]).encode()).hexdigest()


def check(folder: Path, vehicle: str | None = None) -> list[str]:
    """Evidence that the C in a folder does not belong to its vehicle file, or to this version; empty if it does.

    `vehicle` is another vehicle file than that of the export, or its new place.

    Raises
    ------
    InputError
        If the folder holds no export, or the vehicle file is missing.
    """
    list_content = _read_list(folder / LIST)
    differences = []
    if (list_content["program"], list_content["sources"]) != (tr.__version__, sources()):
        differences.append(
            f"it was written by trackres_ros {list_content['program']} with other sources than this {tr.__version__}"
        )
    for name, digest in list_content["files"].items():
        path = folder / name
        if not path.is_file():
            differences.append(f"{name} is missing")
        elif _digest(path) != digest:
            differences.append(f"{name} was changed after the export")
    given = vehicle or _found_again(list_content["vehicle"], folder)
    surroundings = list_content["surroundings"] and Path(_found_again(list_content["surroundings"], folder))
    of_file = find_vehicle(given)
    if _digest(of_file) != list_content["vehicle_sha256"]:
        differences.append(f"the vehicle file {of_file} differs from the exported one")
    settings = {**list_content["settings"], "feedforward_parts": tuple(list_content["settings"]["feedforward_parts"])}
    request_loaded = Request(str(of_file), surroundings, method=list_content["method"], thermal=list_content["thermal"]).load()
    if values_key(Estimator(request_loaded, Settings(**settings))) != list_content["values"]:
        differences.append("values of the vehicle, its rubber, its effects or its surroundings differ")
    return differences


def _read_list(path: Path) -> dict[str, Any]:
    allowed = "a folder written by trackres export c"
    try:
        with path.open("rb") as file:
            list_content = parse_json(file.read(LARGEST))
    except OSError as error:
        raise InputError(str(path), error.strerror or str(error), allowed) from error
    except ValueError as error:
        raise InputError(str(path), "a damaged list", allowed, "export again") from error
    keys = ("program", "sources", "vehicle", "vehicle_sha256", "surroundings", "method", "thermal", "settings", "values", "files")
    if not isinstance(list_content, dict) or (list_content.get("format"), list_content.get("version")) != (FORMAT, VERSION):
        raise InputError(str(path), "another kind of list, or of another version", allowed, "export again")
    if not set(keys) <= set(list_content) or not all(isinstance(list_content[name], dict) for name in ("files", "settings")):
        raise InputError(str(path), "an incomplete list", allowed, "export again")
    return list_content


def _relative(path: Path, folder: Path) -> str:
    """A path relative to the folder, or the name of a shipped file."""
    resolved, shipped_folder = path.resolve(), config_dir().resolve()
    if resolved.is_relative_to(shipped_folder):
        return SHIPPED + resolved.relative_to(shipped_folder).as_posix()
    return Path(os.path.relpath(resolved, folder.resolve())).as_posix()


def _found_again(path: str, folder: Path) -> str:
    path_found = config_dir() / path.removeprefix(SHIPPED) if path.startswith(SHIPPED) else folder / path
    if not path_found.is_file():
        raise InputError(str(folder / LIST), str(path), "an existing vehicle file", "give its path: --vehicle FILE")
    return str(path_found)


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
