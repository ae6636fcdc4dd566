# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads a DMA sweep as instruments write it: names and units of columns, separators, decimal commas, lines about the test."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trackres_ros.errors import InputError, one_line
from trackres_ros.files.dataclass_reader import Limits
from trackres_ros.recording.reading import check_there, reading
from trackres_ros.recording.text_table import Column, Progress, TextTable, decide, marks_of, number_of
from trackres_ros.text import figures
from trackres_ros.tools.compound.columns import (
    ANGLE,
    COMPLEX,
    FREQUENCY,
    LOSS,
    STORAGE,
    TANGENT,
    TEMPERATURE,
    DmaColumn,
    another_column,
    columns_of,
    is_unit,
)
from trackres_ros.vehicle.loading import SWEEP_DEGC, SWEEP_LOSS, SWEEP_STORAGE, SWEEP_TAN_DELTA

Array = NDArray[np.float64]

FREQUENCIES = Limits("Hz", 1e-6, 1e6, "frequency of a row")
FEWEST_ROWS, FEWEST_DEGC, NARROWEST_K = 8, 4, 10.0
TANGENT_DIFFERS = 0.02  # of loss over storage modulus, in the median: both are there, and cannot be of one test
NEEDED = {
    (TEMPERATURE,): "a temperature",
    (STORAGE,): "a storage modulus (E' or G') or |E*|",
    (LOSS, TANGENT): "a loss modulus (E'' or G''), tan delta or loss angle",
}
WHAT = "table of a DMA sweep as text"
UNIT_REMEDY = "check its unit; delete rows that the instrument could not measure"


@dataclass(frozen=True, eq=False)
class Sweep:
    """A sweep: frequency [Hz], temperature [degC], storage and loss modulus in tension [Pa], each of shape (n,)."""

    path: Path
    frequency: Array
    temp_degc: Array
    storage: Array
    loss: Array
    notes: tuple[str, ...] = field(default=())

    def some(self, rows: NDArray[np.bool_]) -> Sweep:
        """Some rows of it."""
        return replace(
            self, frequency=self.frequency[rows], temp_degc=self.temp_degc[rows], storage=self.storage[rows], loss=self.loss[rows]
        )

    @property
    def frequencies(self) -> Array:
        """Each frequency once, rising; those within 2 % are merged."""
        sorted_hz = np.sort(self.frequency)
        return np.asarray(sorted_hz[np.concatenate([[True], np.diff(np.log(sorted_hz)) > 0.02])])


def read_sweep(path: Path, frequency_hz: float | None = None) -> Sweep:
    """Read a DMA sweep. Raises InputError with file, line and column, and the given and the allowed values.

    The text is a `TextTable`: lines about the test above the names, perhaps a line of units below them, rows of numbers.
    `frequency_hz` is that of the whole sweep, if the file does not give it.
    """
    name = one_line(str(path))
    check_there(path)
    with reading(path, f"a {WHAT}"):
        return _read(path, name, frequency_hz)


def _read(path: Path, name: str, frequency_hz: float | None) -> Sweep:
    table = TextTable(path, name, is_unit)
    where = f"{name}: line {table.line}"
    columns = columns_of(table.names, table.units, where)
    notes = table.notes
    rows = _rows(table, columns)
    if rows:  # an instrument that did not compute tan delta may still name it
        has_number = [any(map(math.isfinite, numbers)) for numbers in zip(*(numbers for _, numbers in rows), strict=True)]
        columns = list(itertools.compress(columns, has_number))
        rows = [(line, list(itertools.compress(numbers, has_number))) for line, numbers in rows]
    whole_rows = [(line, numbers) for line, numbers in rows if all(map(math.isfinite, numbers))]
    columns, numbers_of = _each_once(columns, whole_rows, where)
    _check_complete(columns, table.names, where, frequency_hz)
    if any(c.shear for c in columns):
        notes.append("moduli in shear were multiplied by 3, as rubber keeps its volume")
    computed = [f"{c.role} from {c.name.strip()}" for c in columns if c.quantity]
    notes += [f"computed: {', '.join(computed)}"] if computed else []
    if len(whole_rows) < len(rows):
        notes.append(f"{len(rows) - len(whole_rows)} rows with an empty cell were left out")
    if not whole_rows:
        raise InputError(name, "no row of numbers", f"at least {FEWEST_ROWS}")
    return _assembled(path, _Table.of(name, columns, numbers_of), frequency_hz, notes)


