# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads times as text: dates with times in the notations of loggers and spreadsheets, and clocks of the day without a date."""

import re
import unicodedata
from collections.abc import Iterable
from contextlib import suppress
from datetime import date
from functools import lru_cache
from typing import Literal

import numpy as np

from trackres_ros.errors import InputError
from trackres_ros.files.documents import in_a_line
from trackres_ros.units import SECOND_NS

FLAGS = re.IGNORECASE | re.ASCII
ZONE = r"(?P<zone>Z|(?:UTC|GMT)?[+-]\d\d(?::?\d\d)?|UTC|GMT)?"
PART = r"(?:[.,:](?P<part>\d+))?\s*(?P<half>[ap]\.?m\.?)?\s*"
CLOCK = rf"(?P<hour>\d{{1,2}}):?(?P<minute>\d\d)(?::?(?P<second>\d\d){PART})?\s*{ZONE}"
SHORT_CLOCK = r"(?P<hour>\d{1,2}):(?P<minute>\d\d)\s*(?P<half>[ap]\.?m\.?)"
FIRST = r"(?P<year>\d{4})(?P<mark>[-/.]?)(?P<month>\d\d)(?P=mark)(?P<day>\d\d)[T ] *"
LAST = r"(?P<one>\d{1,2})(?P<mark>[./-])(?P<two>\d{1,2})(?P=mark)(?P<year>\d{4}|(?<=[./])\d\d)[T ,] *"
DAY, NAME, YEAR = r"(?P<day>\d{1,2})(?:st|nd|rd|th)?\.?", r"(?P<name>[^\W\d_]{3,10})\.?", r"(?P<year>\d{4}|\d\d)"
WEEKDAY, GAP = r"(?:[^\W\d_]{2,10}\.?,? +)?", r"[-/ ,]*"
YEAR_FIRST, YEAR_LAST = re.compile(FIRST + CLOCK, FLAGS), re.compile(LAST + CLOCK, FLAGS)
YEAR_LAST_SHORT = re.compile(LAST + SHORT_CLOCK, FLAGS)
NAMED_MONTH = tuple(
    re.compile(WEEKDAY + form, re.IGNORECASE)
    for form in (
        rf"{DAY}{GAP}{NAME}{GAP}{YEAR}[T ,:_-] *{CLOCK}",  # 02-Sep-2021 09:37:00.100, Thu, 2 Sep 2021 09:37:00 GMT
        rf"{NAME}{GAP}{DAY}[-/ ,]+(?P<year>\d{{4}})[T ,:_-] *{CLOCK}",  # September 2, 2021 09:37:00
        rf"{NAME} +{DAY} +{CLOCK} +(?P<year>\d{{4}})",  # Thu Sep 02 09:37:00 GMT+02:00 2021
        rf"(?P<year>\d{{4}}){GAP}{NAME}{GAP}{DAY}[T ,:_-] *{CLOCK}",  # 2021-Sep-02 09:37:00
    )
)
PATTERNS = (YEAR_FIRST, YEAR_LAST, YEAR_LAST_SHORT, *NAMED_MONTH)
MONTHS = (
    ("jan", "gen", "ene"), ("feb", "fev"), ("mar", "mrz", "maer"), ("apr", "avr", "abr"), ("may", "mai", "mag", "maj", "mei"),
    ("jun", "juin", "giu"), ("jul", "juil", "lug"), ("aug", "aou", "ago"), ("sep", "set"), ("oct", "okt", "ott", "out"), ("nov",),
    ("dec", "dez", "dic", "des"),
)  # fmt: skip
"""How the names of the months begin in European languages, without accents."""
UNIX_DAY = date(1970, 1, 1).toordinal()
MOST_S = 2**63 // SECOND_NS - 1
"""Years that fit in 64 bits as nanoseconds: from 1678 to 2262."""
MOST_MONTHS = 12
MOST_SECONDS = 60
"""A leap second has this number."""
CENTURY = 69
"""Of a year with two digits, the last one of this century, as POSIX has it."""

Order = Literal["dmy", "mdy", ""]


def _match(text: str) -> re.Match[str] | None:
    """The date and time in a cell."""
    return next((match for pattern in PATTERNS if (match := pattern.fullmatch(text)) and _is_month(match)), None)


