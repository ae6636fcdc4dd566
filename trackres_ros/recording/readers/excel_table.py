# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads sheets of Excel workbooks."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from datetime import time as clock_time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from trackres_ros.errors import InputError, one_line
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.channel_file import (
    SEEN_CELLS,
    Channel,
    ChannelRows,
    ChosenChannel,
    TableFile,
    check_dates,
    time_note,
)
from trackres_ros.recording.opening import FileKind
from trackres_ros.recording.text_table import (
    COMMA,
    COMMENTS,
    Mark,
    decide,
    has_no_value,
    header_of,
    is_number,
    marks_of,
    number_of,
)
from trackres_ros.recording.text_times import MOST_S, NO_ZONE, DateTimes, times_of
from trackres_ros.recording.time_columns import clock_s
from trackres_ros.units import SECOND_NS

if TYPE_CHECKING:
    from openpyxl.workbook import Workbook

HEADER_WITHIN = 100  # rows
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def excel_tables(path: Path, name: str, _: Topics | None = None) -> list[ExcelTable]:
    """The visible sheets of a workbook that have a row of names.

    Raises InputError if no sheet has.
    """
    with _workbook(path) as book:
        sheets = [sheet for sheet in book.worksheets if sheet.sheet_state == "visible"]
        tables = [ExcelTable(path, name, sheet.title, *header) for sheet in sheets if (header := _header(sheet))]
    if not tables:
        raise InputError(name, "no visible sheet with a row of names", "a workbook with a table")
    return tables


class ExcelTable(TableFile):
    """A sheet of a workbook; see `ChannelFile`. Row numbers are those of Excel."""

    def __init__(self, path: Path, name: str, sheet: str, header_row: int, channels: Sequence[Channel]) -> None:
        self._path, self._sheet, self._header_row = path, sheet, header_row
        self.name, self.channels = f"{name}: sheet {one_line(sheet)}", channels

    def is_number(self, place: int) -> bool:
        """Whether the first filled cell of a column holds a number."""
        first_value = next(iter(self.first_cells(place)), "")
        return is_number(first_value) if isinstance(first_value, str) else isinstance(first_value, int | float)

    def first_cells(self, place: int) -> Sequence[Any]:
        """The first cells of a column with a value."""
        with _workbook(self._path) as book:
            cells = (_cell_content(row[place]) for row in self._below_header(book) if place < len(row))
            return list(itertools.islice((cell for cell in cells if cell is not None), SEEN_CELLS))

    def _below_header(self, book: Workbook) -> Iterator[Sequence[Any]]:
        sheet: Any = book[self._sheet]
        sheet.reset_dimensions()
        rows: Iterator[Sequence[Any]] = sheet.iter_rows(min_row=self._header_row + 1, values_only=True)
        return rows

    def settle(self, time: ChosenChannel | None, channels: Sequence[ChosenChannel]) -> None:
        """Read the sheet, and see how numbers and times in text are written."""
        assert time is not None
        self._columns = (time, *channels)
        self._numbers, cells = self._cells()
        times = self._times(time, cells[0])
        has_dates = times is not None
        notes = [f"sheet {one_line(self._sheet)}"]
        marks = marks_of((column.name, column.binding.decimal) for column in self._columns[has_dates:])
        for column, column_cells in zip(self._columns, cells, strict=True):
            if column.name in marks:
                marks[column.name].see([value for value in column_cells if isinstance(value, str)])
        mark_of_column = decide(marks, self.name)
        numbers = [
            [
                self._number(value, mark_of_column[column.name], row, column.name)
                for value, row in zip(column_cells, self._numbers, strict=True)
            ]
            for column, column_cells in list(zip(self._columns, cells, strict=True))[has_dates:]
        ]
        of_comma = [column for column, mark in mark_of_column.items() if mark == COMMA]
        notes += [f"decimal comma in {', '.join(of_comma)}"] if of_comma else []
        matrix = np.array([[np.nan if value is None else value for value in row] for row in numbers]).reshape(len(numbers), -1).T
        has_value = np.array([[value is not None for value in row] for row in numbers], np.bool_).reshape(len(numbers), -1).T
        if times is None:
            self._rows = ChannelRows(matrix[:, 0], has_value[:, 0], matrix[:, 1:], has_value[:, 1:])
        else:
            stamps, kind, note = times
            has_time = np.array([value is not None for value in stamps], np.bool_)
            self._rows = ChannelRows(np.array([value or 0 for value in stamps], kind), has_time, matrix, has_value)
            notes.insert(1, time_note(time.name, note))
        self.notes = tuple(notes)

    def _times(self, time: ChosenChannel, cells: Sequence[Any]) -> tuple[list[Any], type, str] | None:
        """Dates or clocks of the rows, how they are stored, and a note on their notation; None for numbers.

        Raises InputError for a first cell that is no time, or another one that is none of its notation.
        """
        first_value = next((value for value in cells if value is not None), 0.0)
        notation = times_of(first_value, time.binding.order) if isinstance(first_value, str) else None
        is_numeric = is_number(first_value) if isinstance(first_value, str) else isinstance(first_value, int | float)
        is_cell = isinstance(first_value, datetime | clock_time | timedelta)
        check_dates(time, self.name, is_cell or notation is not None, "" if is_numeric else str(first_value))
        rows = list(zip(cells, self._numbers, strict=True))
        if isinstance(first_value, datetime):
            return [self._stamp(value, row) for value, row in rows], np.int64, f"dates of Excel, {NO_ZONE}"
        if is_cell:
            return [self._clock(value, row) for value, row in rows], np.float64, "clocks of Excel, without a date"
        if notation is None:
            return None
        if isinstance(notation, DateTimes):
            notation.see(str(value) for value, _ in rows if value is not None)
            notation.decide(self.name, time.name)
        places = (f"{self.name}: row {row}, {time.name}" for row in self._numbers)
        stamps = [
            None if value is None else notation.value(str(value), place) for value, place in zip(cells, places, strict=True)
        ]
        return stamps, notation.kind, notation.text

    def streams(self) -> Sequence[Iterator[ChannelRows]]:
        """The rows read by `settle`."""
        return [iter([self._rows] if len(self._rows.time) else [])]

    def _cells(self) -> tuple[list[int], list[list[Any]]]:
        """Numbers of the rows with any wanted cell filled, and these cells by column: None where empty."""
        numbers: list[int] = []
        cells: list[list[Any]] = [[] for _ in self._columns]
        with _workbook(self._path) as book:
            for number, row in enumerate(self._below_header(book), self._header_row + 1):
                row_cells = [_cell_content(row[column.place]) if column.place < len(row) else None for column in self._columns]
                if any(value is not None for value in row_cells) and not self._is_beside(row):
                    numbers.append(number)
                    for values, value in zip(cells, row_cells, strict=True):
                        values.append(value)
        return numbers, cells

    def _is_beside(self, row: Sequence[Any]) -> bool:
        """Whether a row is a comment, or holds the names or units again."""
        texts = [value.strip() if isinstance(value, str) else value for value in row[: len(self.channels)]]
        is_comment = isinstance(texts[0], str) and texts[0].startswith(COMMENTS) and not any(texts[1:])
        return is_comment or any(
            texts == [getattr(channel, key) or None for channel in self.channels] for key in ("name", "unit")
        )

    def _number(self, value: Any, mark: Mark, row: int, column: str) -> float | None:
        if value is None or isinstance(value, int | float):
            return None if value is None else float(value)
        return number_of(str(value), mark, f"{self.name}: row {row}, {column}")

    def _clock(self, value: Any, row: int) -> float | None:
        if value is None or isinstance(value, clock_time | timedelta):
            return None if value is None else clock_s(value)
        where = f"{self.name}: row {row}, {self._columns[0].name}"
        raise InputError(where, str(value), "a clock, as in the rows before")

    def _stamp(self, value: Any, row: int) -> int | None:
        if value is None:
            return None
        if isinstance(value, datetime):
            interval = value.replace(tzinfo=UTC) - EPOCH
            seconds = interval.days * 86400 + interval.seconds
            if abs(seconds) <= MOST_S:
                return seconds * SECOND_NS + interval.microseconds * 1000
        where = f"{self.name}: row {row}, {self._columns[0].name}"
        raise InputError(where, str(value), "a date with a time, as in the rows before")


