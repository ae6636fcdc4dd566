# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Locks a results folder for one run at a time."""

from __future__ import annotations

import fcntl
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from trackres_ros.errors import InputError

LOCK, MOST_READ = "run.lock", 200


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder. The system frees it when the process ends, however it ends.

    Raises InputError if another run holds it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / LOCK).open("a+", encoding="utf-8", errors="replace") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            lock.seek(0)
            given = f"{folder}, in use by another run ({lock.read(MOST_READ).strip() or 'of unknown number'})"
            raise InputError("--output", given, "a folder that no other run uses", "wait until it ends") from None
        except OSError:  # a file system without locks
            yield
            return
        with suppress(OSError):  # a full disk: the owner is only for the message
            lock.truncate(0)
            lock.write(f"process {os.getpid()} on {socket.gethostname()}\n")
            lock.flush()
        yield
