# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads files of bounded size, writes and locks the program's own: none of them is trusted for its name alone.

A disk may fill up, power may fail, another program or user may write there. So only regular files of a bounded
size are read, a new file replaces the old one in one step, and a seal over the content shows whether it is unchanged.
"""

import errno
import fcntl
import hashlib
import os
import secrets
import socket
import stat
import sys
from contextlib import suppress
from pathlib import Path
from typing import TextIO

from trackres_ros.files.file_sets import Member, open_set, settle, write_new

PART = ".part"
MOST_READ = 1000  # characters of the holder of a lock
OF_ALL, PRIVATE = 0o666, 0o600  # permissions of a new file, the first less the umask
SEAL = hashlib.sha256
KINDS = {
    stat.S_IFDIR: "a folder", stat.S_IFIFO: "a named pipe", stat.S_IFCHR: "a device", stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}  # fmt: skip


class NotOurFileError(OSError):
    """The path is not a file of our own; the text says what it is."""


def read(path: Path, limit: int) -> bytes:
    """All bytes of a regular file of at most `limit` bytes; never blocks.

    Files that belong together and that a killed process had replaced in part are made whole first, see `file_sets`.

    Raises OSError if there is none, or it cannot be read; NotOurFileError if it is not a regular file, or larger.
    """
    try:
        settle(Path(os.path.realpath(path)).parent)
        _check(path, path.stat(), limit)  # before it is opened: to open a device may do something
        with os.fdopen(os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK), "rb") as file:
            _check(path, os.fstat(file.fileno()), limit)
            data = file.read(limit + 1)
    except ValueError as error:  # a path with a zero byte in it
        raise NotOurFileError(errno.EINVAL, str(error), str(path)) from error
    if len(data) > limit:
        raise NotOurFileError(errno.EFBIG, f"more than {limit} bytes", str(path))
    return data


def _check(path: Path, status: os.stat_result, limit: int) -> None:
    if not stat.S_ISREG(status.st_mode):
        raise NotOurFileError(errno.EINVAL, KINDS.get(stat.S_IFMT(status.st_mode), "not a regular file"), str(path))
    if status.st_size > limit:
        raise NotOurFileError(errno.EFBIG, f"{status.st_size} bytes; a file of this kind has at most {limit}", str(path))


def write(path: Path, data: bytes, is_private: bool = False) -> None:
    """Write a temporary file in the same folder, flush it to the disk and move it in place; within a `file_set`, at its end.

    The permissions of an older file stay; `is_private`: the file is for its owner alone. A symbolic link stays one: the
    file that it leads to is replaced.

    Raises OSError if it cannot be written; an older file is then unchanged. Also if the older file is write-protected, or
    something other than a file is there, as moving there would destroy a device or a pipe.
    """
    mode = PRIVATE if is_private else OF_ALL
    old_status = path.stat() if path.exists() else None
    if old_status is not None:
        _check(path, old_status, sys.maxsize)
        if not is_private:
            mode = stat.S_IMODE(old_status.st_mode)
        if not os.access(path, os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
    place = Path(os.path.realpath(path))
    is_exact = old_status is not None  # no umask narrows what was there
    if (files := open_set()) is not None:
        files.add(Member(place, data, mode, is_exact))
        return
    part = place.with_name(f"{place.name}{secrets.token_hex(4)}{PART}")
    try:
        write_new(part, data, mode, is_exact)
        part.replace(place)
    except BaseException as error:
        part.unlink(missing_ok=True)
        if isinstance(error, OSError):  # not that of the temporary file, and a full disk names none
            error.filename = str(path)
        raise


def put(part: Path, path: Path) -> None:
    """Move a finished file from beside its place there; within a `file_set`, at its end. Raises OSError.

    A symbolic link is replaced by the file.
    """
    if (files := open_set()) is None:
        part.replace(path)
    else:
        files.add(Member(path.parent.resolve() / path.name, part.resolve()))


def remove(path: Path) -> None:
    """Remove a file, if it is there; within a `file_set`, at its end. Raises OSError."""
    if (files := open_set()) is None:
        path.unlink(missing_ok=True)
    else:
        files.add(Member(path.parent.resolve() / path.name, None))


def seal_payload(name: str, payload: bytes) -> bytes:
    """The payload behind a digest of itself and of the name it is kept under: moved to another name it is another's."""
    return _digest(name, payload) + payload


def unsealed(name: str, data: bytes) -> bytes | None:
    """The payload, if its seal under this name is intact; else None."""
    size = SEAL().digest_size
    payload = data[size:]
    return payload if len(data) >= size and data[:size] == _digest(name, payload) else None


def _digest(name: str, payload: bytes) -> bytes:
    return SEAL(name.encode() + b"\0" + payload).digest()


class FileLock:
    """A lock between processes by a file at a path.

    The file is gone after `release`. The system frees the lock when its holder ends, however it ends.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file: TextIO | None = None

    def take(self) -> str:
        """Try to take the lock. Return its holder if another process or object has it; empty if it is ours now.

        Where the file system has no locks, it is ours: nobody can tell. Raises OSError if the file cannot be made.
        """
        while self._file is None:
            file = self.path.open("a+", encoding="utf-8", errors="replace")
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                file.seek(0)
                with file:
                    return file.read(MOST_READ).strip() or "a process of unknown number"
            except OSError:
                pass
            if not self._is_there(file):  # its last holder has just removed it
                file.close()
                continue
            self._file = file
            with suppress(OSError):  # a full disk: the holder is only for messages
                file.truncate(0)
                file.write(f"process {os.getpid()} on {socket.gethostname()}\n")
                file.flush()
        return ""

    def release(self) -> None:
        """Give the lock back, if it is ours."""
        if self._file is not None:
            with suppress(OSError):
                self.path.unlink()
            with suppress(OSError):
                self._file.close()
            self._file = None

    def _is_there(self, file: TextIO) -> bool:
        try:
            return os.path.samestat(os.fstat(file.fileno()), self.path.stat())
        except OSError:
            return False
