# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Guards the reading of every recording: a regular file, content that fits its name, limits of memory and time, and one line for
any error.
"""

import codecs
import errno
import os
import resource
import signal
import stat
import struct
import threading
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

from trackres_ros.errors import InputError, one_line
from trackres_ros.files.own_files import KINDS

LEAST_BYTES, TIMES_FILE = 3 * 2**28, 32
"""Most memory that a step of reading may add: this, and so many times the size of the file. A file that it unpacks may be as
long. Packed tables shrink to a tenth; a few bytes of an archive may request all of the memory."""
LEAST_S, S_PER_BYTE = 10.0, 60e-6
"""Most processor time of reading a file: ten seconds, and a minute for each megabyte. The slowest format, a packed log of a
bus, takes some seconds for one."""
OWN_FAULT = "a bug: please report it, with the file"
HEAD_BYTES = 512
MATLAB_4_BYTES = 20
"""Length of the head of a matrix of MATLAB 4, before its name."""
UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
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
    (b"TDSm", "a TDMS file of LabVIEW", (), "name it .tdms to see how it is converted"),
    (b"UnFinMF ", "an MDF file that was not finished", (".mf4", ".mdf"), "name it .mf4"),
    (b"LOGG", "a BLF log of CAN frames", (".blf",), "name it .blf"),
    (b"ULog\x01\x12\x35", "a ULog", (".ulg", ".ulog"), "name it .ulg"),
    (b"MATLAB 5.0 MAT-file", "a MATLAB file", (".mat",), "name it .mat"),
    (b"MATLAB 7.3 MAT-file", "a MATLAB file", (".mat",), "name it .mat"),
    (b"\x89HDF\r\n\x1a\n", "an HDF5 file", (".mat",), "name it .mat if MATLAB wrote it"),
    (b"PK\x03\x04", "a zip archive or an Excel workbook", (".xlsx",), "unpack it, or name it .xlsx"),
    (b"\xd0\xcf\x11\xe0", "an old Excel workbook", (), "save it as .xlsx, or the sheet as CSV"),
    (b"ARROW1", "an Arrow file", (), "write it as Parquet"),
)
"""First bytes, their format, its suffixes, and the remedy for another suffix."""
DATA_FAULTS = (OSError, EOFError, MemoryError, RecursionError, UnicodeError)
"""Exceptions of Python itself for bad data, in addition to those of libraries."""


class OutOfTime(BaseException):
    """Reading took too long. Libraries catch every `Exception`, and would go on."""


BEYOND = (MemoryError, OutOfTime)
SMALLER = "the file is damaged or hostile; a genuine one can be read in parts, or as Parquet"
STEP_S = 0.01  # of reading at once: to set the limits takes 0.1 ms

Part = TypeVar("Part")


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
    expected_format = next((description for _, description, suffixes, _ in CONTENTS if name.endswith(suffixes)), "text")
    if not head:
        raise InputError(str(path), "an empty file", f"{expected_format}, according to its suffix")
    content_match = _content(head)
    if content_match and not name.endswith(content_match[1]):
        raise InputError(str(path), content_match[0], f"{expected_format}, according to its suffix", content_match[2])
    if not content_match and name.endswith(".mat") and _is_matlab_4(head):
        return
    if not content_match and (expected_format != "text" or (b"\0" in head and not head.startswith(UTF_16))):
        given = "binary data" if b"\0" in head else f"a file that begins with {head[:16]!r}"
        raise InputError(str(path), given, f"{expected_format}, according to its suffix")


def content_of(path: Path) -> tuple[str, str] | None:
    """What a file is by its first bytes, and the remedy for its suffix; None if they do not show it."""
    with reading(path, "a readable file"), path.open("rb") as file:
        match = _content(file.read(HEAD_BYTES))
    return (match[0], match[2]) if match else None


def _content(head: bytes) -> tuple[str, tuple[str, ...], str] | None:
    return next(
        ((description, suffixes, remedy) for magic, description, suffixes, remedy in CONTENTS if head.startswith(magic)), None
    )


def _is_matlab_4(head: bytes) -> bool:
    """Whether a file begins with a matrix of MATLAB 4: its kind in decimal digits, its size, complex or not, the length of its
    name, and the name (MAT-File Format, level 4).
    """
    for order in "<>":
        if len(head) < MATLAB_4_BYTES:
            return False
        kind, rows, columns, is_complex, length = struct.unpack_from(f"{order}5i", head)
        name = head[MATLAB_4_BYTES : MATLAB_4_BYTES + max(length, 0)]
        is_kind = kind // 1000 in (0, 1) and kind // 100 % 10 == 0 and kind // 10 % 10 <= 5 and kind % 10 <= 2
        if is_kind and min(rows, columns) >= 0 and is_complex in (0, 1) and length > 1 and name[:1].isalpha():
            return True
    return False


@contextmanager
def in_one_line(path: Path, allowed: str, remedy: str = "") -> Iterator[None]:
    """Turn any exception while reading a file into one line with its name; the cause is chained.

    Libraries raise exceptions of their formats, archives and the system, without documentation. A fault of our own code is
    reported as one. Raises InputError instead of every other exception.
    """
    try:
        yield
    except InputError:
        raise
    except (Exception, OutOfTime) as error:
        frame = traceback.extract_tb(error.__traceback__)[-1]
        if _is_own(error, frame):
            where = f"{Path(frame.filename).name}:{frame.lineno}"
            raise InputError(str(path), f"{_message_of(error)} at {where}", allowed, OWN_FAULT) from error
        raise InputError(str(path), _message_of(error), allowed, SMALLER if isinstance(error, BEYOND) else remedy) from error


@contextmanager
def reading(path: Path, allowed: str, remedy: str = "") -> Iterator[None]:
    """Read a file within the limits of memory and time; any exception is one line, see `in_one_line`."""
    with in_one_line(path, allowed, remedy), Limits(path).step():
        yield


def read_in_steps(path: Path, allowed: str, parts: Iterator[Part], remedy: str = "") -> Iterator[Part]:
    """The parts of a file, read within the limits; what the caller does with them has none."""
    limits, is_complete = Limits(path), False
    while not is_complete:
        read: list[Part] = []
        refusal = None
        try:
            with in_one_line(path, allowed, remedy), limits.step():
                until_s = time.perf_counter() + STEP_S
                for part in parts:
                    read.append(part)
                    if time.perf_counter() > until_s:
                        break
                else:
                    is_complete = True
        except InputError as error:
            refusal = error
        yield from read
        if refusal:
            raise refusal


class Limits:
    """The limits of reading one file, by its size.

    The system holds the memory of the process, beyond its present use, and the size of files that it writes. A timer ends a step
    in the main thread. In another one, the time is checked after each step. Of several files read at once the first one has
    limits.
    """

    _in_use = threading.Lock()

    def __init__(self, path: Path) -> None:
        size = _size_of(path)
        memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
        self._bytes = min(LEAST_BYTES + TIMES_FILE * size, max(LEAST_BYTES, memory // 2))
        self._left_s = LEAST_S + S_PER_BYTE * size

    @contextmanager
    def step(self) -> Iterator[None]:
        """One step of reading. Raises MemoryError, OutOfTime beyond a limit, or what libraries make of it."""
        if not self._in_use.acquire(blocking=False):
            yield
            return
        begun_s, previous_limits = time.process_time(), {}
        try:
            for kind, used_amount in ((resource.RLIMIT_DATA, _present_bytes()), (resource.RLIMIT_FSIZE, 0)):
                previous_limits[kind] = soft_limit, hard = resource.getrlimit(kind)
                new_limit = used_amount + self._bytes
                resource.setrlimit(
                    kind, (new_limit if soft_limit == resource.RLIM_INFINITY else min(new_limit, soft_limit), hard)
                )
            with _ends_after(self._left_s):
                yield
        finally:
            for kind, limits in previous_limits.items():
                resource.setrlimit(kind, limits)
            self._in_use.release()
            self._left_s -= time.process_time() - begun_s
        if self._left_s <= 0.0:
            raise OutOfTime


@contextmanager
def _ends_after(most_s: float) -> Iterator[None]:
    """Raise OutOfTime after some processor time, and again each second, as a library may swallow it."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    going_on = True

    def end(*_: object) -> None:
        if going_on:
            raise OutOfTime

    handler = signal.signal(signal.SIGVTALRM, end)
    try:
        signal.setitimer(signal.ITIMER_VIRTUAL, max(most_s, STEP_S), 1.0)
        yield
    finally:
        going_on = False
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        signal.signal(signal.SIGVTALRM, handler or signal.SIG_DFL)


