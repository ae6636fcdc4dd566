# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Translates operators: arithmetic, comparisons, conditions and choices."""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from trackres_ros.kernels.expressions import (
    AND,
    ATOM,
    BITS,
    COMPARED,
    OR,
    PRODUCT,
    SHIFTED,
    SUM,
    TERNARY,
    UNARY,
    Expressions,
    Value,
)  # fmt: skip
from trackres_ros.kernels.kinds import BOOL, INT, REAL, REALS, WIDE, Const, Kind, Scalar, joined, narrowed, widened

OPERATORS: dict[type, tuple[str, int, Callable[..., Any]]] = {
    ast.Add: ("+", SUM, operator.add),
    ast.Sub: ("-", SUM, operator.sub),
    ast.Mult: ("*", PRODUCT, operator.mul),
    ast.Div: ("/", PRODUCT, operator.truediv),
    ast.FloorDiv: ("/", PRODUCT, operator.floordiv),
    ast.Mod: ("%", PRODUCT, operator.mod),
    ast.Pow: ("**", PRODUCT, operator.pow),
    ast.BitAnd: ("&", BITS, operator.and_),
    ast.BitOr: ("|", BITS, operator.or_),
    ast.BitXor: ("^", BITS, operator.xor),
    ast.LShift: ("<<", SHIFTED, operator.lshift),
    ast.RShift: (">>", SHIFTED, operator.rshift),
}
BITS_OF_INT = 63
OF_WHOLE_NUMBERS = ("&", "|", "^", "<<", ">>")
COMPARISONS: dict[type, tuple[str, Callable[..., Any]]] = {
    ast.Lt: ("<", operator.lt),
    ast.LtE: ("<=", operator.le),
    ast.Gt: (">", operator.gt),
    ast.GtE: (">=", operator.ge),
    ast.Eq: ("==", operator.eq),
    ast.NotEq: ("!=", operator.ne),
}


