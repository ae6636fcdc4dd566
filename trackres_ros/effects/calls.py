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
from trackres_ros.kernels.compiler import FLAGS, compile_text, compiler
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
    arguments = ", ".join(f"x[{i}]" for i in range(FACTS, LOOKED_AT))
    vehicle = ", ".join(f"x[{i}]" for i in range(FACTS))
    name, answer_count = f"{kind.__name__.lower()}_{method}", ANSWERS[method]
    lines = [
        f"def {name}(x, p, out):",
        f'    """{method} of {kind.__name__}"""',
        f"    found = run(None, Conditions(VehicleConstants({vehicle}), {arguments}), p)",
        *(f"    out[{i}] = found[{i}]" for i in range(answer_count)),
    ]
    text = "\n".join(lines)
    namespace: dict[str, Any] = {"Conditions": Conditions, "VehicleConstants": VehicleConstants, "run": getattr(kind, method)}
    exec(text, namespace)
    function: FunctionType = namespace[name]
    translator.add_text(function, text)
    kinds = [ArrayOf(REAL, (LOOKED_AT,)), ArrayOf(REAL, (len(names),), names), ArrayOf(REAL, (answer_count,))]
    old_check, translator.is_checked = translator.is_checked, is_of_user(kind)
    try:
        return translator.instance(function, kinds)
    finally:
        translator.is_checked = old_check


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
        _warn_of_python(f"effect {kind.__name__}", "there is no C compiler")
        return None
    try:
        text = _text(kind, method, names)
    except InputError as error:
        _warn_of_python(f"effect {kind.__name__}", str(error))
        return None
    library = _library(text)
    if library is None:
        _warn_of_python(f"effect {kind.__name__}", f"{compiler()} does not compile it")
        return None
    return ctypes.cast(getattr(library, NAME), ctypes.c_void_p).value