def _present_bytes() -> int:
    """Memory that the process has for its data."""
    return int(Path("/proc/self/statm").read_bytes().split()[5]) * resource.getpagesize()


def _size_of(path: Path) -> int:
    """Size of a file, or of those in a folder; 0 of what is not there."""
    try:
        return sum(file.stat().st_size for file in path.iterdir()) if path.is_dir() else path.stat().st_size
    except OSError:
        return 0


def _is_own(error: BaseException, frame: traceback.FrameSummary) -> bool:
    """Whether our code stumbled: the innermost frame is ours, and the exception is one of Python's for faults of a program."""
    is_ours = Path(frame.filename).is_relative_to(Path(__file__).parents[1])
    return is_ours and type(error).__module__ == "builtins" and not isinstance(error, DATA_FAULTS)


def _message_of(error: BaseException) -> str:
    if isinstance(error, OutOfTime):
        return f"content that takes more than {LEAST_S:g} s, and {S_PER_BYTE * 1e6:g} s for each megabyte, to read"
    if isinstance(error, MemoryError):
        return f"content that takes more than {LEAST_BYTES >> 20} MB of memory, and {TIMES_FILE} times the size of the file"
    if isinstance(error, RecursionError):
        return "nested too deeply"
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return one_line(f"{type(error).__name__}: {error}".removesuffix(": "))
