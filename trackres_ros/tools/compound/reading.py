# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads a DMA sweep as instruments write it: names and units of columns, separators, decimal commas, lines about the test."""

from __future__ import annotations

import codecs
import csv
import math
import re
from collections.abc import Sequence, Set
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trackres_ros.errors import InputError, one_line
from trackres_ros.files.dataclass_reader import Limits
from trackres_ros.files.documents import read_bytes
from trackres_ros.text import figures
from trackres_ros.tools.compound.columns import (
    FREQUENCY,
    LOSS,
    STORAGE,
    TANGENT,
    TEMPERATURE,
    DmaColumn,
    another_column,
    columns_of,
    is_unit,
    role_of,
)
from trackres_ros.vehicle.loading import SWEEP_DEGC, SWEEP_LOSS, SWEEP_STORAGE, SWEEP_TAN_DELTA

Array = NDArray[np.float64]

MOST_BYTES = 4 << 20
MOST_ROWS = 20_000
SEPARATORS = "\t;,"
SPACES = " "  # one or several; not for a line of prose
COMMENTS = ("#", "%", "//", "!")
EMPTY = ("", "-", "--", "---", "nan", "n/a", "na", "none")
PLAIN = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
FREQUENCIES = Limits("Hz", 1e-6, 1e6, "frequency of a row")
FEWEST_ROWS, FEWEST_DEGC, NARROWEST_K = 8, 4, 10.0
TANGENT_DIFFERS = 0.02  # of loss over storage modulus, in the median: both are there, and cannot be of one test
NEEDED = {
    (TEMPERATURE,): "a temperature",
    (STORAGE,): "a storage modulus (E' or G')",
    (LOSS, TANGENT): "a loss modulus (E'' or G'') or tan delta",
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
        rising = np.sort(self.frequency)
        return np.asarray(rising[np.concatenate([[True], np.diff(np.log(rising)) > 0.02])])


def read_sweep(path: Path, frequency_hz: float | None = None) -> Sweep:
    """Read a DMA sweep. Raises InputError with file, line and column, and the given and the allowed values.

    The text has one line of column names, perhaps one of units below, rows of numbers, and lines about the test above it or
    marked as comments. Separators are tab, semicolon or comma, decimals have a point or a comma. `frequency_hz` is that of the
    whole sweep, if the file does not give it.
    """
    content, name = read_bytes(path, WHAT, MOST_BYTES), one_line(str(path))
    if b"\0" in content and not content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise InputError(name, "a binary file, such as an Excel workbook", f"a {WHAT}", "save the sweep as text, such as CSV")
    text, coding = _decoded(content)
    lines = text.splitlines()
    notes = [] if coding == "utf-8" else [f"the file is not UTF-8; read as {coding}"]
    at, separator, cells = _header(lines, name)
    below = next((i for i in range(at + 1, len(lines)) if not _is_comment(lines[i])), None)
    units = None
    if below is not None:
        found = _cells(lines[below], separator)
        if any(map(is_unit, found)) and not any(map(_looks_like_number, found)):
            units = found
    repeated = {lines[at].strip(), lines[below].strip() if units is not None and below is not None else lines[at].strip()}
    wanted = _lines_of_numbers(lines, at + 1, separator, len(cells), repeated, name)
    where = f"{name}: line {at + 1}"
    columns = columns_of(cells, units, where)
    if wanted:  # an instrument that did not compute tan delta may still name it
        columns = [c for c in columns if any(cells[c.place].lower() not in EMPTY for _, cells in wanted)]
    rows, left_out = _rows(wanted, columns, name)
    columns, rows = _each_once(columns, rows, where)
    _complete(columns, cells, where, frequency_hz)
    if any(c.shear for c in columns):
        notes.append("moduli in shear were multiplied by 3, as rubber keeps its volume")
    if left_out:
        notes.append(f"{left_out} rows with an empty cell were left out")
    if not rows:
        raise InputError(name, "no row of numbers", f"at least {FEWEST_ROWS}")
    return _assembled(path, _Table.of(name, columns, rows), frequency_hz, notes)


def _decoded(content: bytes) -> tuple[str, str]:
    for mark, coding in ((codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"), (codecs.BOM_UTF8, "utf-8-sig")):
        if content.startswith(mark):
            return content.decode(coding, errors="replace"), coding.removesuffix("-sig")
    try:
        return content.decode("utf-8"), "utf-8"
    except UnicodeDecodeError:
        return content.decode("latin-1"), "Latin-1"


def _is_comment(line: str) -> bool:
    return not line.strip() or line.lstrip().startswith(COMMENTS)


def _cells(line: str, separator: str) -> list[str]:
    if separator == SPACES:
        return line.split()
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=separator), [])]
    except csv.Error:  # a null byte, an endless cell
        return [cell.strip() for cell in line.split(separator)]


