# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Finds the column of the times in a table, by its name, its unit and its first cells."""

import re
from collections.abc import Sequence
from contextlib import suppress
from datetime import datetime, time, timedelta
from typing import Any, NamedTuple

import numpy as np

from trackres_ros.errors import InputError
from trackres_ros.recording.text_table import MARKS, number_of
from trackres_ros.recording.text_times import times_of
from trackres_ros.text import words

TIME_WORDS = re.compile(
    r"time|datenum|stamp|\b(t|date|clock|elapsed|utc)\b|zeit|\bdatum\b|\b(temps|heure|horodatage|tiempo|hora|fecha|tempo|ora|tijd|tid|czas)\b"
)
"""Words in the name of a column of times."""
DAY_S = 86400.0


class Epoch(NamedTuple):
    """A unit of numbers that count from a known day: those of 1970 to 2100, and the longest step that shows the unit."""

    unit: str
    lowest: float
    highest: float
    longest_step: float


EPOCHS = (
    Epoch("datenum", 719529.0, 767011.0, 20.0 / DAY_S),
    Epoch("excel_days", 25569.0, 73051.0, 2.0 / DAY_S),
    *(Epoch(unit, 1e9 * factor, 4.1e9 * factor, np.inf) for unit, factor in (("s", 1.0), ("ms", 1e3), ("us", 1e6), ("ns", 1e9))),
)
"""Units that the numbers themselves show: days of MATLAB and of Excel, and times since 1970. As seconds, days would be steps of a
few hundredths of a millisecond."""

DAYS = ("datenum", "excel_days")


class SeenTimes(NamedTuple):
    """What the first cells of a column say: whether they are dates or clocks, the unit that numbers show, whether they rise, and
    the share of cells that differ from the one before.
    """

    is_text: bool
    unit: str
    rises: bool
    changes: float


def seen_times(cells: Sequence[Any]) -> SeenTimes:
    """The first cells of a column as times; nothing rises if they are none."""
    is_text = bool(cells) and (isinstance(cells[0], datetime | time | timedelta) or times_of(str(cells[0])) is not None)
    values = _values(cells, is_text)
    steps = np.diff(values)
    rises = len(values) > 0 and bool((steps >= 0.0).all() or (steps < 0.0).sum() <= 1) and (not len(steps) or bool(steps.any()))
    forward = steps[steps > 0.0]
    unit = ""
    if len(values) and not is_text:
        step = float(np.median(forward)) if len(forward) else np.inf
        fitting = (epoch.unit for epoch in EPOCHS if epoch.lowest <= values.min() and values.max() < epoch.highest)
        steps_of = {epoch.unit: epoch.longest_step for epoch in EPOCHS}
        unit = next((name for name in fitting if step <= steps_of[name]), "")
    return SeenTimes(is_text, unit, rises, len(forward) / len(steps) if len(steps) else 1.0)


def _values(cells: Sequence[Any], is_text: bool) -> np.ndarray:
    """Numbers of some cells that rise as the times do; none if a cell is no time."""
    if not is_text:
        numbers = [float(cell) if isinstance(cell, int | float) else _number(str(cell)) for cell in cells]
        return np.array([] if None in numbers else numbers, np.float64)
    if isinstance(cells[0], datetime):
        return np.array([cell.timestamp() for cell in cells if isinstance(cell, datetime)])
    if isinstance(cells[0], time | timedelta):
        return np.array([clock_s(cell) for cell in cells if isinstance(cell, time | timedelta)])
    notation = times_of(str(cells[0]), "dmy")
    assert notation is not None
    for times in (notation, times_of(str(cells[0]), "mdy")):
        with suppress(InputError):
            return np.array([times.value(str(cell)) for cell in cells if times], np.float64)
    return np.array([])


def _number(text: str) -> float | None:
    for mark, _ in MARKS:
        with suppress(InputError):
            return number_of(text, mark)
    return None


def clock_s(cell: time | timedelta) -> float:
    """A time of day or a duration of a spreadsheet [s]."""
    if isinstance(cell, timedelta):
        return cell.total_seconds()
    return 3600.0 * cell.hour + 60.0 * cell.minute + cell.second + 1e-6 * cell.microsecond


def is_named_as_time(name: str) -> bool:
    """Whether the name of a column says that it holds times."""
    return bool(TIME_WORDS.search(words(name)))
