# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads MATLAB files: vectors, alone and in structs, each with the vector of its times."""

import struct
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trackres_ros.errors import InputError, MissingExtraError
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.channel_file import Channel, ChannelFile, ChannelRows, rows_at
from trackres_ros.recording.choosing import listed_names
from trackres_ros.recording.file_kind import FileKind
from trackres_ros.recording.samples import FloatArray

BLOCK_ROWS = 2**14
MOST_BYTES = 2**27
"""Of the unpacked content of a version 5 file, which is read at once: sixteen million numbers. And of a block of version 7.3."""
MOST_ROWS = 2**31
"""Of a vector: a year at 60 Hz."""
TIMES = ("time_s", "time", "t", "timestamp", "timestamps", "tout")
"""Names of a vector of times, in any case, in the order of preference; so are the name of a channel with ``_time`` or ``_t``."""
COMPRESSED, HEADER_BYTES, ENDIAN_AT = 15, 128, 126
"""Of version 5: the type of a packed element, the length of the header, and its position of the byte order."""


class _Vector(NamedTuple):
    """A vector of numbers: its length, a suitable number to read at once, and a function that reads a part."""

    length: int
    at_once: int
    part: Callable[[int, int], FloatArray]


class MatlabFile(ChannelFile):
    """The vectors of a MATLAB file that have times."""

    def __init__(self, name: str, vectors: Mapping[str, _Vector], topics: Topics | None) -> None:
        self.name, self._vectors = name, vectors
        clock = topics.time if topics else None
        if clock and clock.column not in vectors:
            where = f"{topics.origin if topics else name}: time: column"
            raise InputError(where, clock.column, listed_names(list(vectors)))
        self._scale, self._offset = (clock.scale, clock.offset) if clock else (1.0, 0.0)
        times = {name: _time_of(name, vectors, clock.column if clock else "") for name in vectors}
        self.channels = [Channel(name, "", time) for name, time in times.items() if time and time != name]
        alone = [name for name, time in times.items() if not time]
        unit = "" if clock else ", in seconds"
        self.notes = (
            *(f"time: vector {time}{unit}" for time in dict.fromkeys(one.group for one in self.channels)),
            *([f"vectors without times: {listed_names(alone)}"] if alone else []),
        )
        if not self.channels:
            allowed = f"numeric vectors and one of the same length named {', '.join(TIMES)}"
            remedy = "give the times in a topics file: time: {channel: NAME}"
            raise InputError(name, f"the vectors {listed_names(list(vectors)) or 'none'}", allowed, remedy)

    def streams(self) -> Sequence[Iterator[ChannelRows]]:
        """The vectors by their times; those of the last one, the speed, last."""
        times = [self.channels[one.place].group for one in self.wanted]
        return [self._rows(time) for time in sorted(set(times), key=lambda time: (time == times[-1], time))]

    def _rows(self, time: str) -> Iterator[ChannelRows]:
        mine = [(column, self._vectors[self.channels[one.place].name]) for column, one in enumerate(self.wanted)]
        mine = [pair for pair, one in zip(mine, self.wanted, strict=True) if self.channels[one.place].group == time]
        clock = self._vectors[time]
        at_once = max(vector.at_once for vector in (clock, *(vector for _, vector in mine)))
        for start in range(0, clock.length, at_once):
            end = min(start + at_once, clock.length)
            seconds = self._scale * clock.part(start, end) + self._offset
            cells = np.full((end - start, len(self.wanted)), np.nan)
            for column, vector in mine:
                cells[:, column] = vector.part(start, end)
            yield rows_at(seconds, cells)


def _time_of(name: str, vectors: Mapping[str, _Vector], named: str) -> str:
    """The time vector of a channel: the one that the topics file names, its own, or one in the same or a parent group."""
    if named:
        return named if vectors[named].length == vectors[name].length else ""
    folder = name
    candidates = [f"{name}_time", f"{name}_t"]
    while folder:
        folder = folder.rpartition(".")[0]
        within = {one.lower(): one for one in vectors if one.rpartition(".")[0] == folder}
        candidates += [within[key] for time in TIMES if (key := f"{folder}.{time}".lower().lstrip(".")) in within]
    return next((one for one in candidates if one in vectors and vectors[one].length == vectors[name].length), "")


