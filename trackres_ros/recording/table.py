# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads tables: CSV, Parquet and Excel, in blocks."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trackres_ros.errors import InputError, one_line
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.csv_table import CsvTable
from trackres_ros.recording.parquet_table import ParquetTable
from trackres_ros.recording.position_units import PositionUnits
from trackres_ros.recording.reading import check_file, reading
from trackres_ros.recording.samples import Finding, FloatArray, IntArray, SampleBlock
from trackres_ros.recording.table_columns import TableColumn, choose_columns, listed_names
from trackres_ros.recording.table_file import TableFile
from trackres_ros.recording.torque_candidates import note_of, of_columns

MAX_TIME_S = 4.6e9
"""Above it, differences of two times in nanoseconds do not fit in 64 bits [s]; a time in milliseconds or nanoseconds mostly
lies above."""
KINDS = {".parquet": "Parquet", ".xlsx": "an Excel workbook"}


class TableSource:
    """Samples of a CSV (also ``.csv.gz``), Parquet or Excel file, row by row.

    An empty cell gives no sample, and a sum of columns has one where all of them do. Within a row speed comes last, so that
    whoever steps on speed knows the rest of the row. Stamps are the column ``time_s``, or the one that the topics file names,
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
        No header, no column for time or speed, a column that is not there or is there twice, numbers or dates that may be read
        in two ways.
    MissingExtraError
        A Parquet or Excel file, and the library that reads it is not installed.
    """

    zero_is_unset = False

    def __init__(self, path: Path, topics: Topics | None = None) -> None:
        self.name = one_line(str(path))
        self._path = path
        self.findings: tuple[Finding, ...] = ()
        check_file(path)
        with self._reading():
            tables = _tables_of(path, self.name)
        self._table, self._time, columns, others = _first_that_fits(tables, topics)
        columns.sort(key=lambda column: column.role == "speed")
        self.roles = tuple(dict.fromkeys(column.role for column in columns))
        self._columns = [[column for column in columns if column.role == role] for role in self.roles]
        self.bindings = {
            role: topics[role] if len(of) > 1 and topics else of[0].binding
            for role, of in zip(self.roles, self._columns, strict=True)
        }
        self._alone = [0] * len(self.roles)
        used = {self._time.place, *(column.place for column in columns)}
        ignored = [(place, column) for place, column in enumerate(self._table.names) if place not in used]
        like = of_columns(column for _, column in ignored)
        with self._reading():
            self._table.settle(self._time, list(itertools.chain(*self._columns)))
            self.torque_candidates = tuple(one for place, one in ignored if one in like and self._table.is_number(place))
        notes = [*others, *self._table.notes, *map(_note_of, self._columns)]
        if ignored:
            notes.append(f"ignored columns: {listed_names([column for _, column in ignored])}")
        notes += note_of(self.torque_candidates, self.roles)
        self._notes = tuple(map(one_line, notes))
        self._position = PositionUnits(self.bindings)

    @property
    def notes(self) -> tuple[str, ...]:
        """How the file was read, which column feeds what, what is ignored, and in which unit a position was taken to be."""
        return (*self._notes, *self._position.notes)

    def blocks(self, max_rows: int = 65536) -> Iterator[SampleBlock]:
        """Read the table; see `trackres_ros.recording.samples.Source.blocks`.

        Raises
        ------
        InputError
            No row at all, a cell that is no number, a row without time or of another length: with its place. A file that
            is damaged.
        """
        with self._reading():
            blocks = self._blocks(max_rows)
            for place, role in enumerate(self.roles):
                blocks = _derived(blocks, place) if self.bindings[role].derivative else blocks
            for block in blocks:
                yield self._position.in_radians(block, self.roles)

    def _reading(self) -> AbstractContextManager[None]:
        kind = next((kind for suffix, kind in KINDS.items() if self._path.name.lower().endswith(suffix)), "CSV")
        return reading(self._path, f"{kind} that can be read to its end")

    def _blocks(self, max_rows: int) -> Iterator[SampleBlock]:
        delay_ns = np.array([self.bindings[role].delay_ns for role in self.roles])
        modes = [place for place, role in enumerate(self.roles) if self.bindings[role].values]
        at_once = max(1, max_rows // len(self.roles))
        self._alone = [0] * len(self.roles)
        done = 0
        for time, timed, cells, given in self._table.rows():
            stamp_ns = self._stamps(time, timed, done)
            done += len(time)
            values, there = self._values(cells, given)
            for start in range(0, len(time), at_once):
                rows, column = np.nonzero(there[start : start + at_once])
                if not rows.size:
                    continue
                rows += start
                stamps, found = stamp_ns[rows], values[rows, column]
                for place in modes:
                    found[column == place] = self.bindings[self.roles[place]].meant(found[column == place])
                yield SampleBlock(column.astype(np.int16), stamps - delay_ns[column], stamps, found)
        if not done:
            raise InputError(self._table.name, "no row", "at least one row below the column names")
        self.findings = (*self._table.findings, *self._of_sums())

    def _stamps(self, time: FloatArray | IntArray, timed: NDArray[np.bool_], done: int) -> IntArray:
        """Stamps of some rows [ns], of which `done` come before."""
        clock = self._time.binding
        dates = time.dtype == np.int64
        seconds = time * 1e-9 + clock.offset if dates else clock.scale * time + clock.offset
        bad = ~timed | ~(np.abs(seconds) < MAX_TIME_S)
        if bad.any():
            first = int(np.argmax(bad))
            where = f"{self._table.name}: {self._time.name}, row {done + first + 1} below the header"
            raise InputError(where, float(seconds[first]) if timed[first] else "", f"a time in seconds, within {MAX_TIME_S:g}")
        if dates:
            return np.asarray(time + round(clock.offset * 1e9), np.int64)
        return np.rint(seconds * 1e9).astype(np.int64)

    def _values(self, cells: FloatArray, given: NDArray[np.bool_]) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Values by role in the units of the roles, and where there is one: of a sum where there are all of its parts."""
        values, there = np.empty((len(cells), len(self.roles))), np.empty((len(cells), len(self.roles)), np.bool_)
        place = 0
        for index, of in enumerate(self._columns):
            whole, total = np.ones(len(cells), np.bool_), np.zeros(len(cells))
            for column in of:
                total = total + column.binding.scale * cells[:, place] + column.binding.offset
                whole &= given[:, place]
                place += 1
            if len(of) > 1:
                role = self.bindings[self.roles[index]]
                total = role.scale * total + role.offset
                self._alone[index] += int(np.count_nonzero(given[:, place - len(of) : place].any(axis=1) & ~whole))
            values[:, index], there[:, index] = total, whole
        return values, there

    def _of_sums(self) -> Iterator[Finding]:
        for role, count in zip(self.roles, self._alone, strict=True):
            if count:
                text = f"{count} rows hold only some parts of the sum: they give no sample"
                yield Finding(role, "part", count, float("nan"), text)


def _tables_of(path: Path, name: str) -> Sequence[TableFile]:
    """The tables in a file: of a workbook one for each sheet."""
    suffix = path.suffix.lower()
    if suffix == ".xlsx":
        from trackres_ros.recording.excel_table import excel_tables

        return excel_tables(path, name)
    return [ParquetTable(path, name) if suffix == ".parquet" else CsvTable(path, name)]


def _first_that_fits(
    tables: Sequence[TableFile], topics: Topics | None
) -> tuple[TableFile, TableColumn, list[TableColumn], list[str]]:
    """The first table that has a time and a speed, its columns, and what to say of the others."""
    fitting: list[tuple[TableFile, TableColumn, list[TableColumn]]] = []
    errors: list[InputError] = []
    for table in tables:
        try:
            fitting.append((table, *choose_columns(table.names, topics, table.name)))
        except InputError as error:
            errors.append(error)
    if not fitting:
        raise errors[0]
    others = ", ".join(table.name for table, *_ in fitting[1:])
    return (*fitting[0], [f"also possible: {others}"] if others else [])


def _derived(blocks: Iterator[SampleBlock], place: int) -> Iterator[SampleBlock]:
    """All blocks with the change over time of the role at a place instead of its values: from the sample before each to the one
    after it, nan where their times do not rise. So both of these have to be read before.
    """
    read = list(blocks)
    of = [block.role == place for block in read]
    at = np.concatenate([block.stamp_ns[rows] for block, rows in zip(read, of, strict=True)]) if read else np.empty(0, np.int64)
    value = np.concatenate([block.value[rows] for block, rows in zip(read, of, strict=True)]) if read else np.empty(0)
    first, last = np.maximum(np.arange(len(at)) - 1, 0), np.minimum(np.arange(len(at)) + 1, len(at) - 1)
    over = (at[last] - at[first]) * 1e-9
    rises = over > 0.0
    rate = np.where(rises, (value[last] - value[first]) / np.where(rises, over, 1.0), np.nan)
    for block, rows, part in zip(read, of, np.split(rate, np.cumsum([rows.sum() for rows in of])[:-1]), strict=True):
        whole = block.value.copy()
        whole[rows] = part
        yield replace(block, value=whole)


def _note_of(columns: Sequence[TableColumn]) -> str:
    """Which column feeds a role, or which are added."""
    if len(columns) == 1:
        change = "the change of " if columns[0].binding.derivative else ""
        return f"{columns[0].role}: {change}column {columns[0].name}"
    return f"{columns[0].role}: sum of the columns {', '.join(column.name for column in columns)}, where a row has them all"
