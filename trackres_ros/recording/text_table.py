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
from operator import itemgetter
from pathlib import Path
from typing import Any, BinaryIO, Literal, NamedTuple, cast

from trackres_ros.errors import InputError
from trackres_ros.recording.reading import UTF_16
from trackres_ros.recording.roles import is_quantity
from trackres_ros.recording.samples import Finding
from trackres_ros.recording.text_times import is_clock, is_date_time

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
NO_VALUE_WORDS = frozenset((
    "", "-", "--", "---", "----", "?", "*", "***", "na", "n/a", "n.a.", "n.a", "n/d", "nd", "nil", "null", "(null)", "none",
    "nan", "+nan", "-nan", "nan(ind)", "-nan(ind)", "1.#qnan", "-1.#ind", "1.#ind", "<na>", "nat", "missing", "invalid",
    "no data", "no value", "not available", "undefined", "#n/a", "#na", "#nv", "#value!", "#wert!", "#div/0!", "#num!",
    "#zahl!", "#ref!", "#bezug!", "#name?", "#null!", "#valeur!", "#nombre!", "k. a.", "k.a.",
))  # fmt: skip
"""What programs write into a cell without a value, in lower case; the words with # are errors of spreadsheets."""
NO_VALUE = frozenset(form(word) for word in NO_VALUE_WORDS for form in (str, str.upper, str.title)) | {"NaN", "NaT", "<NA>"}
"""Cells without a value, as they are written most: no sample. Other cases count as well."""


def has_no_value(text: str) -> bool:
    """Whether a cell holds no value: one list for tables of text, Excel and DMA sweeps."""
    return text.strip().lower() in NO_VALUE_WORDS


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
    """The number in a cell, None where it has no value. Raises InputError with its place if it is no number."""
    number_text, other_mark = text.strip(), COMMA if mark == POINT else POINT
    if not number_text[-1:].isdigit() and has_no_value(number_text):
        return None
    try:
        if "_" in number_text or (
            other_mark in number_text and not GROUPED[mark].fullmatch(number_text)
        ):  # 1_0 is Python's notation, not that of a table
            raise ValueError(text)
        number_text = number_text.replace(other_mark, "")
        return float(number_text if mark == POINT else number_text.replace(COMMA, POINT))
    except ValueError:
        if number_text.lower() in TRUTH:
            return TRUTH[number_text.lower()]
        raise InputError(where, text, "a number, or an empty cell") from None


def is_number_or_time(text: str) -> bool:
    """Whether a cell holds a number, a date with a time, or a clock."""
    return is_number(text) or is_date_time(text) or is_clock(text)


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
    numbers: int  # most numbers and times in one of these rows


def header_of(rows: Sequence[tuple[Row, bool]], is_unit: Callable[[str], bool] = is_quantity) -> Header | None:
    """The row with the names of a table: the one above most rows of numbers of its width; without any the first one.

    `rows`: each row, empty or not, and whether it is a comment, which may hold the names too; `is_unit`: whether a text is a
    unit. Returns None if all rows are empty.
    """
    lines = [
        _Line(place, cells, comment, sum(map(is_number_or_time, cells)))
        for place, (cells, comment) in enumerate(rows)
        if any(cells) and not (any(map(str.strip, cells)) and all(map(has_no_value, cells)))
    ]
    first = next((line.place for line in lines if not line.comment), None)
    best_header, is_best_comment = None, False
    for number, line in enumerate(lines):
        if has_remarks(line.cells):
            return Header(line.cells, (), line.place, line.place + 1, COMPARED_ROWS, len(line.cells))
        is_first, has_several = line.place == first, sum(map(bool, line.cells)) > 1
        if not (is_first or (has_several and not line.numbers)):
            continue
        header = _header_at(line, lines[number + 1 :], has_several, len(rows), is_unit)
        if best_header is None:
            is_better = bool(header.rows) or is_first
        else:
            gain = (header.rows, header.numbers) > (best_header.rows, best_header.numbers)
            is_nearer = header.rows == best_header.rows and is_best_comment and line.comment  # text may stand above the names
            is_better = (gain and line.cells != best_header.names) or (is_nearer and line.cells != best_header.units)
        if is_better:
            best_header, is_best_comment = header, line.comment
    return best_header


