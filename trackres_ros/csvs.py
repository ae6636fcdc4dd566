"""Tables: CSV and Parquet read in blocks, and written so that equal numbers give equal bytes."""

from __future__ import annotations

import codecs
import csv
import gzip
import itertools
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import IO, Any, Self

import numpy as np
from numpy.typing import NDArray

from trackres_ros.errors import InputError, MissingExtraError
from trackres_ros.recording import ROLES, Block, Finding, FloatArray, base_role
from trackres_ros.topics import TopicBinding, Topics, nearest

TIME = "time_s"
COLUMNS: Mapping[str, tuple[str, float]] = MappingProxyType({
    "speed_mps": ("speed", 1.0), "speed_kmh": ("speed", 1.0 / 3.6), "weight_n": ("load", 1.0),
    "weight_kn": ("load", 1e3), "torque_nm": ("torque", 1.0), "belt_degc": ("belt", 1.0),
    "ambient_degc": ("ambient", 1.0), "grade": ("grade", 1.0), "yaw_rate_radps": ("yaw_rate", 1.0),
    "heading_rad": ("heading", 1.0), "accel_mps2": ("accel", 1.0), "distance_m": ("distance", 1.0),
})
"""Columns known by name: role, and scale to its unit. ``weight_n/front`` is the load of the axle or assembly front."""
CHUNK_ROWS = 8192
SUFFIXES = (".csv", ".csv.gz", ".parquet")


@dataclass(frozen=True, slots=True)
class _Column:
    """A column to read: its place among all columns, its name, the role it feeds, and the conversion."""

    place: int
    name: str
    role: str
    scale: float = 1.0
    offset: float = 0.0


class TableSource:
    """Samples of a CSV (also ``.csv.gz``) or Parquet file, row by row.

    An empty cell gives no sample. Within a row speed comes last, so that whoever steps on speed knows the rest of
    the row. Stamps are the column ``time_s``, counted in nanoseconds; a role without a column in the topics file is
    taken from the column known by name.

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
        self.name = str(path)
        self._path = path
        self._parquet = path.name.lower().endswith(".parquet")
        self._encoding, self._delimiter = "utf-8", ","
        self.findings: tuple[Finding, ...] = ()
        names = self._parquet_names() if self._parquet else self._header()
        self._time, columns = _chosen(names, topics, self.name)
        self._columns = tuple(sorted(columns, key=lambda column: column.role == "speed"))
        self.roles = tuple(column.role for column in self._columns)
        notes = [f"{column.role}: column {column.name}" for column in self._columns]
        used = {self._time, *(column.place for column in columns)}
        ignored = [name for place, name in enumerate(names) if place not in used]
        if ignored:
            notes.append(f"ignored columns: {', '.join(ignored)}")
        if self._encoding == "latin-1":
            notes.append("the file is not UTF-8; read as Latin-1")
        self.notes = tuple(notes)

    def blocks(self, max_rows: int = 65536) -> Iterator[Block]:
        """Read the table; see `trackres_ros.recording.Source.blocks`.

        Raises
        ------
        InputError
            A cell that is no number, a row without time, a row of another length: with its line.
        """
        places = [self._time, *(column.place for column in self._columns)]
        scale = np.array([column.scale for column in self._columns])
        offset = np.array([column.offset for column in self._columns])
        at_once = max(1, max_rows // len(self._columns))
        chunks = self._parquet_chunks(places, at_once) if self._parquet else self._csv_chunks(places, at_once)
        for cells, given in chunks:
            stamp_ns = np.rint(cells[:, 0] * 1e9).astype(np.int64)
            rows, column = np.nonzero(given[:, 1:])
            values = scale[column] * cells[rows, column + 1] + offset[column]
            yield Block(column.astype(np.int16), stamp_ns[rows], stamp_ns[rows], values)

    def _header(self) -> list[str]:
        """Read the names of a CSV, and settle encoding and delimiter."""
        try:
            with _binary(self._path) as file:
                line = file.readline()
        except (OSError, EOFError) as error:
            raise InputError(self.name, str(error), "a readable CSV file") from None
        try:
            text = line.removeprefix(codecs.BOM_UTF8).decode("utf-8")
        except UnicodeDecodeError:
            self._encoding, text = "latin-1", line.decode("latin-1")
        self._delimiter = max(",;\t", key=text.count)
        names = [name.strip() for name in next(csv.reader([text], delimiter=self._delimiter), [])]
        if not any(names):
            raise InputError(self.name, "an empty file or first line", "CSV with a line of column names")
        return names

    def _csv_chunks(self, places: Sequence[int], rows: int) -> Iterator[tuple[FloatArray, NDArray[np.bool_]]]:
        """Yield cells and which are given: by pyarrow as far as it understands, the rest as plain text."""
        done = 0
        try:
            for cells, given in self._fast_chunks(places):
                for start in range(0, len(cells), rows):
                    piece = slice(start, start + rows)
                    if not (given[piece, 0] & np.isfinite(cells[piece, 0])).all():
                        raise _SlowPathError
                    yield cells[piece], given[piece]
                    done += len(cells[piece])
        except _SlowPathError:
            yield from self._plain_chunks(places, rows, done)

    def _fast_chunks(self, places: Sequence[int]) -> Iterator[tuple[FloatArray, NDArray[np.bool_]]]:
        try:
            import pyarrow as pa
            from pyarrow import csv as pacsv
        except ImportError:
            raise _SlowPathError from None
        wanted = [f"c{place}" for place in places]
        convert = pacsv.ConvertOptions(column_types=dict.fromkeys(wanted, pa.float64()), include_columns=wanted,
                                       null_values=[""], quoted_strings_can_be_null=True)
        try:
            with pacsv.open_csv(
                self._path, convert_options=convert,
                read_options=pacsv.ReadOptions(use_threads=False, skip_rows=1, encoding=self._encoding,
                                               column_names=[f"c{place}" for place in range(self._count())]),
                parse_options=pacsv.ParseOptions(delimiter=self._delimiter),
            ) as reader:
                for batch in reader:
                    yield _cells(batch)
        except pa.ArrowException:
            raise _SlowPathError from None