def _is_month(match: re.Match[str]) -> bool:
    return "name" not in match.re.groupindex or bool(_month_of(match["name"]))


@lru_cache(maxsize=64)
def _month_of(name: str) -> int:
    """Number of a month by its name in any case, with accents or without; 0 for another word."""
    decomposed_text = unicodedata.normalize("NFD", name.lower())
    plain_text = "".join(char for char in decomposed_text if not unicodedata.combining(char))
    return next((number for number, beginnings in enumerate(MONTHS, 1) if plain_text.startswith(beginnings)), 0)


def is_date_time(text: str) -> bool:
    """Whether a cell holds a date with a time."""
    return _match(text.strip()) is not None


class DateTimes:
    """The dates and times of one column, all in the notation of the first one.

    `first`: the first cell; `is_date_time` is true for it; `order`: of day and month if the year comes last and the topics file
    names it. With dots the day comes first.
    """

    kind = np.int64

    def __init__(self, first_text: str, order: Order = "") -> None:
        match = _match(first_text.strip())
        assert match
        self._pattern = match.re
        self._mark = match.groupdict().get("mark", "")
        self._has_zone = bool(match.groupdict().get("zone"))
        self._order: Order = order or ("dmy" if self._mark == "." else "")
        self._first_text = first_text.strip()
        self._order_examples: dict[Order, str] = {}

    @property
    def is_open(self) -> bool:
        """Whether the other cells have to show which is the day and which the month."""
        return self._pattern in (YEAR_LAST, YEAR_LAST_SHORT) and not self._order

    def see(self, cells: Iterable[str]) -> None:
        """Look for a day above 12 in some more cells."""
        for text in cells if self.is_open else ():
            if match := self._pattern.fullmatch(text.strip()):
                if int(match["one"]) > MOST_MONTHS:
                    self._order_examples.setdefault("dmy", text)
                if int(match["two"]) > MOST_MONTHS:
                    self._order_examples.setdefault("mdy", text)

    def decide(self, table: str, name: str) -> None:
        """Settle the order of day and month from the cells so far.

        `table`, `name`: of the column, for messages. Raises InputError if the column does not show it, or shows both.
        """
        if not self.is_open:
            return
        if len(self._order_examples) > 1:
            raise InputError(
                f"{table}: {name}", " and ".join(self._order_examples.values()), "dates in one order of day and month"
            )
        if not self._order_examples:
            line = in_a_line({"column": name, "order": "dmy"})
            remedy = f"give the order in a topics file: time: {line}, or mdy; or write dates as 2026-11-23"
            given = f"{self._first_text}: the order of day and month is ambiguous in the whole column"
            raise InputError(f"{table}: {name}", given, "at least one date with a day above 12", remedy)
        self._order = next(iter(self._order_examples))

    def value(self, text: str, where: str = "") -> int:
        """Time since 1970 in UTC [ns]; digits below a nanosecond are cut off.

        Raises InputError with its place for another notation than that of the first cell, or an invalid date or time.
        """
        try:
            match = self._pattern.fullmatch(text.strip())
            if match is None:
                raise ValueError(text)
            groups = match.groupdict()
            if groups.get("mark", "") != self._mark or bool(groups.get("zone")) is not self._has_zone:
                raise ValueError(text)
            if "name" in groups:
                month, day = str(_month_of(groups["name"])), groups["day"]
            elif "one" in groups:
                month, day = (groups["two"], groups["one"]) if self._order == "dmy" else (groups["one"], groups["two"])
            else:
                month, day = groups["month"], groups["day"]
            seconds = _day_s(groups["year"], month, day) + _clock_s(groups) - _zone_s(groups.get("zone"))
            if abs(seconds) > MOST_S:
                raise ValueError(text)
            return seconds * SECOND_NS + int((groups.get("part") or "0")[:9].ljust(9, "0"))
        except ValueError:
            raise InputError(where, text, f"an existing date and time, as in the other rows ({self.text})") from None

    @property
    def text(self) -> str:
        """How the column was read, for people."""
        if self._pattern is YEAR_FIRST:
            form = f"yyyy{self._mark}mm{self._mark}dd hh:mm:ss" if self._mark in ("/", ".") else "ISO 8601"
        elif self._pattern in NAMED_MONTH:
            form = "dates with the name of the month"
        else:
            form = f"{self._mark.join(('dd', 'mm') if self._order == 'dmy' else ('mm', 'dd'))}{self._mark}yyyy hh:mm:ss"
        return f"{form}, {'with a time zone' if self._has_zone else NO_ZONE}"


