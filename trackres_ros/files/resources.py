# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Finds the shipped files, alike in a checkout, a pip install and a colcon install."""

import os
from pathlib import Path

from trackres_ros import checks
from trackres_ros.errors import InputError, nearest

PACKAGE = "trackres_ros"


def config_dir() -> Path:
    """Folder of the shipped configuration: config/ of a checkout, else share/trackres_ros/config of the install prefix."""
    package = Path(__file__).resolve().parents[1]
    checkout = package.parent / "config"
    if (checkout / "rubber").is_dir():
        return checkout
    for prefix in package.parents:
        folder = prefix / "share" / PACKAGE / "config"
        if folder.is_dir():
            return folder
    raise InputError(
        "installation",
        str(package),
        f"a folder share/{PACKAGE}/config above it",
        "reinstall the package, or give paths instead of names",
    )


def shipped_vehicles() -> dict[str, Path]:
    """Names of the shipped vehicles and their files."""
    return _with_section("tracks:")


def shipped_road_vehicles() -> dict[str, Path]:
    """Names of the shipped vehicles of the base model `road_load`, which have no belts, and their files."""
    return _with_section("road_load:")


def shipped_topics() -> dict[str, Path]:
    """Names of the shipped topics files, and the files."""
    return {path.stem: path for path in sorted((config_dir() / "topics").glob("*.yaml"))}


def find_vehicle(path_or_name: str | os.PathLike[str]) -> Path:
    """Path of a vehicle file given as a path or as the name of a shipped vehicle. Raises InputError if it is neither."""
    return _find("vehicle", path_or_name, shipped_vehicles() | shipped_road_vehicles())


def find_topics(path_or_name: str | os.PathLike[str]) -> Path:
    """Path of a topics file given as a path or as the name of a shipped one. Raises InputError if it is neither."""
    return _find("topics", path_or_name, shipped_topics())


def cache_dir() -> Path | None:
    """Folder for data that can be computed again: $XDG_CACHE_HOME/trackres or ~/.cache/trackres; None without a home."""
    base = os.environ.get("XDG_CACHE_HOME")
    try:
        return (Path(base) if base else Path.home() / ".cache") / "trackres"
    except RuntimeError:  # no HOME, and a user unknown to the system
        return None


def _find(kind: str, path_or_name: str | os.PathLike[str], shipped: dict[str, Path]) -> Path:
    """The shipped file of a name, else the path: a file of that name in the current folder may have come with recordings."""
    allowed = f"the path of a {kind} file, or one of {', '.join(shipped)}"
    path, name = checks.path(path_or_name, kind, allowed), str(path_or_name)
    if name in shipped:
        return shipped[name]
    if path.is_file():
        return path
    raise InputError(kind, name, allowed, nearest(name, shipped))


def _with_section(section: str) -> dict[str, Path]:
    files = {}
    for path in sorted(config_dir().glob("*.yaml")):
        with path.open(encoding="utf-8") as lines:
            if any(line.startswith(section) for line in lines):
                files[path.stem] = path
    return files
