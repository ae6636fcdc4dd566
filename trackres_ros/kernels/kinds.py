# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The kinds of value that a translated function works with, how C writes each, and those of an entry's parameters."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import Enum, auto
from types import FunctionType
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import numpy as np

from trackres_ros.kernels.marks import record_name

# Kinds

FAILED = "tr_failed"
"""In C: where a function notes that Python would have raised an error."""
OF_ONE_NUMBER = (
    "sqrt", "exp", "expm1", "log", "log1p", "log2", "log10", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh",
    "asinh", "acosh", "atanh", "erf", "erfc", "fabs", "cbrt",
)  # fmt: skip
OF_TWO_NUMBERS = ("hypot", "atan2", "pow", "fmod", "copysign")
SAME_IN_C = {**dict.fromkeys(OF_ONE_NUMBER, 1), **dict.fromkeys(OF_TWO_NUMBERS, 2)}
"""Functions of `math` with the same name in C, all of real numbers, and how many these are."""
TO_WHOLE = ("floor", "ceil")
ASKED = ("isnan", "isfinite", "isinf")
MOST_OF_INT = 2**31 - 1
LARGEST_WHOLE = 9.2e18  # inside of 64 bits
NOT_FOR_NAMES = frozenset((
    "auto", "bool", "break", "case", "char", "const", "continue", "default", "do", "double", "else", "enum", "extern", "false",
    "float", "for", "goto", "if", "inline", "int", "long", "register", "restrict", "return", "short", "signed", "sizeof",
    "static", "struct", "switch", "true", "typedef", "union", "unsigned", "void", "volatile", "while",
    "NAN", "INFINITY", *ASKED, *(f"{name}{single}" for name in (*SAME_IN_C, *TO_WHOLE) for single in ("", "f")),
))  # fmt: skip


@dataclass(frozen=True, slots=True)
class Scalar:
    """A number or a truth value, by its name in C."""

    name: str


REAL, INT, BOOL = Scalar("double"), Scalar("int64_t"), Scalar("bool")
WIDE = Scalar("sum")
"""A number that sums small increments up: `double` where others are `float`, in its array and in functions that read it there."""
REALS = (REAL, WIDE)
WIDTHS = {BOOL: 0, INT: 1, REAL: 2, WIDE: 3}


class AtRunTime(Enum):
    """A length that is known when the code runs: the array brings it along."""

    LENGTH = auto()


LENGTH = AtRunTime.LENGTH
Length = int | AtRunTime | None


@dataclass(frozen=True, slots=True)
class ArrayOf:
    """Numbers in C order: a pointer, or a struct of a pointer and those lengths that are known at run time only. A length is None
    if unknown; `names` are those of entries, if any.
    """

    element: Scalar
    shape: tuple[Length, ...]
    names: tuple[str, ...] = ()

    @property
    def lengths(self) -> int:
        """How many lengths it brings along."""
        return self.shape.count(LENGTH)

    def place_of(self, axis: int) -> str:
        """The name in its struct of a length that it brings along."""
        return f"n{self.shape[:axis].count(LENGTH)}"


@dataclass(frozen=True, slots=True)
class Record:
    """A tuple, named or not: a struct of its parts without constants."""

    name: str
    fields: tuple[tuple[str, Kind], ...]

    def kind_of(self, name: str) -> Kind | None:
        """Kind of a part; None for an unknown name."""
        return dict(self.fields).get(name)

    def stored_fields(self) -> Iterator[tuple[str, Kind]]:
        """The parts in the struct."""
        return ((name, kind) for name, kind in self.fields if not isinstance(kind, Const))


@dataclass(frozen=True, slots=True, eq=False)
class Const:
    """A value known at translation; arrays, functions and modules are compared by identity."""

    value: Any
    key: Any = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "key", _key(self.value))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Const) and self.key == other.key

    def __hash__(self) -> int:
        return hash(self.key)


Kind = Scalar | ArrayOf | Record | Const


def _key(value: Any) -> Any:
    if isinstance(value, bool | int | float):
        return type(value).__name__, repr(value)
    if isinstance(value, tuple):
        return (type(value).__name__, *map(_key, value))
    return id(value)


def record_of(value: tuple[Any, ...]) -> Record:
    """The record of a tuple: with the fields of a named one, else numbered."""
    fields = getattr(type(value), "_fields", tuple(f"f{i}" for i in range(len(value))))
    name = words(type(value).__name__) if hasattr(type(value), "_fields") else ""
    return Record(name, tuple(zip(fields, map(Const, value), strict=True)))


