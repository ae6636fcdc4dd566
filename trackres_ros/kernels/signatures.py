# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads the kinds of an entry's parameters from their types."""

from __future__ import annotations

from types import FunctionType
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import numpy as np

from trackres_ros.kernels.kinds import BOOL, INT, LENGTH, REAL, ArrayOf, Kind, Record, Scalar
from trackres_ros.kernels.marks import record_name

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
        return Record(record_name(hint), tuple((name, kind_of(of)) for name, of in fields.items()))
    if get_origin(hint) is tuple:
        return Record("", tuple((f"f{i}", kind_of(of)) for i, of in enumerate(get_args(hint))))
    if get_origin(hint) is np.ndarray:
        of = get_args(get_args(hint)[1])[0]
        return ArrayOf(SCALARS[of], tuple(LENGTH if length is None else length for length in shape))
    raise TypeError(f"{hint} is no type of a kernel's parameter")
