# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Makes entries into compiled code: from Python they take single arrays and numbers, inside they use named records.

A call from Python costs more for a named tuple than for its arrays one by one. For those of a message it doubles the
cost of the call (benchmarks/bench_ways.py).
"""

from __future__ import annotations

from collections.abc import Callable
from inspect import signature
from types import FunctionType
from typing import Any, cast, get_type_hints

from trackres_ros.jit.compiled import compiled


def entry(function: Callable[..., Any]) -> Callable[..., Any]:
    """An entry to a compiled function whose parameters are records: it takes the fields of each instead of the record.

    Parameters
    ----------
    function
        Compiled as `inlined`. For a parameter that is a `NamedTuple`, the entry takes its fields; for a field that is a
        `NamedTuple` itself, it takes an array of one numpy record with the same fields, or a list with it.
    """
    python = cast(FunctionType, getattr(function, "py_func", function))
    known: dict[str, Any] = {"inner": function}
    parameters: list[str] = []
    given: list[str] = []
    kinds = get_type_hints(python)
    for name in signature(python).parameters:
        kind = kinds[name]
        if not _is_record(kind):
            parameters.append(name)
            given.append(name)
            continue
        known[kind.__name__] = kind
        fields = {f"{name}_{field}": "[0]" * _is_record(inside) for field, inside in get_type_hints(kind).items()}
        parameters += fields
        given.append(f"{kind.__name__}({', '.join(field + only for field, only in fields.items())})")
    exec(f"def entry({', '.join(parameters)}):\n    return inner({', '.join(given)})", known)
    made = cast(FunctionType, known["entry"])
    made.__module__, made.__qualname__, made.__doc__ = python.__module__, f"{python.__qualname__}.entry", python.__doc__
    return compiled(made)


def _is_record(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, tuple) and hasattr(kind, "_fields")