def _looks_like_number(cell: str) -> bool:
    return bool(re.fullmatch(r"[+-]?[\d.,]*\d[\d.,]*([eE][+-]?\d+)?", cell.strip()))


def _header(lines: Sequence[str], name: str) -> tuple[int, str, list[str]]:
    """Line of the column names, the separator, and the names: the first line that names a temperature and a storage modulus."""
    nearly: tuple[int, list[str], int] = 0, [], 0
    for i, line in enumerate(lines):
        text = line.lstrip("#%! ") if _is_comment(line) else line
        for separator in sorted(SEPARATORS, key=lambda one: -text.count(one)):
            cells = _cells(text, separator)
            roles = [role_of(cell) for cell in cells]
            if len(cells) > 1 and not any(map(_looks_like_number, cells)):
                if len(cells) > 2 and TEMPERATURE in roles and STORAGE in roles:
                    return i, separator, cells
                if len(set(roles) - {None}) > nearly[2]:
                    nearly = i, cells, len(set(roles) - {None})
    for i, line in enumerate(lines):
        cells = line.lstrip("#%!").split()
        if {TEMPERATURE, STORAGE} <= {role_of(cell) for cell in cells} and _stand_over_numbers(lines, i, len(cells)):
            return i, SPACES, cells
    if nearly[2]:
        raise _incomplete(f"{name}: line {nearly[0] + 1}", nearly[1], {role_of(cell) for cell in nearly[1]})
    needed = f"a line of column names with {', '.join(NEEDED.values())}, between tabs, semicolons, commas or spaces"
    raise InputError(name, f"{len(lines)} lines without column names", needed)


def _incomplete(where: str, cells: Sequence[str], roles: Set[str | None]) -> InputError:
    """Error of columns that are insufficient for a sweep: it names each missing one."""
    missing = [text for needed, text in NEEDED.items() if not roles & set(needed)]
    return InputError(
        where, f"columns {', '.join(cells)}", f"columns with {', '.join(NEEDED.values())}", f"missing: {', '.join(missing)}"
    )


def _stand_over_numbers(lines: Sequence[str], at: int, width: int) -> bool:
    """Whether as many numbers between spaces follow, at once or after a line of units."""
    following = [line.split() for line in lines[at + 1 :] if not _is_comment(line)][:2]
    if following and any(map(is_unit, following[0])):
        del following[0]
    return bool(following) and len(following[0]) == width and all(map(_looks_like_number, following[0]))


def _complete(columns: Sequence[DmaColumn], cells: Sequence[str], where: str, frequency_hz: float | None) -> None:
    roles, names = {c.role for c in columns}, ", ".join(cells)
    if not all(roles & set(needed) for needed in NEEDED):
        raise _incomplete(where, cells, roles)
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


def _lines_of_numbers(
    lines: Sequence[str], first: int, separator: str, width: int, repeated: set[str], name: str
) -> list[tuple[int, list[str]]]:
    """Line number and cells of each line other than comments, names and units.

    Some programs write names between tabs and numbers between spaces.
    """
    at = [i for i in range(first, len(lines)) if not _is_comment(lines[i]) and lines[i].strip() not in repeated]
    if len(at) > MOST_ROWS:
        raise InputError(name, f"{len(at)} rows", f"at most {MOST_ROWS}", "average or thin the sweep")
    if separator == "\t" and not any("\t" in lines[i].strip() for i in at):
        separator = SPACES
    remedies = {
        ",": "decimal commas need semicolons or tabs between cells",
        SPACES: "empty cells cannot be detected between spaces",
    }
    wanted = []
    for i in at:
        cells = _cells(lines[i], separator)
        if len(cells) != width and (separator == SPACES or any(cells[width:])):
            remedy = remedies.get(separator, "")
            raise InputError(f"{name}: line {i + 1}", f"{len(cells)} cells", f"{width} cells, as in the line of names", remedy)
        wanted.append((i, cells + [""] * (width - len(cells))))
    return wanted


def _rows(
    wanted: Sequence[tuple[int, list[str]]], columns: Sequence[DmaColumn], name: str
) -> tuple[list[tuple[int, list[float]]], int]:
    """Numbers of the wanted columns with their line, and the number of rows left out because of an empty cell."""
    texts = [cells[c.place] for _, cells in wanted for c in columns]
    comma = any("," in text for text in texts) and not any("." in text for text in texts)
    rows, left_out = [], 0
    for i, cells in wanted:
        where = f"{name}: line {i + 1}"
        if not any(cells[c.place] for c in columns):
            raise InputError(where, " ".join(cells).strip(), "a row of numbers, or a comment after #")
        if any(cells[c.place].lower() in EMPTY for c in columns):
            left_out += 1
            continue
        rows.append((i + 1, [_number(cells[c.place], comma, f"{where}, column {c.name}") for c in columns]))
    return rows, left_out


