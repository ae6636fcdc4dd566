# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads CSV in blocks, as text that shows its own notation, and by pyarrow as far as it understands it."""

import itertools
import zlib
from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from trackres_ros.files.arrow_columns import as_numpy
from trackres_ros.recording.channel_file import (
    CHUNK_ROWS,
    SEEN_CELLS,
    Channel,
    ChannelRows,
    ChosenChannel,
    TableFile,
    check_dates,
    time_note,
)
from trackres_ros.recording.opening import FileKind
from trackres_ros.recording.samples import FloatArray, IntArray
from trackres_ros.recording.text_table import (
    COMMA,
    NO_VALUE,
    POINT,
    SEPARATORS,
    Column,
    Progress,
    Tap,
    TextTable,
    decide,
    has_no_value,
    is_number,
    marks_of,
    number_of,
)
from trackres_ros.recording.text_times import DateTimes, TextTimes, times_of

BLOCK_BYTES = 2**20


class CsvTable(TableFile):
    """A CSV file, packed by gzip or not; see `ChannelFile`."""

    def __init__(self, path: Path, name: str) -> None:
        self.name = name
        self._table = TextTable(path, name)
        units = itertools.chain(self._table.units, itertools.repeat(""))
        self.channels = [Channel(name, unit) for name, unit in zip(self._table.names, units, strict=False)]

    def is_number(self, place: int) -> bool:
        """Whether the first filled cell of a column is a number, with any decimal mark."""
        return is_number(self._table.first_cell(place))

    def first_cells(self, place: int) -> Sequence[str]:
        """The first cells of a column with a value."""
        return self._table.first_cells(place, SEEN_CELLS)

    def settle(self, time: ChosenChannel | None, channels: Sequence[ChosenChannel]) -> None:
        """Choose the columns to read and find the notation of times and numbers, from the whole column where a cell is
        ambiguous.
        """
        assert time is not None
        chosen_channels, separator = (time, *channels), self._table.separator
        first_text = self._table.first_cell(time.place)
        self._dates = dates = times_of(first_text, time.binding.order)
        check_dates(time, self.name, dates is not None, "" if is_number(first_text) else first_text)
        marks = marks_of((column.name, column.binding.decimal) for column in chosen_channels[bool(dates) :])
        if separator != "," or (dates and dates.is_open) or self._has_quotes():
            observers = [(column.place, marks[column.name].see) for column in chosen_channels if column.name in marks]
            if isinstance(dates, DateTimes) and dates.is_open:
                observers.append((time.place, dates.see))
            self._table.look(observers)
        if isinstance(dates, DateTimes):
            dates.decide(self.name, time.name)
        mark_of_column = decide(marks, self.name, separator == ",")
        self._columns = [
            Column(item.place, item.name, partial(number_of, mark=mark_of_column.get(item.name, POINT)))
            for item in chosen_channels[bool(dates) :]
        ]
        if dates:
            self._columns.insert(0, Column(time.place, time.name, lambda cell: None if has_no_value(cell) else dates.value(cell)))
        marks_written = {mark_of_column[name] for name, item in marks.items() if item.marks}
        is_uniform = len(marks_written) < 2 and all(
            item.marks <= {mark_of_column[name]} and not item.topics_mark for name, item in marks.items()
        )
        self._fast_mark = next(iter(marks_written), POINT) if is_uniform and separator != " " else None
        self.notes = tuple(self._assumption_notes(time, [name for name, mark in mark_of_column.items() if mark == COMMA]))

    def _assumption_notes(self, time: ChosenChannel, of_comma: Sequence[str]) -> Iterator[str]:
        yield from self._table.notes
        if self._table.separator != ",":
            yield f"cells are separated by {SEPARATORS.get(self._table.separator, self._table.separator)}"
        if self._table.line > 1:
            yield f"the names are in line {self._table.line}"
        if of_comma:
            yield f"decimal comma in {', '.join(of_comma)}"
        if self._dates:
            yield time_note(time.name, self._dates.text)

    def _has_quotes(self) -> bool:
        with self._table.binary() as file:
            return any(b'"' in block for block in iter(lambda: file.read(BLOCK_BYTES), b""))

    def streams(self) -> Sequence[Iterator[ChannelRows]]:
        """The rows of the file."""
        return [self._rows()]

    def _rows(self) -> Iterator[ChannelRows]:
        """Read the rows: by pyarrow as far as it is installed and understands them, the rest as plain text."""
        progress = Progress()
        for chunks in (self._fast_chunks, self._plain_chunks):
            if not progress.is_complete:
                for rows in chunks(progress):
                    progress.rows += len(rows.time)
                    yield rows
        self.findings = tuple(self._table.look_at_lines(progress))

    def _fast_chunks(self, progress: Progress) -> Iterator[ChannelRows]:
        """Yield rows until the first block that pyarrow does not take as numbers."""
        try:
            import pyarrow as pa
            from pyarrow import csv as arrow
        except ImportError:
            return
        if self._fast_mark is None:
            return
        column_names = [f"c{column.place}" for column in self._columns]
        types = dict.fromkeys(column_names, pa.float64())
        if self._dates:
            types[column_names[0]] = pa.string()
        convert = arrow.ConvertOptions(
            column_types=types,
            include_columns=list(types),
            null_values=sorted(NO_VALUE),
            strings_can_be_null=True,
            quoted_strings_can_be_null=True,
            decimal_point=self._fast_mark,
        )
        table = self._table
        names = [f"c{place}" for place in range(len(table.names))]
        read = arrow.ReadOptions(use_threads=False, skip_rows=table.first_row, encoding=table.encoding, column_names=names)
        parse = arrow.ParseOptions(delimiter=table.separator)
        with (
            Tap(table, progress) as file,
            suppress(pa.ArrowException, OSError, EOFError, ValueError, zlib.error),  # plain reading reports it, with the line
            arrow.open_csv(file, read_options=read, parse_options=parse, convert_options=convert) as reader,
        ):
            while True:
                try:
                    rows = self._rows_of(reader.read_next_batch(), column_names)
                except StopIteration:
                    progress.is_complete = True
                    return
                if not rows.has_time.all():
                    return
                yield rows

    def _rows_of(self, batch: Any, column_names: Sequence[str]) -> ChannelRows:
        """Rows of an Arrow batch, time first."""
        first_column, *other_columns = (batch.column(name) for name in column_names)
        cells, is_given = zip(*map(as_numpy, other_columns), strict=True)
        has_value = [given & ~np.isnan(numbers) for numbers, given in zip(cells, is_given, strict=True)]  # nan in any case
        if self._dates is None:
            time, has_time = as_numpy(first_column)
            has_time &= ~np.isnan(time)
        else:
            texts = first_column.to_pylist()
            has_time = np.array([text is not None for text in texts], np.bool_)
            time = as_times([0 if text is None else self._dates.value(text) for text in texts], self._dates)
        return ChannelRows(time, has_time, np.stack(cells, axis=1), np.stack(has_value, axis=1))

    def _plain_chunks(self, progress: Progress) -> Iterator[ChannelRows]:
        """Yield the rows after those so far, cell by cell; the same numbers, and an error with its line."""
        rows = itertools.islice(self._table.rows(progress), progress.rows, None)
        numbers = self._table.numbers(rows, self._columns, progress)
        while chunk := list(itertools.islice(numbers, CHUNK_ROWS)):
            has_value = np.array([[number is not None for number in row] for row in chunk])
            time = [0 if row[0] is None else row[0] for row in chunk]
            cells = np.array([row[1:] for row in chunk], np.float64)
            stamps = as_times(time, self._dates)
            yield ChannelRows(stamps, has_value[:, 0], cells, has_value[:, 1:])


def as_times(times: Sequence[float], notation: TextTimes | None) -> IntArray | FloatArray:
    """Times of rows: of dates in whole nanoseconds, of clocks and numbers as floats."""
    return np.array(times, np.int64) if isinstance(notation, DateTimes) else np.array(times, np.float64)


KINDS = (FileKind("CSV", (".csv", ".csv.gz"), lambda path, name, _: [CsvTable(path, name)], checked=True),)
