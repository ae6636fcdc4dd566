# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Translates expressions: each becomes one expression of C with its kind, or a constant.

First names, attributes, tuples and entries of arrays; then operators: arithmetic, comparisons, conditions and choices.
"""

from __future__ import annotations

import ast
import builtins
import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Any

import numpy as np

from trackres_ros.errors import InputError
from trackres_ros.kernels.functions import Instance, Translator, refusal_at
from trackres_ros.kernels.kinds import (
    BOOL,
    FAILED,
    INT,
    LENGTH,
    REAL,
    REALS,
    WIDE,
    ArrayOf,
    Const,
    Kind,
    Length,
    Record,
    Scalar,
    join_kinds,
    narrow_kind,
    safe_name,
    widen_kind,
)

# Names, tuples and arrays

# Precedence in C: a part with a lower one than its expression gets parentheses.
TERNARY, OR, AND, BITS, COMPARED, SHIFTED, SUM, PRODUCT, UNARY, ATOM = range(10)


@dataclass(frozen=True, slots=True)
class Value:
    """Result of an expression: kind and code; of an array or record the parameter or variable it belongs to; of a literal tuple
    its parts.
    """

    kind: Kind
    code: str
    precedence: int = ATOM
    root: str | None = None
    by_pointer: bool = False
    parts: tuple[Value, ...] = ()

    @property
    def is_const(self) -> bool:
        """Whether it is known at translation."""
        return isinstance(self.kind, Const)

    @property
    def const(self) -> Any:
        """Its value, if known at translation."""
        return self.kind.value if isinstance(self.kind, Const) else None


class Expressions:
    """Translates the expressions of one function; `Operators` has those with operators."""

    def __init__(self, translator: Translator, instance: Instance) -> None:
        self.translator, self.instance = translator, instance
        self.kinds: dict[str, Kind] = {}
        self.pointers: set[str] = set()  # records that are parameters
        self.written: set[str] = set()
        self.parents: dict[str, str | None] = {}
        self.calls: list[Instance] = []

    # Refusals

    def refuse(self, node: ast.AST, code: str, allowed: str) -> InputError:
        """The refusal of a part of the source."""
        return refusal_at(self.instance.source, node, code, allowed)

    # Names

    def value(self, node: ast.expr) -> Value:
        """Translate an expression."""
        method = getattr(self, f"_{type(node).__name__.lower()}", None)
        if method is None:
            raise self.refuse(node, ast.unparse(node)[:80], "an expression of numbers, arrays and calls")
        value: Value = method(node)
        return value

    def guarded_value(self, node: ast.expr, read: Callable[[ast.expr], Value]) -> Value:
        """Translate a part of an expression that Python computes only sometimes."""
        return read(node)

    def const(self, value: Any) -> Value:
        """A value known at translation."""
        is_literal = isinstance(value, bool | int | float | np.number | np.bool_)
        if isinstance(value, np.generic):
            value = value.item()
        code = self.translator.literal(value) if is_literal else ""
        return Value(Const(value), code, UNARY if code.startswith("-") else ATOM)

    def _constant(self, node: ast.Constant) -> Value:
        if isinstance(node.value, bool | int | float) or node.value is None:
            return self.const(node.value)
        raise self.refuse(node, ast.unparse(node)[:80], "a number")

    def _name(self, node: ast.Name) -> Value:
        name = node.id
        if name in self.kinds:
            kind = self.kinds[name]
            self.note_place(name)
            if isinstance(kind, Const):
                return self.const(kind.value)
            return Value(kind, safe_name(name), ATOM, name, name in self.pointers)
        function = self.instance.function
        closure = dict(zip(function.__code__.co_freevars, function.__closure__ or (), strict=True))
        if name in closure:
            return self.const(closure[name].cell_contents)
        if name in function.__globals__:
            return self.const(function.__globals__[name])
        if hasattr(builtins, name):
            return self.const(getattr(builtins, name))
        raise self.refuse(node, f"the name {name}", "a name that has a value here")

    def note_place(self, name: str) -> None:
        """Record that a variable is used in the present block."""

    def _attribute(self, node: ast.Attribute) -> Value:
        owner = self.value(node.value)
        if owner.is_const:
            value = owner.const
            if isinstance(value, np.ndarray) and node.attr == "shape":
                return self.const(value.shape)
            if (isinstance(value, ModuleType | tuple | type) or hasattr(value, "_fields")) and hasattr(value, node.attr):
                return self.const(getattr(value, node.attr))
            access = f"{ast.unparse(node)} of {'self' if value is None else type(value).__name__}"
            raise self.refuse(node, access[:80], "an argument, a constant of the file, or math")
        if isinstance(owner.kind, ArrayOf) and node.attr == "shape":
            if None in owner.kind.shape:
                raise self.refuse(node, ast.unparse(node), "the length of a whole array")
            lengths = [self.length(owner, axis) for axis in range(len(owner.kind.shape))]
            return Value(Record("", tuple((f"f{i}", length.kind) for i, length in enumerate(lengths))), "", parts=tuple(lengths))
        if isinstance(owner.kind, ArrayOf) and node.attr in owner.kind.names:
            code = f"{self.pointer(owner)}[{owner.kind.names.index(node.attr)} /* {node.attr} */]"
            if (count := owner.kind.names.count(node.attr)) > 1:
                return self.array(ArrayOf(owner.kind.element, (count,)), code, (None,), owner.root)
            return Value(owner.kind.element, code, ATOM, owner.root)
        if isinstance(owner.kind, Record) and (part := owner.kind.kind_of(node.attr)) is not None:
            return self.part(owner, node.attr, part)
        raise self.refuse(node, ast.unparse(node)[:80], "an attribute that it has")

    def length(self, array: Value, axis: int) -> Value:
        """The length of an array along an axis."""
        assert isinstance(array.kind, ArrayOf)
        length = array.kind.shape[axis]
        return (
            Value(INT, f"{self.code_within(array, ATOM)}.{array.kind.place_of(axis)}") if length is LENGTH else self.const(length)
        )

    def pointer(self, array: Value) -> str:
        """The code of the pointer to the first entry of an array that is no constant."""
        brings_lengths = isinstance(array.kind, ArrayOf) and array.kind.lengths
        return f"{self.code_within(array, ATOM)}.at" if brings_lengths else self.code_within(array, ATOM)

    def array(self, kind: ArrayOf, entry: str, lengths: Sequence[Value | None], root: str | None) -> Value:
        """An array of a kind that begins at an entry, with the lengths that it brings along."""
        if not kind.lengths:
            return Value(kind, f"&{entry}", UNARY, root)
        codes = [length.code for length, size in zip(lengths, kind.shape, strict=True) if length is not None and size is LENGTH]
        return Value(kind, f"({self.translator.array(kind)}){{&{entry}, {', '.join(codes)}}}", ATOM, root)

    def part(self, record: Value, name: str, kind: Kind) -> Value:
        """A part of a record."""
        if isinstance(kind, Const):
            return self.const(kind.value)
        if isinstance(kind, Record) and not list(kind.stored_fields()):
            return Value(kind, "")
        return Value(kind, f"{record.code}{'->' if record.by_pointer else '.'}{safe_name(name)}", ATOM, record.root)

    # Tuples

    def _tuple(self, node: ast.Tuple) -> Value:
        return self.tuple_of(self.spread(node.elts))

    def spread(self, nodes: Sequence[ast.expr]) -> list[Value]:
        """Values one by one, including those of a starred tuple."""
        values: list[Value] = []
        for node in nodes:
            values += self.parts(node, self.value(node.value)) if isinstance(node, ast.Starred) else [self.value(node)]
        return values

    def parts(self, node: ast.AST, value: Value) -> list[Value]:
        """The parts of a tuple."""
        if value.parts:
            return list(value.parts)
        if isinstance(value.const, tuple):
            return [self.const(item) for item in value.const]
        if isinstance(value.kind, Record):
            return [self.part(value, name, kind) for name, kind in value.kind.fields]
        raise self.refuse(node, ast.unparse(node)[:80], "a tuple")

    def tuple_of(self, values: Sequence[Value], kind: Record | None = None) -> Value:
        """A tuple of values, as a compound literal."""
        if kind is None and all(v.is_const for v in values):
            return self.const(tuple(v.const for v in values))
        record = kind or Record("", tuple((f"f{i}", narrow_kind(v.kind)) for i, v in enumerate(values)))
        for v in values:
            if isinstance(v.kind, ArrayOf):
                self.note_written(v)  # the owner of the pointer may change its target
        code = f"({self.translator.struct(record)}){{{self.initial(values, record)}}}"
        return Value(record, code, ATOM, None, False, tuple(values) if kind is None else ())

    def initial(self, values: Sequence[Value], kind: Record) -> str:
        """The parts of a struct in its initializer."""
        codes = [self.as_kind(v, part) for v, (_, part) in zip(values, kind.fields, strict=True) if not isinstance(part, Const)]
        return ", ".join(codes)

    def as_kind(self, value: Value, kind: Kind) -> str:
        """The code of a value, converted to another kind."""
        if isinstance(kind, Record):
            if value.is_const and isinstance(value.const, tuple):
                inner = self.initial([self.const(item) for item in value.const], kind)
                return f"({self.translator.struct(kind)}){{{inner}}}"
            if isinstance(value.kind, Record) and tuple(value.kind.stored_fields()) != tuple(kind.stored_fields()):
                parts = value.parts or [self.part(value, name, part_kind) for name, part_kind in value.kind.fields]
                return f"({self.translator.struct(kind)}){{{self.initial(parts, kind)}}}"
            return f"*{value.code}" if value.by_pointer else value.code
        if isinstance(kind, Scalar) and kind in REALS:
            if value.is_const and not isinstance(value.const, np.ndarray):
                return self.translator.literal(float(value.const))
            if self.translator.single and (value.kind == INT or (value.kind, kind) == (WIDE, REAL)):
                return f"({self.translator.number(kind)}){self.code_within(value, UNARY)}"
        if isinstance(kind, ArrayOf) and isinstance(value.const, np.ndarray):
            return self.table(value, "table")
        if isinstance(kind, ArrayOf) and not kind.lengths:
            return self.pointer(value) if isinstance(value.kind, ArrayOf) and value.kind.lengths else value.code
        return value.code

    def table(self, value: Value, name: str) -> str:
        """The name of a table of constants."""
        return self.translator.table(value.const, name)

    # Subscripts

    def _subscript(self, node: ast.Subscript) -> Value:
        return self.subscript(node, self.value(node.value))

    def subscript(self, node: ast.Subscript, owner: Value) -> Value:
        """An entry of an array or tuple, or a view."""
        indices = list(node.slice.elts) if isinstance(node.slice, ast.Tuple) else [node.slice]
        if isinstance(owner.const, tuple) or isinstance(owner.kind, Record):
            index = self.value(indices[0])
            if index.is_const and isinstance(index.const, int):
                parts = self.parts(node, owner)
                return parts[self._known_place(node, index.const, len(parts))]
            if owner.const and isinstance(owner.const, tuple) and all(isinstance(x, int | float) for x in owner.const):
                place = self.offset(node, owner, ArrayOf(REAL, (len(owner.const),)), [index], indices)
                return Value(widen_kind(Const(sum(owner.const))), f"{self.table(owner, ast.unparse(node.value))}[{place}]")
            raise self.refuse(node, ast.unparse(node)[:80], "a place in a tuple that is known")
        array = self.array_kind(node, owner)
        if len(indices) > len(array.shape):
            raise self.refuse(node, ast.unparse(node)[:80], f"at most {len(array.shape)} places")
        if isinstance(indices[-1], ast.Slice):
            return self._view(node, owner, array, indices)
        places = [self.value(index) for index in indices]
        if len(places) == len(array.shape) and isinstance(owner.const, np.ndarray) and all(p.is_const for p in places):
            constants = [self._known_place(node, p.const, n) for p, n in zip(places, array.shape, strict=True)]
            return self.const(owner.const[tuple(constants)].item())
        name = self.table(owner, ast.unparse(node.value)) if isinstance(owner.const, np.ndarray) else self.pointer(owner)
        offset = self.offset(node, owner, array, places, indices)
        if len(places) == len(array.shape):
            return Value(array.element, f"{name}[{offset}]", ATOM, owner.root)
        inner = ArrayOf(array.element, array.shape[len(places) :])
        lengths = [
            self.length(owner, axis) if array.shape[axis] is LENGTH else None for axis in range(len(places), len(array.shape))
        ]
        return self.array(inner, f"{name}[{offset}]", lengths, owner.root)

    def array_kind(self, node: ast.AST, value: Value) -> ArrayOf:
        """The kind of an array, constant or not."""
        if isinstance(value.kind, ArrayOf):
            return value.kind
        if isinstance(value.const, np.ndarray):
            return ArrayOf(INT if value.const.dtype.kind in "iu" else REAL, value.const.shape)
        raise self.refuse(node, ast.unparse(node)[:80], "an array or a tuple")

    def _known_place(self, node: ast.AST, place: int, length: Length) -> int:
        """A place that is known, counted from the first entry; of a length that may be unknown."""
        length = None if length is LENGTH else length
        if place >= 0 if length is None else -length <= place < length:
            return place if length is None else place % length
        raise self.refuse(node, ast.unparse(node)[:80], "a place that the array or tuple has")

    def _place(self, node: ast.AST, place: Value, length: Length) -> Value:
        """A place in an axis, negative ones counted from its end as in Python. Kernels have no place outside the axis."""
        if not self.translator.is_checked:
            return place
        if not isinstance(length, int):
            raise self.refuse(node, ast.unparse(node)[:80], "places that are known, or an array of known length")
        return Value(INT, f"tr_place({place.code}, {length}, {FAILED})")

    def offset(
        self,
        node: ast.AST,
        owner: Value,
        array: ArrayOf,
        places: Sequence[Value],
        nodes: Sequence[ast.expr],
        is_slice: bool = False,
    ) -> str:
        """Index of an entry of an array in C order, or of the first one of a slice of its last axis."""
        constant, terms = 0, []
        for axis, place in enumerate(places):
            inner, length = array.shape[axis + 1 :], None if is_slice and axis == len(places) - 1 else array.shape[axis]
            if None in inner or not (place.kind in (INT, BOOL) or isinstance(place.const, int)):
                raise self.refuse(node, ast.unparse(node)[:80], "whole numbers as places, in an array of known shape")
            stride = math.prod(n for n in inner if isinstance(n, int))
            length_codes = [self.length(owner, axis + 1 + i).code for i, n in enumerate(inner) if n is LENGTH]
            factors = [*([str(stride)] if stride != 1 else []), *length_codes]
            if place.is_const:
                index = self._known_place(node, place.const, length)
                constant += 0 if length_codes else stride * index
                terms += [" * ".join([str(index), *factors])] if length_codes and index else []
            else:
                place_value = self._place(node, place, length)
                terms.append(
                    " * ".join([self.code_within(place_value, PRODUCT), *factors])
                    if factors
                    else self.code_within(place_value, SUM)
                )
        constant_names = [ast.unparse(n).rpartition(".")[2] for n in nodes if isinstance(n, ast.Name | ast.Attribute)]
        constant_names = [name for name in constant_names if name.isupper()]
        text = (
            [*terms, f"{constant}{f' /* {constant_names[-1]} */' if constant_names else ''}"]
            if constant or not terms or constant_names
            else terms
        )
        return " + ".join(text)

    def _view(self, node: ast.Subscript, owner: Value, array: ArrayOf, indices: Sequence[ast.expr]) -> Value:
        """A part of the last axis of an array."""
        last_index = indices[-1]
        if not isinstance(last_index, ast.Slice) or last_index.step is not None or len(indices) != len(array.shape):
            raise self.refuse(node, ast.unparse(node)[:80], "a slice of the last axis, without a step")
        lower = self.value(last_index.lower) if last_index.lower else self.const(0)
        count = array.shape[-1] if isinstance(array.shape[-1], int) else None
        if array.shape[-1] is LENGTH and last_index.lower is last_index.upper is None:
            end, length = self.length(owner, len(array.shape) - 1), LENGTH
        else:
            end, length = self.value(last_index.upper) if last_index.upper else self.const(count), None
        if lower.is_const and end.is_const and end.const is not None:
            if count is not None:
                begin, stop, _ = slice(lower.const, end.const).indices(count)
                lower, end = self.const(begin), self.const(stop)
            length = max(self._known_place(node, end.const, None) - lower.const, 0)
        elif self.translator.is_checked:
            raise self.refuse(node, ast.unparse(node)[:80], "a slice with known ends, of an array of known length")
        places = [*(self.value(index) for index in indices[:-1]), lower]
        name = self.table(owner, ast.unparse(node.value)) if isinstance(owner.const, np.ndarray) else self.pointer(owner)
        offset = self.offset(node, owner, array, places, [*indices[:-1], *([last_index.lower] if last_index.lower else [])], True)
        return self.array(ArrayOf(array.element, (length,)), f"{name}[{offset}]", (end,), owner.root)

    def note_written(self, value: Value) -> None:
        """Record that the owner of an array or record is changed here."""
        if value.root is not None:
            self.written.add(value.root)

    def code_within(self, value: Value, precedence: int) -> str:
        """The code of a value inside of an operator."""
        return value.code if value.precedence >= precedence else f"({value.code})"


# Operators

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
    """The operators of one function; `statements.Calls` has its calls."""

    def truth(self, node: ast.AST, value: Value) -> Value:
        """A value as a condition."""
        if value.is_const and isinstance(value.const, bool | int | float):
            return self.const(bool(value.const))
        if value.kind == BOOL:
            return value
        if value.kind in (INT, *REALS):
            return Value(BOOL, f"{self.code_within(value, SHIFTED)} != 0", COMPARED)
        raise self.refuse(node, ast.unparse(node)[:80], "a condition")

    def _binop(self, node: ast.BinOp) -> Value:
        return self.binary(node, node.op, self.value(node.left), self.value(node.right))

    def binary(self, node: ast.AST, op: ast.operator, left_value: Value, right_value: Value) -> Value:
        """Two numbers and an operator between them."""
        if type(op) not in OPERATORS or not all(isinstance(widen_kind(v.kind), Scalar) for v in (left_value, right_value)):
            raise self.refuse(node, ast.unparse(node)[:80], "numbers, with operators of numbers between them")
        sign, precedence, python = OPERATORS[type(op)]
        if left_value.is_const and right_value.is_const:
            try:
                return self.const(python(left_value.const, right_value.const))
            except (ArithmeticError, ValueError, TypeError):
                pass
        kind = join_kinds(join_kinds(INT, left_value.kind), right_value.kind) or REAL
        if sign == "**":
            return self._power(left_value, right_value)
        if sign in ("%", "/") and isinstance(op, ast.Mod | ast.FloorDiv):
            helper = "modulo" if isinstance(op, ast.Mod) else "floored"
            return self.helper_call(
                f"{helper}_{'real' if kind in REALS else 'int'}", [left_value, right_value], narrow_kind(kind)
            )
        if sign == "/":
            kind = join_kinds(kind, REAL) or REAL
            if left_value.kind not in REALS and right_value.kind not in REALS:
                left_value = Value(REAL, self.as_real(left_value), UNARY)
        if sign in OF_WHOLE_NUMBERS and kind in REALS:
            raise self.refuse(node, ast.unparse(node)[:80], "whole numbers")
        if (
            self.translator.is_checked
            and sign in ("<<", ">>")
            and not (right_value.is_const and 0 <= right_value.const < BITS_OF_INT)
        ):
            raise self.refuse(node, ast.unparse(node)[:80], f"a known number of bits below {BITS_OF_INT}")
        if sign in OF_WHOLE_NUMBERS and left_value.kind == right_value.kind == BOOL:
            kind = BOOL
        if kind in REALS:
            left_value, right_value = self._real_pair(left_value, right_value, kind)
        low = SUM if sign in ("<<", ">>") else UNARY if sign in ("&", "|", "^") else precedence
        right_low = low if sign in OF_WHOLE_NUMBERS else precedence + 1
        return Value(kind, f"{self.code_within(left_value, low)} {sign} {self.code_within(right_value, right_low)}", precedence)

    def _real_pair(self, left_value: Value, right_value: Value, kind: Kind) -> tuple[Value, Value]:
        """Convert both to real numbers, constants none wider than a `float`."""
        pair = []
        for v in (left_value, right_value):
            code = self.as_kind(v, kind)
            pair.append(v if code == v.code else replace(v, code=code, precedence=UNARY))
        return pair[0], pair[1]

    def as_real(self, value: Value) -> str:
        """The code of a number as a real one."""
        if value.is_const:
            return self.translator.literal(float(value.const))
        if value.kind in REALS:
            return self.as_kind(value, REAL)
        return f"({self.translator.number(REAL)}){self.code_within(value, UNARY)}"

    def _power(self, base: Value, exponent: Value) -> Value:
        if exponent.is_const and exponent.const == 2 and base.kind == INT and base.code.replace("_", "").isalnum():
            return Value(widen_kind(base.kind), f"{base.code} * {base.code}", PRODUCT)
        return Value(REAL, f"{self.translator.call('pow')}({self.as_real(base)}, {self.as_real(exponent)})")

    def _unaryop(self, node: ast.UnaryOp) -> Value:
        if isinstance(node.op, ast.Not):
            truth = self.condition(node.operand)
            return self.const(not truth.const) if truth.is_const else Value(BOOL, f"!{self.code_within(truth, UNARY)}", UNARY)
        operand = self.value(node.operand)
        if not isinstance(widen_kind(operand.kind), Scalar) or not isinstance(node.op, ast.USub | ast.UAdd):
            raise self.refuse(node, ast.unparse(node)[:80], "a number with a sign, or not")
        if isinstance(node.op, ast.UAdd):
            return operand
        return (
            self.const(-operand.const)
            if operand.is_const
            else Value(widen_kind(operand.kind), f"-{self.code_within(operand, ATOM)}", UNARY)
        )

    def condition(self, node: ast.expr) -> Value:
        """An expression that is only tested for its truth."""
        if isinstance(node, ast.BoolOp):
            return self._logical(node, self._until_decided(node, self.condition))
        return self.truth(node, self.value(node))

    def _until_decided(self, node: ast.BoolOp, read: Callable[[ast.expr], Value]) -> list[Value]:
        """The operands of `and` or `or`, up to one that is known to decide."""
        operands: list[Value] = []
        for operand in node.values:
            operands.append(self.guarded_value(operand, read) if operands else read(operand))
            if self.truth(operand, operands[-1]).const is isinstance(node.op, ast.Or):
                break
        return operands

    def _logical(self, node: ast.BoolOp, values: Sequence[Value]) -> Value:
        """Operands that are truth values."""
        decider = isinstance(node.op, ast.Or)  # the value that decides
        operands = [v for v in values if not v.is_const or v.const is decider]
        if len(operands) < 2:
            return operands[0] if operands else self.const(not decider)
        sign, precedence = ("||", OR) if decider else ("&&", AND)
        return Value(BOOL, f" {sign} ".join(self.code_within(v, COMPARED) for v in operands), precedence)

    def _boolop(self, node: ast.BoolOp) -> Value:
        values = self._until_decided(node, self.value)
        if all(widen_kind(v.kind) == BOOL for v in values):
            return self._logical(node, values)
        result = values[-1]
        for value in values[-2::-1]:  # the answer is an operand, not its truth
            if any(call.writes and f"{call.name}(" in value.code for call in self.calls):
                raise self.refuse(node, ast.unparse(node)[:80], "operands that change nothing")
            branches = (value, result) if isinstance(node.op, ast.Or) else (result, value)
            result = self._choice(node, self.truth(node, value), *branches)
        return result

    def _compare(self, node: ast.Compare) -> Value:
        values = [self.value(operand) for operand in (node.left, *node.comparators)]
        comparisons: list[str] = []
        for op, left_value, right_value in zip(node.ops, values, values[1:], strict=False):
            if type(op) not in COMPARISONS or not all(isinstance(widen_kind(v.kind), Scalar) for v in (left_value, right_value)):
                raise self.refuse(node, ast.unparse(node)[:80], "numbers that are compared")
            sign, python = COMPARISONS[type(op)]
            if left_value.is_const and right_value.is_const:
                if not python(left_value.const, right_value.const):
                    return self.const(False)
                continue
            if left_value.kind in REALS or right_value.kind in REALS:
                left_value, right_value = self._real_pair(
                    left_value, right_value, WIDE if WIDE in (left_value.kind, right_value.kind) else REAL
                )
            comparisons.append(f"{self.code_within(left_value, SHIFTED)} {sign} {self.code_within(right_value, SHIFTED)}")
        if not comparisons:
            return self.const(True)
        return Value(BOOL, comparisons[0], COMPARED) if len(comparisons) == 1 else Value(BOOL, " && ".join(comparisons), AND)

    def _ifexp(self, node: ast.IfExp) -> Value:
        test = self.condition(node.test)
        if test.is_const:
            return self.value(node.body if test.const else node.orelse)
        return self._choice(node, test, self.guarded_value(node.body, self.value), self.guarded_value(node.orelse, self.value))

    def _choice(self, node: ast.AST, test: Value, then_value: Value, else_value: Value) -> Value:
        """One of two values, by a condition."""
        if test.is_const:
            return then_value if test.const else else_value
        kind = join_kinds(widen_kind(then_value.kind), else_value.kind)
        if kind is None or isinstance(kind, Const):
            raise self.refuse(node, ast.unparse(node)[:80], "two values of one kind")
        codes = [
            v.code if isinstance(kind, Scalar) and not v.is_const else self.as_kind(v, kind) for v in (then_value, else_value)
        ]
        then_code = codes[0] if then_value.precedence > TERNARY else f"({codes[0]})"
        return Value(kind, f"{self.code_within(test, OR)} ? {then_code} : {codes[1]}", TERNARY)

    def helper_call(self, name: str, values: Sequence[Value], kind: Kind) -> Value:
        """A call of a function of the file's own, see templates/helpers.c."""
        codes = [self.as_kind(v, kind) for v in values]
        return Value(kind, f"tr_{name}({', '.join(codes)})")
