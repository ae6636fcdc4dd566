# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Defines what every kind of table gives: names of columns, and its rows as numbers and times."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from trackres_ros.errors import InputError
from trackres_ros.recording.samples import Finding, FloatArray, IntArray
from trackres_ros.recording.table_columns import TableColumn

CHUNK_ROWS = 8192


class TableRows(NamedTuple):
    """Some rows of a table.

    Attributes
    ----------
    time
        Numbers in the unit of the column, or stamps since 1970 [ns]; shape (n,).
    timed
        Where there is a time, shape (n,).
    cells, given
        The numbers of the other columns, and where there is one, shape (n, columns).
    """

    time: FloatArray | IntArray
    timed: NDArray[np.bool_]
    cells: FloatArray
    given: NDArray[np.bool_]


class TableFile(Protocol):
    """A table of one file: a CSV, a Parquet file, a sheet of a workbook."""

    @property
    def name(self) -> str:
        """The file, and the sheet of a workbook, for messages."""

    @property
    def names(self) -> Sequence[str]:
        """Names of all columns."""

    @property
    def notes(self) -> Sequence[str]:
        """What was assumed of the file."""

    @property
    def findings(self) -> Sequence[Finding]:
        """What the last reading met."""

    def is_number(self, place: int) -> bool:
        """Whether the first filled cell of a column holds a number."""

    def settle(self, time: TableColumn, columns: Sequence[TableColumn]) -> None:
        """Choose what to read, and decide how times and numbers are written; before `rows`."""

    def rows(self) -> Iterator[TableRows]:
        """Read from the beginning, some rows at a time."""


def time_note(column: str, text: str) -> str:
    """Say how a column of dates and times was read."""
    return f"time: column {column}, {text}"


def check_dates(time: TableColumn, name: str, are_dates: bool) -> None:
    """Refuse numbers of which nobody says the unit, and a scale of dates.

    Raises
    ------
    InputError
        With the line of the topics file.
    """
    if not are_dates and time.dates_only:
        remedy = f"say the unit in a topics file: time: {{column: {time.name}, scale: 1.0}}, or name the column time_s"
        raise InputError(f"{name}: {time.name}", "numbers of an unknown unit", "dates with times", remedy)
    if are_dates and time.binding.scale != 1.0:
        raise InputError(f"{name}: {time.name}", f"scale {time.binding.scale:g}", "no scale for dates with times")
