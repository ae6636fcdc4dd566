# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads numbers, dates and times in the cells of a text table: the whole column decides how an ambiguous one is written."""

import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import date
from functools import lru_cache
from typing import Literal

from trackres_ros.errors import InputError
from trackres_ros.units import SECOND_NS

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


ZONE = r"(?P<zone>Z|UTC|[+-]\d\d(?::?\d\d)?)?"
CLOCK = rf"(?P<hour>\d{{1,2}}):?(?P<minute>\d\d)(?::?(?P<second>\d\d)(?:[.,](?P<part>\d+))?)?\s*{ZONE}"
FIRST = r"(?P<year>\d{4})(?P<mark>[-/]?)(?P<month>\d\d)(?P=mark)(?P<day>\d\d)[T ] *"
LAST = r"(?P<one>\d{1,2})(?P<mark>[./-])(?P<two>\d{1,2})(?P=mark)(?P<year>\d{4})[T ,] *"
YEAR_FIRST, YEAR_LAST = (re.compile(day + CLOCK, re.IGNORECASE | re.ASCII) for day in (FIRST, LAST))
UNIX_DAY = date(1970, 1, 1).toordinal()
MOST_S = 2**63 // SECOND_NS - 1
"""Years that fit in 64 bits as nanoseconds: from 1678 to 2262."""
MOST_MONTHS = 12

Order = Literal["dmy", "mdy", ""]


def is_date_time(text: str) -> bool:
    """Whether a cell holds a date with a time."""
    text = text.strip()
    return bool(YEAR_FIRST.fullmatch(text) or YEAR_LAST.fullmatch(text))


class DateTimes:
    """The dates and times of one column, all in the notation of the first one.

    `first`: the first cell; `is_date_time` is true for it; `order`: of day and month if the year comes last and the topics file
    names it. With dots the day comes first.
    """

    def __init__(self, first: str, order: Order = "") -> None:
        match = YEAR_FIRST.fullmatch(first.strip()) or YEAR_LAST.fullmatch(first.strip())
        assert match
        self._pattern = match.re
        self._mark = match["mark"]
        self._has_zone = bool(match["zone"])
        self._order: Order = order or ("dmy" if self._mark == "." else "")
        self._first = first.strip()
        self._more: dict[Order, str] = {}

    @property
    def is_open(self) -> bool:
        """Whether the other cells have to show which is the day and which the month."""
        return self._pattern is YEAR_LAST and not self._order

    def see(self, cells: Iterable[str]) -> None:
        """Look for a day above 12 in some more cells."""
        for text in cells:
            if match := YEAR_LAST.fullmatch(text.strip()):
                if int(match["one"]) > MOST_MONTHS:
                    self._more.setdefault("dmy", text)
                if int(match["two"]) > MOST_MONTHS:
                    self._more.setdefault("mdy", text)

    def decide(self, where: str) -> None:
        """Settle the order of day and month from the cells so far.

        Raises InputError if the column does not show it, or shows both.
        """
        if not self.is_open:
            return
        if len(self._more) > 1:
            raise InputError(where, " and ".join(self._more.values()), "dates in one order of day and month")
        if not self._more:
            remedy = "give the order in a topics file: time: {column: NAME, order: dmy}, or mdy; or write dates as 2026-11-23"
            given = f"{self._first}: the order of day and month is ambiguous in the whole column"
            raise InputError(where, given, "at least one date with a day above 12", remedy)
        self._order = next(iter(self._more))

    def ns(self, text: str, where: str = "") -> int:
        """Time since 1970 in UTC [ns]; digits below a nanosecond are cut off.

        Raises InputError with its place for another notation than that of the first cell, or an invalid date or time.
        """
        try:
            match = self._pattern.fullmatch(text.strip())
            if not match or match["mark"] != self._mark or bool(match["zone"]) is not self._has_zone:
                raise ValueError(text)
            if self._pattern is YEAR_FIRST:
                month, day = match["month"], match["day"]
            else:
                month, day = (match["two"], match["one"]) if self._order == "dmy" else (match["one"], match["two"])
            hour, minute, second = int(match["hour"]), int(match["minute"]), int(match["second"] or 0)
            if hour > 23 or minute > 59 or second > 60:  # a leap second has the number 60
                raise ValueError(text)
            seconds = _day_s(match["year"], month, day) + 3600 * hour + 60 * minute + second - _zone_s(match["zone"])
            if abs(seconds) > MOST_S:
                raise ValueError(text)
            return seconds * SECOND_NS + int((match["part"] or "0")[:9].ljust(9, "0"))
        except ValueError:
            raise InputError(where, text, f"an existing date and time, as in the other rows ({self.text})") from None

    @property
    def text(self) -> str:
        """How the column was read, for people."""
        if self._pattern is YEAR_FIRST:
            form = "yyyy/mm/dd hh:mm:ss" if self._mark == "/" else "ISO 8601"
        else:
            form = f"{self._mark.join(('dd', 'mm') if self._order == 'dmy' else ('mm', 'dd'))}{self._mark}yyyy hh:mm:ss"
        return f"{form}, {'with a time zone' if self._has_zone else NO_ZONE}"


NO_ZONE = "without a time zone: treated as UTC"


@lru_cache(maxsize=64)
def _day_s(year: str, month: str, day: str) -> int:
    return (date(int(year), int(month), int(day)).toordinal() - UNIX_DAY) * 86400


@lru_cache(maxsize=64)
def _zone_s(zone: str | None) -> int:
    """Seconds by which a zone is ahead of UTC."""
    if not zone or zone.upper() in ("Z", "UTC"):
        return 0
    digits = zone[1:].replace(":", "").ljust(4, "0")
    hours, minutes = int(digits[:2]), int(digits[2:])
    if hours > 23 or minutes > 59:
        raise ValueError(zone)
    return (3600 * hours + 60 * minutes) * (-1 if zone[0] == "-" else 1)
