# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Checks the places of results before any work is done for them."""

import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from importlib.util import find_spec
from os import PathLike
from pathlib import Path
from tempfile import TemporaryFile

from trackres_ros import checks
from trackres_ros.errors import InputError, MissingExtraError
from trackres_ros.files.file_sets import settle

BAG_SUFFIX = ".mcap"
PICTURE_SUFFIXES = (".png", ".svg")
BAG_FILES = (BAG_SUFFIX, ".db3", "metadata.yaml")  # in the folder of a bag
TABLE_SUFFIXES = (".csv", ".csv.gz", ".parquet", ".mf4")
OUTPUT_SUFFIXES = (*TABLE_SUFFIXES, BAG_SUFFIX)
WRITTEN_WITH = {
    ".parquet": ("writing Parquet", "pyarrow", "parquet"),
    ".mf4": ("writing MDF", "asammdf", "mdf"),
    BAG_SUFFIX: ("writing bags", "rosbags", "bags"),
}
BEFORE_1970 = "give the times an offset in the topics file, such as time: {column: time_s, offset: 100.0}; or write a CSV"
"""Remedy for stamps below zero, which bags and MDF cannot hold."""


def output_file(path: str | PathLike[str], suffixes: Sequence[str] = OUTPUT_SUFFIXES, where: str = "output") -> Path:
    """The path, if its suffix is a known format, the library for it is installed, and its folder exists.

    Raises InputError otherwise; `where` names the argument.
    """
    file = checks.path(path, where)
    _settled(file.parent, where)
    if not file.name.lower().endswith(tuple(suffixes)):
        raise InputError(where, str(file), f"a file name that ends in {', '.join(suffixes)}")
    if not file.parent.is_dir():
        raise InputError(where, str(file), "a file in a folder that exists", f"create it first: mkdir -p {file.parent}")
    if file.is_dir():
        raise InputError(where, str(file), "a file; a folder of that name exists")
    if not file.exists():
        _try_to_write(file.parent, file, where)
    if file.suffix.lower() in WRITTEN_WITH:
        feature, module, extra = WRITTEN_WITH[file.suffix.lower()]
        if find_spec(module) is None:
            raise MissingExtraError(feature, module, extra)
    return file


def picture_file(path: str | PathLike[str], where: str = "path") -> Path:
    """The path, if its suffix is a known format of pictures; its folder is created. Raises InputError otherwise."""
    file = checks.path(path, where)
    if file.name.lower().endswith(PICTURE_SUFFIXES):
        _try_to_write(file.parent, file, where)
        file.parent.mkdir(parents=True, exist_ok=True)
    return output_file(file, PICTURE_SUFFIXES, where)


def output_folder(path: str | PathLike[str], where: str = "output", names: Iterable[str] = ()) -> Path:
    """The path, if it is or can be a folder in which files of some names can be written; nothing is left in it.

    Raises InputError otherwise; `where` names the argument.
    """
    folder = checks.path(path, where)
    if folder.exists() and not folder.is_dir():
        raise InputError(where, str(folder), "a folder; a file of that name exists")
    _try_to_write(folder, folder, where)
    _settled(folder, where)
    for file in (folder / name for name in names):
        if file.exists() and not (file.is_file() and os.access(file, os.W_OK)):
            raise InputError(where, str(file), "a file that can be replaced", "remove it, or choose another folder")
    return folder


def _settled(folder: Path, where: str) -> None:
    """Make files whole that a killed process had replaced in part: what is read there before it is written is of one run."""
    try:
        settle(folder)
    except OSError as error:
        raise InputError(where, str(folder), f"a folder whose files are of one run: {error.strerror or error}") from error


def _try_to_write(folder: Path, given: Path, where: str) -> None:
    """Make a folder and a file in it, and remove both: only the attempt shows whether a file system lets us."""
    missing = [one for one in (folder, *folder.parents) if not one.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InputError(where, str(given), f"a place that can be written to: {error.strerror or error}") from error
    finally:
        with suppress(OSError):
            for one in missing:
                one.rmdir()


def no_two_alike(outputs: Mapping[str, Path | None]) -> None:
    """Check that no output replaces another; keys are the names of their arguments. Raises InputError for the same file."""
    found: dict[Path, str] = {}
    for where, file in outputs.items():
        if file is not None and (other := found.setdefault(file.resolve(), where)) != where:
            raise InputError(f"{other}, {where}", str(file), "a file for each output")


def not_an_input(file: Path | None, inputs: Iterable[str | PathLike[str] | None], where: str) -> None:
    """Check that an output replaces no input, and no part of an input bag that is a folder.

    Raises InputError for the same file, under any name; `where` names the argument of the output.
    """
    if file is None or not file.is_file():
        return
    for given in (Path(one) for one in inputs if one is not None):
        if given.is_dir():
            given /= file.name if file.name.endswith(BAG_FILES) else ""
        if given.is_file() and file.samefile(given):
            raise InputError(where, str(file), f"a file other than the input {given}, which it would overwrite")
