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


def number(given: object, where: str, low: float, high: float, unit: str = "", if_outside: str = "") -> float:
    """A number from `low` to `high`; nan, true and false are refused. `if_outside`: the remedy for one out of the range."""
    allowed = f"a number from {low:g} to {high:g} {unit}".rstrip()
    given = _plain(given)
    if isinstance(given, bool) or not isinstance(given, int | float):
        raise InputError(where, given, allowed)
    if not low <= given <= high:
        raise InputError(where, given, allowed, if_outside)
    return float(given)


def whole(given: object, where: str, low: int, high: int, unit: str = "") -> int:
    """An integer from `low` to `high`; 3.0 is accepted, 2.5, true and false are refused."""
    allowed = f"a whole number from {low} to {high} {unit}".rstrip()
    given = _plain(given)
    if isinstance(given, float) and given.is_integer():
        given = int(given)
    if isinstance(given, bool) or not isinstance(given, int) or not low <= given <= high:
        raise InputError(where, given, allowed)
    return given


def finite(given: object, where: str) -> float:
    """A finite number; true and false are refused."""
    given = _plain(given)
    if isinstance(given, bool) or not isinstance(given, int | float) or not abs(given) < LARGEST:
        raise InputError(where, given, "a finite number")
    return float(given)


def positive(given: object, where: str) -> float:
    """A finite number above 0."""
    if not finite(given, where) > 0.0:
        raise InputError(where, given, "a positive number")
    return finite(given, where)


def text(given: object, where: str) -> str:
    """A text that is not empty."""
    if not isinstance(given, str) or not given.strip():
        raise InputError(where, given, "a text that is not empty")
    return given


def name(given: object, where: str, pattern: str, allowed: str) -> str:
    """A name of a form: a regular expression, and the same in words."""
    if not re.fullmatch(pattern, text(given, where)):
        raise InputError(where, given, allowed)
    return str(given)


def switch(given: object, where: str) -> bool:
    """True or false."""
    if not isinstance(given, bool):
        raise InputError(where, given, "true or false")
    return given


def _plain(given: object) -> object:
    """A number of numpy as one of Python; anything else as it is."""
    if isinstance(given, bool) or not isinstance(given, numbers.Real):
        return given
    return int(given) if isinstance(given, numbers.Integral) else float(given)


def path(given: object, where: str, allowed: str = "a path") -> Path:
    """A path, without a null character."""
    text = os.fspath(given) if isinstance(given, str | os.PathLike) else None
    if not isinstance(text, str) or "\0" in text:
        raise InputError(where, given, allowed)
    return Path(text)


def function(given: object, where: str) -> None:
    """Anything that can be called."""
    if not callable(given):
        raise InputError(where, given, "a function")


def seed(given: object) -> int:
    """The seed of random draws."""
    return whole(given, "seed", 0, LARGEST_SEED)


def span(given: object, where: str, low: float, high: float, unit: str = "") -> tuple[float, float]:
    """Two numbers in their order, ``[low, high]``, each as `number` takes it."""
    if not isinstance(given, list) or len(given) != 2:
        raise InputError(where, given, "two numbers, [low, high]")
    first, last = (number(bound, where, low, high, unit) for bound in given)
    if first > last:
        raise InputError(where, given, "[low, high] with low <= high")
    return first, last


def one_of(given: object, where: str, names: Iterable[str]) -> str:
    """One of some names; the error for another one suggests the nearest."""
    allowed = list(names)
    if not isinstance(given, str) or given not in allowed:
        raise InputError(where, given, f"one of {', '.join(allowed)}", nearest(str(given), allowed))
    return given


def each_of(given: object, where: str, names: Iterable[str]) -> tuple[str, ...]:
    """A list of some names."""
    allowed = list(names)
    if not isinstance(given, list | tuple) or any(name not in allowed for name in given):
        raise InputError(where, given, f"a list of {', '.join(allowed)}")
    return tuple(given)
