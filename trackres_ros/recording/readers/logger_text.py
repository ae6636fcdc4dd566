# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads tables of text whose format defines the times and units: VBOX files of Racelogic, measurement files of LabVIEW."""

import itertools
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import numpy as np

from trackres_ros.errors import InputError
from trackres_ros.recording.channel_file import (
    CHUNK_ROWS,
    MOST_TIME_S,
    Channel,
    ChannelFile,
    ChannelRows,
    ChosenChannel,
    time_note,
)
from trackres_ros.recording.opening import FileKind
from trackres_ros.recording.roles import is_quantity
from trackres_ros.recording.samples import Finding
from trackres_ros.recording.text_table import SECTION, Column, Progress, TextTable, decide, is_number, marks_of, number_of
from trackres_ros.units import SECOND_NS

DAY_NS = 86400 * SECOND_NS
CREATED = re.compile(r"File created on (\d{1,2})/(\d{1,2})/(\d{4})")
"""The first line of a VBOX file: day, month and year."""
CLOCK = re.compile(r"(\d{1,2})(\d\d)(\d\d)(?:[.,](\d{1,9}))?")
"""Time of day of a VBOX file: hhmmss.ss in UTC."""
POSITION = {"lat": ("latitude_deg", 1 / 60), "long": ("longitude_deg", -1 / 60)}
"""Columns of a VBOX file in minutes, longitudes positive to the west: name in degrees, positive to the east, and factor."""
VBOX_UNITS = {"velocity": "km/h", "heading": "deg", "height": "m"}
"""Units of columns of a VBOX file whose header does not name them."""
LABVIEW_CLOCK = re.compile(r"(\d+):(\d\d):(\d\d)(?:[.,](\d{1,9}))?\d*")


class LoggerText(ChannelFile):
    """A table of text with a column of times, and what its format says of it.

    `table`: the text; `time`: name of the column of times; `clock`: makes the function that reads its cells [ns];
    `units`: by column; `note`: how the times are read; `renamed`: other name and factor, by column.
    """

    def __init__(
        self,
        table: TextTable,
        time: str,
        clock: Callable[[], Callable[[str], int | None]],
        units: Mapping[str, str],
        note: str,
        renamed: Mapping[str, tuple[str, float]] | None = None,
    ) -> None:
        self.name, self._table, self._clock = table.name, table, clock
        if time not in table.names:
            raise InputError(self.name, f"columns {', '.join(table.names)}", f"a column {time}")
        self._time_place = table.names.index(time)
        self._renamed = renamed or {}
        self._places = [place for place in range(len(table.names)) if place != self._time_place]
        self.channels = [
            Channel(*(self._renamed[name][0], "") if name in self._renamed else (name, units.get(name, "")))
            for name in (table.names[place] for place in self._places)
        ]
        in_degrees = ", ".join(f"{name} in minutes as {new_name}" for name, (new_name, _) in self._renamed.items())
        self.notes = (*table.notes, time_note(time, note), *([in_degrees] if in_degrees else []))

    def settle(self, time: ChosenChannel | None, channels: Sequence[ChosenChannel]) -> None:
        """Choose the columns to read, and find their decimal marks."""
        super().settle(time, channels)
        table = self._table
        places = [self._places[channel.place] for channel in channels]
        marks = marks_of((channel.name, channel.binding.decimal) for channel in channels)
        table.look([(place, marks[channel.name].see) for place, channel in zip(places, channels, strict=True)])
        mark_of_column = decide(marks, self.name, table.separator == ",")
        self._columns = [
            Column(place, channel.name, partial(number_of, mark=mark_of_column[channel.name]))
            for place, channel in zip(places, channels, strict=True)
        ]
        self._factors = np.array([self._renamed.get(table.names[place], ("", 1.0))[1] for place in places])

    def is_number(self, place: int) -> bool:
        """Whether the first filled cell of a column is a number."""
        try:
            return number_of(self._table.first_cell(self._places[place]), ".") is not None
        except InputError:
            return False

    def streams(self) -> Sequence[Iterator[ChannelRows]]:
        """The rows of the file."""
        return [self._rows()]

    def _rows(self) -> Iterator[ChannelRows]:
        progress = Progress()
        columns = [Column(self._time_place, self._table.names[self._time_place], self._clock()), *self._columns]
        numbers = self._table.numbers(self._table.rows(progress), columns, progress)
        while chunk := list(itertools.islice(numbers, CHUNK_ROWS)):
            progress.rows += len(chunk)
            has_value = np.array([[number is not None for number in row] for row in chunk])
            stamps = np.array([row[0] or 0 for row in chunk], np.int64)
            yield ChannelRows(
                stamps, has_value[:, 0], np.array([row[1:] for row in chunk], np.float64) * self._factors, has_value[:, 1:]
            )
        self.findings = (*self._table.look_at_lines(progress), *self._look_above())

    def _look_above(self) -> Iterator[Finding]:
        """Report rows above the names, as in a file that was joined from several."""
        table = self._table
        rows = [line.split(None if table.separator == " " else table.separator) for line in table.lines_above]
        count = sum(len(row) >= len(table.names) and is_number(row[0]) for row in rows)
        if count:
            yield Finding("", "missing", count, float("nan"), f"{count} rows above the names are not read")