def _each_once(
    columns: Sequence[DmaColumn], rows: Sequence[tuple[int, list[float]]], where: str
) -> tuple[list[DmaColumn], list[tuple[int, list[float]]]]:
    """Without the columns that some instruments write twice; a second one with other numbers is another quantity."""
    for k, column in enumerate(columns):
        if column.again:
            first = next(i for i, c in enumerate(columns) if c.role == column.role and c.frequency == column.frequency)
            if any(values[k] != values[first] for _, values in rows):
                raise another_column(column, columns[first], where)
    kept = [k for k, column in enumerate(columns) if not column.again]
    return [columns[k] for k in kept], [(line, [values[k] for k in kept]) for line, values in rows]


def _number(text: str, comma: bool, where: str) -> float:
    """A number in text; a mix of comma and point is ambiguous."""
    plain = text.replace(",", ".") if comma else text
    if not PLAIN.fullmatch(plain):
        allowed = "a number with a decimal comma" if comma else "a number with a decimal point"
        if not comma and "," in text:
            raise InputError(where, text, "decimal points or decimal commas, not both in one file, and no mark between thousands")
        raise InputError(where, text, allowed)
    return float(plain)


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
        return cls(name, columns, [line for line, _ in rows], given, si)

    def of_role(self, role: str) -> list[int]:
        return [k for k, column in enumerate(self.columns) if column.role == role]

    def of_frequency(self, role: str, storage: DmaColumn) -> int | None:
        """Index of the role's column at the storage modulus' frequency; one without a frequency fits the only storage modulus."""
        listed = self.of_role(role)
        same = [k for k in listed if self.columns[k].frequency == storage.frequency]
        if not same and len(listed) == 1 and None in (self.columns[listed[0]].frequency, storage.frequency):
            same = listed
        return same[0] if same else None

    def checked(
        self, k: int, limits: Limits, to_limits: float = 1.0, values: Array | None = None, remedy: str = UNIT_REMEDY
    ) -> Array:
        """Values of a column in SI, or made with it, that are within limits."""
        values = self.si[:, k] if values is None else values
        shown = values / to_limits
        bad = ~((shown >= limits.low) & (shown <= limits.high))
        if bad.any():
            at = int(np.argmax(bad))
            given = figures(float(self.given[at, k])) if math.isfinite(self.given[at, k]) else str(self.given[at, k])
            raise InputError(
                f"{self.name}: line {self.lines[at]}, column {self.columns[k].name}",
                f"{given} ({figures(float(shown[at]), 4)} {limits.unit})",
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
    f, t, e1, e2 = (np.concatenate(each) for each in zip(*parts, strict=True))
    apart, width = len(np.unique(np.round(t))), float(t.max() - t.min())
    if len(f) < FEWEST_ROWS or apart < FEWEST_DEGC or width < NARROWEST_K:
        given = f"{len(f)} rows at {apart} temperatures over {width:.0f} K"
        allowed = f"at least {FEWEST_ROWS} rows at {FEWEST_DEGC} temperatures over {NARROWEST_K:g} K"
        raise InputError(table.name, given, allowed)
    return Sweep(path, f, t, e1, e2, tuple(notes))


def _loss(table: _Table, column: DmaColumn, storage: Array) -> Array:
    """Loss modulus [Pa] of the frequency of a column with the storage modulus: measured, or by tan delta."""
    k_loss, k_tan = (table.of_frequency(role, column) for role in (LOSS, TANGENT))
    if k_loss is None:
        if k_tan is None:
            needed = "a loss modulus or tan delta of the same frequency beside each storage modulus"
            raise InputError(table.name, column.name, needed)
        return table.checked(k_tan, SWEEP_LOSS, 1e6, storage * table.checked(k_tan, SWEEP_TAN_DELTA))
    if k_tan is not None:
        table.checked(k_tan, SWEEP_TAN_DELTA)
    loss = table.checked(k_loss, SWEEP_LOSS, 1e6)
    remedy = "loss over storage modulus: check that both have the same unit"
    by_moduli = table.checked(k_loss, SWEEP_TAN_DELTA, 1.0, loss / storage, remedy)
    if k_tan is not None:
        apart = float(np.median(np.abs(np.log(by_moduli / table.si[:, k_tan]))))
        if apart > TANGENT_DIFFERS:
            raise InputError(
                table.name, f"{table.columns[k_tan].name} that is {100 * apart:.0f} % off loss over storage modulus",
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
