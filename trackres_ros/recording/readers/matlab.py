# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads MATLAB files: vectors, alone and in structs, each with the vector of its times."""

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trackres_ros.errors import InputError, MissingExtraError
from trackres_ros.recording.bindings import TIME, Topics
from trackres_ros.recording.channel_file import Channel, ChannelFile, ChannelRows, rows_at
from trackres_ros.recording.choosing import COLUMNS
from trackres_ros.recording.guessing import listed_names
from trackres_ros.recording.opening import FileKind
from trackres_ros.recording.roles import base_role
from trackres_ros.recording.samples import FloatArray
from trackres_ros.recording.wrapping import WrappingClock

BLOCK_ROWS = 2**14
TIMES = ("time_s", "time", "t", "timestamp", "timestamps", "tout")
"""Names of a vector of times, in any case, in the order of preference; so are the name of a channel with ``_time`` or ``_t``."""
CONSTANT = ("load", "passengers", "ambient", "stood")
"""Roles of which one number holds for the whole recording; of others it may be the first value, or a setting."""


class _Vector(NamedTuple):
    """A vector of numbers: its length, a suitable number to read at once, and a function that reads a part."""

    length: int
    at_once: int
    part: Callable[[int, int], FloatArray]


@dataclass(frozen=True, slots=True)
class _Content:
    """What a file holds, by name: vectors of numbers, single numbers, and the names of all else."""

    vectors: dict[str, _Vector] = field(default_factory=dict)
    numbers: dict[str, _Vector] = field(default_factory=dict)
    other_names: list[str] = field(default_factory=list)


class MatlabFile(ChannelFile):
    """The vectors of a MATLAB file that have times, and single numbers that hold for the whole recording."""

    uses = (TIME,)

    def __init__(self, name: str, content: _Content, topics: Topics | None) -> None:
        self.name, vectors = name, content.vectors
        clock = topics.time if topics else None
        if clock and clock.column not in vectors:
            where = f"{topics.origin if topics else name}: time: column"
            raise InputError(where, clock.column, listed_names(list(vectors)))
        self._scale, self._offset = (clock.scale, clock.offset) if clock else (1.0, 0.0)
        times = {name: _time_of(name, vectors, clock.column if clock else "") for name in vectors}
        self.channels = [Channel(name, "", time) for name, time in times.items() if time and time != name]
        timeless_names = [name for name, time in times.items() if not time]
        unit = "" if clock else ", in seconds"
        constants = _constants(content.numbers, self.channels, topics)
        self._vectors = {**vectors, **{item: _constant(content.numbers[item]) for item in constants}}
        unread_names = [*content.other_names, *(item for item in content.numbers if item not in constants)]
        self.notes = (
            *(f"time: vector {time}{unit}" for time in dict.fromkeys(item.group for item in self.channels)),
            *([f"vectors without times: {listed_names(timeless_names)}"] if timeless_names else []),
            *([f"one number for the whole recording: {listed_names(list(constants))}"] if constants else []),
            *([f"not read (no vectors): {listed_names(unread_names)}"] if unread_names else []),
        )
        if not self.channels:
            allowed = f"numeric vectors and one of the same length named {', '.join(TIMES)}"
            remedy = "give the times in a topics file: time: {channel: NAME}"
            raise InputError(name, f"the vectors {listed_names(list(vectors)) or 'none'}", allowed, remedy)
        self.channels += [Channel(item, "", time) for item, time in constants.items()]

    def streams(self) -> Sequence[Iterator[ChannelRows]]:
        """The vectors by their times; those of the last one, the speed, last."""
        times = [self.channels[channel.place].group for channel in self.wanted]
        return [self._rows(time) for time in sorted(set(times), key=lambda time: (time == times[-1], time))]

    def _rows(self, time: str) -> Iterator[ChannelRows]:
        columns = [(column, self._vectors[self.channels[channel.place].name]) for column, channel in enumerate(self.wanted)]
        columns = [pair for pair, channel in zip(columns, self.wanted, strict=True) if self.channels[channel.place].group == time]
        clock = self._vectors[time]
        turns = WrappingClock(self._scale)
        at_once = max(vector.at_once for vector in (clock, *(vector for _, vector in columns)))
        for start in range(0, clock.length, at_once):
            end = min(start + at_once, clock.length)
            seconds = self._scale * turns.continued(clock.part(start, end)) + self._offset
            cells = np.full((end - start, len(self.wanted)), np.nan)
            for column, vector in columns:
                cells[:, column] = vector.part(start, end)
            yield rows_at(seconds, cells)
        self.findings = tuple(dict.fromkeys((*self.findings, *turns.findings())))


