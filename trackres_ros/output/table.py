# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes tables: CSV and Parquet, in which equal numbers give equal bytes, and MDF."""

import csv
import gzip
import io
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from trackres_ros.errors import InputError
from trackres_ros.files.arrow_columns import as_arrow
from trackres_ros.files.output_files import BEFORE_1970
from trackres_ros.files.own_files import put
from trackres_ros.recording.samples import FloatArray

EXACT = ("time_s",)
"""Of estimates: columns that keep double precision in Parquet."""
CHUNK_ROWS = 8192
"""Rows of a CSV that are put together at once."""
GROUP_ROWS = 250_000
"""Rows of a row group of Parquet: with small ones reading takes longer, and their list grows with the table."""
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
UNITS = {
    "s": "s", "ns": "ns", "mps": "m/s", "mps2": "m/s^2", "n": "N", "nm": "N m", "degc": "degC", "k": "K", "w": "W", "m^2": "m^2",
}  # fmt: skip
"""The unit in the last word of a column name."""


class TableWriter:
    """Writes a table block by block; it is put in place only when the `with` block ends without an exception.

    In CSV a NaN becomes an empty cell, every other number the shortest text that reads back as the same number. Equal numbers
    give equal bytes, except in MDF, which contains the time of writing.

    Parameters
    ----------
    path : Path
        ``.csv``, ``.csv.gz``, ``.parquet`` or ``.mf4``, see `output_file`; replaced if it exists.
    names : sequence of str
        Names of the k columns.
    estimates : bool
        Whether all numbers except times are estimates. Parquet and MDF store these in single precision: seven digits, a thousand
        times finer than their accuracy.
    """

    def __init__(self, path: Path, names: Sequence[str], estimates: bool = False) -> None:
        self.path, self.names = path, tuple(names)
        self._part = path.with_name(f".{path.name}.{os.getpid()}.part")
        if path.suffix.lower() == ".mf4":  # the library would write to another name
            self._part = self._part.with_suffix(".mf4")
        self._estimates = estimates
        self._suffix = path.suffix.lower()
        self._files = ExitStack()
        self._target: Any = None

    def __enter__(self) -> Self:
        """Begin a temporary file in the same folder."""
        if self._suffix in BY_COLUMN:
            self._target = self._files.enter_context(BY_COLUMN[self._suffix](self._part, self.names))
        else:
            raw: Any = self._files.enter_context(self._part.open("wb"))
            if self.path.name.lower().endswith(".gz"):
                raw = self._files.enter_context(gzip.GzipFile("", "wb", 6, raw, mtime=0))
            self._target = self._files.enter_context(io.TextIOWrapper(raw, encoding="utf-8", newline=""))
            csv.writer(self._target, lineterminator="\n").writerow(self.names)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Finish the file and put it in place, or remove the temporary one."""
        try:
            self._files.__exit__(kind, error, trace)
            if kind is None:
                put(self._part, self.path)
        except BaseException:
            self._part.unlink(missing_ok=True)
            raise
        if kind is not None:
            self._part.unlink(missing_ok=True)

    def write(self, rows: FloatArray) -> None:
        """Write n rows, shape (n, k)."""
        self.write_columns([rows[:, place] for place in range(len(self.names))])

    def write_columns(self, columns: Sequence[NDArray[Any]]) -> None:
        """Write n rows given as k columns, each of shape (n,): numbers or texts."""
        if self._suffix in BY_COLUMN:
            single_names = self._single_precision_names(columns)
            self._target.write(
                [c.astype(np.float32) if n in single_names else c for n, c in zip(self.names, columns, strict=True)]
            )
            return
        for start in range(0, len(columns[0]), CHUNK_ROWS):
            cache: dict[tuple[str, bytes], list[str]] = {}  # belts with the same load have the same values
            texts = []
            for column in columns:
                cells = column[start : start + CHUNK_ROWS]
                key = cells.dtype.str, cells.tobytes()  # a whole 0 and a real 0.0 have the same bytes
                if key not in cache:
                    cache[key] = _texts(cells)
                texts.append(cache[key])
            self._target.write("\n".join(map(",".join, zip(*texts, strict=True))) + "\n")

    def _single_precision_names(self, columns: Sequence[NDArray[Any]]) -> set[str]:
        """Names of the columns that are kept in single precision."""
        float_names = {name for name, column in zip(self.names, columns, strict=True) if column.dtype.kind == "f"}
        return float_names.difference(EXACT) if self._estimates else set()


def write_table(path: Path, columns: Mapping[str, NDArray[Any]], estimates: bool = False) -> None:
    """Write a whole table; see `TableWriter`.

    `path`: ``.csv``, ``.csv.gz``, ``.parquet`` or ``.mf4``; `columns`: numbers or texts by name, shape (n,); `estimates`: as
    there. Raises InputError for columns of different lengths.
    """
    lengths = {name: len(column) for name, column in columns.items()}
    if len(set(lengths.values())) != 1:
        raise InputError(str(path), lengths, "columns of one length")
    with TableWriter(path, list(columns), estimates) as writer:
        writer.write_columns([np.asarray(column) for column in columns.values()])


def _texts(column: NDArray[Any]) -> list[str]:
    """Return the cells of a column as CSV texts."""
    if column.dtype.kind == "f":
        texts = list(map(repr, (column.astype(np.float64) + 0.0).tolist()))  # which takes the sign off a zero
        return ["" if text == "nan" else text for text in texts] if np.isnan(column).any() else texts
    if column.dtype.kind in "iub":
        return list(map(str, column.astype(np.int64).tolist()))
    cells = []
    for text in map(str, column.tolist()):
        has_marks = any(mark in text for mark in ',"\r\n')
        cells.append('"' + text.replace('"', '""') + '"' if has_marks else text)
    return cells


class ParquetTable(AbstractContextManager["ParquetTable"]):
    """A Parquet file in row groups of `GROUP_ROWS`, whatever the blocks: equal rows give equal bytes, in bounded memory.

    `path`: final file; `names`: of the columns.
    """

    def __init__(self, path: Path, names: Sequence[str]) -> None:
        self._names = names
        self._files = ExitStack()
        self._file = self._files.enter_context(path.open("wb"))  # the library opens no name that is not UTF-8
        self._writer: Any = None
        self._group: list[NDArray[Any]] = []  # of each column; memory never written to costs nothing
        self._rows = 0  # of the group, so far

    def write(self, columns: Sequence[NDArray[Any]]) -> None:
        """Write some rows; a column keeps the type of its first ones."""
        if not self._group:
            self._group = [np.empty(GROUP_ROWS, c.dtype if c.dtype.kind in "fiub" else np.object_) for c in columns]
        for start, end in self._parts(len(columns[0])):
            for group, column in zip(self._group, columns, strict=True):
                np.copyto(group[self._rows : self._rows + end - start], column[start:end], casting="same_kind")
            self._rows += end - start
            if self._rows == GROUP_ROWS:
                self._write_group()

    def _parts(self, count: int) -> Iterator[tuple[int, int]]:
        """Bounds of the rows that go into one group, of `count` further ones."""
        start = 0
        while start < count:
            end = min(count, start + GROUP_ROWS - self._rows)
            yield start, end
            start = end

    def _write_group(self) -> None:
        """Write the group, and begin the next one."""
        import pyarrow as pa
        from pyarrow import parquet

        table = pa.table([as_arrow(column[: self._rows]) for column in self._group], names=list(self._names))
        if self._writer is None:
            # Bytes of equal weight are grouped: smooth values differ in the last ones alone.
            float_names = [name for name, column in zip(self._names, self._group, strict=True) if column.dtype.kind == "f"]
            dictionary_names: Any = [name for name in self._names if name not in float_names]
            writer = parquet.ParquetWriter(
                self._file, table.schema, write_page_checksum=True, compression="zstd", use_dictionary=dictionary_names,
                use_byte_stream_split=float_names,
            )  # fmt: skip
            self._writer = self._files.enter_context(writer)
        self._writer.write_table(table, GROUP_ROWS)
        self._rows = 0

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Write the last group; nothing after an exception."""
        with self._files:
            if kind is None and (self._rows or self._writer is None):
                if not self._group:
                    self.write([np.empty(0)] * len(self._names))
                self._write_group()


