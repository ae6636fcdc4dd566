# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Numbers the functions of effects, by which the step calls them: its table of effects has these numbers.

Those of the package are part of the compiled kernels. One of a user's has its address as its number: of C if it can be compiled
here, see `own_code`, else of a function that runs it in plain Python.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from functools import cache
from inspect import unwrap
from types import CodeType, FunctionType
from typing import Any

from trackres_ros.arrays import Array
from trackres_ros.effects.effect import ANSWERS, FACTS, LOOKED_AT, Conditions, Effect, Lag, VehicleConstants, values_type
from trackres_ros.effects.own_code import address_of

C_FUNCTION = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)

Function = tuple[type[Effect], str, tuple[str, ...]]
"""A function of an effect: its class, `terms` or `lag`, and the names of the parameters."""


def call_at(number: int, looked_at: Array, values: Array, answer: Array) -> None:
    """Call an effect's function by its number; compiled code does so without leaving itself."""
    if number <= len(shipped()):
        _in_python(int(number))(looked_at, values, answer)
    else:
        C_FUNCTION(int(number))(looked_at.ctypes.data, values.ctypes.data, answer.ctypes.data)


@cache
def shipped() -> dict[Function, int]:
    """The functions of all effects of the package, with their numbers from 1."""
    from trackres_ros.effects.learned import examples
    from trackres_ros.effects.registry import catalogue

    found: dict[Function, int] = {}
    for effect in (*catalogue().values(), *examples()):
        for method in methods_of(effect):
            found.setdefault(function_of(effect, method), len(found) + 1)
    return found


def methods_of(effect: Effect) -> tuple[str, ...]:
    """Names of the functions that an effect has."""
    return ("terms", "lag") if effect.has_lag else ("terms",)


def numbers_of(effect: Effect) -> tuple[int, int]:
    """Numbers of an effect's `terms` and `lag`, 0 without one."""
    return number_of(effect, "terms"), number_of(effect, "lag") if effect.has_lag else 0


def number_of(effect: Effect, method: str, compiled: bool = True) -> int:
    """The number of a function; of a user's effect in C, if allowed and possible, or in plain Python."""
    known = shipped().get(function_of(effect, method))
    if known is not None:
        return known
    found = address_of(*function_of(effect, method)) if compiled else None
    return found or ctypes.cast(_callback(effect, method), ctypes.c_void_p).value or 0


def is_compiled(effect: Effect) -> bool:
    """Whether the compiled step calls C for an effect, not plain Python."""
    functions = [function_of(effect, method) for method in methods_of(effect)]
    return all(one in shipped() or address_of(*one) is not None for one in functions)


def reads_drag_area(effect: Effect) -> bool:
    """Whether an effect's `terms`, or a function of its file that it calls, reads the vehicle's drag area."""
    terms = unwrap(type(effect).terms)
    codes = [terms.__code__] if isinstance(terms, FunctionType) else []
    for code in codes:  # it grows
        called = (terms.__globals__.get(name) for name in code.co_names)
        inner = (getattr(one, "__code__", None) for one in called)
        codes += [one for one in (*inner, *code.co_consts) if isinstance(one, CodeType) and one not in codes]
    return any("drag_area" in code.co_names for code in codes)


def function_of(effect: Effect, method: str) -> Function:
    """A function of an effect."""
    return type(effect), method, tuple(q.name for q in effect.parameters)


@cache
def _in_python(number: int) -> Callable[[Array, Array, Array], None]:
    """A function of the package in plain Python."""
    kind, method, names = list(shipped())[number - 1]
    run, answered = getattr(kind, method), ANSWERS[method]

    def call(looked_at: Array, values: Array, answer: Array) -> None:
        known = looked_at[:LOOKED_AT].tolist()
        at = Conditions(VehicleConstants(*known[:FACTS]), *known[FACTS:])
        answer[:answered] = run(None, at, values_type(names)(*values[: len(names)].tolist()))

    return call


@cache
def _callback(effect: Effect, method: str) -> Any:
    """An effect's method in plain Python as a machine function. It is kept: its address may be in any table."""
    count, answered = len(effect.parameters), ANSWERS[method]
    given, wanted, out = (ctypes.c_double * n for n in (LOOKED_AT, count, answered))

    def call(looked_at_: int, values_: int, answer_: int) -> None:
        try:
            known, values = given.from_address(looked_at_)[:], wanted.from_address(values_)[:]
            answer = effect.run(method, Conditions(VehicleConstants(*known[:FACTS]), *known[FACTS:]), values)
            if answer is None:  # no own state after all
                answer = Lag(0.0, 1.0, 0.0)
            out.from_address(answer_)[:] = [float(x) for x in answer]
        except Exception:  # of any kind, as the code is not ours
            out.from_address(answer_)[:] = [math.nan] * answered

    return C_FUNCTION(call)