def sections(lines: Sequence[str]) -> dict[str, list[str]]:
    """The lines of a VBOX file by the name of their section, without brackets; those before the first one under an empty name."""
    parts, name = {"": list[str]()}, ""
    for line in map(str.strip, lines):
        if SECTION.fullmatch(line):
            name = line.strip("[]").lower()
            parts[name] = []
        else:
            parts[name].append(line)
    return parts


def vbox(path: Path, name: str) -> LoggerText:
    """A VBOX file: a time of day in UTC, its date from the first line, a position in minutes, and the units of its header.

    Format: Racelogic, VBO file format, https://en.racelogic.support/VBOX_Automotive/Knowledge_Base/VBO_File_Format
    """
    table = TextTable(path, name)
    parts = sections(table.lines_above)
    header = [line for line in parts.get("header", ()) if line]
    units = dict(VBOX_UNITS)
    if len(header) == len(table.names):
        ends = ((column, title.rpartition(" ")[2]) for column, title in zip(table.names, header, strict=True))
        units |= {column: end for column, end in ends if is_quantity(end)}
    further = parts.get("channel units", [])
    while further and not further[-1] and len(further) > max(0, len(table.names) - len(STANDARD & set(table.names))):
        further = further[:-1]
    units |= {column: unit for column, unit in zip(table.names[::-1], further[::-1], strict=False) if unit}
    created = CREATED.search(parts[""][0]) if parts[""] else None
    try:
        start = datetime(int(created[3]), int(created[2]), int(created[1]), tzinfo=UTC) if created else None
    except ValueError:
        start = None
    start_ns = int(start.timestamp()) * SECOND_NS if start else 0
    clock, note = partial(_time_of_day, start_ns), f"hhmmss.ss in UTC, {f'on {start:%Y-%m-%d}' if start else 'without a date'}"
    if other := _other_time(table):
        clock, note = partial(_seconds_from, 0, 0.0), f"seconds, as {other} is no time of day"
    renamed = {column: entry for column, entry in POSITION.items() if column in table.names}
    return LoggerText(table, "time", clock, units, note, renamed)


STANDARD = frozenset(("sats", "time", "lat", "long", "velocity", "heading", "height", "vertvel", "vert-vel", "event1", "event-1"))
"""Columns of a VBOX file without a line in its section of units."""


def _other_time(table: TextTable) -> str:
    """The first time of a VBOX file that is a number, and no time of day; empty without one."""
    other_times: list[str] = []

    def see(cells: Sequence[str]) -> None:
        if not other_times:
            other_times.extend(itertools.islice((text for text in cells if is_number(text) and _clock_ns(text) is None), 1))

    if "time" in table.names:
        table.look([(table.names.index("time"), see)])
    return "".join(other_times)


