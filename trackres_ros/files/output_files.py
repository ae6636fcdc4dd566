# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Checks the places of results before any work is done for them."""

from collections.abc import Iterable, Mapping, Sequence
from importlib.util import find_spec
from os import PathLike
from pathlib import Path

from trackres_ros.errors import InputError, MissingExtraError

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


def picture_file(path: str | PathLike[str]) -> Path:
    """The path, if its suffix is a known format of pictures; its folder is created. Raises InputError otherwise."""
    file = Path(path)
    try:
        if file.name.lower().endswith(PICTURE_SUFFIXES):
            file.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError("path", str(file), f"a file in a folder that can be created: {error.strerror}") from error
    return output_file(file, PICTURE_SUFFIXES, "path")


def output_folder(path: str | PathLike[str], where: str = "output") -> Path:
    """The path, if it is a folder or can be created. Raises InputError if it is a file."""
    folder = Path(path)
    if folder.exists() and not folder.is_dir():
        raise InputError(where, str(folder), "a folder; a file of that name exists")
    return folder


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