def _text(kind: type[Any], method: str, names: tuple[str, ...]) -> str:
    """The C of a function, which answers nan where Python raises an error."""
    from trackres_ros.kernels.extension import used_helpers
    from trackres_ros.kernels.flow import translate_body
    from trackres_ros.kernels.functions import Translator

    translator = Translator(translate_body)
    instance = effect_function(translator, kind, method, names)
    functions = translator.text_of_functions([instance])
    arguments = ", ".join([*(name for name, _ in instance.given), *["&failed"] * instance.has_failure])
    return "\n".join(
        (
            "#include <math.h>\n#include <stdbool.h>\n#include <stdint.h>\n",
            used_helpers(translator, functions),
            translator.text_of_structs(functions),
            translator.text_of_tables(),
            functions,
            f"void {NAME}(const double *x, const double *p, double *out)\n{{",
            f"    bool failed = false;\n    {instance.name}({arguments});\n",
            "    if (failed) {\n        out[0] = NAN;\n    }\n}\n",
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
        code = compile_text(text)
        if code is None:
            return None
        keep(folder, name, code)
    # What was checked is what is loaded, whoever may change files meanwhile. It stays open: the loader knows it by its path.
    file = os.memfd_create(NAME, os.MFD_CLOEXEC)
    os.write(file, code)
    return ctypes.CDLL(f"/proc/self/fd/{file}")


@cache
def _warn_of_python(subject: str, reason: str) -> None:
    _log.warning("trackres: %s runs in plain Python, about %d times slower: %s", subject, SLOWER, reason)


# Numbers

C_FUNCTION = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)

Function = tuple[type[Effect], str, tuple[str, ...]]
"""A function of an effect: its class, `terms` or `lag`, and the names of the parameters."""


def call_at(number: int, instant: Array, values: Array, answer: Array) -> None:
    """Call an effect's function by its number; compiled code does so without leaving itself."""
    if number <= len(package_functions()):
        _python_call(int(number))(instant, values, answer)
    else:
        C_FUNCTION(int(number))(instant.ctypes.data, values.ctypes.data, answer.ctypes.data)


@cache
def package_functions() -> dict[Function, int]:
    """The functions of all effects of the package, with their numbers from 1."""
    from trackres_ros.effects.learned import examples
    from trackres_ros.effects.registry import catalogue

    numbers: dict[Function, int] = {}
    for effect in (*catalogue().values(), *examples()):
        for method in methods_of(effect):
            numbers.setdefault(function_of(effect, method), len(numbers) + 1)
    return numbers


def methods_of(effect: Effect) -> tuple[str, ...]:
    """Names of the functions that an effect has."""
    return ("terms", "lag") if effect.has_lag else ("terms",)


def numbers_of(effect: Effect) -> tuple[int, int]:
    """Numbers of an effect's `terms` and `lag`, 0 without one."""
    return number_of(effect, "terms"), number_of(effect, "lag") if effect.has_lag else 0


def number_of(effect: Effect, method: str, compiled: bool = True) -> int:
    """The number of a function; of a user's effect in C, if allowed and possible, or in plain Python."""
    number = package_functions().get(function_of(effect, method))
    if number is not None:
        return number
    address = address_of(*function_of(effect, method)) if compiled else None
    return address or ctypes.cast(_callback(effect, method), ctypes.c_void_p).value or 0


def is_compiled(effect: Effect) -> bool:
    """Whether the compiled step calls C for an effect, not plain Python."""
    functions = [function_of(effect, method) for method in methods_of(effect)]
    return all(function in package_functions() or address_of(*function) is not None for function in functions)


def reads_drag_area(effect: Effect) -> bool:
    """Whether an effect's `terms`, or a function of its file that it calls, reads the vehicle's drag area."""
    terms = unwrap(type(effect).terms)
    codes = [terms.__code__] if isinstance(terms, FunctionType) else []
    for code in codes:  # it grows
        callees = (terms.__globals__.get(name) for name in code.co_names)
        inner = (getattr(function_code, "__code__", None) for function_code in callees)
        codes += [
            function_code
            for function_code in (*inner, *code.co_consts)
            if isinstance(function_code, CodeType) and function_code not in codes
        ]
    return any("drag_area" in code.co_names for code in codes)


def function_of(effect: Effect, method: str) -> Function:
    """A function of an effect."""
    return type(effect), method, tuple(q.name for q in effect.parameters)


@cache
def _python_call(number: int) -> Callable[[Array, Array, Array], None]:
    """A function of the package in plain Python."""
    kind, method, names = list(package_functions())[number - 1]
    run, answer_count = getattr(kind, method), ANSWERS[method]

    def call(instant: Array, values: Array, answer: Array) -> None:
        numbers = instant[:LOOKED_AT].tolist()
        at = Conditions(VehicleConstants(*numbers[:FACTS]), *numbers[FACTS:])
        answer[:answer_count] = run(None, at, values_type(names)(*values[: len(names)].tolist()))

    return call


@cache
def _callback(effect: Effect, method: str) -> Any:
    """An effect's method in plain Python as a machine function. It is kept: its address may be in any table."""
    count, answer_count = len(effect.parameters), ANSWERS[method]
    inputs_type, parameters_type, answer_type = (ctypes.c_double * n for n in (LOOKED_AT, count, answer_count))

    def call(looked_at_: int, values_: int, answer_: int) -> None:
        try:
            numbers, values = inputs_type.from_address(looked_at_)[:], parameters_type.from_address(values_)[:]
            answer = effect.run(method, Conditions(VehicleConstants(*numbers[:FACTS]), *numbers[FACTS:]), values)
            if answer is None:  # no own state after all
                answer = Lag(0.0, 1.0, 0.0)
            answer_type.from_address(answer_)[:] = [float(x) for x in answer]
        except Exception:  # of any kind, as the code is not ours
            answer_type.from_address(answer_)[:] = [math.nan] * answer_count

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
        number, instant, parameters, answer = values
        self.called = True
        body.note_written(answer)
        body.calls += list(self.functions.values())
        codes = [number.code, *(body.as_kind(argument, NUMBERS) for argument in (instant, parameters, answer))]
        return f"{CALL}({', '.join(codes)})"

    def add(self, function: Function, number: int) -> None:
        """Translate a function, which gets a number."""
        self.functions[number] = effect_function(self._translator, *function)

    def text(self) -> str:
        """The function that calls an effect by its number; empty without effects."""
        if not self.functions and not self._others:
            return ""
        real_type = self._translator.number(REAL)
        cases = ""
        for number, instance in self.functions.items():
            arguments = [{"x": "looked_at", "p": "values", "out": "answer"}[name] for name, _ in instance.given] + [
                "&failed"
            ] * instance.has_failure
            cases += f"    case {number}:\n        {instance.name}({', '.join(arguments)});\n        break;\n"
        has_failure = any(instance.has_failure for instance in self.functions.values())
        start = "    bool failed = false;\n" if has_failure else ""
        finish = "    answer[0] = failed ? NAN : answer[0];\n" if has_failure else ""
        casts = [
            f"    (void){name};\n"
            for letter, name in (("x", "looked_at"), ("p", "values"))
            if not self._others and not any(letter in dict(instance.given) for instance in self.functions.values())
        ]
        kind = f"void (*)(const {real_type} *, const {real_type} *, {real_type} *)"
        fallback = f"        (({kind})(intptr_t)number)(looked_at, values, answer);\n" if self._others else ""
        return (
            "/* What an effect does now, by its number. */\n"
            f"{self.prototype.removesuffix(';')}\n"
            f"{{\n{''.join(casts)}{start}"
            f"    switch (number) {{\n{cases}    default:\n{fallback}        break;\n    }}\n"
            f"{finish}}}\n"
        )

    @property
    def prototype(self) -> str:
        """Its declaration."""
        real_type = self._translator.number(REAL)
        return (
            f"static void {CALL}(int64_t number, const {real_type} *looked_at, const {real_type} *values, {real_type} *answer);"
        )
