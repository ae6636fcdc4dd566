# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Defines the interface of a reader: the channels of a file with their units, and their samples in blocks."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackres_ros.errors import InputError
from trackres_ros.files.documents import in_a_line
from trackres_ros.recording.bindings import TIME, TopicBinding
from trackres_ros.recording.samples import Finding, FloatArray, IntArray

CHUNK_ROWS = 8192
SEEN_CELLS = 64
"""First cells of a column that show whether it is a time, and in which notation."""


class Channel(NamedTuple):
    """A channel of a file, or a column of a table.

    Attributes
    ----------
    name
        Name in the file.
    unit
        Unit in the file; empty without one.
    group
        Channels of one group have the same times; one name may be in several groups.
    named
        Values that the file gives names, and these.
    """

    name: str
    unit: str = ""
    group: str = ""
    value_names: tuple[tuple[float, str], ...] = ()


@dataclass(frozen=True, slots=True)
class ChosenChannel:
    """A channel to read: its index among all channels, its name, and the role it feeds, with the conversion in its binding.

    `dates_only`: a time without a unit in its name; `is_valid`: whether it says if the role's next channel counts.
    """

    place: int
    name: str
    role: str
    binding: TopicBinding
    dates_only: bool = False
    is_valid: bool = False


class ChannelRows(NamedTuple):
    """Some rows of channels: one time, and the number of each channel that has one at it."""

    # stamps [ns], in a file without dates from its beginning; of a table without dates in the unit of its column; shape (n,)
    time: FloatArray | IntArray
    has_time: NDArray[np.bool_]  # whether a row has a time, shape (n,)
    # the numbers of the chosen channels, and whether there is one, shape (n, channels)
    cells: FloatArray
    has_value: NDArray[np.bool_]


class ChannelFile:
    """A file of channels: a recording of channels, a table, a sheet of a workbook. Base class of readers.

    A reader sets `name`, `channels`, optionally `left_out`, `notes` and `findings`, and implements `streams`.

    Attributes
    ----------
    name : str
        The file, and the sheet of a workbook, for messages.
    channels : sequence of Channel
        All channels.
    left_out : mapping of Channel to str
        Channels of the file that cannot be read, and why.
    notes : sequence of str
        Assumptions about the file.
    findings : sequence of Finding
        Findings of the last reading.
    has_times : bool
        Whether channels have their own times; in a table a column is the time.
    uses : collection of str
        The lines of the topics file other than roles that the reader uses: `time`, `dbc`.
    """

    name: str
    channels: Sequence[Channel]
    left_out: Mapping[Channel, str] = MappingProxyType({})
    notes: Sequence[str] = ()
    findings: Sequence[Finding] = ()
    has_times = True
    uses: Collection[str] = ()

    def is_number(self, place: int) -> bool:  # noqa: ARG002
        """Whether a channel holds numbers."""
        return True

    def settle(self, time: ChosenChannel | None, channels: Sequence[ChosenChannel]) -> None:  # noqa: ARG002
        """Choose the channels to read, before `streams`; a table decides here on the notation of times and numbers."""
        self.wanted = tuple(channels)

    def streams(self) -> Sequence[Iterator[ChannelRows]]:
        """Read from the beginning: one iterator per set of channels with common times, some rows at a time.

        Cells have a column for each of `wanted`, which other streams may fill.
        """
        raise NotImplementedError


class TableFile(ChannelFile):
    """A table, in which one column is the time of all others."""

    has_times, uses = False, (TIME,)

    def first_cells(self, place: int) -> Sequence[Any]:  # noqa: ARG002
        """The first cells of a column with a value, up to `SEEN_CELLS`: numbers, texts, dates or clocks; none if unknown."""
        return ()


def rows_at(seconds: FloatArray, cells: FloatArray, start_ns: int = 0) -> ChannelRows:
    """Rows at times in seconds; each number other than nan is a sample.

    `seconds`: shape (n,); `cells`: shape (n, channels); `start_ns`: the time 0 [ns since 1970], if the file gives it.
    """
    has_value, has_time = ~np.isnan(cells), np.ones(len(seconds), np.bool_)
    if not (np.abs(seconds) < MOST_TIME_S).all():  # refused as they are
        return ChannelRows(seconds, has_time, cells, has_value)
    return ChannelRows(np.rint(seconds * 1e9).astype(np.int64) + start_ns, has_time, cells, has_value)


MOST_TIME_S = 4.6e9
"""Above it, differences of two times in nanoseconds do not fit in 64 bits [s]; times in milliseconds or nanoseconds mostly exceed
it."""


def time_note(column: str, text: str) -> str:
    """Note how a column of dates and times was read."""
    return f"time: column {column}, {text}"


def check_dates(time: ChosenChannel, name: str, are_dates: bool, first_text: str = "") -> None:
    """Refuse what is no time, numbers with an unknown unit, and a scale of dates. Raises InputError with a remedy.

    `first_text`: the first time, unless it is a number.
    """
    where = f"{name}: {time.name}"
    if first_text and not are_dates:
        allowed = "dates with times, such as 2026-11-23 10:00:00.5, 23.11.2026 10:00, 23-Nov-2026 10:00:00; clocks as 10:00:00.5"
        remedy = "write date and time in one column as 2026-11-23T10:00:00, or seconds in a column time_s"
        raise InputError(where, first_text, allowed if time.dates_only else f"numbers, or {allowed}", remedy)
    if not are_dates and time.dates_only:
        line = in_a_line({"column": time.name, "unit": "s"})
        remedy = f"give the unit in a topics file: time: {line}, or ms; or name the column time_s"
        raise InputError(where, "numbers of an unknown unit", "dates with times", remedy)
    if are_dates and time.binding.scale != 1.0:
        raise InputError(where, f"scale {time.binding.scale:g}", "no scale for dates with times")
