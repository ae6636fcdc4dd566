# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Keeps arrays and compiled code in the cache folder, which is used only if no other user can write to it.

A file in it is used only if its seal is intact.
A cache of compiled code is code: another user who can write there can run anything as the user of the program. So a folder that
others can write to, or could replace by one of theirs, is not used at all. All of its content can be computed again.
"""

import grp
import logging
import math
import os
import pwd
import stat
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path

import numpy as np

from trackres_ros.arrays import Array
from trackres_ros.files import own_files
from trackres_ros.files.resources import cache_dir

ONLY_OURS = 0o700
SUFFIX = ".arrays"
MOST_KEPT = 500 << 20  # bytes of all tables: those of some 250 diagnoses, each of which fits vehicles of its own
STORED = np.dtype("<f8")
REMEDY = "set XDG_CACHE_HOME to your own folder to keep them"

_log = logging.getLogger("trackres")


def cached_arrays(
    key: str, shapes: Mapping[str, tuple[int, ...]], compute: Callable[[], Mapping[str, Array]], cache: Path | None = None
) -> dict[str, Array]:
    """Arrays by name, from the cache if intact, else computed and stored.

    `key`: file name without suffix; must change with all inputs of the arrays. `shapes`: by name; arrays are stored one after the
    other, so the shapes define the size of the file. `cache`: the folder, by default `files.resources.cache_dir`; if it cannot be
    used the next start computes again. The oldest tables are removed where all have more than `MOST_KEPT` bytes.
    """
    folder, name = usable_folder(cache or cache_dir()), f"{key}{SUFFIX}"
    sizes = [math.prod(shape) for shape in shapes.values()]
    data = fetched(folder, name, sum(sizes) * STORED.itemsize + own_files.SEAL().digest_size)
    if data is not None and len(data) == sum(sizes) * STORED.itemsize:
        numbers = np.frombuffer(data, dtype=STORED).astype(float)
        parts = np.split(numbers, np.cumsum(sizes)[:-1])
        return {name: part.reshape(shape) for (name, shape), part in zip(shapes.items(), parts, strict=True)}
    arrays = {name: np.asarray(value, dtype=float) for name, value in compute().items()}
    keep(folder, name, b"".join(np.ascontiguousarray(arrays[array_name], dtype=STORED).tobytes() for array_name in shapes))
    trim(folder, f"*{SUFFIX}", MOST_KEPT)
    return arrays


def usable_folder(folder: Path | None) -> Path | None:
    """The folder, created if needed, if it is safe as a cache; None if not, which is logged once."""
    if folder is None:
        _warn("there is no home folder")
        return None
    folder = folder.absolute()
    reason = _make(folder) or why_not(folder)
    if reason:
        _warn(reason)
        return None
    return folder


def fetched(folder: Path | None, name: str, limit: int) -> bytes | None:
    """Content kept under a name, if it is intact and our own; a damaged file is removed."""
    if folder is None:
        return None
    path = folder / name
    try:
        payload = own_files.unsealed(name, own_files.read(path, limit)) if path.stat().st_uid in _own_ids() else None
    except FileNotFoundError:
        return None
    except OSError:
        payload = None
    if payload is None:
        drop(folder, name)
    return payload


def keep(folder: Path | None, name: str, payload: bytes) -> None:
    """Keep content under a name. If that fails the next start computes it again."""
    if folder is None:
        return
    try:
        own_files.write(folder / name, own_files.seal_payload(name, payload), is_private=True)
    except OSError as error:
        _warn(f"{folder}: {error.strerror or error}")


def drop(folder: Path, name: str) -> None:
    """Remove the content under a name, if possible."""
    try:
        (folder / name).unlink(missing_ok=True)
    except OSError:
        return


def trim(folder: Path | None, pattern: str, limit: int) -> None:
    """Remove the oldest of some files, if they have more than `limit` bytes together. Who needs one again computes it.

    Other processes may use the folder at the same time: a file that has vanished is not there, an open one stays readable.
    """
    entries = []
    for path in () if folder is None else folder.glob(pattern):
        with suppress(OSError):
            status = path.lstat()
            entries.append((status.st_mtime_ns, status.st_size, path))
    excess = sum(size for _, size, _ in entries) - limit
    for _, size, path in sorted(entries):
        if excess <= 0:
            return
        drop(path.parent, path.name)
        excess -= size


def why_not(folder: Path) -> str:
    """Why another user could write to files in a folder; empty if none could."""
    real_folder = folder.resolve()
    for place in (real_folder, *real_folder.parents):
        try:
            status = place.stat()
        except OSError as error:
            return f"{place}: {error.strerror}"
        if status.st_uid not in _own_ids():
            return f"{place} belongs to another user"
        by_group = status.st_mode & stat.S_IWGRP and not _group_of_one(status.st_gid)
        by_all = status.st_mode & stat.S_IWOTH
        # In a sticky folder such as /tmp others can add files, but not replace ours: good above the cache, not as the cache.
        if (by_group or by_all) and not (status.st_mode & stat.S_ISVTX and place != real_folder):
            return f"other users can write to {place}"
    return ""


def _make(folder: Path) -> str:
    """Make the folder, for its owner alone; the reason if that fails."""
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=ONLY_OURS, exist_ok=True)
        mode = stat.S_IMODE(folder.stat().st_mode)
        if mode & 0o077 and not why_not(folder):
            folder.chmod(ONLY_OURS)  # made by an older version, which left it readable
    except OSError as error:
        return f"{folder}: {error.strerror or error}"
    if not os.access(folder, os.W_OK | os.X_OK):
        return f"{folder} cannot be written to"
    return ""


def _own_ids() -> tuple[int, int]:
    return os.geteuid(), 0


@cache
def _group_of_one(group: int) -> bool:
    """Whether a group is the user's private one, the default of many systems."""
    try:
        user, entry = pwd.getpwuid(os.geteuid()).pw_name, grp.getgrgid(group)
    except KeyError:
        return False
    return entry.gr_name == user and set(entry.gr_mem) <= {user}


@cache
def _warn(reason: str) -> None:
    _log.warning("trackres: compiled code and tables are not cached for the next start: %s; %s", reason, REMEDY)