def _rows(table: TextTable, columns: Sequence[DmaColumn]) -> list[tuple[int, list[float]]]:
    """Line and numbers of each row, nan in empty cells. Raises InputError with line and column for a cell that is no number."""
    marks = marks_of((column.name, "") for column in columns)
    table.look([(column.place, marks[column.name].see) for column in columns])
    mark_of_column = decide(marks, table.name, table.separator == ",")
    read = [
        Column(table_column.place, table_column.name, partial(number_of, mark=mark_of_column[table_column.name]))
        for table_column in columns
    ]
    progress = Progress()
    numbers = table.numbers(table.rows(progress), read, progress)
    return [(progress.line, [math.nan if number is None else number for number in row]) for row in numbers]


def _check_complete(columns: Sequence[DmaColumn], cells: Sequence[str], where: str, frequency_hz: float | None) -> None:
    roles, names = {c.role for c in columns}, ", ".join(cells)
    missing_texts = [text for needed_roles, text in NEEDED.items() if not roles & set(needed_roles)]
    if missing_texts:
        allowed = f"columns with {', '.join(NEEDED.values())}, between tabs, semicolons, commas or spaces"
        raise InputError(where, f"columns {names}", allowed, f"missing: {', '.join(missing_texts)}")
    in_names = [c.frequency for c in columns if c.role == STORAGE and not c.again]
    if frequency_hz is not None and (FREQUENCY in roles or any(in_names)):
        raise InputError("frequency_hz", figures(frequency_hz, 6), f"nothing, as {where} says the frequency")
    if FREQUENCY in roles or frequency_hz is not None:
        if len(in_names) > 1:
            raise InputError(
                where, f"columns {names}", "one storage modulus, or several with their frequency in the name and no other"
            )
    elif None in in_names:
        remedy = "add such a column, write the frequency into the names as E'_10Hz [MPa], or give --frequency-hz"
        raise InputError(where, f"columns {names}", "a column with the frequency", remedy)


def _each_once(
    columns: Sequence[DmaColumn], rows: Sequence[tuple[int, list[float]]], where: str
) -> tuple[list[DmaColumn], list[tuple[int, list[float]]]]:
    """Without the columns that some instruments write twice; a second one with other numbers is another quantity."""
    for k, column in enumerate(columns):
        if column.again:
            first_place = next(i for i, c in enumerate(columns) if c.role == column.role and c.frequency == column.frequency)
            if any(values[k] != values[first_place] for _, values in rows):
                raise another_column(column, columns[first_place], where)
    places_kept = [k for k, column in enumerate(columns) if not column.again]
    return [columns[k] for k in places_kept], [(line, [values[k] for k in places_kept]) for line, values in rows]


def _split_complex(columns: Sequence[DmaColumn], si: Array) -> None:
    """Put tan delta in the place of loss angles, and storage moduli in that of complex ones: |E*|^2 = E'^2 + E''^2.

    `si`: by row and column; a complex modulus without a loss at its frequency stays.
    """
    for k, column in enumerate(columns):
        if column.quantity == ANGLE:
            is_acute = (si[:, k] >= 0.0) & (si[:, k] < 0.5 * math.pi)
            si[:, k] = np.where(is_acute, np.tan(si[:, k]), math.inf)  # infinite is out of limits
    for k, column in enumerate(columns):
        if column.quantity != COMPLEX:
            continue
        losses = [j for j, c in enumerate(columns) if c.role in (LOSS, TANGENT) and c.frequency in (column.frequency, None)]
        if losses and columns[losses[0]].role == TANGENT:
            tangent = si[:, losses[0]]
            si[:, k] /= np.where(np.isfinite(tangent), np.hypot(1.0, tangent), 1.0)
        elif losses:
            si[:, k] = np.sqrt(np.maximum(si[:, k] ** 2 - si[:, losses[0]] ** 2, 0.0))


