# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads CSV in blocks, with the separator, the decimal mark and the times that the file itself shows."""

import codecs
import csv
import gzip
import io
import itertools
import re
import zlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, cast

import numpy as np

from trackres_ros.errors import InputError
from trackres_ros.files.arrow_columns import as_numpy
from trackres_ros.recording.channel_file import CHUNK_ROWS, Channel, ChannelRows, ChosenChannel, TableFile, check_dates, time_note
from trackres_ros.recording.opening import FileKind
from trackres_ros.recording.samples import Finding
from trackres_ros.recording.text_table import COMMA, POINT, DateTimes, Mark, decide, is_date_time, is_number, marks_of, number_of

MAX_ROW_BYTES = 2**24
"""Longest line, and longest row of quoted lines, that is read: one of 200,000 columns is a fifth of it."""
HEAD_BYTES = 2**16
BLOCK_BYTES = 2**20
SEEN_ROWS = 512
"""Text held at once, of the columns that are read; a cell has at most 128 KiB."""
SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs"}


@dataclass(slots=True)
class _Met:
    """State of one reading: rows so far, whether that is all, whether there are quotes, the last byte."""

    rows: int = 0
    complete: bool = False
    quoted: bool = False
    last: bytes = b""
    left_out: bool = False  # a cut last line


