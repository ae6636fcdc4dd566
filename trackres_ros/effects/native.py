# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Makes each effect a machine function of one signature, called by its address.

An effect is a Python file; the step that calls it is compiled once. A function that cannot be compiled, such as a user's, has an
address too, and runs in plain Python.
"""

from __future__ import annotations

import ctypes
import hashlib
import math
from collections.abc import Callable
from functools import cache
from importlib import import_module
from inspect import unwrap
from types import CodeType, FunctionType, ModuleType
from typing import Any, cast

import numpy as np

from trackres_ros.arrays import Array
from trackres_ros.effects.as_compiled import LARGEST_WHOLE
from trackres_ros.effects.effect import Conditions, Effect, Lag, Terms, VehicleConstants, values_type
from trackres_ros.jit.code_cache import CodeCache
from trackres_ros.jit.compiled import HAVE_NUMBA, code_folder, inlined, part

FACTS, ANSWERED = len(VehicleConstants._fields), len(Terms._fields)  # numbers that an effect looks at, and that it answers
LOOKED_AT = FACTS + len(Conditions._fields) - 1
ANSWERS = {"terms": ANSWERED, "lag": len(Lag._fields)}
CALL = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)


def call_at(address: int, looked_at: Array, values: Array, answer: Array) -> None:
    """Call the function at an address; compiled code does so without leaving itself."""
    CALL(int(address))(looked_at.ctypes.data, values.ctypes.data, answer.ctypes.data)


def native(effect: Effect, machine: bool = True) -> tuple[int, int]:
    """Addresses of an effect's `terms` and `lag`, 0 without one; of machine code, if allowed and possible."""
    return _address(effect, "terms", machine), _address(effect, "lag", machine) if effect.has_lag else 0


def is_compiled(effect: Effect) -> bool:
    """Whether the step calls machine code for an effect, not plain Python."""
    methods = ("terms", "lag") if effect.has_lag else ("terms",)
    return all(_machine_code(effect, method) is not None for method in methods)


def is_of_user(kind: type[Effect]) -> bool:
    """Whether an effect is of a file of the user's own, not of the catalogue."""
    return not kind.__module__.startswith(f"{__package__}.")


def reads_drag_area(effect: Effect) -> bool:
    """Whether an effect's `terms`, or a function of its file that it calls, reads the vehicle's drag area."""
    terms = unwrap(type(effect).terms)
    codes = [terms.__code__] if isinstance(terms, FunctionType) else []
    for code in codes:  # it grows
        called = (terms.__globals__.get(name) for name in code.co_names)
        inner = (getattr(getattr(one, "py_func", one), "__code__", None) for one in called)
        codes += [one for one in (*inner, *code.co_consts) if isinstance(one, CodeType) and one not in codes]
    return any("drag_area" in code.co_names for code in codes)


def _address(effect: Effect, method: str, machine: bool) -> int:
    code = _machine_code(effect, method) if machine else None
    if code is not None:
        return int(code.address)
    return ctypes.cast(_callback(effect, method), ctypes.c_void_p).value or 0


def _machine_code(effect: Effect, method: str) -> Any:
    """Machine code of an effect's method; None without numba, or if it cannot be compiled."""
    return _machine(type(effect), method, tuple(q.name for q in effect.parameters)) if HAVE_NUMBA else None


@cache
def _callback(effect: Effect, method: str) -> Any:
    """An effect's method in plain Python as a machine function. It is kept: its address may be in any table."""
    return CALL(_python_function(effect, method, ANSWERS[method]))


def _python_function(effect: Effect, method: str, answered: int) -> Callable[[int, int, int], None]:
    """An effect's method behind the signature of machine code; after a failure the result is nan."""
    run, pack, count = getattr(effect.in_python, method), effect.pack, len(effect.parameters)
    given, wanted, out = (ctypes.c_double * n for n in (LOOKED_AT, count, answered))

    def call(looked_at_: int, values_: int, answer_: int) -> None:
        try:
            known = given.from_address(looked_at_)[:]
            answer = run(Conditions(VehicleConstants(*known[:FACTS]), *known[FACTS:]), pack(*wanted.from_address(values_)))
            if answer is None:  # no own state after all
                answer = Lag(0.0, 1.0, 0.0)
            out.from_address(answer_)[:] = [float(x) for x in answer]
        except Exception:  # of any kind, as the code is not ours
            out.from_address(answer_)[:] = [math.nan] * answered

    return call