def _time_of(name: str, vectors: Mapping[str, _Vector], topics_time: str) -> str:
    """The time vector of a channel: the one that the topics file names, its own, or one in the same or a parent group."""
    if topics_time:
        return topics_time if vectors[topics_time].length == vectors[name].length else ""
    folder = name
    candidates = [f"{name}_time", f"{name}_t"]
    while folder:
        folder = folder.rpartition(".")[0]
        folder_names = {candidate.lower(): candidate for candidate in vectors if candidate.rpartition(".")[0] == folder}
        candidates += [folder_names[key] for time in TIMES if (key := f"{folder}.{time}".lower().lstrip(".")) in folder_names]
    return next(
        (candidate for candidate in candidates if candidate in vectors and vectors[candidate].length == vectors[name].length), ""
    )


def _constants(numbers: Collection[str], channels: Sequence[Channel], topics: Topics | None) -> dict[str, str]:
    """Names of numbers that hold for the whole recording, with the vector of times of each.

    The topics file names them. Or they are columns known by name, each the only one of its role, in the struct of the times.
    """
    if not channels:
        return {}
    role_of_name = {
        part.column: base_role(role) for role, line in (topics.bindings if topics else {}).items() for part in line.sources
    }
    times = {item.group.rpartition(".")[0]: item.group for item in reversed(channels)}
    constants = {item: channels[0].group for item in numbers if role_of_name.get(item) in CONSTANT}
    known_names = [item for item in (*numbers, *(item.name for item in channels)) if item.rpartition(".")[2] in COLUMNS]
    role_of = {item: COLUMNS[item.rpartition(".")[2]][0] for item in known_names}
    role_counts = Counter(role_of.values())
    for item, role in role_of.items():
        if (
            item in numbers
            and item not in constants
            and role in CONSTANT
            and role_counts[role] == 1
            and item.rpartition(".")[0] in times
        ):
            constants[item] = times[item.rpartition(".")[0]]
    return constants


def _constant(number: _Vector) -> _Vector:
    return _Vector(1, 1, lambda start, end: np.repeat(number.part(0, 1), end - start))


def _read(path: Path, name: str, topics: Topics | None) -> list[MatlabFile]:
    with path.open("rb") as file:
        is_hdf5 = file.read(10).startswith((b"MATLAB 7.3", b"\x89HDF"))
    return [MatlabFile(name, _of_version_7_3(path) if is_hdf5 else _of_version_5(path), topics)]


def _of_version_5(path: Path) -> _Content:
    """Content of a file of version 4 to 7, which is read at once."""
    from scipy.io import loadmat

    content = _Content()

    def visit(name: str, value: Any) -> None:
        if isinstance(value, Mapping):
            for key, child in value.items():
                visit(f"{name}.{key}", child)
        elif isinstance(value, list):
            for number, child in enumerate(value, 1):
                visit(f"{name}({number})", child)
        elif isinstance(value, int | float):
            content.numbers[name] = _Vector(1, 1, lambda *_: np.array([value], np.float64))
        elif isinstance(value, np.ndarray) and value.ndim == 1 and value.dtype.kind in "biuf" and value.size > 1:
            numbers = value.astype(np.float64)
            numbers[np.isnan(numbers)] = np.nan  # damaged ones would raise a warning
            content.vectors[name] = _Vector(len(value), BLOCK_ROWS, lambda start, end: numbers[start:end])
        else:
            content.other_names.append(name)

    for name, value in loadmat(path, simplify_cells=True).items():
        if not name.startswith("__"):
            visit(name, value)
    return content


def _of_version_7_3(path: Path) -> _Content:
    """Content of an HDF5 file."""
    try:
        import h5py
    except ImportError:
        raise MissingExtraError("reading MATLAB files of version 7.3", "h5py", "matlab") from None
    content = _Content()

    def visit(place: str | bytes, item: Any) -> None:
        if not isinstance(place, str) or "#refs#" in place:  # a damaged name is no text
            return
        if not isinstance(item, h5py.Dataset):
            return
        name = place.replace("/", ".")
        is_row = item.ndim == 2 and item.shape[0] == 1  # MATLAB's arrays are transposed there
        is_vector = item.size not in (None, 0) and (item.ndim == 1 or is_row or (item.ndim == 2 and item.shape[1] == 1))
        is_numeric = item.dtype.kind in "biuf" and item.attrs.get("MATLAB_class", b"double") not in (b"char", b"cell")
        if not is_vector or not is_numeric:
            if "#" not in place:  # MATLAB's own
                content.other_names.append(name)
            return
        at_once = max(BLOCK_ROWS, *(item.chunks or (0,)))

        def part(start: int, end: int) -> FloatArray:
            with h5py.File(path, "r") as file:  # reopened, as the library keeps some kilobytes for each block until it is closed
                data = file[place][0, start:end] if is_row else file[place][start:end]
            return np.asarray(data, np.float64).reshape(end - start)

        (content.numbers if item.size == 1 else content.vectors)[name] = _Vector(item.size, at_once, part)

    with h5py.File(path, "r") as file:
        file.visititems(visit)  # follows no link to another file
    return content


KINDS = (FileKind("a MATLAB file", (".mat",), _read, (("scipy.io", ""),), checked=True),)
