# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Marks the kernels: functions in restricted Python, which are translated to C when the package is built.

What Python calls runs as that C where it was built of these very sources, else as plain Python, with the same bits. The
environment variable TRACKRES_INTERPRETED=1 leaves the C out, which the tests use to show it.

Python computes `x ** 2` by the C library's `pow` and has its own `hypot`; compiled code multiplies, and uses the C library's.
So kernels call `squared` and `length`, which give the same bits in both.
"""

from __future__ import annotations

import hashlib
import logging
import math
import os
from collections.abc import Callable
from functools import cache
from importlib import import_module
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, Generic, TypeVar, cast

# Compiled kernels

ROOMS = ("model", "estimator", "effects", "kernels", "route", "diagnosis/prepare", "diagnosis/base", "diagnosis/empirical")
FILES = ("units.py",)
"""Sources of compiled code, and of constants, which become part of it."""
NAME = "trackres_ros.kernels.built"
SLOWER = 100  # times that a step in plain Python takes longer, at least: 450 us against 1.5 us of `Session.handle`
BUILD = "tools/kernels"

_log = logging.getLogger("trackres")


@cache
def sources_digest() -> str:
    """Digest of every source file that compiled code can come from."""
    package = Path(__file__).parents[1]
    digest = hashlib.sha256()
    paths = [Path(folder, name) for room in ROOMS for folder, _, names in os.walk(package / room) for name in names]
    for path in (*sorted(path for path in paths if path.suffix in (".py", ".c")), *(package / file for file in FILES)):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:32]


def interpreted() -> bool:
    """Whether plain Python is requested."""
    return bool(os.environ.get("TRACKRES_INTERPRETED"))


def _loaded() -> ModuleType | None:
    if interpreted():
        return None
    try:
        module = import_module(NAME)
    except ImportError as error:
        is_missing = error.name == NAME
        reason = (
            "they were not compiled when the package was built: a C compiler or Python.h was missing"
            if is_missing
            else str(error)
        )
        module = None
    else:
        assert module is not None
        if sources_digest() == module.SOURCES:
            return module
        reason = f"their sources have changed since they were compiled; in a checkout run {BUILD}"
    _log.warning("trackres: the kernels run in plain Python, a step about %d times slower, as %s", SLOWER, reason)
    return None


MACHINE = _loaded()
"""The module of compiled kernels; None in plain Python."""


# Marks

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


# Arithmetic


@kernel
def squared(x: float) -> float:
    """X times x."""
    return x * x


@kernel
def length(x: float, y: float) -> float:
    """Length of a vector, for components whose squares neither overflow nor vanish."""
    return math.sqrt(x * x + y * y)