NO_ZONE = "without a time zone: treated as UTC"


@lru_cache(maxsize=64)
def _day_s(year: str, month: str, day: str) -> int:
    full_year = int(year) if len(year) > 2 else int(year) + (2000 if int(year) < CENTURY else 1900)
    return (date(full_year, int(month), int(day)).toordinal() - UNIX_DAY) * 86400


def _clock_s(groups: dict[str, str | None]) -> int:
    """Whole seconds of a clock of the day. Raises ValueError for an hour, minute or second that none has."""
    hour, minute, second = int(groups["hour"] or 0), int(groups["minute"] or 0), int(groups.get("second") or 0)
    hour = _hour_of_half(hour, groups.get("half") or "")
    if hour > 23 or minute > 59 or second > MOST_SECONDS:
        raise ValueError(hour)
    return 3600 * hour + 60 * minute + second


def _hour_of_half(hour: int, half: str) -> int:
    """The hour of a day by that of its half, AM or PM; without a half as it is. Raises ValueError for one above 12, or 0."""
    if not half:
        return hour
    if not 1 <= hour <= 12:
        raise ValueError(hour)
    return hour % 12 + 12 * (half[0] in "pP")


@lru_cache(maxsize=64)
def _zone_s(zone: str | None) -> int:
    """Seconds by which a zone is ahead of UTC."""
    offset_text = re.sub("UTC|GMT|Z", "", zone or "", flags=re.IGNORECASE)
    if not offset_text:
        return 0
    digits = offset_text[1:].replace(":", "").ljust(4, "0")
    hours, minutes = int(digits[:2]), int(digits[2:])
    if hours > 23 or minutes > 59:
        raise ValueError(zone)
    return (3600 * hours + 60 * minutes) * (-1 if offset_text[0] == "-" else 1)


# --- a clock without a date

DAY_CLOCK = re.compile(rf"(?P<hour>\d{{1,3}}):(?P<minute>\d\d):(?P<second>\d\d){PART}", FLAGS)
MINUTES = re.compile(r"(?P<minute>\d{1,3}):(?P<second>\d\d)[.,](?P<part>\d+)", FLAGS)
"""A clock as spreadsheets show it: 37:00.1. Without a fraction it may be hours and minutes."""


def is_clock(text: str) -> bool:
    """Whether a cell holds a clock or a stopwatch without a date."""
    return bool(DAY_CLOCK.fullmatch(text.strip()) or MINUTES.fullmatch(text.strip()))


class ClockTimes:
    """The times of a column without dates [s]: hh:mm:ss.fff, also above 24 hours, or mm:ss.fff; all as the first one."""

    kind, is_open = np.float64, False

    def __init__(self, first_text: str) -> None:
        self._pattern = DAY_CLOCK if DAY_CLOCK.fullmatch(first_text.strip()) else MINUTES

    def value(self, text: str, where: str = "") -> float:
        """The time in a cell [s]. Raises InputError with its place for another notation."""
        with suppress(ValueError):
            if match := self._pattern.fullmatch(text.strip()):
                groups = {"hour": "0", "half": "", **match.groupdict()}
                hour, minute, second = (int(groups[key]) for key in ("hour", "minute", "second"))
                if second > MOST_SECONDS or (minute > 59 and self._pattern is DAY_CLOCK):
                    raise ValueError(text)
                if groups["half"]:
                    hour = _hour_of_half(hour, groups["half"])
                return 3600 * hour + 60 * minute + second + float(f"0.{groups['part'] or 0}")
        raise InputError(where, text, f"a time as in the other rows ({self.text})")

    @property
    def text(self) -> str:
        """How the column was read, for people."""
        return f"{'hh:mm:ss' if self._pattern is DAY_CLOCK else 'mm:ss'} without a date"


TextTimes = DateTimes | ClockTimes


def times_of(first_text: str, order: Order = "") -> TextTimes | None:
    """The notation of a column of times by its first cell; None if it holds none. `order`: see `DateTimes`."""
    if is_date_time(first_text):
        return DateTimes(first_text, order)
    return ClockTimes(first_text) if is_clock(first_text) else None