def _clock_ns(text: str) -> int | None:
    """A time of day as hhmmss.ss [ns]; None for another number. A leap second has the number 60."""
    match = CLOCK.fullmatch(text.strip())
    if not match or int(match[1]) > 23 or int(match[2]) > 59 or int(match[3]) > 60:
        return None
    return (3600 * int(match[1]) + 60 * int(match[2]) + int(match[3])) * SECOND_NS + int((match[4] or "").ljust(9, "0"))


def _time_of_day(start_ns: int) -> Callable[[str], int | None]:
    """Reads times of day as stamps [ns]; after midnight the next day goes on."""
    last_ns, day_ns = -1, start_ns

    def read(text: str) -> int | None:
        nonlocal last_ns, day_ns
        clock_ns = _clock_ns(text)
        if clock_ns is None:
            raise InputError("", text, "a time of day as hhmmss.ss")
        day_ns += DAY_NS * (clock_ns < last_ns - DAY_NS // 2)
        last_ns = clock_ns
        return day_ns + clock_ns

    return read


def labview(path: Path, name: str) -> LoggerText:
    """A measurement file of LabVIEW: times in seconds from its start, or an interval in its header; a unit for each channel.

    Format: National Instruments, Specification for the LabVIEW Measurement File (.lvm). Raises InputError for several columns of
    times, which belong to channels of different times.
    """
    table = TextTable(path, name)
    entries = {
        cells[0]: cells[1:] for line in table.lines_above if (cells := [cell.strip() for cell in line.split(table.separator)])
    }
    if table.names.count("X_Value") > 1:
        remedy = "write it again with one column of times: X Value Columns, One Column Only"
        raise InputError(name, "several columns X_Value", "one column of times", remedy)
    units = dict(zip(table.names[1:], entries.get("Y_Unit_Label", ()), strict=False))
    start_ns = _labview_start_ns(entries)
    interval_s = _first_number(entries.get("Delta_X", ()))
    note = "seconds" if table.first_cell(0) else f"every {interval_s:g} s, as the header says"
    return LoggerText(table, "X_Value", lambda: _seconds_from(start_ns, interval_s), units, note)


def _labview_start_ns(entries: Mapping[str, Sequence[str]]) -> int:
    """Start of the measurement, from its date and time; 0 without them."""
    days, clocks = entries.get("Date", ()), entries.get("Time", ())
    match = LABVIEW_CLOCK.fullmatch(clocks[0]) if clocks else None
    try:
        start = datetime.strptime(days[0], "%Y/%m/%d").replace(tzinfo=UTC) if days and match else None
    except ValueError:
        start = None
    if start is None or match is None:
        return 0
    seconds = int(start.timestamp()) + 3600 * int(match[1]) + 60 * int(match[2]) + int(match[3])
    return seconds * SECOND_NS + int((match[4] or "").ljust(9, "0"))


def _first_number(cells: Sequence[str]) -> float:
    try:
        number = float(cells[0].replace(",", ".")) if cells else 0.0
    except ValueError:
        return 0.0
    return number if math.isfinite(number) else 0.0


def _seconds_from(start_ns: int, interval_s: float) -> Callable[[str], int | None]:
    """Reads seconds since the start as stamps [ns]; rows without a time follow each other in the interval."""
    rows = itertools.count()

    def read(text: str) -> int | None:
        row = next(rows)
        seconds = number_of(text, "," if "," in text else ".")
        if seconds is None and interval_s:
            seconds = row * interval_s
        if seconds is not None and not abs(seconds) < MOST_TIME_S:
            raise InputError("", text, f"a time in seconds, within {MOST_TIME_S:g}")
        return None if seconds is None else start_ns + round(seconds * SECOND_NS)

    return read


KINDS = (
    FileKind("a VBOX file", (".vbo",), lambda path, name, _: [vbox(path, name)], checked=True),
    FileKind("a LabVIEW measurement file", (".lvm",), lambda path, name, _: [labview(path, name)], checked=True),
)
