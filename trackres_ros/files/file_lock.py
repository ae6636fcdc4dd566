# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A lock between processes that the system frees when its holder ends, however it ends."""

import fcntl
import os
import socket
from contextlib import suppress
from pathlib import Path
from typing import TextIO

MOST_READ = 1000


class FileLock:
    """A lock by a file at a path. It is gone after `release`; what a killed process leaves locks nothing."""

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