@dataclass(frozen=True, eq=False)
class _Table:
    """Numbers of a sweep with their lines, as given and in SI, each of shape (rows, columns)."""

    name: str
    columns: Sequence[DmaColumn]
    lines: Sequence[int]
    given: Array
    si: Array

    @classmethod
    def of(cls, name: str, columns: Sequence[DmaColumn], rows: Sequence[tuple[int, list[float]]]) -> _Table:
        given = np.array([row for _, row in rows])
        with np.errstate(over="ignore"):  # infinite is out of limits
            si = given * np.array([c.scale for c in columns]) + np.array([c.offset for c in columns])
            _split_complex(columns, si)
        return cls(name, columns, [line for line, _ in rows], given, si)

    def of_role(self, role: str) -> list[int]:
        return [k for k, column in enumerate(self.columns) if column.role == role]

    def of_frequency(self, role: str, storage: DmaColumn) -> int | None:
        """Index of the role's column at the storage modulus' frequency; one without a frequency fits the only storage modulus."""
        role_columns = self.of_role(role)
        equal_columns = [k for k in role_columns if self.columns[k].frequency == storage.frequency]
        if not equal_columns and len(role_columns) == 1 and None in (self.columns[role_columns[0]].frequency, storage.frequency):
            equal_columns = role_columns
        return equal_columns[0] if equal_columns else None

    def checked(
        self, k: int, limits: Limits, to_limits: float = 1.0, values: Array | None = None, remedy: str = UNIT_REMEDY
    ) -> Array:
        """Values of a column in SI, or made with it, that are within limits."""
        values = self.si[:, k] if values is None else values
        values_shown = values / to_limits
        is_bad = ~((values_shown >= limits.low) & (values_shown <= limits.high))
        if is_bad.any():
            row = int(np.argmax(is_bad))
            given = figures(float(self.given[row, k])) if math.isfinite(self.given[row, k]) else str(self.given[row, k])
            raise InputError(
                f"{self.name}: line {self.lines[row]}, column {self.columns[k].name}",
                f"{given} ({figures(float(values_shown[row]), 4)} {limits.unit})",
                f"{limits.meaning} of {limits.low:g} to {limits.high:g} {limits.unit}", remedy,
            )  # fmt: skip
        return values


def _assembled(path: Path, table: _Table, frequency_hz: float | None, notes: Sequence[str]) -> Sweep:
    """SI, a row for each frequency and temperature, within what rubber can have."""
    temp_degc = table.checked(table.of_role(TEMPERATURE)[0], SWEEP_DEGC)
    parts = []
    for k in table.of_role(STORAGE):
        storage = table.checked(k, SWEEP_STORAGE, 1e6)
        loss = _loss(table, table.columns[k], storage)
        parts.append((_frequency(table, table.columns[k], frequency_hz), temp_degc, storage, loss))
    f, t, e1, e2 = (np.concatenate(part_arrays) for part_arrays in zip(*parts, strict=True))
    temperature_count, width = len(np.unique(np.round(t))), float(t.max() - t.min())
    if len(f) < FEWEST_ROWS or temperature_count < FEWEST_DEGC or width < NARROWEST_K:
        given = f"{len(f)} rows at {temperature_count} temperatures over {width:.0f} K"
        allowed = f"at least {FEWEST_ROWS} rows at {FEWEST_DEGC} temperatures over {NARROWEST_K:g} K"
        raise InputError(table.name, given, allowed)
    return Sweep(path, f, t, e1, e2, tuple(notes))


def _loss(table: _Table, column: DmaColumn, storage: Array) -> Array:
    """Loss modulus [Pa] of the frequency of a column with the storage modulus: measured, or by tan delta."""
    k_loss, k_tan = (table.of_frequency(role, column) for role in (LOSS, TANGENT))
    if k_loss is None:
        if k_tan is None:
            need_text = "a loss modulus or tan delta of the same frequency beside each storage modulus"
            raise InputError(table.name, column.name, need_text)
        return table.checked(k_tan, SWEEP_LOSS, 1e6, storage * table.checked(k_tan, SWEEP_TAN_DELTA))
    if k_tan is not None:
        table.checked(k_tan, SWEEP_TAN_DELTA)
    loss = table.checked(k_loss, SWEEP_LOSS, 1e6)
    remedy = "loss over storage modulus: check that both have the same unit"
    by_moduli = table.checked(k_loss, SWEEP_TAN_DELTA, 1.0, loss / storage, remedy)
    if k_tan is not None:
        difference = float(np.median(np.abs(np.log(by_moduli / table.si[:, k_tan]))))
        if difference > TANGENT_DIFFERS:
            raise InputError(
                table.name, f"{table.columns[k_tan].name} that is {100 * difference:.0f} % off loss over storage modulus",
                f"within {100 * TANGENT_DIFFERS:g} %", "check the units of both moduli, or delete one of the columns",
            )  # fmt: skip
    return loss


def _frequency(table: _Table, column: DmaColumn, frequency_hz: float | None) -> Array:
    """Frequency of each row [Hz]: a column's, the one given for the sweep, or that in the name of the storage modulus."""
    measured = table.of_role(FREQUENCY)
    if measured:
        return table.checked(measured[0], FREQUENCIES)
    frequency = np.full(len(table.lines), frequency_hz if frequency_hz is not None else column.frequency)
    if not (FREQUENCIES.low <= frequency[0] <= FREQUENCIES.high):
        raise InputError(f"{table.name}: {column.name}", frequency[0], f"{FREQUENCIES.low:g} to {FREQUENCIES.high:g} Hz")
    return frequency
