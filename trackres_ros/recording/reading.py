# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Guards the reading of every recording: a regular file, content that fits its name, and one line for any error."""

import errno
import stat
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from trackres_ros.errors import InputError, one_line
from trackres_ros.files.own_files import KINDS

OWN_FAULT = "a bug: please report it, with the file"
HEAD_BYTES = 512
CONTENTS: tuple[tuple[bytes, str, tuple[str, ...], str], ...] = (
    (b"\x89MCAP", "an MCAP bag", (".mcap", ".part"), "name it .mcap"),
    (b"SQLite format 3\0", "an SQLite bag", (".db3",), "name it .db3"),
    (b"#ROSBAG V", "a ROS 1 bag", (".bag",), "name it .bag"),
    (b"PAR1", "a Parquet table", (".parquet",), "name it .parquet"),
    (b"\x1f\x8b", "a gzip archive", (".gz",), "name it .csv.gz if a CSV is in it"),
    (b"\x28\xb5\x2f\xfd", "a zstd archive", (), "unpack it first: zstd -d"),
    (b"BZh", "a bzip2 archive", (), "unpack it first: bunzip2"),
    (b"\xfd7zXZ", "an xz archive", (), "unpack it first: unxz"),
    (b"MDF     ", "an MDF file", (".mf4", ".mdf"), "name it .mf4"),
    (b"UnFinMF ", "an MDF file that was not finished", (".mf4", ".mdf"), "name it .mf4"),
    (b"LOGG", "a BLF log of CAN frames", (".blf",), "name it .blf"),
    (b"MATLAB 5.0 MAT-file", "a MATLAB file", (".mat",), "name it .mat"),
    (b"MATLAB 7.3 MAT-file", "a MATLAB file", (".mat",), "name it .mat"),
    (b"\x89HDF\r\n\x1a\n", "an HDF5 file", (".mat",), "name it .mat if MATLAB wrote it"),
    (b"PK\x03\x04", "a zip archive or an Excel workbook", (".xlsx",), "unpack it, or name it .xlsx"),
    (b"\xd0\xcf\x11\xe0", "an old Excel workbook", (), "save it as .xlsx, or the sheet as CSV"),
    (b"ARROW1", "an Arrow file", (), "write it as Parquet"),
    (b"\xff\xfe", "UTF-16 text", (), "save it as UTF-8"),
    (b"\xfe\xff", "UTF-16 text", (), "save it as UTF-8"),
)
"""First bytes, their format, its suffixes, and the remedy for another suffix."""
DATA_FAULTS = (OSError, EOFError, MemoryError, RecursionError, UnicodeError)
"""Exceptions of Python itself for bad data, in addition to those of libraries."""


def check_there(path: Path) -> None:
    """Refuse a path that does not exist, or is neither a regular file nor a folder.

    Raises InputError with what is there instead; opens nothing.
    """
    try:
        mode = path.stat().st_mode
    except OSError as error:
        if error.errno == errno.ELOOP:
            given = "a link to itself"
        elif path.is_symlink():
            given = f"a link to {path.readlink()}, which does not exist"
        else:
            given = "no such file or folder" if error.errno == errno.ENOENT else str(error.strerror)
        raise InputError(str(path), given, "a readable file or folder") from error
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):  # without an end, or blocks until another process writes
        raise InputError(str(path), KINDS[stat.S_IFMT(mode)], "a regular file", "save the recording to a file first")


def check_file(path: Path) -> None:
    """Refuse a file that is not regular, or whose content does not fit the suffix. Raises InputError with what it is."""
    check_there(path)
    with reading(path, "a readable file"), path.open("rb") as file:
        head = file.read(HEAD_BYTES)
    name = path.name.lower()
    expected = next((what for _, what, suffixes, _ in CONTENTS if name.endswith(suffixes)), "text")
    if not head:
        raise InputError(str(path), "an empty file", f"{expected}, according to its suffix")
    found = next(((what, suffixes, remedy) for magic, what, suffixes, remedy in CONTENTS if head.startswith(magic)), None)
    if found and not name.endswith(found[1]):
        raise InputError(str(path), found[0], f"{expected}, according to its suffix", found[2])
    if not found and (expected != "text" or b"\0" in head):
        given = "binary data" if b"\0" in head else f"a file that begins with {head[:16]!r}"
        raise InputError(str(path), given, f"{expected}, according to its suffix")


@contextmanager
def reading(path: Path, allowed: str, remedy: str = "") -> Iterator[None]:
    """Turn any exception while reading a file into one line with its name; the cause is chained.

    Libraries raise exceptions of their formats, archives and the system, without documentation. A fault of our own code is
    reported as one. Raises InputError instead of every other exception.
    """
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        frame = traceback.extract_tb(error.__traceback__)[-1]
        if _is_own(error, frame):
            where = f"{Path(frame.filename).name}:{frame.lineno}"
            raise InputError(str(path), f"{_message_of(error)} at {where}", allowed, OWN_FAULT) from error
        raise InputError(str(path), _message_of(error), allowed, remedy) from error


def _is_own(error: Exception, frame: traceback.FrameSummary) -> bool:
    """Whether our code stumbled: the innermost frame is ours, and the exception is one of Python's for faults of a program."""
    ours = Path(frame.filename).is_relative_to(Path(__file__).parents[1])
    return ours and type(error).__module__ == "builtins" and not isinstance(error, DATA_FAULTS)


def _message_of(error: Exception) -> str:
    if isinstance(error, MemoryError):
        return "more than the memory holds"
    if isinstance(error, RecursionError):
        return "nested too deeply"
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return one_line(f"{type(error).__name__}: {error}".removesuffix(": "))