if HAVE_NUMBA:
    ir: Any = import_module("llvmlite.ir")
    numba: Any = import_module("numba")
    extending: Any = import_module("numba.extending")
    ccallback: Any = import_module("numba.core.ccallback")
    sigutils: Any = import_module("numba.core.sigutils")

    _POINTER = numba.types.CPointer(numba.types.float64)
    _SIGNATURE = sigutils.normalize_signature(numba.types.void(_POINTER, _POINTER, _POINTER))

    @extending.intrinsic  # type: ignore[untyped-decorator]
    def _call(typing: Any, address: Any, looked_at: Any, values: Any, answer: Any) -> Any:  # noqa: ARG001
        def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:  # noqa: ARG001
            pointer = ir.IntType(8).as_pointer()
            kind = ir.FunctionType(ir.VoidType(), [pointer] * 3)
            function = builder.inttoptr(given[0], kind.as_pointer())
            builder.call(function, [builder.inttoptr(each, pointer) for each in given[1:]])
            return context.get_dummy_value()

        return numba.types.void(address, looked_at, values, answer), generate

    @extending.overload(call_at)  # type: ignore[untyped-decorator]
    def _call_at(address: Any, looked_at: Any, values: Any, answer: Any) -> Any:  # noqa: ARG001
        def call(address: Any, looked_at: Any, values: Any, answer: Any) -> Any:
            _call(address, looked_at.ctypes.data, values.ctypes.data, answer.ctypes.data)

        return call

    def _terms_in_code() -> Any:
        """`Terms` with its defaults, which compiled code lacks."""
        given = ", ".join(f"{name}={default!r}" for name, default in Terms._field_defaults.items())
        namespace: dict[str, Any] = {"Terms": Terms}
        exec(f"def terms({given}):\n    return Terms({', '.join(f'float({name})' for name in Terms._fields)})", namespace)
        made = namespace["terms"]
        made.__module__ = __name__
        return inlined(made)

    _terms = _terms_in_code()

    def _whole(python: Any) -> Any:
        """A function of Python that gives whole numbers, with its error where there is none: compiled code has a number."""

        def whole(x: Any) -> Any:
            if not abs(x) < LARGEST_WHOLE:
                raise ValueError
            return python(x)

        return part(cast(FunctionType, whole))

    _WHOLE: dict[int, Any] = {id(python): _whole(python) for python in (int, round, math.floor, math.ceil, math.trunc)}
    _WHOLE[id(math)] = ModuleType("math")
    _WHOLE[id(math)].__dict__.update({name: _WHOLE.get(id(value), value) for name, value in vars(math).items()})

    def _with_errors(names: dict[str, Any]) -> dict[str, Any]:
        """Names of a user's file, with the functions that give whole numbers as `_whole`."""
        replaced = {name: _WHOLE.get(id(value), value) for name, value in names.items()}
        return {"int": _WHOLE[id(int)], "round": _WHOLE[id(round)], **replaced}

    @cache
    def _machine(kind: type[Effect], method: str, names: tuple[str, ...]) -> Any:
        """A method of an effect as a machine function; None if that is impossible, as for some users' effects."""
        try:
            return _compile(kind, method, names, ANSWERS[method])
        except Exception:
            if not is_of_user(kind):
                raise
            return None

    def _compile(kind: type[Effect], method: str, names: tuple[str, ...], answered: int) -> Any:
        python, by_user = getattr(kind, method), is_of_user(kind)
        known_names = _with_errors(python.__globals__) if by_user else python.__globals__
        of_file = FunctionType(python.__code__, {**known_names, "Terms": _terms}, python.__name__)
        of_file.__module__ = __name__  # that of a user's file cannot be imported when the code is read again
        inner = part(of_file, by_user)
        known = [f"x[{i}]" for i in range(LOOKED_AT)]
        lines = [
            f"at = Conditions(VehicleConstants({', '.join(known[:FACTS])}), {', '.join(known[FACTS:])})",
            f"found = run(None, at, pack({', '.join(f'p[{i}]' for i in range(len(names)))}))",
            *(f"out[{i}] = found[{i}]" for i in range(answered)),
        ]
        if by_user:
            lines = ["try:", *(f"    {line}" for line in lines), "except Exception:", "    out[0] = nan"]
        lines = ["def call(x, p, out):", *(f"    {line}" for line in lines)]
        namespace: dict[str, Any] = {"Conditions": Conditions, "run": inner, "nan": math.nan}
        namespace["VehicleConstants"] = VehicleConstants
        namespace["pack"] = values_type(names)
        exec("\n".join(lines), namespace)
        function = cast(FunctionType, namespace["call"])
        # The name distinguishes codes in the cache: the catalogue is part of its folder's name, a user's file is not.
        code, frozen = python.__code__, _frozen(python)
        known_as = repr((names, code.co_code, code.co_consts, code.co_names, frozen))
        function.__module__ = __name__
        function.__qualname__ = f"{kind.__name__}.{method}.{hashlib.sha256(known_as.encode()).hexdigest()[:16]}"
        found = ccallback.CFunc(function, _SIGNATURE, locals={}, options={"nopython": True, "error_model": "numpy"})
        if frozen is not None or not by_user:
            found._cache = CodeCache(function, code_folder, by_user)
        found.compile()
        return found

    def _frozen(python: FunctionType) -> list[tuple[str, Any]] | None:
        """Constants of its file that are part of a function's code; None if there are others than plain numbers and `math`, or
        functions in it.
        """
        if any(isinstance(constant, CodeType) for constant in python.__code__.co_consts):
            return None
        used = {name: python.__globals__[name] for name in python.__code__.co_names if name in python.__globals__}
        numbers = {name: value for name, value in used.items() if isinstance(value, int | float)}
        others = [value for name, value in used.items() if name not in numbers]
        return sorted(numbers.items()) if all(value in (math, np, Terms, Lag) for value in others) else None
