# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which value of a vehicle file somebody means, and which values it is to have."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from trackres_ros.errors import InputError, nearest
from trackres_ros.vehicle import Vehicle

USUAL_COUNT, MOST_COUNT = 9, 1000


@dataclass(frozen=True, slots=True)
class Varied:
    """A value of a vehicle file by its path, its unit, and what it is to be."""

    path: str
    unit: str
    values: tuple[float, ...]


def scalars(vehicle: Vehicle) -> list[str]:
    """Paths of all single values of a vehicle."""
    return [path for path, quantity in vehicle.parameters.items() if isinstance(quantity.value, float)]


def meant(vehicle: Vehicle, given: str, where: str) -> str:
    """The path that somebody means: all of it, or enough of its words in their order, as belt.thickness.

    Raises
    ------
    InputError
        If it is none, or several.
    """
    known = scalars(vehicle)
    if given in known:
        return given
    words = [_stem(word) for word in re.split(r"[._]", given) if word]
    found = [path for path in known if words and _in_order(words, [_stem(word) for word in re.split(r"[._]", path)])]
    if len(found) == 1:
        return found[0]
    if found:
        raise InputError(where, given, f"one of {', '.join(found)}")
    names = [short(path, known) for path in known]
    guess = nearest(given, known) or nearest(given, names)
    raise InputError(where, given, f"a value of {vehicle.name} by its path or its last words: {', '.join(names)}", guess)


def _stem(word: str) -> str:
    return word.lower().removesuffix("s")


def _in_order(words: Sequence[str], of: Sequence[str]) -> bool:
    rest = iter(of)
    return all(any(word == there for there in rest) for word in words)


def varied(vehicle: Vehicle, given: str, where: str = "--vary") -> Varied:
    """What `PATH=A:B:N`, `PATH=A:B`, `PATH=A,B,C` and `PATH` say; the last takes the range of the file.

    Raises
    ------
    InputError
        If it says something else.
    """
    name, equals, values = given.partition("=")
    path = meant(vehicle, name.strip(), where)
    quantity = vehicle.parameters[path]
    if not equals:
        return Varied(path, quantity.unit, _between(quantity.low, quantity.high, USUAL_COUNT))
    allowed = "PATH=A:B:N, PATH=A:B or PATH=A,B,C with finite numbers and N from 2 to 1000, or PATH alone for the file's range"
    try:
        if ":" in values:
            low, high, *more = values.split(":")
            (count,) = map(int, more or [str(USUAL_COUNT)])
            if not 2 <= count <= MOST_COUNT:
                raise ValueError
            found = _between(float(low), float(high), count)
        else:
            found = tuple(float(one) for one in values.split(","))
        if not all(map(math.isfinite, found)):
            raise ValueError
    except ValueError:
        raise InputError(where, given, allowed) from None
    return Varied(path, quantity.unit, found)


def _between(low: float, high: float, count: int) -> tuple[float, ...]:
    return tuple(float(f"{low + i * (high - low) / (count - 1):.10g}") for i in range(count))


def short(path: str, beside: Sequence[str] = ()) -> str:
    """The last two words of a path, or more where these do not tell it from those beside it."""
    parts = path.split(".")
    for count in range(2, len(parts)):
        name = ".".join(parts[-count:])
        if not any(other != path and other.endswith(name) for other in beside):
            return name
    return path
