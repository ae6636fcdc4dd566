# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Finds recordings: paths, folders, globs and URLs of any file system that fsspec knows."""

import hashlib
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import PurePosixPath
from typing import Any

from trackres_ros.errors import InputError, MissingExtraError, encodable, one_line
from trackres_ros.recording.opening import AMBIGUOUS, suffixes

SUFFIXES = tuple(suffix for suffix in suffixes() if suffix not in AMBIGUOUS)
OF_A_BAG = "metadata.yaml"  # marks a folder as one recording, a rosbag2
WILD = "*?["
LOCK, ROWS = "run.lock", "rows"  # in a folder of results, whose tables are no recordings
CHANGED = ("ETag", "etag", "mtime", "LastModified", "last_modified")
"""Names of a change marker in file systems; the first present one is used."""


@dataclass(frozen=True, slots=True)
class FoundRecording:
    """A recording, or a place that cannot be read."""

    url: str  # as it is opened: an absolute path, or a URL
    stamp: str  # size and time of change, or the file system's equivalent: it detects a change without reading
    problem: str = ""  # why it cannot be used; empty if it can


def find_recordings(places: Sequence[str]) -> Iterator[FoundRecording]:
    """All recordings at some places, each once, in the order of the places and of their names.

    Raises MissingExtraError without fsspec, or its library for such a URL.
    """
    urls: set[str] = set()
    for place in places:
        for recording in map(_printable, _recordings_at(place)):
            if recording.url not in urls:
                urls.add(recording.url)
                yield recording


def _printable(recording: FoundRecording) -> FoundRecording:
    """The same, if all programs can write its name; else its name with escapes, as a place that cannot be read."""
    url = encodable(recording.url)
    return (
        recording
        if url == recording.url
        else replace(recording, url=url, problem=recording.problem or "its name is not UTF-8; rename it")
    )


def is_there(url: str) -> bool:
    """Whether a recording that was once found still exists."""
    system, path = _open(url)
    return bool(system.exists(path))


def _open(place: str) -> tuple[Any, str]:
    """The file system of a place, and its path there. A path that exists is one, even with `::`, which chains URLs."""
    from fsspec import filesystem
    from fsspec.core import url_to_fs

    if "://" not in place:
        local = filesystem("file")
        if local.exists(place):
            return local, local._strip_protocol(place)
    system, path = url_to_fs(place)
    return system, path


def _recordings_at(place: str) -> Iterator[FoundRecording]:
    try:
        import fsspec  # noqa: F401
    except ImportError:
        raise MissingExtraError("trackres fleet", "fsspec", "fleet") from None
    protocol = place.partition("://")[0] if "://" in place else ""
    try:
        system, path = _open(place)
    except ImportError as error:
        module = "s3fs" if protocol in ("s3", "s3a") else str(error).split()[1] if len(str(error).split()) > 1 else protocol
        raise InputError(place, f"{protocol}://", "a URL that an installed library opens", f"pip install {module}") from None
    except ValueError as error:
        raise InputError(place, f"{protocol}://", f"a path, or a URL that fsspec knows ({error})") from None
    try:
        yield from _list(system, path, place)
    except (OSError, ValueError) as error:  # a bucket without access, a network failure: reported, and the others continue
        yield FoundRecording(place, "", _error_text(error))


def _list(system: Any, path: str, place: str) -> Iterator[FoundRecording]:
    if any(sign in path for sign in WILD) and not (_is_local(system) and system.exists(path)):
        matches = sorted(system.glob(path))
        if not matches:
            yield FoundRecording(place, "", "nothing matches it")
        parents = {parent for match in matches for parent in PurePosixPath(match).parents}
        results = tuple(f"{folder}/" for folder in parents if _holds_results(system, str(folder)))
        for match in matches:
            if not match.startswith(results):
                yield from _recording_at(system, match, by_name=False)
    elif not system.exists(path):
        yield FoundRecording(place, "", "nothing is there")
    else:
        empty = True
        for recording in _recording_at(system, path, by_name=True):
            empty = False
            yield recording
        if empty:
            yield FoundRecording(place, "", f"a folder without a recording ({', '.join(SUFFIXES)})")


def _recording_at(system: Any, path: str, by_name: bool) -> Iterator[FoundRecording]:
    """Recordings at a path; a file of another kind only if it was named (`by_name`)."""
    if system.isdir(path):
        yield from _walk(system, path, [os.path.realpath(path)])
    elif by_name or path.lower().endswith(SUFFIXES):
        yield FoundRecording(_url(system, path), _stamp([system.info(path)]))


def _holds_results(system: Any, folder: str) -> bool:
    """Whether a folder is one of results; only local ones are looked at."""
    return _is_local(system) and system.isfile(f"{folder}/{LOCK}") and system.isdir(f"{folder}/{ROWS}")


def _walk(system: Any, folder: str, visited: list[str]) -> Iterator[FoundRecording]:
    """Recordings in a folder, by name, then those in its folders; a folder that cannot be read is one with a problem.

    `visited`: real paths of the given folder and of linked ones. A link into one of them is not followed: it may be a loop.
    """
    errors: list[OSError] = []
    # One level at a time: a walk of fsspec asks `on_error` about its first folder alone, and leaves out others that fail.
    for _, folders, files in system.walk(folder, maxdepth=1, detail=True, on_error=errors.append):
        if LOCK in files and ROWS in folders:
            return
        if OF_A_BAG in files:
            yield FoundRecording(_url(system, folder), _stamp([files[name] for name in sorted(files)]))
            return
        links = {name: info for name, info in files.items() if info.get("islink") and system.isdir(info["name"])}
        for name in sorted(files):
            if name.lower().endswith(SUFFIXES) and name not in links:
                yield FoundRecording(_url(system, str(PurePosixPath(folder) / name)), _stamp([files[name]]))
        for name, info in sorted({**folders, **links}.items()):
            path = info["name"].rstrip("/")
            if name in links:
                target = PurePosixPath(os.path.realpath(path))
                if any(target.is_relative_to(folder_seen) for folder_seen in visited):
                    continue
                visited.append(str(target))
            yield from _walk(system, path, visited)
    for error in errors:
        yield FoundRecording(_url(system, folder), "", _error_text(error))


def _url(system: Any, path: str) -> str:
    """A local path unchanged, else with its protocol."""
    return path if _is_local(system) else str(system.unstrip_protocol(path))


def _is_local(system: Any) -> bool:
    return (system.protocol if isinstance(system.protocol, str) else system.protocol[0]) in ("file", "local")


def _error_text(error: Exception) -> str:
    return one_line(f"{type(error).__name__}: {getattr(error, 'strerror', None) or error}")


def _stamp(infos: Sequence[dict[str, Any]]) -> str:
    parts = []
    for info in infos:
        time = next((str(info[name]) for name in CHANGED if info.get(name) is not None), "")
        parts.append(f"{info.get('size')} {time}")
    return parts[0] if len(parts) == 1 else hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]
