# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Checks the places of results before any work is done for them."""

from collections.abc import Sequence
from importlib.util import find_spec
from os import PathLike
from pathlib import Path

from trackres_ros.errors import InputError, MissingExtraError

BAG_SUFFIX = ".mcap"
TABLE_SUFFIXES = (".csv", ".csv.gz", ".parquet", ".mf4")
OUTPUT_SUFFIXES = (*TABLE_SUFFIXES, BAG_SUFFIX)
WRITTEN_WITH = {
    ".parquet": ("writing Parquet", "pyarrow", "parquet"),
    ".mf4": ("writing MDF", "asammdf", "mdf"),
    BAG_SUFFIX: ("writing bags", "rosbags", "bags"),
}


def output_file(path: str | PathLike[str], suffixes: Sequence[str] = OUTPUT_SUFFIXES, where: str = "output") -> Path:
    """The path, if its suffix is a known format, the library for it is installed, and its folder exists.

    Raises InputError otherwise; `where` names the argument.
    """
    file = Path(path)
    if not file.name.lower().endswith(tuple(suffixes)):
        raise InputError(where, str(file), f"a file name that ends in {', '.join(suffixes)}")
    if not file.parent.is_dir():
        raise InputError(where, str(file), "a file in a folder that exists", f"create it first: mkdir -p {file.parent}")
    if file.is_dir():
        raise InputError(where, str(file), "a file; a folder of that name exists")
    if file.suffix.lower() in WRITTEN_WITH:
        feature, module, extra = WRITTEN_WITH[file.suffix.lower()]
        if find_spec(module) is None:
            raise MissingExtraError(feature, module, extra)
    return file


def output_folder(path: str | PathLike[str], where: str = "output") -> Path:
    """The path, if it is a folder or can be created. Raises InputError if it is a file."""
    folder = Path(path)
    if folder.exists() and not folder.is_dir():
        raise InputError(where, str(folder), "a folder; a file of that name exists")
    return folder


def state_file(path: str | PathLike[str], where: str) -> Path:
    """The path, if a state can be saved there.

    Raises InputError for no such folder, or something in its place that is no file.
    """
    file = Path(path)
    if not file.parent.is_dir() or (file.exists() and not file.is_file()):
        raise InputError(where, str(file), "a file in a folder that exists")
    return file