def words(name: str) -> str:
    """`VehicleConstants` as `vehicle_constants`."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()


def widen_kind(kind: Kind) -> Kind:
    """The kind of a variable that holds a value of this kind; the constant itself, if no variable can hold it."""
    if isinstance(kind, Record):
        return Record(kind.name, tuple((name, widen_kind(part)) for name, part in kind.fields))
    if not isinstance(kind, Const):
        return kind
    value = kind.value
    if isinstance(value, tuple):
        return widen_kind(record_of(value))
    for python, scalar in ((bool | np.bool_, BOOL), (int | np.integer, INT), (float | np.floating, REAL)):
        if isinstance(value, python):
            return scalar
    return kind


def narrow_kind(kind: Kind) -> Kind:
    """The kind of a number where it leaves its function: nothing but an array is wide there."""
    return REAL if kind == WIDE else kind


def join_kinds(kind: Kind | None, new_kind: Kind) -> Kind | None:
    """The common kind of a variable for both; None if C has none."""
    if kind is None or kind == new_kind:
        return new_kind
    kind, new_kind = widen_kind(kind), widen_kind(new_kind)
    if isinstance(kind, Scalar) and isinstance(new_kind, Scalar):
        return max(kind, new_kind, key=WIDTHS.__getitem__)
    if isinstance(kind, Record) and isinstance(new_kind, Record) and len(kind.fields) == len(new_kind.fields):
        parts = [join_kinds(a, b) for (_, a), (_, b) in zip(kind.fields, new_kind.fields, strict=True)]
        if None not in parts:
            names = [name for name, _ in kind.fields]
            return Record(kind.name or new_kind.name, tuple(zip(names, parts, strict=True)))  # type: ignore[arg-type]
    if (
        isinstance(kind, ArrayOf)
        and isinstance(new_kind, ArrayOf)
        and kind.element == new_kind.element
        and len(kind.shape) == len(new_kind.shape)
    ):
        return ArrayOf(kind.element, tuple(a if a == b else None for a, b in zip(kind.shape, new_kind.shape, strict=True)))
    return kind if kind == new_kind else None


def literal(value: Any, single: bool) -> str:
    """A constant number as C writes it."""
    if isinstance(value, bool | np.bool_):
        return "true" if value else "false"
    if isinstance(value, int | np.integer):
        integer = int(value)
        return f"INT64_C({integer})" if abs(integer) > MOST_OF_INT else str(integer)
    number = float(np.float32(value)) if single else float(value)
    if math.isnan(number):
        return "NAN"
    if math.isinf(number):
        return "INFINITY" if number > 0 else "-INFINITY"
    text = str(np.float32(number)) if single else repr(number)
    return (text if "e" in text or "." in text else f"{text}.0") + "f" * single


def safe_name(name: str) -> str:
    """A name that is no word of C, nor one of math.h or of the file itself."""
    return f"{name}_" if name.rstrip("_") in NOT_FOR_NAMES or name.lower().startswith("tr_") else name


# Signatures

SCALARS: dict[Any, Scalar] = {float: REAL, int: INT, bool: BOOL, np.float64: REAL, np.int64: INT, np.bool_: BOOL}


def kinds_of(function: FunctionType) -> list[Kind]:
    """The kinds of a function's parameters."""
    hints = get_type_hints(function, include_extras=True)
    names = function.__code__.co_varnames[: function.__code__.co_argcount]
    return [kind_of(hints[name]) for name in names]


def kind_of(hint: Any) -> Kind:
    """The kind of a type: numbers, arrays, named tuples and tuples.

    An array has one axis, and its length is known at run time. `Annotated[Array, (None, 4)]` has two axes, and four columns.
    """
    if hint in SCALARS:
        return SCALARS[hint]
    shape: tuple[int | None, ...] = (None,)
    if get_origin(hint) is Annotated:
        hint, shape = get_args(hint)
    if isinstance(hint, type) and hasattr(hint, "_fields"):
        fields = get_type_hints(hint, include_extras=True)
        return Record(record_name(hint), tuple((name, kind_of(field_hint)) for name, field_hint in fields.items()))
    if get_origin(hint) is tuple:
        return Record("", tuple((f"f{i}", kind_of(field_hint)) for i, field_hint in enumerate(get_args(hint))))
    if get_origin(hint) is np.ndarray:
        field_hint = get_args(get_args(hint)[1])[0]
        return ArrayOf(SCALARS[field_hint], tuple(LENGTH if length is None else length for length in shape))
    raise TypeError(f"{hint} is no type of a kernel's parameter")