class CsvTable(TableFile):
    """A CSV file, packed by gzip or not; see `ChannelFile`."""

    def __init__(self, path: Path, name: str) -> None:
        self.name, self._path = name, path
        self._encoding, self._separator = "utf-8", ","
        self.names = self._header()
        self.channels = [Channel(name) for name in self.names]

    def _header(self) -> list[str]:
        """Read the names, and settle encoding and separator."""
        with _binary(self._path) as file:
            head = file.read(HEAD_BYTES)
            if not re.search(rb"[\r\n]", head):
                head += file.read(MAX_ROW_BYTES)
        line, *more = re.split(rb"[\r\n]+", head.removeprefix(codecs.BOM_UTF8), maxsplit=2)
        if len(line) >= MAX_ROW_BYTES:
            raise InputError(self.name, f"a first line of more than {MAX_ROW_BYTES} bytes", "CSV with a line of column names")
        try:
            text = line.decode("utf-8")
        except UnicodeDecodeError:
            self._encoding, text = "latin-1", line.decode("latin-1")
        first = more[0].decode("latin-1") if more else ""
        fitting = [one for one in SEPARATORS if one in text and _width(first, one) == _width(text, one)]
        self._separator = max(fitting or SEPARATORS, key=text.count)
        names = [name.strip() for name in next(csv.reader([text], delimiter=self._separator), [])]
        if not any(names):
            raise InputError(self.name, "an empty file or first line", "CSV with a line of column names")
        return names

    def is_number(self, place: int) -> bool:
        """Whether the first filled cell of a column is a number, with any decimal mark."""
        first = next((row[place].strip() for row in self._whole_rows() if row[place].strip()), "")
        return is_number(first)

    def settle(self, time: ChosenChannel | None, channels: Sequence[ChosenChannel]) -> None:
        """Choose the columns to read and find the notation of times and numbers, from the whole column where a cell is
        ambiguous.
        """
        assert time is not None
        self._read = (time, *channels)
        self._places = [column.place for column in self._read]
        first = next((row[time.place] for row in self._whole_rows() if row[time.place].strip()), "")
        self._dates = DateTimes(first, time.binding.order) if is_date_time(first) else None
        check_dates(time, self.name, self._dates is not None, "" if is_number(first) else first.strip())
        marks = marks_of((column.name, column.binding.decimal) for column in self._read[bool(self._dates) :])
        if self._separator != "," or (self._dates and self._dates.is_open) or self._has_quotes():
            rows = ([row[place].strip() for place in self._places] for row in self._whole_rows())
            while chunk := list(itertools.islice(rows, SEEN_ROWS)):
                for column, cells in zip(self._read, zip(*chunk, strict=True), strict=True):
                    if column.name in marks:
                        marks[column.name].see(cells)
                    elif self._dates and self._dates.is_open:
                        self._dates.see(cells)
        if self._dates:
            self._dates.decide(f"{self.name}: {time.name}")
        decided = decide(marks, self.name, self._separator == ",")
        self._marks: list[Mark] = [decided.get(column.name, POINT) for column in self._read]
        written = {decided[name] for name, one in marks.items() if one.marks}
        alike = len(written) < 2 and all(one.marks <= {decided[name]} and not one.given for name, one in marks.items())
        self._fast_mark = next(iter(written), POINT) if alike else None
        self.notes = tuple(self._assumed(time, [name for name, mark in decided.items() if mark == COMMA]))

    def _assumed(self, time: ChosenChannel, of_comma: Sequence[str]) -> Iterator[str]:
        if self._encoding == "latin-1":
            yield "the file is not UTF-8; read as Latin-1"
        if self._separator != ",":
            yield f"cells are separated by {SEPARATORS[self._separator]}"
        if of_comma:
            yield f"decimal comma in {', '.join(of_comma)}"
        if self._dates:
            yield time_note(time.name, self._dates.text)

    def _has_quotes(self) -> bool:
        with _binary(self._path) as file:
            return any(b'"' in block for block in iter(lambda: file.read(BLOCK_BYTES), b""))

    def _whole_rows(self) -> Iterator[list[str]]:
        """Rows as long as the header, without a last one that may be cut; others are reported when they are read."""
        with suppress(csv.Error), cast("IO[bytes]", _Tap(self._path, _Met())) as tap, self._text(tap) as file:
            lines = _Lines(file, self.name)
            rows = itertools.islice(lines.rows(csv.reader(lines, delimiter=self._separator)), 1, None)
            yield from (row for place, row in enumerate(rows) if len(row) == len(self.names) and (lines.ended or not place))

    def _text(self, file: IO[bytes]) -> io.TextIOWrapper:
        return io.TextIOWrapper(file, self._encoding, errors="replace", newline="")

    def streams(self) -> Sequence[Iterator[ChannelRows]]:
        """The rows of the file."""
        return [self._rows()]

    def _rows(self) -> Iterator[ChannelRows]:
        """Read the rows: by pyarrow as far as it is installed and understands them, the rest as plain text."""
        met = _Met()
        for chunks in (self._fast_chunks, self._plain_chunks):
            if not met.complete:
                for rows in chunks(met):
                    met.rows += len(rows.time)
                    yield rows
        self.findings = tuple(self._look_at_lines(met))

    def _fast_chunks(self, met: _Met) -> Iterator[ChannelRows]:
        """Yield rows until the first block that pyarrow does not take as numbers."""
        try:
            import pyarrow as pa
            from pyarrow import csv as arrow
        except ImportError:
            return
        if self._fast_mark is None:
            return
        wanted = [f"c{place}" for place in self._places]
        types = dict.fromkeys(wanted, pa.float64())
        if self._dates:
            types[wanted[0]] = pa.string()
        convert = arrow.ConvertOptions(
            column_types=types,
            include_columns=list(types),
            null_values=[""],
            strings_can_be_null=True,
            quoted_strings_can_be_null=True,
            decimal_point=self._fast_mark,
        )
        names = [f"c{place}" for place in range(len(self.names))]
        read = arrow.ReadOptions(use_threads=False, skip_rows=1, encoding=self._encoding, column_names=names)
        parse = arrow.ParseOptions(delimiter=self._separator)
        with (
            _Tap(self._path, met) as file,
            suppress(pa.ArrowException, OSError, EOFError, ValueError, zlib.error),  # plain reading reports it, with the line
            arrow.open_csv(file, read_options=read, parse_options=parse, convert_options=convert) as reader,
        ):
            while True:
                try:
                    rows = self._rows_of(reader.read_next_batch(), wanted)
                except StopIteration:
                    met.complete = True
                    return
                if not rows.timed.all():
                    return
                yield rows

    def _rows_of(self, batch: Any, wanted: Sequence[str]) -> ChannelRows:
        """Rows of an Arrow batch, time first."""
        first, *others = (batch.column(name) for name in wanted)
        cells, given = zip(*map(as_numpy, others), strict=True)
        if self._dates is None:
            time, timed = as_numpy(first)
        else:
            texts = first.to_pylist()
            timed = np.array([text is not None for text in texts], np.bool_)
            time = np.array([0 if text is None else self._dates.ns(text) for text in texts], np.int64)
        return ChannelRows(time, timed, np.stack(cells, axis=1), np.stack(given, axis=1))

    def _plain_chunks(self, met: _Met) -> Iterator[ChannelRows]:
        """Yield the rows after those that were met, cell by cell; the same numbers, and an error with its line."""
        tap = cast("IO[bytes]", _Tap(self._path, met))
        with tap, self._text(tap) as file:
            lines = _Lines(file, self.name)
            reader = csv.reader(lines, delimiter=self._separator)
            try:
                rows = (row for row in itertools.islice(lines.rows(reader), 1, None) if row)
                next(itertools.islice(rows, met.rows, met.rows), None)
                numbers = self._whole_numbers(((row, reader.line_num) for row in rows), lines, met)
                while chunk := list(itertools.islice(numbers, CHUNK_ROWS)):
                    given = np.array([[number is not None for number in row] for row in chunk])
                    time = [0 if row[0] is None else row[0] for row in chunk]
                    cells = np.array([row[1:] for row in chunk], np.float64)
                    stamps = np.array(time, np.int64) if self._dates else np.array(time, np.float64)
                    yield ChannelRows(stamps, given[:, 0], cells, given[:, 1:])
            except csv.Error as error:
                where = f"{self.name}: line {reader.line_num + 1}"
                raise InputError(where, str(error), "CSV to the end of the file") from error

    def _whole_numbers(
        self, rows: Iterator[tuple[list[str], int]], lines: "_Lines", met: _Met
    ) -> Iterator[list[float | int | None]]:
        """Return the wanted cells row by row, without a last line that is cut before it is a row."""
        for row, line in rows:
            try:
                numbers = self._numbers(row, line)
            except InputError:
                if lines.ended or len(row) > len(self.names):
                    raise
                numbers = [None]
            met.left_out = not lines.ended and numbers[0] is None
            if not met.left_out:
                yield numbers

    def _numbers(self, row: Sequence[str], line: int) -> list[float | int | None]:
        """Return the wanted cells of a row, None where empty."""
        where = f"{self.name}: line {line}"
        if len(row) != len(self.names):
            commas = self._separator == "," and len(row) > len(self.names)
            remedy = "if numbers have a decimal comma, separate cells by semicolons" if commas else ""
            raise InputError(where, f"{len(row)} cells", f"{len(self.names)} cells, as in the header", remedy)
        numbers: list[float | int | None] = []
        for place, mark in zip(self._places, self._marks, strict=True):
            if numbers or not self._dates:
                numbers.append(number_of(row[place], mark, where))
            else:
                numbers.append(self._dates.ns(row[place], where) if row[place].strip() else None)
        return numbers

    def _look_at_lines(self, met: _Met) -> Iterator[Finding]:
        """Report lines of the file that are no rows of the table, and a last row that may be incomplete."""
        if met.quoted:
            with io.TextIOWrapper(_binary(self._path), "latin-1") as file:  # whatever ends the lines
                swallowed = sum(line != "\n" for line in file) - 1 - met.rows - met.left_out
            if swallowed > 0:
                text = f"{swallowed} lines are not rows: they are inside a quotation that an earlier line opens"
                yield Finding("", "quoted", swallowed, float("nan"), text)
        if met.last not in (b"\n", b"\r"):
            what = "it is left out" if met.left_out else "the file and its last number may be truncated"
            text = f"the last line is incomplete: {what}"
            yield Finding("", "cut", 1, float("nan"), text)


