# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Marks the kernels: functions in restricted Python, which are translated to C when the package is built.

What Python calls runs as that C where it was built of these very sources, else as plain Python, with the same bits. The
environment variable TRACKRES_INTERPRETED=1 leaves the C out, which the tests use to show it.
"""

from __future__ import annotations

from collections.abc import Callable
from types import FunctionType
from typing import Any, Generic, TypeVar, cast

from trackres_ros.kernels.machine import MACHINE

Function = TypeVar("Function", bound=Callable[..., Any])
Record = TypeVar("Record")

ENTRIES: dict[str, FunctionType] = {}
"""By their names in C, the kernels that Python calls."""
COMPILED = MACHINE is not None
"""Whether they run as C."""


def kernel(function: Function) -> Function:
    """A function that kernels call. From Python it runs as Python."""
    return function


def entry(function: Function) -> Function:
    """A kernel that Python calls. No kernel calls it: in plain Python it would be C again."""
    name = function.__name__.strip("_")
    if name in ENTRIES and ENTRIES[name].__module__ != function.__module__:
        raise TypeError(f"{name}: two entries have this name")
    ENTRIES[name] = cast(FunctionType, function)
    return function if MACHINE is None else cast(Function, getattr(MACHINE, name))


class Bound(Generic[Record]):
    """A record for many calls of entries: `given` has its arrays found once. A copy is bound to the arrays of its own record."""

    __slots__ = ("given", "record")

    def __init__(self, record: Record, compiled: bool = COMPILED) -> None:
        self.record = self.given = record
        if compiled:
            self.given = getattr(MACHINE, f"bind_{record_name(type(record))}")(record)

    def __reduce__(self) -> tuple[object, ...]:
        """Copied or in another process it is bound anew."""
        return Bound, (self.record,)


def record_name(kind: type) -> str:
    """The name of a record in C: `VehicleConstants` as `vehicle_constants`."""
    return "".join(f"_{letter.lower()}" if letter.isupper() else letter for letter in kind.__name__).strip("_")
