# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes the function in C that calls an effect by its number."""

from __future__ import annotations

from collections.abc import Sequence

from trackres_ros.effects.calls import Function, call_at
from trackres_ros.effects.translated import effect_function
from trackres_ros.kernels.expressions import Expressions, Value
from trackres_ros.kernels.functions import Instance, Translator
from trackres_ros.kernels.kinds import REAL, ArrayOf

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
