# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads a table of text, as programs and instruments write it: lines above the names, a row of units below them, comments, any
separator, decimal mark, notation of time and coding. The whole column decides how an ambiguous number or date is written.
"""

import codecs
import csv
import gzip
import io
import itertools
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import date
from functools import lru_cache
from operator import itemgetter
from pathlib import Path
from typing import Any, BinaryIO, Literal, NamedTuple, cast

from trackres_ros.errors import InputError
from trackres_ros.recording.reading import UTF_16
from trackres_ros.recording.roles import is_quantity
from trackres_ros.recording.samples import Finding
from trackres_ros.units import SECOND_NS

Mark = Literal[".", ","]
POINT: Mark = "."
COMMA: Mark = ","
MARKS: tuple[tuple[Mark, Mark], ...] = ((POINT, COMMA), (COMMA, POINT))
"""Each mark, and the other one."""
EXPONENT = r"(?:[eE][+-]?\d+)?"
HEAD = r"[+-]?[1-9]\d{0,2}"


def _either_pattern(mark: Mark) -> str:
    """1,234: one and a bit, or one thousand and more."""
    return rf"{HEAD}[{mark}]\d{{3}}"


def _sure_pattern(mark: Mark, other_mark: Mark) -> str:
    """Numbers with a certain decimal mark: 0,5 and 12,34 and 1.234,5 and 1.234.567."""
    plain_pattern = rf"(?!{_either_pattern(mark)}$)[+-]?(?:\d+[{mark}]\d*|[{mark}]\d+){EXPONENT}"
    grouped_pattern = rf"{HEAD}(?:[{other_mark}]\d{{3}})+[{mark}]\d*{EXPONENT}|{HEAD}(?:[{other_mark}]\d{{3}}){{2,}}"
    return rf"(?:{plain_pattern}|{grouped_pattern})"


SURELY = {mark: re.compile(rf"^{_sure_pattern(mark, other)}$", re.MULTILINE) for mark, other in MARKS}
EITHER = {mark: re.compile(rf"^{_either_pattern(mark)}$", re.MULTILINE) for mark, _ in MARKS}
GROUPED = {mark: re.compile(rf"{HEAD}(?:[{other}]\d{{3}})+(?:[{mark}]\d*)?{EXPONENT}", re.ASCII) for mark, other in MARKS}
"""A number with a mark between thousands, by its decimal mark."""
NUMBER_LIKE = re.compile(rf"[+-]?(?:[\d.,]*\d[\d.,]*{EXPONENT}|nan|inf(?:inity)?|true|false)", re.IGNORECASE)
TRUTH = {"true": 1.0, "false": 0.0}
"""Cells of a switch, in lower case."""
NO_VALUE = frozenset(("", "-", "--", "---", "NA", "N/A", "n/a", "na", "#N/A", "#NA", "NULL", "Null", "null", "None", "none"))
"""Cells without a value: no sample."""


@dataclass(slots=True)
class ColumnMarks:
    """Evidence on the marks in the cells of one column."""

    topics_mark: Mark | Literal[""] = ""  # the decimal mark that the topics file names; empty without one
    # by mark: the first cell in which it is surely the decimal mark, and the first in which it may also separate thousands
    sure_examples: dict[Mark, str] = field(default_factory=dict)
    either_examples: dict[Mark, str] = field(default_factory=dict)
    marks: set[Mark] = field(default_factory=set)  # all marks in any cell

    def see(self, cells: Sequence[str]) -> None:
        """Look at some more cells."""
        text = "\n".join(cells)
        for mark in (POINT, COMMA):
            self.marks |= {mark} if mark in text else set()
        for examples, patterns in ((self.sure_examples, SURELY), (self.either_examples, EITHER)):
            for mark, pattern in patterns.items():
                if mark not in examples and self.marks and (match := pattern.search(text)):
                    examples[mark] = match.group()


def marks_of(lines: Iterable[tuple[str, Mark | Literal[""]]]) -> dict[str, ColumnMarks]:
    """The evidence to collect, by column: of several lines for one column, any may give its decimal mark."""
    marks: dict[str, ColumnMarks] = {}
    for column, mark in lines:
        marks_of_column = marks.setdefault(column, ColumnMarks())
        marks_of_column.topics_mark = marks_of_column.topics_mark or mark
    return marks


def decide(columns: Mapping[str, ColumnMarks], name: str, commas_separate: bool = False) -> dict[str, Mark]:
    """The decimal mark of each column.

    A column decides for itself. In an ambiguous one, a mark is the decimal one if it surely is in other columns of the table and
    the other mark is in none; or if it is a point and commas separate the cells.

    `columns`: by name; `name`: of the table, for messages; `commas_separate`: the cells of the table. Raises InputError if
    neither the column nor the others decide, or a column shows both.
    """
    sure_marks = {
        mark for marks in columns.values() for mark in ((marks.topics_mark,) if marks.topics_mark else marks.sure_examples)
    }
    shown_marks = sure_marks or ({POINT} if commas_separate else set())
    return {column: _mark_of(marks, shown_marks, f"{name}: {column}") for column, marks in columns.items()}


def _mark_of(marks: ColumnMarks, shown_marks: set[Mark], where: str) -> Mark:
    if marks.topics_mark:
        return marks.topics_mark
    if len(marks.sure_examples) > 1:
        given = f"{marks.sure_examples[POINT]} with a decimal point and {marks.sure_examples[COMMA]} with a decimal comma"
        raise InputError(where, given, "one decimal mark in a column")
    if marks.sure_examples:
        return next(iter(marks.sure_examples))
    if not marks.either_examples:
        return POINT
    if set(marks.either_examples) == shown_marks:
        return next(iter(shown_marks))
    given = f"{next(iter(marks.either_examples.values()))}, a number whose mark may be a decimal or a thousands separator"
    remedy = "give the decimal mark in a topics file, in the line of the column: decimal: ',' or decimal: '.'"
    raise InputError(where, given, "a column or table with an unambiguous decimal mark, as in 0,5", remedy)


def is_number(text: str) -> bool:
    """Whether a cell holds a number, whatever its decimal mark is."""
    if not NUMBER_LIKE.fullmatch(text.strip()):
        return False
    for mark in (POINT, COMMA):
        with suppress(ValueError):
            return number_of(text, mark) is not None
    return False


def number_of(text: str, mark: Mark, where: str = "") -> float | None:
    """The number in a cell, None where it is empty. Raises InputError with its place if it is no number."""
    number_text, other_mark = text.strip(), COMMA if mark == POINT else POINT
    if not number_text:
        return None
    try:
        if "_" in number_text or (
            other_mark in number_text and not GROUPED[mark].fullmatch(number_text)
        ):  # 1_0 is Python's notation, not that of a table
            raise ValueError(text)
        number_text = number_text.replace(other_mark, "")
        return float(number_text if mark == POINT else number_text.replace(COMMA, POINT))
    except ValueError:
        if number_text in NO_VALUE:
            return None
        if number_text.lower() in TRUTH:
            return TRUTH[number_text.lower()]
        raise InputError(where, text, "a number, or an empty cell") from None


def is_number_or_time(text: str) -> bool:
    """Whether a cell holds a number, or a date with a time."""
    return is_number(text) or is_date_time(text)


ZONE = r"(?P<zone>Z|UTC|[+-]\d\d(?::?\d\d)?)?"
CLOCK = rf"(?P<hour>\d{{1,2}}):?(?P<minute>\d\d)(?::?(?P<second>\d\d)(?:[.,](?P<part>\d+))?)?\s*{ZONE}"
FIRST = r"(?P<year>\d{4})(?P<mark>[-/]?)(?P<month>\d\d)(?P=mark)(?P<day>\d\d)[T ] *"
LAST = r"(?P<one>\d{1,2})(?P<mark>[./-])(?P<two>\d{1,2})(?P=mark)(?P<year>\d{4})[T ,] *"
YEAR_FIRST, YEAR_LAST = (re.compile(day + CLOCK, re.IGNORECASE | re.ASCII) for day in (FIRST, LAST))
UNIX_DAY = date(1970, 1, 1).toordinal()
MOST_S = 2**63 // SECOND_NS - 1
"""Years that fit in 64 bits as nanoseconds: from 1678 to 2262."""
MOST_MONTHS = 12

Order = Literal["dmy", "mdy", ""]


def is_date_time(text: str) -> bool:
    """Whether a cell holds a date with a time."""
    text = text.strip()
    return bool(YEAR_FIRST.fullmatch(text) or YEAR_LAST.fullmatch(text))


class DateTimes:
    """The dates and times of one column, all in the notation of the first one.

    `first`: the first cell; `is_date_time` is true for it; `order`: of day and month if the year comes last and the topics file
    names it. With dots the day comes first.
    """

    def __init__(self, first_text: str, order: Order = "") -> None:
        match = YEAR_FIRST.fullmatch(first_text.strip()) or YEAR_LAST.fullmatch(first_text.strip())
        assert match
        self._pattern = match.re
        self._mark = match["mark"]
        self._has_zone = bool(match["zone"])
        self._order: Order = order or ("dmy" if self._mark == "." else "")
        self._first_text = first_text.strip()
        self._order_examples: dict[Order, str] = {}

    @property
    def is_open(self) -> bool:
        """Whether the other cells have to show which is the day and which the month."""
        return self._pattern is YEAR_LAST and not self._order

    def see(self, cells: Iterable[str]) -> None:
        """Look for a day above 12 in some more cells."""
        for text in cells:
            if match := YEAR_LAST.fullmatch(text.strip()):
                if int(match["one"]) > MOST_MONTHS:
                    self._order_examples.setdefault("dmy", text)
                if int(match["two"]) > MOST_MONTHS:
                    self._order_examples.setdefault("mdy", text)

    def decide(self, where: str) -> None:
        """Settle the order of day and month from the cells so far.

        Raises InputError if the column does not show it, or shows both.
        """
        if not self.is_open:
            return
        if len(self._order_examples) > 1:
            raise InputError(where, " and ".join(self._order_examples.values()), "dates in one order of day and month")
        if not self._order_examples:
            remedy = "give the order in a topics file: time: {column: NAME, order: dmy}, or mdy; or write dates as 2026-11-23"
            given = f"{self._first_text}: the order of day and month is ambiguous in the whole column"
            raise InputError(where, given, "at least one date with a day above 12", remedy)
        self._order = next(iter(self._order_examples))

    def ns(self, text: str, where: str = "") -> int:
        """Time since 1970 in UTC [ns]; digits below a nanosecond are cut off.

        Raises InputError with its place for another notation than that of the first cell, or an invalid date or time.
        """
        try:
            match = self._pattern.fullmatch(text.strip())
            if not match or match["mark"] != self._mark or bool(match["zone"]) is not self._has_zone:
                raise ValueError(text)
            if self._pattern is YEAR_FIRST:
                month, day = match["month"], match["day"]
            else:
                month, day = (match["two"], match["one"]) if self._order == "dmy" else (match["one"], match["two"])
            hour, minute, second = int(match["hour"]), int(match["minute"]), int(match["second"] or 0)
            if hour > 23 or minute > 59 or second > 60:  # a leap second has the number 60
                raise ValueError(text)
            seconds = _day_s(match["year"], month, day) + 3600 * hour + 60 * minute + second - _zone_s(match["zone"])
            if abs(seconds) > MOST_S:
                raise ValueError(text)
            return seconds * SECOND_NS + int((match["part"] or "0")[:9].ljust(9, "0"))
        except ValueError:
            raise InputError(where, text, f"an existing date and time, as in the other rows ({self.text})") from None

    def read(self, cell: str) -> int | None:
        """The time in a cell, as `ns`; None where there is none."""
        return None if cell.strip() in NO_VALUE else self.ns(cell)

    @property
    def text(self) -> str:
        """How the column was read, for people."""
        if self._pattern is YEAR_FIRST:
            form = "yyyy/mm/dd hh:mm:ss" if self._mark == "/" else "ISO 8601"
        else:
            form = f"{self._mark.join(('dd', 'mm') if self._order == 'dmy' else ('mm', 'dd'))}{self._mark}yyyy hh:mm:ss"
        return f"{form}, {'with a time zone' if self._has_zone else NO_ZONE}"


NO_ZONE = "without a time zone: treated as UTC"


@lru_cache(maxsize=64)
def _day_s(year: str, month: str, day: str) -> int:
    return (date(int(year), int(month), int(day)).toordinal() - UNIX_DAY) * 86400


@lru_cache(maxsize=64)
def _zone_s(zone: str | None) -> int:
    """Seconds by which a zone is ahead of UTC."""
    if not zone or zone.upper() in ("Z", "UTC"):
        return 0
    digits = zone[1:].replace(":", "").ljust(4, "0")
    hours, minutes = int(digits[:2]), int(digits[2:])
    if hours > 23 or minutes > 59:
        raise ValueError(zone)
    return (3600 * hours + 60 * minutes) * (-1 if zone[0] == "-" else 1)


# --- tables

COMMENTS = ("#", "%", "//", "!")
SECTION = re.compile(r"\[[^\[\]]*\]|\*{3}\w+\*{3}")
"""A line that begins or ends a part of a file, as VBOX and LabVIEW write it: like a comment it is no row."""
REMARKS = "X_Value", "Comment"
"""The first and last name of a LabVIEW table. Rows have a cell for the last one only where they have a comment."""
SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs", " ": "spaces"}
SEPARATOR_LINE = re.compile(r'"?sep=(.)"?', re.IGNORECASE)
"""As Excel takes it from the first line."""
HEAD_BYTES, LEAST_LINES, MOST_LINES = 2**16, 4, 200
"""Text in which the names are looked for: so many bytes, at least and at most so many lines."""
COMPARED_ROWS = 8
LOOKED_AT_ROWS = 512
"""Cells held at once; one has at most 128 KiB."""

Row = Sequence[str]


class Header(NamedTuple):
    """The names of a table, and the units below them if it has any."""

    names: Row
    units: Row
    place: int  # index of the row of names
    first_row: int  # index of the row below the names and the units
    rows: int  # rows of numbers of the same width below them, up to `COMPARED_ROWS`
    numbers: int  # numbers and times in the first row


def header_of(rows: Sequence[tuple[Row, bool]], is_unit: Callable[[str], bool] = is_quantity) -> Header | None:
    """The row with the names of a table: the one above most rows of numbers of its width; without any the first one.

    `rows`: each row, empty or not, and whether it is a comment, which may hold the names too; `is_unit`: whether a text is a
    unit. Returns None if all rows are empty.
    """
    filled_rows = [(place, cells) for place, (cells, comment) in enumerate(rows) if any(cells) and not comment]
    best_header: Header | None = None
    for place, (cells, _) in enumerate(rows):
        if has_remarks(cells):
            return Header(cells, (), place, place + 1, COMPARED_ROWS, len(cells))
        is_first, has_several = bool(filled_rows) and place == filled_rows[0][0], sum(map(bool, cells)) > 1
        if not (is_first or (has_several and not any(map(is_number_or_time, cells)))):
            continue
        rows_below = [entry for entry in filled_rows if entry[0] > place and entry[1] != cells]
        units: Row = ()
        if rows_below and any(map(is_unit, rows_below[0][1])) and not any(map(is_number_or_time, rows_below[0][1])):
            units = rows_below[0][1]
            rows_below = [entry for entry in rows_below if entry[1] != units]  # some instruments write both again
        fitting = [
            has_several and any(map(is_number_or_time, row)) and fits_width(row, len(cells))
            for _, row in rows_below[:COMPARED_ROWS]
        ]
        count = [*fitting, False].index(False)
        numbers = sum(map(is_number_or_time, rows_below[0][1])) if count else 0
        first = rows_below[0][0] if rows_below else len(rows)
        if best_header is None or count > best_header.rows:
            best_header = Header(cells, units, place, first, count, numbers) if count or is_first else best_header
        if fitting and all(fitting):
            break
    return best_header


def has_remarks(names: Row) -> bool:
    """Whether the last column holds comments, and most rows end before it."""
    return len(names) > 1 and (names[0], names[-1]) == REMARKS


def fits_width(row: Row, width: int) -> bool:
    """Whether a row has as many cells as there are names; further ones may be empty."""
    return len(row) == width or (len(row) > width and not any(row[width:]))


@dataclass(slots=True)
class Progress:
    """State of one reading of a table."""

    rows: int = 0  # rows so far
    is_complete: bool = False  # whether that is all
    has_quotes: bool = False  # whether there are quotes
    last: bytes = b""  # the last byte
    line: int = 0  # number of the last line
    has_line_end: bool = True  # false after a row of one line without an end, which may be cut
    left_out: bool = False  # whether that row is
    side_rows: int = 0  # rows between the others that are comments, or the names and units again


class Column(NamedTuple):
    """A column to read: its index, its name, and how a cell is read."""

    place: int
    name: str
    read: Callable[[str], float | int | None]


class TextTable:
    """A table in a file of text, packed by gzip or not.

    `path`: the file; `name`: for messages; `is_unit`: whether a text is a unit of a column. Raises InputError for a file without
    text.
    """

    def __init__(self, path: Path, name: str, is_unit: Callable[[str], bool] = is_quantity) -> None:
        self.path, self.name, self.encoding, self.notes = path, name, "utf-8", list[str]()
        lines = self._head()
        given = SEPARATOR_LINE.fullmatch(lines[0].rstrip("\r\n")) if lines else None
        candidates: list[tuple[tuple[int, int, int], str, Header]] = []
        for separator in given[1] if given else SEPARATORS:
            if separator == " " and any(key[0] for key, _, _ in candidates):
                break  # spaces are in dates and names too
            rows = [_cells(line, separator) for line in lines[given is not None :]]
            header = header_of([((), True)] * (given is not None) + rows, is_unit)
            if header:
                count = lines[header.place].count(separator) * (separator != " ")
                candidates.append(((header.rows, header.numbers, count), separator, header))
        if not candidates:
            raise InputError(name, "no line with text", "a table with a line of column names")
        _, self.separator, header = max(candidates, key=itemgetter(0))
        self.has_remarks = has_remarks(header.names)
        self.names = [cell.strip() for cell in header.names[: -1 if self.has_remarks else None]]
        self.units = [cell.strip() for cell in header.units]
        self.line, self.first_row, self.lines_above = header.place + 1, header.first_row, lines[: header.place]

    def _head(self) -> list[str]:
        """The first lines, and so the encoding."""
        with self.binary() as file:
            head, block = b"", b"-"
            while block and (len(head) < HEAD_BYTES or len(re.findall(rb"\r\n|\r|\n", head)) < LEAST_LINES):
                block = file.read(max(HEAD_BYTES, len(head)))
                head += block
        try:
            text = codecs.getincrementaldecoder("utf-8-sig")().decode(head, not block)
        except UnicodeDecodeError:
            self.encoding, text = "latin-1", head.decode("latin-1")
            self.notes.append("the file is not UTF-8; read as Latin-1")
        if "\0" in text:
            raise InputError(self.name, "binary data", "a table as text", "save it as text, such as CSV")
        lines = list(itertools.islice(io.StringIO(text, newline=""), MOST_LINES))
        return lines[:-1] if block and not lines[-1].endswith(("\n", "\r")) else lines

    def binary(self) -> BinaryIO:
        """The unpacked file; one in UTF-16 as UTF-8."""
        is_packed = self.path.name.lower().endswith(".gz")
        file = cast("BinaryIO", gzip.open(self.path) if is_packed else self.path.open("rb"))  # noqa: SIM115 - the caller closes it
        is_wide = file.read(2) in UTF_16
        file.seek(0)
        return cast("BinaryIO", codecs.EncodedFile(file, "utf-8", "utf-16", "replace")) if is_wide else file

    def rows(self, progress: Progress) -> Iterator[list[str]]:
        """The rows below the header, with the state of reading. Raises InputError with the line for one that is no row."""
        tap = cast("BinaryIO", Tap(self, progress))
        with tap, io.TextIOWrapper(tap, self.encoding, errors="replace", newline="") as file:
            is_inside = False  # of a row of several lines

            def lines() -> Iterator[str]:
                nonlocal is_inside
                has_spaces = self.separator == " "
                for progress.line, line in enumerate(itertools.islice(file, self.first_row, None), self.first_row + 1):
                    progress.has_line_end = is_inside or line.endswith(("\n", "\r"))
                    is_inside = True
                    yield " ".join(line.split()) + "\n" if has_spaces else line

            try:
                for row in csv.reader(lines(), delimiter=self.separator):
                    is_inside = False
                    if row:
                        yield row[: len(self.names)] if self.has_remarks else row
            except csv.Error as error:
                raise InputError(f"{self.name}: line {progress.line}", str(error), "a table to the end of the file") from error

    def whole_rows(self) -> Iterator[list[str]]:
        """Rows as long as the header, without a last one that may be cut; others are reported when they are read."""
        progress, width = Progress(), len(self.names)
        with suppress(InputError):
            for place, row in enumerate(self.rows(progress)):
                if fits_width(row, width) and (progress.has_line_end or not place):
                    yield row

    def first_cell(self, place: int) -> str:
        """The first cell of a column with a value; empty without one."""
        return next((cell for row in self.whole_rows() if (cell := row[place].strip()) not in NO_VALUE), "")

    def look(self, observers: Sequence[tuple[int, Callable[[Sequence[str]], None]]]) -> None:
        """Show the cells of some columns to a function each."""
        rows = ([row[place].strip() for place, _ in observers] for row in self.whole_rows())
        while chunk := list(itertools.islice(rows, LOOKED_AT_ROWS)):
            for (_, see), cells in zip(observers, zip(*chunk, strict=True), strict=True):
                see(cells)

    def numbers(self, rows: Iterator[list[str]], columns: Sequence[Column], progress: Progress) -> Iterator[list[Any]]:
        """The numbers of some columns row by row, None where there is no value.

        Without comments, repeated names and units, and a last line that is cut before it is a row. Raises InputError with its
        place.
        """
        for row in rows:
            try:
                numbers = self._numbers(row, columns, progress.line)
            except InputError:
                if row[0].lstrip().startswith(COMMENTS) or [cell.strip() for cell in row] in (self.names, self.units):
                    progress.side_rows += 1
                    continue
                if progress.has_line_end or len(row) > len(self.names):
                    raise
                numbers = [None]
            progress.left_out = not progress.has_line_end and numbers[0] is None
            if not progress.left_out:
                yield numbers

    def _numbers(self, row: Sequence[str], columns: Sequence[Column], line: int) -> list[float | int | None]:
        width = len(self.names)
        if len(row) != width and not fits_width(row, width):
            remedy = ""
            if self.separator == "," and len(row) > width:
                remedy = "if numbers have a decimal comma, separate cells by semicolons or tabs"
            elif self.separator == " ":
                remedy = "between spaces no cell may be empty: separate cells by tabs"
            raise InputError(f"{self.name}: line {line}", f"{len(row)} cells", f"{width} cells, as in the header", remedy)
        numbers = []
        for place, name, read in columns:
            try:
                numbers.append(read(row[place]))
            except InputError as error:
                raise InputError(f"{self.name}: line {line}, column {name}", error.given, error.allowed) from None
        return numbers

    def look_at_lines(self, progress: Progress) -> Iterator[Finding]:
        """Report lines of the file that are no rows of the table, and a last row that may be incomplete."""
        if progress.side_rows:
            text = f"{progress.side_rows} lines between the rows are skipped: they are comments, or the names again"
            yield Finding("", "comment", progress.side_rows, float("nan"), text)
        if progress.has_quotes:
            with io.TextIOWrapper(self.binary(), "latin-1") as file:  # whatever ends the lines
                lines = sum(line != "\n" for line in itertools.islice(file, self.first_row, None))
            swallowed = lines - progress.rows - progress.left_out - progress.side_rows
            if swallowed > 0:
                text = f"{swallowed} lines are not rows: they are inside a quotation that an earlier line opens"
                yield Finding("", "quoted", swallowed, float("nan"), text)
        if progress.last not in (b"\n", b"\r"):
            consequence = "it is left out" if progress.left_out else "the file and its last number may be truncated"
            text = f"the last line is incomplete: {consequence}"
            yield Finding("", "cut", 1, float("nan"), text)


def _cells(line: str, separator: str) -> tuple[Row, bool]:
    """The cells of a line without its mark of a comment, and whether it is one."""
    text = line.strip("\r\n")
    comment = text.lstrip().startswith(COMMENTS) or SECTION.fullmatch(text.strip()) is not None
    text = text.lstrip("#%!/ ") if comment else text
    if separator == " ":
        return (text.split("\t") if "\t" in text.strip() else text.split()), comment
    try:
        return [cell.strip() for cell in next(csv.reader([text], delimiter=separator), [])], comment
    except csv.Error:  # an endless cell
        return [cell.strip() for cell in text.split(separator)], comment


class Tap(io.BufferedIOBase):
    """Watches the bytes of a table in passing: whether they contain quotes, and which is the last."""

    def __init__(self, table: TextTable, progress: Progress) -> None:
        self._file, self._progress = table.binary(), progress

    def readable(self) -> bool:
        """Always."""
        return True

    def read(self, size: int | None = -1) -> bytes:
        """Pass on the next bytes."""
        data = self._file.read(-1 if size is None else size)
        if data:
            self._progress.has_quotes = self._progress.has_quotes or b'"' in data
            self._progress.last = data[-1:]
        return data

    read1 = read

    def close(self) -> None:
        """Close the file."""
        self._file.close()
        super().close()
