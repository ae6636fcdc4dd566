# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads numbers in text. The whole column decides on the decimal mark; an ambiguous one is refused."""

import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Literal

from trackres_ros.errors import InputError

Mark = Literal[".", ","]
POINT: Mark = "."
COMMA: Mark = ","
MARKS: tuple[tuple[Mark, Mark], ...] = ((POINT, COMMA), (COMMA, POINT))
"""Each mark, and the other one."""
EXPONENT = r"(?:[eE][+-]?\d+)?"
HEAD = r"[+-]?[1-9]\d{0,2}"


def _either(mark: Mark) -> str:
    """1,234: one and a bit, or one thousand and more."""
    return rf"{HEAD}[{mark}]\d{{3}}"


def _surely(mark: Mark, other: Mark) -> str:
    """Numbers with a certain decimal mark: 0,5 and 12,34 and 1.234,5 and 1.234.567."""
    plain = rf"(?!{_either(mark)}$)[+-]?(?:\d+[{mark}]\d*|[{mark}]\d+){EXPONENT}"
    grouped = rf"{HEAD}(?:[{other}]\d{{3}})+[{mark}]\d*{EXPONENT}|{HEAD}(?:[{other}]\d{{3}}){{2,}}"
    return rf"(?:{plain}|{grouped})"


SURELY = {mark: re.compile(rf"^{_surely(mark, other)}$", re.MULTILINE) for mark, other in MARKS}
EITHER = {mark: re.compile(rf"^{_either(mark)}$", re.MULTILINE) for mark, _ in MARKS}
GROUPED = {mark: re.compile(rf"{HEAD}(?:[{other}]\d{{3}})+(?:[{mark}]\d*)?{EXPONENT}", re.ASCII) for mark, other in MARKS}
"""A number with a mark between thousands, by its decimal mark."""


@dataclass(slots=True)
class ColumnMarks:
    """Evidence on the marks in the cells of one column."""

    given: Mark | Literal[""] = ""  # the decimal mark that the topics file names; empty without one
    # by mark: the first cell in which it is surely the decimal mark, and the first in which it may also separate thousands
    surely: dict[Mark, str] = field(default_factory=dict)
    either: dict[Mark, str] = field(default_factory=dict)
    marks: set[Mark] = field(default_factory=set)  # all marks in any cell

    def see(self, cells: Sequence[str]) -> None:
        """Look at some more cells."""
        text = "\n".join(cells)
        for mark in (POINT, COMMA):
            self.marks |= {mark} if mark in text else set()
        for found, patterns in ((self.surely, SURELY), (self.either, EITHER)):
            for mark, pattern in patterns.items():
                if mark not in found and self.marks and (match := pattern.search(text)):
                    found[mark] = match.group()


def marks_of(lines: Iterable[tuple[str, Mark | Literal[""]]]) -> dict[str, ColumnMarks]:
    """The evidence to collect, by column: of several lines for one column, any may give its decimal mark."""
    marks: dict[str, ColumnMarks] = {}
    for column, given in lines:
        one = marks.setdefault(column, ColumnMarks())
        one.given = one.given or given
    return marks


def decide(columns: Mapping[str, ColumnMarks], name: str, commas_separate: bool = False) -> dict[str, Mark]:
    """The decimal mark of each column.

    A column decides for itself. In an ambiguous one, a mark is the decimal one if it surely is in other columns of the table and
    the other mark is in none; or if it is a point and commas separate the cells.

    `columns`: by name; `name`: of the table, for messages; `commas_separate`: the cells of the table. Raises InputError if
    neither the column nor the others decide, or a column shows both.
    """
    sure = {mark for marks in columns.values() for mark in ((marks.given,) if marks.given else marks.surely)}
    shown = sure or ({POINT} if commas_separate else set())
    return {column: _mark_of(marks, shown, f"{name}: {column}") for column, marks in columns.items()}


def _mark_of(marks: ColumnMarks, shown: set[Mark], where: str) -> Mark:
    if marks.given:
        return marks.given
    if len(marks.surely) > 1:
        given = f"{marks.surely[POINT]} with a decimal point and {marks.surely[COMMA]} with a decimal comma"
        raise InputError(where, given, "one decimal mark in a column")
    if marks.surely:
        return next(iter(marks.surely))
    if not marks.either:
        return POINT
    if set(marks.either) == shown:
        return next(iter(shown))
    given = f"{next(iter(marks.either.values()))}, a number whose mark may be a decimal or a thousands separator"
    remedy = "give the decimal mark in a topics file, in the line of the column: decimal: ',' or decimal: '.'"
    raise InputError(where, given, "a column or table with an unambiguous decimal mark, as in 0,5", remedy)


def is_number(text: str) -> bool:
    """Whether a cell holds a number, whatever its decimal mark is."""
    for mark in (POINT, COMMA):
        with suppress(ValueError):
            return number_of(text, mark) is not None
    return False


def number_of(text: str, mark: Mark, where: str = "") -> float | None:
    """The number in a cell, None where it is empty. Raises InputError with its place if it is no number."""
    bare, other = text.strip(), COMMA if mark == POINT else POINT
    if not bare:
        return None
    try:
        if "_" in bare or (other in bare and not GROUPED[mark].fullmatch(bare)):  # 1_0 is Python's notation, not that of a table
            raise ValueError(text)
        bare = bare.replace(other, "")
        return float(bare if mark == POINT else bare.replace(COMMA, POINT))
    except ValueError:
        raise InputError(where, text, "a number, or an empty cell") from None
