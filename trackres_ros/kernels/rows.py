# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Names the numbers of an array: `Motion(motion).last_speed` is an entry of `motion`, to read and to change.

In C a name is an index, so it costs nothing. The array keeps its layout.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, overload

from numpy.typing import NDArray

from trackres_ros.arrays import Array


class Real:
    """A real number of a row; on the class, its index in the array. `Row` replaces the declaration by a property."""

    shape: tuple[int, ...] = ()

    @overload
    def __get__(self, row: None, owner: type[Row]) -> int: ...
    @overload
    def __get__(self, row: Row, owner: type[Row]) -> float: ...
    def __get__(self, row: Row | None, owner: type[Row]) -> Any:
        raise NotImplementedError

    def __set__(self, row: Row, value: float) -> None:
        raise NotImplementedError


class Whole:
    """An integer of a row, else as `Real`."""

    shape: tuple[int, ...] = ()

    def __get__(self, row: Row | None, owner: type[Row]) -> int:
        raise NotImplementedError

    def __set__(self, row: Row, value: int) -> None:
        raise NotImplementedError


class Reals:
    """Several real numbers of a row as an array; on the class, their slice."""

    def __init__(self, count: int) -> None:
        self.shape = (count,)

    @overload
    def __get__(self, row: None, owner: type[Row]) -> slice: ...
    @overload
    def __get__(self, row: Row, owner: type[Row]) -> Array: ...
    def __get__(self, row: Row | None, owner: type[Row]) -> Any:
        raise NotImplementedError


class _Places(type):
    """The metaclass of rows: it gives each row class its places as properties."""


class Row(metaclass=_Places):
    """Base class: a subclass declares the numbers in their order."""

    __slots__ = ("numbers",)
    columns: int
    names: tuple[str, ...]  # one per number: those of several are equal

    def __init__(self, numbers: NDArray[Any]) -> None:
        self.numbers = numbers

    def __init_subclass__(cls) -> None:
        fields = {name: field for name, field in vars(cls).items() if isinstance(field, Real | Whole | Reals)}
        cls.names = tuple(name for name, field in fields.items() for _ in range(math.prod(field.shape)))
        cls.columns = len(cls.names)
        places: dict[str, int | slice] = {}
        for name, field in fields.items():
            start = cls.names.index(name)
            places[name] = slice(start, start + field.shape[0]) if field.shape else start
            setattr(cls, name, _number(places[name]))
        # The class finds a property of its own class first: of the class, a name is a place.
        of_class = {name: property(_constant(place)) for name, place in places.items()}
        cls.__class__ = type("Places", (_Places,), of_class)  # type: ignore[method-assign]


def _constant(place: int | slice) -> Callable[[Any], int | slice]:
    return lambda _: place


def _number(place: int | slice) -> property:
    """The property of an index, which is a constant in the code: Python is a tenth faster so."""
    index, namespace = f"{place.start}:{place.stop}" if isinstance(place, slice) else place, dict[str, Any]()
    exec(f"def get(row):\n    return row.numbers[{index}]\ndef change(row, value):\n    row.numbers[{index}] = value", namespace)
    return property(namespace["get"], namespace["change"])