def has_remarks(names: Row) -> bool:
    """Whether the last column holds comments, and most rows end before it."""
    return len(names) > 1 and (names[0], names[-1]) == REMARKS


class _Line(NamedTuple):
    """A filled row of the head of a table: its index, and how many of its cells are numbers or times."""

    place: int
    cells: Row
    comment: bool
    numbers: int


KINDS_OF_NUMBERS = re.compile(
    r"[iuf]\d{1,2}|u?int\d*|float\d*|double|single|real|integer|bool(?:ean)?|string|text|number|numeric|date(?:time)?|time|char",
    re.IGNORECASE,
)
"""Words of a row that says how numbers were stored."""


def _header_at(line: _Line, below: Sequence[_Line], has_several: bool, end: int, is_unit: Callable[[str], bool]) -> Header:
    """The header if a row holds the names: rows with units, kinds of numbers or, below units, descriptions may follow.

    `below`: the filled rows below it; `has_several`: whether it has several names; `end`: number of rows.
    """
    first_number = next((other.place for other in below if not other.comment), end)
    below = [other for other in below if not other.comment or (line.comment and other.place < first_number)]
    units: Row = ()
    rows = list[_Line]()
    for other in below:
        if other.cells in (line.cells, units):  # some instruments write both again
            continue
        if not rows and not other.numbers:
            filled_cells = [cell for cell in other.cells if cell]
            if not units and any(map(is_unit, filled_cells)):
                units = other.cells
                continue
            is_described = bool(units) and len(other.cells) == len(line.cells)
            if other.comment or is_described or all(map(KINDS_OF_NUMBERS.fullmatch, filled_cells)):
                continue
        rows.append(other)
    fitting = [has_several and row.numbers > 0 and fits_width(row.cells, len(line.cells)) for row in rows[:COMPARED_ROWS]]
    count = [*fitting, False].index(False)
    numbers = max((row.numbers for row in rows[:count]), default=0)
    return Header(line.cells, units, line.place, rows[0].place if rows else end, count, numbers)


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
    side_rows: int = 0  # rows between the others that are comments, empty, or the names and units again


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
        names = [cell.strip() for cell in header.names[: -1 if self.has_remarks else None]]
        self.names = names[: max(place for place, cell in enumerate(names, 1) if cell)]
        self.units = ["" if has_no_value(cell) else cell.strip() for cell in header.units][: len(self.names)]
        self._header = [names, [cell.strip() for cell in header.units]]
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
        return next(iter(self.first_cells(place, 1)), "")

    def first_cells(self, place: int, count: int) -> list[str]:
        """The first so many cells of a column with a value."""
        cells = (row[place].strip() for row in self.whole_rows())
        return list(itertools.islice((cell for cell in cells if not has_no_value(cell)), count))

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
                if row[0].lstrip().startswith(COMMENTS) or self._is_header(row):
                    progress.side_rows += 1
                    continue
                if progress.has_line_end or len(row) > len(self.names):
                    raise
                numbers = [None]
            if numbers.count(None) == len(numbers) and progress.has_line_end and not any(map(str.strip, row)):
                progress.side_rows += 1
                continue
            progress.left_out = not progress.has_line_end and numbers[0] is None
            if not progress.left_out:
                yield numbers

    def _is_header(self, row: Sequence[str]) -> bool:
        """Whether a row holds the names or units again."""
        cells = [cell.strip() for cell in row]
        return any(header and cells[: len(header)] == header and not any(cells[len(header) :]) for header in self._header)

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
            text = f"{progress.side_rows} lines between the rows are skipped: they are comments, empty, or the names again"
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
