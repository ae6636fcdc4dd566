# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The vehicles of a fleet, with their files and recordings."""

import hashlib
import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path, PurePosixPath
from typing import Annotated, Any

from trackres_ros.errors import InputError
from trackres_ros.files.dataclass_reader import FILLED, DataReader, Limits
from trackres_ros.files.documents import MOST_BYTES, read_text, read_yaml
from trackres_ros.files.resources import find_topics, find_vehicle

ALLOWED = "vehicles: a name for each, with file, and if need be recordings, topics, limits"
FORBIDDEN_IN_NAMES = "/\\=\0"  # a name becomes a folder of the dataset
HIGHEST_LIMIT = 1e12
NOT_A_NAME = ("", ".", "..", "none")
WORDS = "title", "reason"  # keys of a vehicle file that alter no result


@dataclass(frozen=True, slots=True)
class Entry:
    """A vehicle in a fleet.yaml; paths are relative to it."""

    file: str
    recordings: str | tuple[str, ...] = ()  # globs
    topics: str | None = None
    limits: Mapping[str, Annotated[float, Limits("1", 0.0, HIGHEST_LIMIT, "value for maintenance")]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class FleetFile:
    """The content of a fleet.yaml."""

    vehicles: Annotated[Mapping[str, str | Entry], FILLED]


@dataclass(frozen=True, slots=True)
class FleetVehicle:
    """One vehicle."""

    name: str  # of the individual vehicle; `file` describes its type
    file: Path
    sha: str  # digest of that file, and of the files it names
    values: str  # the same of its values
    patterns: tuple[str, ...] = ()  # globs for the paths of its recordings; by default a folder of the path must have its name
    topics: Path | None = None  # topic or column of each role; None to guess
    topics_sha: str = ""  # digest of the topics file; empty without one
    limits: Mapping[str, float] = field(default_factory=dict)  # by parameter: value for maintenance

    def owns(self, url: str) -> bool:
        """Whether a recording is this vehicle's."""
        path = PurePosixPath(url.partition("://")[2] or url)
        if not self.patterns:
            return self.name in path.parts
        return any(fnmatchcase(str(path), pattern) or fnmatchcase(str(path), f"*/{pattern}") for pattern in self.patterns)


@dataclass(frozen=True, slots=True)
class Fleet:
    """All vehicles by name."""

    vehicles: Mapping[str, FleetVehicle]

    def vehicle_of(self, url: str) -> FleetVehicle:
        """Vehicle of a recording. Raises InputError if it belongs to none, or to several."""
        owners = [vehicle for vehicle in self.vehicles.values() if vehicle.owns(url)]
        if len(owners) == 1:
            return owners[0]
        if owners:
            names = ", ".join(vehicle.name for vehicle in owners[:3])
            raise InputError(url, f"a recording of {names}", "one vehicle", "make the recordings patterns of fleet.yaml narrower")
        raise InputError(
            url,
            "a recording of no vehicle",
            "a folder named after a vehicle",
            "or give recordings patterns in fleet.yaml",
        )


def one_vehicle(path_or_name: str, topics_path_or_name: str | None) -> Fleet:
    """A fleet of one vehicle for all recordings."""
    file = find_vehicle(path_or_name)
    topics = None if topics_path_or_name is None else find_topics(topics_path_or_name)
    shas = digest(file), digest_of_values(file)
    return Fleet({file.stem: FleetVehicle(file.stem, file, *shas, ("*",), topics, digest(topics) if topics else "")})


def read_fleet(path: Path) -> Fleet:
    """Read a fleet.yaml; paths in it are relative to it. Raises InputError if it cannot be used."""
    content = read_yaml(path, ALLOWED)
    file: FleetFile = DataReader(path).part(FleetFile, content)
    text = read_text(path, "YAML file", MOST_BYTES)
    for key in content["vehicles"]:
        # A number, date or truth value is a name only if it reads as it is written. YAML reads 0123 as 83.
        if not isinstance(key, str) and not re.search(rf"(?<![\w.+:-]){re.escape(str(key))}\s*:", text):
            raise InputError(f"{path}: vehicles", key, "names that are texts", "write such a name in quotes")
    if len(file.vehicles) < len(content["vehicles"]):  # as 7 and "7"
        raise InputError(f"{path}: vehicles", list(map(str, content["vehicles"])), "each name once")
    return Fleet({name: _vehicle(path, name, entry) for name, entry in file.vehicles.items()})


def _vehicle(path: Path, name: str, entry: Entry | str) -> FleetVehicle:
    place = f"{path}: vehicles.{name}"
    if name in NOT_A_NAME or any(sign in name for sign in FORBIDDEN_IN_NAMES) or not name.isprintable():
        raise InputError(place, name, "a name that may be that of a folder")
    entry = Entry(entry) if isinstance(entry, str) else entry
    file = _resolve(path, entry.file, f"{place}.file", find_vehicle)
    topics = None if entry.topics is None else _resolve(path, entry.topics, f"{place}.topics", find_topics)
    patterns = (entry.recordings,) if isinstance(entry.recordings, str) else entry.recordings
    shas = digest(file), digest_of_values(file)
    return FleetVehicle(name, file, *shas, patterns, topics, digest(topics) if topics else "", entry.limits)


def _resolve(path: Path, name: str, place: str, find: Callable[[str], Path]) -> Path:
    local = path.parent / name
    if local.is_file():
        return local.resolve()
    try:
        return find(name).resolve()
    except InputError as error:
        raise InputError(place, error.given, error.allowed, error.remedy) from None


def digest(path: Path) -> str:
    """Digest of a vehicle or topics file, and of the files that it names. Raises InputError if it cannot be read."""
    content = read_yaml(path)
    return _digest(path.read_bytes(), content, path.parent)


def digest_of_values(path: Path) -> str:
    """The same of the values of a vehicle file: a comment, title or reason does not change it."""
    values = _without_words(read_yaml(path))
    return _digest(repr(values).encode(), values, path.parent)


def _digest(data: bytes, content: Any, folder: Path) -> str:
    checksum = hashlib.sha256(data)
    for name in sorted(_texts(content)):  # whichever key names a file: rubber, effects, databases of buses
        with suppress(OSError, ValueError):  # most texts are no paths, and some are too long for one
            if (folder / name).is_file():
                checksum.update((folder / name).read_bytes())
    return checksum.hexdigest()


def _texts(content: Any) -> set[str]:
    if isinstance(content, str):
        return {content}
    parts = content.values() if isinstance(content, dict) else content if isinstance(content, list) else ()
    return set().union(*map(_texts, parts))


def _without_words(content: Any) -> Any:
    if isinstance(content, dict):
        return {key: _without_words(value) for key, value in content.items() if key not in WORDS}
    return [_without_words(value) for value in content] if isinstance(content, list) else content
