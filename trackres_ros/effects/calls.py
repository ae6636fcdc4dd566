# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Numbers the functions of effects, by which the step calls them: its table of effects has these numbers.

Those of the package are part of the compiled kernels. One of a user's has its address as its number. With a C compiler it is
compiled here, and the code is kept in the cache. Without one, the address is that of a function that runs it in plain Python.
"""

from __future__ import annotations

import ctypes
import hashlib
import logging
import math
import os
import platform
from collections.abc import Callable, Sequence
from functools import cache
from inspect import unwrap
from types import CodeType, FunctionType
from typing import TYPE_CHECKING, Any

from trackres_ros.arrays import Array
from trackres_ros.effects.effect import (
    ANSWERS,
    FACTS,
    LOOKED_AT,
    Conditions,
    Effect,
    Lag,
    VehicleConstants,
    is_of_user,
    values_type,
)
from trackres_ros.errors import InputError
from trackres_ros.files.cache import fetched, keep, usable_folder
from trackres_ros.files.resources import cache_dir
from trackres_ros.kernels.compiler import FLAGS, compiled, compiler
from trackres_ros.kernels.kinds import REAL, ArrayOf
from trackres_ros.kernels.marks import SLOWER, interpreted

if TYPE_CHECKING:  # a step alone translates nothing
    from trackres_ros.kernels.expressions import Expressions, Value
    from trackres_ros.kernels.functions import Instance, Translator

# In C


def effect_function(translator: Translator, kind: type[Effect], method: str, names: tuple[str, ...]) -> Instance:
    """`terms` or `lag` of an effect behind the signature that the step calls: numbers that it looks at, parameters, its answer.

    Raises
    ------
    InputError
        With file and line, if it cannot be written in C.
    """
    known = ", ".join(f"x[{i}]" for i in range(FACTS, LOOKED_AT))
    vehicle = ", ".join(f"x[{i}]" for i in range(FACTS))
    name, answered = f"{kind.__name__.lower()}_{method}", ANSWERS[method]
    lines = [
        f"def {name}(x, p, out):",
        f'    """{method} of {kind.__name__}"""',
        f"    found = run(None, Conditions(VehicleConstants({vehicle}), {known}), p)",
        *(f"    out[{i}] = found[{i}]" for i in range(answered)),
    ]
    text = "\n".join(lines)
    namespace: dict[str, Any] = {"Conditions": Conditions, "VehicleConstants": VehicleConstants, "run": getattr(kind, method)}
    exec(text, namespace)
    made: FunctionType = namespace[name]
    translator.add_text(made, text)
    kinds = [ArrayOf(REAL, (LOOKED_AT,)), ArrayOf(REAL, (len(names),), names), ArrayOf(REAL, (answered,))]
    before, translator.checked = translator.checked, is_of_user(kind)
    try:
        return translator.instance(made, kinds)
    finally:
        translator.checked = before


# Compiled effects of a user

LARGEST = 16 << 20  # bytes; a usual one has 16 kB
NAME = "trackres_effect"

_log = logging.getLogger("trackres")


@cache
def address_of(kind: type[Any], method: str, names: tuple[str, ...]) -> int | None:
    """The address of C of a function of an effect; None if it must run in plain Python, which is logged."""
    if interpreted():
        return None
    if compiler() is None:
        _say(f"effect {kind.__name__}", "there is no C compiler")
        return None
    try:
        text = _text(kind, method, names)
    except InputError as error:
        _say(f"effect {kind.__name__}", str(error))
        return None
    library = _library(text)
    if library is None:
        _say(f"effect {kind.__name__}", f"{compiler()} does not compile it")
        return None
    return ctypes.cast(getattr(library, NAME), ctypes.c_void_p).value


def _text(kind: type[Any], method: str, names: tuple[str, ...]) -> str:
    """The C of a function, which answers nan where Python raises an error."""
    from trackres_ros.kernels.extension import used_helpers
    from trackres_ros.kernels.flow import translate_body
    from trackres_ros.kernels.functions import Translator

    translator = Translator(translate_body)
    one = effect_function(translator, kind, method, names)
    functions = translator.text_of_functions([one])
    given = ", ".join([*(name for name, _ in one.given), *["&failed"] * one.fails])
    return "\n".join(
        (
            "#include <math.h>\n#include <stdbool.h>\n#include <stdint.h>\n",
            used_helpers(translator, functions),
            translator.text_of_structs(functions),
            translator.text_of_tables(),
            functions,
            f"void {NAME}(const double *x, const double *p, double *out)\n{{",
            f"    bool failed = false;\n    {one.name}({given});\n    if (failed) {{\n        out[0] = NAN;\n    }}\n}}\n",
        )
    )


@cache
def _library(text: str) -> ctypes.CDLL | None:
    """The loaded library of some C, from the cache or compiled now."""
    parts = "\n".join((platform.machine(), *FLAGS, text))
    name = f"{hashlib.sha256(parts.encode()).hexdigest()[:32]}.code"
    base = cache_dir()
    folder = usable_folder(None if base is None else base / "effects")
    code = fetched(folder, name, LARGEST)
    if code is None:
        code = compiled(text)
        if code is None:
            return None
        keep(folder, name, code)
    # What was checked is what is loaded, whoever may change files meanwhile. It stays open: the loader knows it by its path.
    file = os.memfd_create(NAME, os.MFD_CLOEXEC)
    os.write(file, code)
    return ctypes.CDLL(f"/proc/self/fd/{file}")


@cache
def _say(what: str, why: str) -> None:
    _log.warning("trackres: %s runs in plain Python, about %d times slower: %s", what, SLOWER, why)


# Numbers

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


# The call in C

NUMBERS = ArrayOf(REAL, (None,))
CALL = "tr_call_effect"


class EffectCalls:
    """Functions of effects by their numbers, for a step in C. With `others`, further numbers are addresses of functions."""

    def __init__(self, translator: Translator, others: bool = False) -> None:
        self._translator, self._others = translator, others
        self.functions: dict[int, Instance] = {}
        self.called = False  # whether a translated function calls any
        translator.intrinsics[call_at] = self._call

    def _call(self, body: Expressions, values: Sequence[Value]) -> str:
        number, looked_at, parameters, answer = values
        self.called = True
        body.note_written(answer)
        body.calls += list(self.functions.values())
        codes = [number.code, *(body.as_kind(one, NUMBERS) for one in (looked_at, parameters, answer))]
        return f"{CALL}({', '.join(codes)})"

    def add(self, function: Function, number: int) -> None:
        """Translate a function, which gets a number."""
        self.functions[number] = effect_function(self._translator, *function)

    def text(self) -> str:
        """The function that calls an effect by its number; empty without effects."""
        if not self.functions and not self._others:
            return ""
        real = self._translator.number(REAL)
        cases = ""
        for number, one in self.functions.items():
            given = [{"x": "looked_at", "p": "values", "out": "answer"}[name] for name, _ in one.given] + ["&failed"] * one.fails
            cases += f"    case {number}:\n        {one.name}({', '.join(given)});\n        break;\n"
        fails = any(one.fails for one in self.functions.values())
        begun = "    bool failed = false;\n" if fails else ""
        ended = "    answer[0] = failed ? NAN : answer[0];\n" if fails else ""
        unused = [
            f"    (void){name};\n"
            for short, name in (("x", "looked_at"), ("p", "values"))
            if not self._others and not any(short in dict(one.given) for one in self.functions.values())
        ]
        kind = f"void (*)(const {real} *, const {real} *, {real} *)"
        other = f"        (({kind})(intptr_t)number)(looked_at, values, answer);\n" if self._others else ""
        return (
            "/* What an effect does now, by its number. */\n"
            f"{self.prototype.removesuffix(';')}\n"
            f"{{\n{''.join(unused)}{begun}"
            f"    switch (number) {{\n{cases}    default:\n{other}        break;\n    }}\n"
            f"{ended}}}\n"
        )

    @property
    def prototype(self) -> str:
        """Its declaration."""
        real = self._translator.number(REAL)
        return f"static void {CALL}(int64_t number, const {real} *looked_at, const {real} *values, {real} *answer);"