def _binary(path: Path) -> IO[bytes]:
    return cast("IO[bytes]", gzip.open(path)) if path.name.lower().endswith(".gz") else path.open("rb")


def _width(line: str, separator: str) -> int:
    try:
        return len(next(csv.reader([line], delimiter=separator), []))
    except csv.Error:
        return 0


class _Tap(io.BufferedIOBase):
    """Watches the bytes of a CSV file in passing: whether they contain quotes, and which is the last."""

    def __init__(self, path: Path, met: _Met) -> None:
        self._file, self._met = _binary(path), met

    def readable(self) -> bool:
        """Always."""
        return True

    def read(self, size: int | None = -1) -> bytes:
        """Pass on the next bytes."""
        data = self._file.read(-1 if size is None else size)
        if data:
            self._met.quoted = self._met.quoted or b'"' in data
            self._met.last = data[-1:]
        return data

    read1 = read

    def close(self) -> None:
        """Close the file."""
        self._file.close()
        super().close()


class _Lines:
    """Lines of a text, with a limit on the length of a line and of all lines of one row.

    `ended` is false after a row of one line without an end, which may be cut.
    """

    def __init__(self, file: IO[str], name: str) -> None:
        self._file, self._name, self.ended = file, name, True
        self._of_row = 0

    def __iter__(self) -> Iterator[str]:
        while line := self._file.readline(MAX_ROW_BYTES):
            self.ended = bool(self._of_row) or line.endswith(("\n", "\r"))
            self._of_row += len(line)
            if self._of_row >= MAX_ROW_BYTES:
                raise InputError(self._name, f"a row of more than {MAX_ROW_BYTES} bytes", "CSV with one line per row")
            yield line

    def rows(self, reader: Iterable[list[str]]) -> Iterator[list[str]]:
        """Pass on the rows of a reader of these lines."""
        for row in reader:
            self._of_row = 0
            yield row


KINDS = (FileKind("CSV", (".csv", ".csv.gz"), lambda path, name, _: [CsvTable(path, name)], checked=True),)