class MdfTable(AbstractContextManager["MdfTable"]):
    """An MDF file written block by block; blocks are kept in a temporary file of asammdf.

    `path`: final file; asammdf requires the suffix .mf4; `names`: of the columns; the first is the time [s].
    """

    def __init__(self, path: Path, names: Sequence[str]) -> None:
        from asammdf import MDF

        self._path, self._names = path, names
        self._mdf = MDF(version="4.10")
        self._mdf.header.start_time = EPOCH
        self._has_begun = False

    def write(self, columns: Sequence[NDArray[Any]]) -> None:
        """Write some rows, the time first."""
        from asammdf import Signal

        arrays = [column if column.dtype.kind in "fiu" else np.asarray(column, np.bytes_) for column in columns]
        if self._has_begun:
            self._mdf.extend(0, [(array, None) for array in arrays])
            return
        if "stamp_ns" in self._names and len(arrays[0]):
            begin_ns = int(columns[self._names.index("stamp_ns")][0])
            if begin_ns < 0:
                raise InputError("output: stamp_ns", begin_ns, "0 ns or later in MDF", BEFORE_1970)
            self._mdf.header.start_time = EPOCH + timedelta(microseconds=begin_ns // 1000)
        signals = [Signal(a, arrays[0], name=n, unit=unit_of(n)) for n, a in zip(self._names[1:], arrays[1:], strict=True)]
        self._mdf.append(signals, acq_name="trackres", comment="written by trackres", common_timebase=True)
        self._has_begun = True

    def __enter__(self) -> Self:
        """Begin."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Save the blocks, compressed; nothing after an exception."""
        try:
            if kind is None:
                if not self._has_begun:
                    self.write([np.empty(0)] * len(self._names))
                self._mdf.save(self._path, overwrite=True, compression=2)
        finally:
            self._mdf.close()


BY_COLUMN: Mapping[str, type[ParquetTable] | type[MdfTable]] = {".parquet": ParquetTable, ".mf4": MdfTable}
"""Tables that are written as columns, by suffix."""


def unit_of(column: str) -> str:
    """Unit of a column by its name: ``N m`` of ``resistance_torque_nm/front_left``; empty without one."""
    return UNITS.get(column.partition("/")[0].rpartition("_")[2], "")
