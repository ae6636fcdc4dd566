# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads tables: CSV and Parquet, in blocks."""

from __future__ import annotations

import codecs
import csv
import gzip
import io
import itertools
import re
import zlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, cast

import numpy as np
from numpy.typing import NDArray

from trackres_ros.errors import InputError, MissingExtraError, one_line
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.position_units import PositionUnits
from trackres_ros.recording.reading import check_file, reading
from trackres_ros.recording.samples import Block, Finding, FloatArray
from trackres_ros.recording.table_columns import choose_columns, listed_names

CHUNK_ROWS = 8192
MAX_TIME_S = 4.6e9
"""Above it, differences of two times in nanoseconds do not fit in 64 bits [s]; a time in milliseconds or nanoseconds mostly
lies above."""
MAX_ROW_BYTES = 2**24
"""Longest line, and longest row of quoted lines, that is read: one of 200,000 columns is a fifth of it."""
HEAD_BYTES = 2**16
PARQUET_BUFFER_BYTES = 2**20
"""Read at once of a column; without it, and with buffering ahead, pyarrow holds a whole row group: that may be the whole file."""


_Cells = tuple[FloatArray, NDArray[np.bool_]]
"""Numbers of some rows, time first, shape (n, 1 + k), and where there is one."""


@dataclass(slots=True)
class _Met:
    """What one run of reading a CSV met: rows so far, whether that is all, whether there are quotes, and the last byte."""

    rows: int = 0
    complete: bool = False
    quoted: bool = False
    last: bytes = b""


