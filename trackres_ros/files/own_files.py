# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads and writes the program's own files: none of them is trusted for its name alone.

A disk may fill up, power may fail, another program or user may write there. So only regular files of a bounded
size are read, a new file replaces the old one in one step, and a seal over the content shows whether it is unchanged.
"""

import errno
import hashlib
import os
import stat
import sys
import tempfile
from pathlib import Path

PART = ".part"
SEAL = hashlib.sha256
KINDS = {
    stat.S_IFDIR: "a folder", stat.S_IFIFO: "a named pipe", stat.S_IFCHR: "a device", stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}  # fmt: skip


class NotOurFileError(OSError):
    """The path is not a file of our own; the text says what it is."""


def read(path: Path, most: int) -> bytes:
    """All bytes of a regular file of at most `most` bytes; never blocks.

    Raises OSError if there is none, or it cannot be read; NotOurFileError if it is not a regular file, or larger.
    """
    try:
        _check(path, path.stat(), most)  # before it is opened: to open a device may do something
        with os.fdopen(os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK), "rb") as file:
            _check(path, os.fstat(file.fileno()), most)
            data = file.read(most + 1)
    except ValueError as error:  # a path with a zero byte in it
        raise NotOurFileError(errno.EINVAL, str(error), str(path)) from error
    if len(data) > most:
        raise NotOurFileError(errno.EFBIG, f"more than {most} bytes", str(path))
    return data


def _check(path: Path, found: os.stat_result, most: int) -> None:
    if not stat.S_ISREG(found.st_mode):
        raise NotOurFileError(errno.EINVAL, KINDS.get(stat.S_IFMT(found.st_mode), "not a regular file"), str(path))
    if found.st_size > most:
        raise NotOurFileError(errno.EFBIG, f"{found.st_size} bytes; a file of this kind has at most {most}", str(path))


def write(path: Path, data: bytes) -> None:
    """Write a temporary file in the same folder, flush it to the disk and move it in place.

    Raises OSError if it cannot be written; an older file is then unchanged. Also if something other than a file is there, as
    moving there would destroy a device or a pipe.
    """
    if path.exists():
        _check(path, path.stat(), sys.maxsize)
    with tempfile.NamedTemporaryFile(dir=path.parent, prefix=path.name, suffix=PART, delete=False) as file:
        try:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
            Path(file.name).replace(path)
        except BaseException as error:
            Path(file.name).unlink(missing_ok=True)
            if isinstance(error, OSError) and error.filename is None:  # the error of a full disk does not name the file
                error.filename = str(path)
            raise


def sealed(name: str, payload: bytes) -> bytes:
    """The payload behind a digest of itself and of the name it is kept under: moved to another name it is another's."""
    return _digest(name, payload) + payload


def unsealed(name: str, data: bytes) -> bytes | None:
    """The payload, if its seal under this name is intact; else None."""
    size = SEAL().digest_size
    payload = data[size:]
    return payload if len(data) >= size and data[:size] == _digest(name, payload) else None


def _digest(name: str, payload: bytes) -> bytes:
    return SEAL(name.encode() + b"\0" + payload).digest()