def _read(path: Path, name: str, topics: Topics | None) -> list[MatlabFile]:
    with path.open("rb") as file:
        is_old = file.read(10) == b"MATLAB 5.0"
    return [MatlabFile(name, _of_version_5(path) if is_old else _of_version_7_3(path), topics)]


def _of_version_5(path: Path) -> dict[str, _Vector]:
    """Vectors of a file that is read at once."""
    from scipy.io import loadmat

    _check_size(path)
    found: dict[str, _Vector] = {}

    def visit(name: str, value: Any) -> None:
        if isinstance(value, Mapping):
            for key, inner in value.items():
                visit(f"{name}.{key}", inner)
        elif isinstance(value, list):
            for number, inner in enumerate(value, 1):
                visit(f"{name}({number})", inner)
        elif isinstance(value, np.ndarray) and value.ndim == 1 and value.dtype.kind in "biuf" and value.size > 1:
            found[name] = _Vector(len(value), BLOCK_ROWS, lambda start, end: value[start:end].astype(np.float64))

    for name, value in loadmat(path, simplify_cells=True).items():
        if not name.startswith("__"):
            visit(name, value)
    return found


def _check_size(path: Path) -> None:
    """Refuse a file of version 5 that unpacks to more than the limit; it is unpacked piece by piece to find out."""
    size = 0
    with path.open("rb") as file:
        order = "<" if file.read(HEADER_BYTES)[ENDIAN_AT:] == b"IM" else ">"
        while len(tag := file.read(8)) == 8 and size <= MOST_BYTES:
            kind, length = struct.unpack(f"{order}II", tag)
            if kind == COMPRESSED:
                one, left = zlib.decompressobj(), length
                while left > 0 and size <= MOST_BYTES and (data := file.read(min(left, 2**16))):
                    left -= len(data)
                    while data and size <= MOST_BYTES:
                        size += len(one.decompress(data, 2**20))
                        data = one.unconsumed_tail
            else:
                size += length
                file.seek(length, 1)
    if size > MOST_BYTES:
        remedy = "save it with -v7.3, which can be read in parts"
        raise InputError(
            str(path), f"more than {MOST_BYTES} bytes unpacked", f"a file of version 5 of at most {MOST_BYTES}", remedy
        )


def _of_version_7_3(path: Path) -> dict[str, _Vector]:
    """Vectors of an HDF5 file."""
    try:
        import h5py
    except ImportError:
        raise MissingExtraError("reading MATLAB files of version 7.3", "h5py", "matlab") from None
    found: dict[str, _Vector] = {}

    def visit(place: str | bytes, item: Any) -> None:
        if not isinstance(place, str) or "#refs#" in place:  # a damaged name is no text
            return
        if not isinstance(item, h5py.Dataset) or item.dtype.kind not in "biuf":
            return
        across = item.ndim == 2 and item.shape[0] == 1  # MATLAB's arrays are transposed there
        if item.size in (None, 0, 1) or not (item.ndim == 1 or across or (item.ndim == 2 and item.shape[1] == 1)):
            return
        if item.attrs.get("MATLAB_class", b"double") in (b"char", b"cell") or item.size > MOST_ROWS:
            return
        at_once = max(BLOCK_ROWS, *(item.chunks or (0,)))
        if at_once * item.dtype.itemsize > MOST_BYTES:
            raise InputError(f"{path}: {place}", f"blocks of {at_once} numbers", f"blocks of at most {MOST_BYTES} bytes")

        def part(start: int, end: int) -> FloatArray:
            with h5py.File(path, "r") as file:  # reopened, as the library keeps some kilobytes for each block until it is closed
                data = file[place][0, start:end] if across else file[place][start:end]
            return np.asarray(data, np.float64).reshape(end - start)

        found[place.replace("/", ".")] = _Vector(item.size, at_once, part)

    with h5py.File(path, "r") as file:
        file.visititems(visit)  # follows no link to another file
    return found


KINDS = (FileKind("a MATLAB file", (".mat",), _read, checked=True),)
