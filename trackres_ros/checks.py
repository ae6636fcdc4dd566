# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Checks input from outside. Each function returns the value, or raises `InputError` with its place, the given value and the
allowed ones.
"""

from __future__ import annotations

import numbers
import os
import re
from collections.abc import Iterable
from pathlib import Path

from trackres_ros.errors import InputError, nearest

LARGEST_SEED = 2**32 - 1
LARGEST = 1e300  # an integer may be larger than any float


def number(value: object, place: str, low: float, high: float, unit: str = "", if_outside: str = "") -> float:
    """A number from `low` to `high`; nan, true and false are refused. `if_outside`: the remedy for one out of the range."""
    allowed = f"a number from {low:g} to {high:g} {unit}".rstrip()
    value = _plain(value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(place, value, allowed)
    if not low <= value <= high:
        raise InputError(place, value, allowed, if_outside)
    return float(value)


def whole(value: object, place: str, low: int, high: int, unit: str = "") -> int:
    """An integer from `low` to `high`; 3.0 is accepted, 2.5, true and false are refused."""
    allowed = f"a whole number from {low} to {high} {unit}".rstrip()
    value = _plain(value)
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise InputError(place, value, allowed)
    return value


def finite(value: object, place: str) -> float:
    """A finite number; true and false are refused."""
    value = _plain(value)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < LARGEST:
        raise InputError(place, value, "a finite number")
    return float(value)


def positive(value: object, place: str) -> float:
    """A finite number above 0."""
    if not finite(value, place) > 0.0:
        raise InputError(place, value, "a positive number")
    return finite(value, place)


def text(value: object, place: str) -> str:
    """A text that is not empty."""
    if not isinstance(value, str) or not value.strip():
        raise InputError(place, value, "a text that is not empty")
    return value


def name(value: object, place: str, pattern: str, allowed: str) -> str:
    """A name of a form: a regular expression, and the same in words."""
    if not re.fullmatch(pattern, text(value, place)):
        raise InputError(place, value, allowed)
    return str(value)


def switch(value: object, place: str) -> bool:
    """True or false."""
    if not isinstance(value, bool):
        raise InputError(place, value, "true or false")
    return value


def _plain(value: object) -> object:
    """A number of numpy as one of Python; anything else as it is."""
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        return value
    return int(value) if isinstance(value, numbers.Integral) else float(value)


def path(value: object, place: str, allowed: str = "a path") -> Path:
    """A path, without a null character."""
    text = os.fspath(value) if isinstance(value, str | os.PathLike) else None
    if not isinstance(text, str) or "\0" in text:
        raise InputError(place, value, allowed)
    return Path(text)


def function(value: object, place: str) -> None:
    """Anything that can be called."""
    if not callable(value):
        raise InputError(place, value, "a function")


def seed(value: object) -> int:
    """The seed of random draws."""
    return whole(value, "seed", 0, LARGEST_SEED)


def span(value: object, place: str, low: float, high: float, unit: str = "") -> tuple[float, float]:
    """Two numbers in their order, ``[low, high]``, each as `number` takes it."""
    if not isinstance(value, list) or len(value) != 2:
        raise InputError(place, value, "two numbers, [low, high]")
    first, last = (number(bound, place, low, high, unit) for bound in value)
    if first > last:
        raise InputError(place, value, "[low, high] with low <= high")
    return first, last


def one_of(value: object, place: str, names: Iterable[str]) -> str:
    """One of some names; the error for another one suggests the nearest."""
    allowed = list(names)
    if not isinstance(value, str) or value not in allowed:
        raise InputError(place, value, f"one of {', '.join(allowed)}", nearest(str(value), allowed))
    return value


def each_of(value: object, place: str, names: Iterable[str]) -> tuple[str, ...]:
    """A list of some names."""
    allowed = list(names)
    if not isinstance(value, list | tuple) or any(name not in allowed for name in value):
        raise InputError(place, value, f"a list of {', '.join(allowed)}")
    return tuple(value)