class TableSource:
    """Samples of a CSV (also ``.csv.gz``) or Parquet file, row by row.

    An empty cell gives no sample. Within a row speed comes last, so that whoever steps on speed knows the rest of
    the row. Stamps are the column ``time_s``, or the one that the topics file names,
    counted in nanoseconds; a role without a column in the topics file is taken from the column known by name.

    Parameters
    ----------
    path : Path
        The file.
    topics : Topics, optional
        Columns of other names or units, by role.

    Raises
    ------
    InputError
        No header, no column for time or speed, a column that is not there or is there twice.
    MissingExtraError
        A Parquet file, and pyarrow is not installed.
    """

    zero_is_unset = False

    def __init__(self, path: Path, topics: Topics | None = None) -> None:
        self.name = one_line(str(path))
        self._path = path
        self._parquet = path.name.lower().endswith(".parquet")
        self._encoding, self._delimiter = "utf-8", ","
        self.findings: tuple[Finding, ...] = ()
        check_file(path)
        with self._reading():
            names = self._parquet_names() if self._parquet else self._header()
        self._time, columns = choose_columns(names, topics, self.name)
        self._columns = tuple(sorted(columns, key=lambda column: column.role == "speed"))
        self.roles = tuple(column.role for column in self._columns)
        self.bindings = {column.role: column.binding for column in self._columns}
        notes = [f"{column.role}: column {column.name}" for column in self._columns]
        used = {self._time.place, *(column.place for column in columns)}
        ignored = [name for place, name in enumerate(names) if place not in used]
        if ignored:
            notes.append(f"ignored columns: {listed_names(ignored)}")
        if self._encoding == "latin-1":
            notes.append("the file is not UTF-8; read as Latin-1")
        self._notes = tuple(map(one_line, notes))
        self._position = PositionUnits(self.bindings)

    @property
    def notes(self) -> tuple[str, ...]:
        """Which column feeds what, what is ignored, and in which unit a position was taken to be once it was read."""
        return (*self._notes, *self._position.notes)

    def blocks(self, max_rows: int = 65536) -> Iterator[Block]:
        """Read the table; see `trackres_ros.recording.samples.Source.blocks`.

        Raises
        ------
        InputError
            No row at all, a cell that is no number, a row without time or of another length: with its place. A file that
            is damaged.
        """
        with self._reading():
            for block in self._blocks(max_rows):
                yield self._position.in_radians(block, self.roles)

    def _reading(self) -> AbstractContextManager[None]:
        return reading(self._path, f"{'Parquet' if self._parquet else 'CSV'} that can be read to its end")

    def _blocks(self, max_rows: int) -> Iterator[Block]:
        places = [self._time.place, *(column.place for column in self._columns)]
        clock, bindings = self._time.binding, [column.binding for column in self._columns]
        scale, offset = np.array([b.scale for b in bindings]), np.array([b.offset for b in bindings])
        delay_ns = np.array([b.delay_ns for b in bindings])
        modes = [place for place, b in enumerate(bindings) if b.values]
        at_once = max(1, max_rows // len(self._columns))
        done = 0
        for cells, given in self._parquet_chunks(places) if self._parquet else self._csv_chunks(places):
            seconds = clock.scale * cells[:, 0] + clock.offset
            bad = ~(np.abs(seconds) < MAX_TIME_S)
            if bad.any():
                first = int(np.argmax(bad))
                where = f"{self.name}: {self._time.name}, row {done + first + 1} below the header"
                time_s = float(seconds[first]) if given[first, 0] else ""
                raise InputError(where, time_s, f"a time in seconds, within {MAX_TIME_S:g}")
            done += len(cells)
            stamp_ns = np.rint(seconds * 1e9).astype(np.int64)
            for start in range(0, len(cells), at_once):
                rows, column = np.nonzero(given[start : start + at_once, 1:])
                if not rows.size:
                    continue
                rows += start
                values = scale[column] * cells[rows, column + 1] + offset[column]
                for place in modes:
                    values[column == place] = bindings[place].meant(values[column == place])
                yield Block(column.astype(np.int16), stamp_ns[rows] - delay_ns[column], stamp_ns[rows], values)
        if not done:
            raise InputError(self.name, "no row", "at least one row below the column names")

    def _header(self) -> list[str]:
        """Read the names of a CSV, and settle encoding and delimiter."""
        with _binary(self._path) as file:
            head = file.read(HEAD_BYTES)
            if not re.search(rb"[\r\n]", head):
                head += file.read(MAX_ROW_BYTES)
        line = re.split(rb"[\r\n]", head.removeprefix(codecs.BOM_UTF8), maxsplit=1)[0]
        if len(line) >= MAX_ROW_BYTES:
            raise InputError(self.name, f"a first line of more than {MAX_ROW_BYTES} bytes", "CSV with a line of column names")
        try:
            text = line.decode("utf-8")
        except UnicodeDecodeError:
            self._encoding, text = "latin-1", line.decode("latin-1")
        self._delimiter = max(",;\t", key=text.count)
        names = [name.strip() for name in next(csv.reader([text], delimiter=self._delimiter), [])]
        if not any(names):
            raise InputError(self.name, "an empty file or first line", "CSV with a line of column names")
        self._width = len(names)
        return names

    def _csv_chunks(self, places: Sequence[int]) -> Iterator[_Cells]:
        """Yield the rows: by pyarrow as far as it is there and understands them, the rest as plain text."""
        met = _Met()
        for chunks in (self._fast_chunks, self._plain_chunks):
            if not met.complete:
                for cells, given in chunks(places, met):
                    met.rows += len(cells)
                    yield cells, given
        self.findings = tuple(self._look_at_lines(met))

    def _fast_chunks(self, places: Sequence[int], met: _Met) -> Iterator[_Cells]:
        """Yield rows until the first block that pyarrow does not take as numbers."""
        try:
            import pyarrow as pa
            from pyarrow import csv as arrow
        except ImportError:
            return
        wanted = [f"c{place}" for place in places]
        convert = arrow.ConvertOptions(
            column_types=dict.fromkeys(wanted, pa.float64()),
            include_columns=wanted,
            null_values=[""],
            quoted_strings_can_be_null=True,
        )
        read = arrow.ReadOptions(
            use_threads=False, skip_rows=1, encoding=self._encoding, column_names=[f"c{place}" for place in range(self._width)]
        )
        parse = arrow.ParseOptions(delimiter=self._delimiter)
        with (
            _Tap(self._path, met) as file,
            suppress(pa.ArrowException, OSError, EOFError, ValueError, zlib.error),  # the plain way says it, with the line
            arrow.open_csv(file, read_options=read, parse_options=parse, convert_options=convert) as reader,
        ):
            while True:
                try:
                    cells = _cells(reader.read_next_batch(), wanted)
                except StopIteration:
                    met.complete = True
                    return
                yield cells

    def _plain_chunks(self, places: Sequence[int], met: _Met) -> Iterator[_Cells]:
        """Yield the rows after those that were met, cell by cell; the same numbers, and an error with its line."""
        tap = cast("IO[bytes]", _Tap(self._path, met))
        with tap, io.TextIOWrapper(tap, self._encoding, errors="replace", newline="") as file:
            lines = _Lines(file, self.name)
            reader = csv.reader(lines, delimiter=self._delimiter)
            try:
                rows = (row for row in itertools.islice(lines.rows(reader), 1, None) if row)
                next(itertools.islice(rows, met.rows, met.rows), None)
                while chunk := [self._numbers(row, places, reader.line_num) for row in itertools.islice(rows, CHUNK_ROWS)]:
                    given = np.array([[number is not None for number in row] for row in chunk])
                    yield np.array(chunk, np.float64), given
            except csv.Error as error:
                where = f"{self.name}: line {reader.line_num + 1}"
                raise InputError(where, str(error), "CSV to the end of the file") from error

    def _look_at_lines(self, met: _Met) -> Iterator[Finding]:
        """Say where a line of the file is no row of the table, and where the last one may be half a row."""
        if met.quoted:
            with _binary(self._path) as file:
                swallowed = sum(bool(line.strip(b"\r\n")) for line in file) - 1 - met.rows
            if swallowed > 0:
                text = f"{swallowed} lines are no rows: they stand inside quotes that an earlier line opens"
                yield Finding("", "quoted", swallowed, float("nan"), text)
        if met.last not in (b"\n", b"\r"):
            text = "the last line does not end: the file may have been cut off, and its last number with it"
            yield Finding("", "cut", 1, float("nan"), text)

    def _numbers(self, row: Sequence[str], places: Sequence[int], line: int) -> list[float | None]:
        """Return the wanted cells of a row, None where empty."""
        if len(row) != self._width:
            raise InputError(f"{self.name}: line {line}", f"{len(row)} cells", f"{self._width} cells, as in the header")
        numbers: list[float | None] = []
        for place in places:
            text = row[place].strip()
            try:
                if "_" in text:  # Python's own notation, not that of a table
                    raise ValueError(text)
                numbers.append(float(text) if text else None)
            except ValueError:
                raise InputError(f"{self.name}: line {line}", row[place], "a number, or an empty cell") from None
        return numbers

    def _parquet_file(self) -> Any:
        """Open the file with pyarrow, which has no types of its own."""
        try:
            from pyarrow import parquet
        except ImportError:
            raise MissingExtraError("reading Parquet", "pyarrow", "parquet") from None
        return parquet.ParquetFile(
            self._path, buffer_size=PARQUET_BUFFER_BYTES, pre_buffer=False, page_checksum_verification=True
        )

    def _parquet_names(self) -> list[str]:
        with self._parquet_file() as file:
            return list(file.schema_arrow.names)

    def _parquet_chunks(self, places: Sequence[int]) -> Iterator[_Cells]:
        import pyarrow as pa

        with self._parquet_file() as file:
            schema = file.schema_arrow
            names = [schema.names[place] for place in places]
            for place, name in zip(places, names, strict=True):
                kind = schema.field(place).type
                if not (pa.types.is_floating(kind) or pa.types.is_integer(kind)):
                    raise InputError(f"{self.name}: {name}", str(kind), "a column of numbers")
            rows, empty = 0, np.zeros(len(names), np.int64)
            for batch in file.iter_batches(batch_size=CHUNK_ROWS, columns=names, use_threads=False):
                cells, given = _cells(batch, names)
                rows += len(cells)
                empty += np.count_nonzero(~given, axis=0)
                yield cells, given
            self.findings = tuple(_look_at_counts(file.metadata, names, rows, empty))


def _look_at_counts(metadata: Any, names: Sequence[str], rows: int, empty: NDArray[np.int64]) -> Iterator[Finding]:
    """Hold what was read of a Parquet file against what the file says it holds."""
    groups = [metadata.row_group(number) for number in range(metadata.num_row_groups)]
    stated = max(metadata.num_rows, sum(group.num_rows for group in groups))
    if stated > rows:
        yield Finding("", "missing", stated - rows, float("nan"), f"{stated - rows} rows fewer than the file says it holds")
    for name, found in zip(names, empty.tolist(), strict=True):
        chunks = [group.column(place) for group in groups for place in range(group.num_columns)]
        counts = [chunk.statistics for chunk in chunks if chunk.path_in_schema == name]
        if all(count is not None and count.has_null_count for count in counts):
            more = found - sum(count.null_count for count in counts)
            if more > 0:
                text = f"{more} cells of {name} are empty and should not be, as the file counts them"
                yield Finding("", "missing", more, float("nan"), text)


def _cells(batch: Any, names: Sequence[str]) -> _Cells:
    """Return the columns of an Arrow batch as numbers, and where there is one."""
    import pyarrow as pa

    columns = [batch.column(name).cast(pa.float64()) for name in names]
    cells = np.stack([column.to_numpy(zero_copy_only=False) for column in columns], axis=1)
    given = np.stack([column.is_valid().to_numpy(zero_copy_only=False) for column in columns], axis=1)
    return cells, given


def _binary(path: Path) -> IO[bytes]:
    return cast("IO[bytes]", gzip.open(path)) if path.name.lower().endswith(".gz") else path.open("rb")


class _Tap(io.BufferedIOBase):
    """The bytes of a CSV file as they pass: whether there are quotes among them, and which is the last."""

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
    """Lines of a text, none longer than memory takes, nor all lines of one row together."""

    def __init__(self, file: IO[str], name: str) -> None:
        self._file, self._name = file, name
        self._of_row = 0

    def __iter__(self) -> Iterator[str]:
        while line := self._file.readline(MAX_ROW_BYTES):
            self._of_row += len(line)
            if self._of_row >= MAX_ROW_BYTES:
                raise InputError(self._name, f"a row of more than {MAX_ROW_BYTES} bytes", "CSV with one line a row")
            yield line

    def rows(self, reader: Iterable[list[str]]) -> Iterator[list[str]]:
        """Pass on the rows that a reader makes of these lines."""
        for row in reader:
            self._of_row = 0
            yield row
