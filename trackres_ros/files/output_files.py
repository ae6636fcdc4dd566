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


def output_file(path: str | PathLike[str], suffixes: Sequence[str] = OUTPUT_SUFFIXES, argument: str = "output") -> Path:
    """The path, if its suffix is a known format, the library for it is installed, and its folder exists.

    Raises InputError otherwise; `argument` names it.
    """
    file = checks.path(path, argument)
    _settle(file.parent, argument)
    if not file.name.lower().endswith(tuple(suffixes)):
        raise InputError(argument, str(file), f"a file name that ends in {', '.join(suffixes)}")
    if not file.parent.is_dir():
        raise InputError(argument, str(file), "a file in a folder that exists", f"create it first: mkdir -p {file.parent}")
    if file.is_dir():
        raise InputError(argument, str(file), "a file; a folder of that name exists")
    if not file.exists():
        _try_to_write(file.parent, file, argument)
    if file.suffix.lower() in WRITTEN_WITH:
        feature, module, extra_name = WRITTEN_WITH[file.suffix.lower()]
        if find_spec(module) is None:
            raise MissingExtraError(feature, module, extra_name)
    return file


def picture_file(path: str | PathLike[str], argument: str = "path") -> Path:
    """The path, if its suffix is a known format of pictures; its folder is created. Raises InputError otherwise."""
    file = checks.path(path, argument)
    if file.name.lower().endswith(PICTURE_SUFFIXES):
        _try_to_write(file.parent, file, argument)
        file.parent.mkdir(parents=True, exist_ok=True)
    return output_file(file, PICTURE_SUFFIXES, argument)


def output_folder(path: str | PathLike[str], argument: str = "output", names: Iterable[str] = ()) -> Path:
    """The path, if it is or can be a folder in which files of some names can be written; nothing is left in it.

    Raises InputError otherwise; `argument` names it.
    """
    folder = checks.path(path, argument)
    if folder.exists() and not folder.is_dir():
        raise InputError(argument, str(folder), "a folder; a file of that name exists")
    _try_to_write(folder, folder, argument)
    _settle(folder, argument)
    for file in (folder / name for name in names):
        if file.exists() and not (file.is_file() and os.access(file, os.W_OK)):
            raise InputError(argument, str(file), "a file that can be replaced", "remove it, or choose another folder")
    return folder


def _settle(folder: Path, argument: str) -> None:
    """Make files whole that a killed process had replaced in part: what is read there before it is written is of one run."""
    try:
        settle(folder)
    except OSError as error:
        raise InputError(argument, str(folder), f"a folder whose files are of one run: {error.strerror or error}") from error


def _try_to_write(folder: Path, target: Path, argument: str) -> None:
    """Make a folder and a file in it, and remove both: only the attempt shows whether a file system lets us."""
    new_folders = [place for place in (folder, *folder.parents) if not place.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InputError(argument, str(target), f"a place that can be written to: {error.strerror or error}") from error
    finally:
        with suppress(OSError):
            for place in new_folders:
                place.rmdir()


def no_two_alike(outputs: Mapping[str, Path | None]) -> None:
    """Check that no output replaces another; keys are the names of their arguments. Raises InputError for the same file."""
    arguments: dict[Path, str] = {}
    for argument, file in outputs.items():
        if file is not None and (first_argument := arguments.setdefault(file.resolve(), argument)) != argument:
            raise InputError(f"{first_argument}, {argument}", str(file), "a file for each output")


def not_an_input(file: Path | None, inputs: Iterable[str | PathLike[str] | None], argument: str) -> None:
    """Check that an output replaces no input, and no part of an input bag that is a folder.

    Raises InputError for the same file, under any name; `argument` is that of the output.
    """
    if file is None or not file.is_file():
        return
    for source in (Path(path) for path in inputs if path is not None):
        if source.is_dir():
            source /= file.name if file.name.endswith(BAG_FILES) else ""
        if source.is_file() and file.samefile(source):
            raise InputError(argument, str(file), f"a file other than the input {source}, which it would overwrite")
