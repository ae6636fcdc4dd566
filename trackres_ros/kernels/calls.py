# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Translates calls: of functions that are translated too, of named tuples and rows, and of functions of Python, math, numpy."""

from __future__ import annotations

import ast
import math
from dataclasses import replace
from types import FunctionType
from typing import Any

import numpy as np

from trackres_ros.kernels.expressions import UNARY, Value
from trackres_ros.kernels.kinds import (
    ASKED,
    BOOL,
    FAILED,
    INT,
    REAL,
    REALS,
    SAME_IN_C,
    TO_WHOLE,
    ArrayOf,
    Const,
    Kind,
    Record,
    Scalar,
    joined,
    narrowed,
    widened,
    words,
)
from trackres_ros.kernels.operators import Operators
from trackres_ros.kernels.rows import Row

OF_NUMPY = {"abs": "fabs", "absolute": "fabs", "arctan": "atan", "arctan2": "atan2", "arcsin": "asin", "arccos": "acos"}
OF_MATH = ("trunc", *TO_WHOLE, *ASKED, *SAME_IN_C)
ALLOWED = f"abs, min, max, int, float, bool, and of math {', '.join(OF_MATH)}, of one number or two"

REMAINDERS = ("remainder", "mod")  # of numpy


class Calls(Operators):
    """The calls of one function; `statements.Body` has its statements."""

    def _call(self, node: ast.Call) -> Value:
        target = self.value(node.func)
        function = getattr(target.const, "of", target.const)
        if not target.is_const or not callable(function):
            raise self.refuse(node, ast.unparse(node)[:80], "a call of a function that is known")
        if isinstance(function, type) and hasattr(function, "_fields"):
            return self._record(node, function)
        values = self.spread(node.args)
        if isinstance(function, type) and issubclass(function, Row):
            array = self.array_kind(node, values[0])
            code = self.table(values[0], "row") if values[0].is_const else self.as_kind(values[0], ArrayOf(array.of, (None,)))
            return replace(values[0], kind=ArrayOf(array.of, (function.columns,), function.names), code=code)
        if function in self.translator.intrinsics:
            return Value(Const(None), self.translator.intrinsics[function](self, values))
        if isinstance(function, FunctionType):
            return self.call_of(node, function, values)
        if node.keywords:
            raise self.refuse(node, ast.unparse(node)[:80], "arguments without names")
        return self._of_library(node, function, values)

    def _record(self, node: ast.Call, cls: Any) -> Value:
        values = dict(zip(cls._fields, self.spread(node.args), strict=False))
        values |= {str(keyword.arg): self.value(keyword.value) for keyword in node.keywords}
        values = {name: self.const(default) for name, default in cls._field_defaults.items()} | values
        if set(values) != set(cls._fields):
            raise self.refuse(node, ast.unparse(node)[:80], f"each of {', '.join(cls._fields)}")
        ordered = [values[name] for name in cls._fields]
        reals = {name for name, kind in cls.__annotations__.items() if kind in ("float", float)}
        kinds = [REAL if name in reals else narrowed(widened(v.kind)) for name, v in zip(cls._fields, ordered, strict=True)]
        return self.tuple_of(ordered, Record(words(cls.__name__), tuple(zip(cls._fields, kinds, strict=True))))

    def call_of(self, node: ast.Call, function: FunctionType, values: list[Value]) -> Value:
        """A call of another translated function."""
        names = [a.arg for a in self.translator.source(function).tree.args.args]
        given = dict(zip(names, values, strict=False)) | {str(k.arg): self.value(k.value) for k in node.keywords}
        defaults = dict(zip(names[::-1], (function.__defaults__ or ())[::-1], strict=False))
        given = {name: self.const(value) for name, value in defaults.items()} | given
        if set(given) != set(names) or len(values) > len(names):
            raise self.refuse(node, ast.unparse(node)[:80], f"the arguments {', '.join(names)}")
        ordered = [given[name] for name in names]
        kinds = [v.kind if isinstance(v.const, np.ndarray) else self._passed(v.kind) for v in ordered]
        one = self.translator.instance(function, kinds)
        for name, v in given.items():
            if name in one.writes:
                if isinstance(v.const, np.ndarray):
                    raise self.refuse(node, ast.unparse(node)[:80], "an array that may change")
                self.note_written(v)
        if not one.writes and (one.returns is None or isinstance(one.returns, Const)):
            return self.const(one.returns.value if isinstance(one.returns, Const) else None)
        self.calls.append(one)
        codes = [self.argument(given[name], kind) for name, kind in one.given] + [FAILED] * one.fails
        kind = Const(None) if one.returns is None else one.returns
        return Value(kind, f"{one.name}({', '.join(codes)})")

    def _passed(self, kind: Kind) -> Kind:
        """The kind of a parameter: single numbers are no constants, so that there is one function for all of them."""
        return widened(kind) if isinstance(kind, Const) and isinstance(kind.value, bool | int | float) else narrowed(kind)

    def argument(self, value: Value, kind: Kind) -> str:
        """The code of an argument; of a record its address."""
        if not isinstance(kind, Record):
            return self.as_kind(value, kind)
        if value.by_pointer:
            return value.code
        is_place = value.code.startswith("(struct ") or value.code.replace(".", "").replace("->", "").replace("_", "").isalnum()
        return f"&{value.code if is_place else self.hoisted(value, kind)}"

    def hoisted(self, value: Value, kind: Kind) -> str:
        """The name of a variable that holds a value from before the statement."""
        raise NotImplementedError

    def _of_library(self, node: ast.Call, function: Any, values: list[Value]) -> Value:
        """A call of a function of Python, math or numpy on numbers."""
        if function is len and len(values) == 1:
            of = values[0]
            if isinstance(of.const, tuple | np.ndarray):
                return self.const(len(of.const))
            if isinstance(of.kind, ArrayOf) and of.kind.shape[0] is not None:
                return self.length(of, 0)
        if not values or not all(isinstance(widened(v.kind), Scalar) for v in values):
            raise self.refuse(node, ast.unparse(node)[:80], "numbers as arguments")
        if all(v.is_const for v in values):
            try:
                return self.const(function(*(v.const for v in values)))
            except (ArithmeticError, ValueError, TypeError):
                pass
        found = self._of_numbers(function, values)
        if found is None:
            raise self.refuse(node, ast.unparse(node)[:80], ALLOWED)
        return found

    def _of_numbers(self, function: Any, values: list[Value]) -> Value | None:
        first, name = values[0], getattr(function, "__name__", "")
        module = "numpy" if isinstance(function, np.ufunc) else getattr(function, "__module__", "")
        name = OF_NUMPY.get(name, name) if module == "numpy" else name
        if function in (min, max) and len(values) > 1:
            return self._extreme(name, values)
        if module not in ("math", "numpy", "builtins") or len(values) != SAME_IN_C.get(name, 2 if name in REMAINDERS else 1):
            return None
        if function is float:
            return Value(REAL, self.as_real(first), first.binds if first.kind == REAL else UNARY)
        if function in (int, math.trunc):
            return first if first.kind not in REALS else self._whole(self.as_real(first))
        if function is bool:
            return self.truth(ast.Constant(0), first)
        if function is abs or name == "fabs":
            if widened(first.kind) == INT:
                return Value(INT, f"tr_abs_int({first.code})")
            return Value(REAL, f"{self.translator.call('fabs')}({self.as_real(first)})")
        if module == "math" and name in TO_WHOLE:
            return self._whole(f"{self.translator.call(name)}({self.as_real(first)})")
        if name in ASKED:
            return Value(BOOL, f"{name}({self.as_real(first)})")
        if name in REMAINDERS and module == "numpy":
            return self.helped("modulo_real", values, REAL)
        if name in SAME_IN_C:
            return Value(REAL, f"{self.translator.call(name)}({', '.join(map(self.as_real, values))})")
        return None

    def _whole(self, code: str) -> Value:
        """A whole number; what is none leaves an effect out, as in Python."""
        return Value(INT, f"tr_whole_number({code}, {FAILED})" if self.translator.checked else f"tr_whole({code})")

    def _extreme(self, name: str, values: list[Value]) -> Value:
        kind = narrowed(joined(joined(INT, widened(values[0].kind)), widened(values[1].kind)) or REAL)
        found = self.helped(f"{name}_{'real' if kind == REAL else 'int'}", values[:2], kind)
        return self._extreme(name, [found, *values[2:]]) if len(values) > 2 else found