@contextmanager
def _workbook(path: Path) -> Iterator[Workbook]:
    """Open a workbook to read the values of its cells, not their formulas."""
    from openpyxl import load_workbook

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of styles and extensions that are of no use here
        book = load_workbook(path, read_only=True, data_only=True, keep_links=False)
        try:
            yield book
        finally:
            book.close()


def _header(sheet: Any) -> tuple[int, list[Channel]] | None:
    """Number of the last row above the numbers, with the names and the units below them."""
    sheet.reset_dimensions()
    filled_rows = [list(map(_cell_content, row)) for row in itertools.islice(sheet.iter_rows(values_only=True), HEADER_WITHIN)]
    width = max(map(len, filled_rows), default=0)
    texts = [["" if value is None else str(value).strip() for value in row] + [""] * (width - len(row)) for row in filled_rows]
    header = header_of([(row, False) for row in texts])
    if header is None:
        return None
    units = ["" if has_no_value(unit) else unit for unit in header.units]
    names = list(itertools.zip_longest(header.names, units, fillvalue=""))
    while not names[-1][0]:
        del names[-1]
    return (header.first_row if header.rows else header.place + 1 + bool(header.units)), [
        Channel(*name_and_unit) for name_and_unit in names
    ]


def _cell_content(value: Any) -> Any:
    """The value of a cell, None where there is none."""
    return None if isinstance(value, str) and has_no_value(value) else value


KINDS = (FileKind("an Excel workbook", (".xlsx",), excel_tables, (("openpyxl", "excel"),), checked=True),)