class Operators(Expressions):
    """The operators of one function; `calls.Calls` has its calls."""

    def truth(self, node: ast.AST, value: Value) -> Value:
        """A value as a condition."""
        if value.is_const and isinstance(value.const, bool | int | float):
            return self.const(bool(value.const))
        if value.kind == BOOL:
            return value
        if value.kind in (INT, *REALS):
            return Value(BOOL, f"{self.within(value, SHIFTED)} != 0", COMPARED)
        raise self.refuse(node, ast.unparse(node)[:80], "a condition")

    def _binop(self, node: ast.BinOp) -> Value:
        return self.binary(node, node.op, self.value(node.left), self.value(node.right))

    def binary(self, node: ast.AST, op: ast.operator, left: Value, right: Value) -> Value:
        """Two numbers and an operator between them."""
        if type(op) not in OPERATORS or not all(isinstance(widened(v.kind), Scalar) for v in (left, right)):
            raise self.refuse(node, ast.unparse(node)[:80], "numbers, with operators of numbers between them")
        sign, binds, python = OPERATORS[type(op)]
        if left.is_const and right.is_const:
            try:
                return self.const(python(left.const, right.const))
            except (ArithmeticError, ValueError, TypeError):
                pass
        kind = joined(joined(INT, left.kind), right.kind) or REAL
        if sign == "**":
            return self._power(left, right)
        if sign in ("%", "/") and isinstance(op, ast.Mod | ast.FloorDiv):
            which = "modulo" if isinstance(op, ast.Mod) else "floored"
            return self.helped(f"{which}_{'real' if kind in REALS else 'int'}", [left, right], narrowed(kind))
        if sign == "/":
            kind = joined(kind, REAL) or REAL
            if left.kind not in REALS and right.kind not in REALS:
                left = Value(REAL, self.as_real(left), UNARY)
        if sign in OF_WHOLE_NUMBERS and kind in REALS:
            raise self.refuse(node, ast.unparse(node)[:80], "whole numbers")
        if self.translator.checked and sign in ("<<", ">>") and not (right.is_const and 0 <= right.const < BITS_OF_INT):
            raise self.refuse(node, ast.unparse(node)[:80], f"a known number of bits below {BITS_OF_INT}")
        if sign in OF_WHOLE_NUMBERS and left.kind == right.kind == BOOL:
            kind = BOOL
        if kind in REALS:
            left, right = self._real_pair(left, right, kind)
        low = SUM if sign in ("<<", ">>") else UNARY if sign in ("&", "|", "^") else binds
        code = f"{self.within(left, low)} {sign} {self.within(right, low if sign in OF_WHOLE_NUMBERS else binds + 1)}"
        return Value(kind, code, binds)

    def _real_pair(self, left: Value, right: Value, kind: Kind) -> tuple[Value, Value]:
        """Convert both to real numbers, constants none wider than a `float`."""
        both = []
        for v in (left, right):
            code = self.as_kind(v, kind)
            both.append(v if code == v.code else replace(v, code=code, binds=UNARY))
        return both[0], both[1]

    def as_real(self, value: Value) -> str:
        """The code of a number as a real one."""
        if value.is_const:
            return self.translator.literal(float(value.const))
        if value.kind in REALS:
            return self.as_kind(value, REAL)
        return f"({self.translator.number(REAL)}){self.within(value, UNARY)}"

    def _power(self, base: Value, exponent: Value) -> Value:
        if exponent.is_const and exponent.const == 2 and base.kind == INT and base.code.replace("_", "").isalnum():
            return Value(widened(base.kind), f"{base.code} * {base.code}", PRODUCT)
        return Value(REAL, f"{self.translator.call('pow')}({self.as_real(base)}, {self.as_real(exponent)})")

    def _unaryop(self, node: ast.UnaryOp) -> Value:
        if isinstance(node.op, ast.Not):
            truth = self.condition(node.operand)
            return self.const(not truth.const) if truth.is_const else Value(BOOL, f"!{self.within(truth, UNARY)}", UNARY)
        of = self.value(node.operand)
        if not isinstance(widened(of.kind), Scalar) or not isinstance(node.op, ast.USub | ast.UAdd):
            raise self.refuse(node, ast.unparse(node)[:80], "a number with a sign, or not")
        if isinstance(node.op, ast.UAdd):
            return of
        return self.const(-of.const) if of.is_const else Value(widened(of.kind), f"-{self.within(of, ATOM)}", UNARY)

    def condition(self, node: ast.expr) -> Value:
        """An expression of which only its truth is asked."""
        if isinstance(node, ast.BoolOp):
            return self._logical(node, self._until_decided(node, self.condition))
        return self.truth(node, self.value(node))

    def _until_decided(self, node: ast.BoolOp, read: Callable[[ast.expr], Value]) -> list[Value]:
        """The operands of `and` or `or`, up to one that is known to decide."""
        found: list[Value] = []
        for one in node.values:
            found.append(self.later(one, read) if found else read(one))
            if self.truth(one, found[-1]).const is isinstance(node.op, ast.Or):
                break
        return found

    def _logical(self, node: ast.BoolOp, values: Sequence[Value]) -> Value:
        """Operands that are truth values."""
        stops = isinstance(node.op, ast.Or)  # the value that decides
        kept = [v for v in values if not v.is_const or v.const is stops]
        if len(kept) < 2:
            return kept[0] if kept else self.const(not stops)
        sign, binds = ("||", OR) if stops else ("&&", AND)
        return Value(BOOL, f" {sign} ".join(self.within(v, COMPARED) for v in kept), binds)

    def _boolop(self, node: ast.BoolOp) -> Value:
        values = self._until_decided(node, self.value)
        if all(widened(v.kind) == BOOL for v in values):
            return self._logical(node, values)
        result = values[-1]
        for value in values[-2::-1]:  # the answer is an operand, not its truth
            if any(one.writes and f"{one.name}(" in value.code for one in self.calls):
                raise self.refuse(node, ast.unparse(node)[:80], "operands that change nothing")
            both = (value, result) if isinstance(node.op, ast.Or) else (result, value)
            result = self._choice(node, self.truth(node, value), *both)
        return result

    def _compare(self, node: ast.Compare) -> Value:
        values = [self.value(one) for one in (node.left, *node.comparators)]
        found: list[str] = []
        for op, left, right in zip(node.ops, values, values[1:], strict=False):
            if type(op) not in COMPARISONS or not all(isinstance(widened(v.kind), Scalar) for v in (left, right)):
                raise self.refuse(node, ast.unparse(node)[:80], "numbers that are compared")
            sign, python = COMPARISONS[type(op)]
            if left.is_const and right.is_const:
                if not python(left.const, right.const):
                    return self.const(False)
                continue
            if left.kind in REALS or right.kind in REALS:
                left, right = self._real_pair(left, right, WIDE if WIDE in (left.kind, right.kind) else REAL)
            found.append(f"{self.within(left, SHIFTED)} {sign} {self.within(right, SHIFTED)}")
        if not found:
            return self.const(True)
        return Value(BOOL, found[0], COMPARED) if len(found) == 1 else Value(BOOL, " && ".join(found), AND)

    def _ifexp(self, node: ast.IfExp) -> Value:
        test = self.condition(node.test)
        if test.is_const:
            return self.value(node.body if test.const else node.orelse)
        return self._choice(node, test, self.later(node.body, self.value), self.later(node.orelse, self.value))

    def _choice(self, node: ast.AST, test: Value, one: Value, other: Value) -> Value:
        """One of two values, by a condition."""
        if test.is_const:
            return one if test.const else other
        kind = joined(widened(one.kind), other.kind)
        if kind is None or isinstance(kind, Const):
            raise self.refuse(node, ast.unparse(node)[:80], "two values of one kind")
        codes = [v.code if isinstance(kind, Scalar) and not v.is_const else self.as_kind(v, kind) for v in (one, other)]
        first = codes[0] if one.binds > TERNARY else f"({codes[0]})"
        return Value(kind, f"{self.within(test, OR)} ? {first} : {codes[1]}", TERNARY)

    def helped(self, name: str, values: Sequence[Value], kind: Kind) -> Value:
        """A call of a function of the file's own, see templates/helpers.c."""
        codes = [self.as_kind(v, kind) for v in values]
        return Value(kind, f"tr_{name}({', '.join(codes)})")
