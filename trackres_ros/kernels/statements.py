# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Translates calls, assignments and the other statements without branches, and finds the variables of a function.

Python's variables are valid in a whole function; C declares them in the smallest block that has all of their uses.
"""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from types import FunctionType
from typing import Any

import numpy as np

from trackres_ros.kernels.expressions import UNARY, Operators, Value
from trackres_ros.kernels.functions import Instance, Translator
from trackres_ros.kernels.kinds import (
    ASKED,
    BOOL,
    FAILED,
    INT,
    REAL,
    REALS,
    SAME_IN_C,
    TO_WHOLE,
    WIDE,
    ArrayOf,
    Const,
    Kind,
    Record,
    Scalar,
    join_kinds,
    narrow_kind,
    safe_name,
    widen_kind,
    words,
)
from trackres_ros.kernels.rows import Row

# Blocks of variables

Path = tuple[int, ...]  # a block, within its parents


class Scopes:
    """Records the uses of each variable in the order of the text; the next pass knows the blocks of its declarations."""

    def __init__(self) -> None:
        self._uses: dict[str, list[tuple[Path, bool]]] = {}
        self._blocks: dict[str, list[Path]] = {}
        self._declared: set[tuple[str, Path]] = set()

    def begin(self) -> None:
        """Begin a pass, with the records of the one before."""
        self._blocks = {name: _smallest_blocks(uses) for name, uses in self._uses.items()}
        self._uses, self._declared = {}, set()

    @property
    def at_top(self) -> list[str]:
        """Variables that must be declared before all statements."""
        return sorted(name for name, blocks in self._blocks.items() if not blocks)

    def add_use(self, name: str, block: Path, stored: bool) -> None:
        """A variable is used in a block: it gets a value, or is looked at."""
        self._uses.setdefault(name, []).append((block, stored))

    def declares(self, name: str, block: Path) -> bool:
        """Whether a value stored now is the first in its block, where the variable is declared."""
        if block not in self._blocks.get(name, [block]) or (name, block) in self._declared:
            return False
        self._declared.add((name, block))
        return True


def _smallest_blocks(uses: list[tuple[Path, bool]]) -> list[Path]:
    """The outermost blocks that store a variable, if each begins with that and there is no use outside; else none."""
    stores = {block for block, is_store in uses if is_store}
    prefixes = [
        block for block in stores if not any(block != candidate and block[: len(candidate)] == candidate for candidate in stores)
    ]
    if any(not any(block[: len(prefix)] == prefix for prefix in prefixes) for block, _ in uses):
        return []
    for prefix in prefixes:
        first_use = next(use for use in uses if use[0][: len(prefix)] == prefix)
        if first_use != (prefix, True):
            return []
    return prefixes


# Calls

OF_NUMPY = {"abs": "fabs", "absolute": "fabs", "arctan": "atan", "arctan2": "atan2", "arcsin": "asin", "arccos": "acos"}
OF_MATH = ("trunc", *TO_WHOLE, *ASKED, *SAME_IN_C)
ALLOWED = f"abs, min, max, int, float, bool, and of math {', '.join(OF_MATH)}, of one number or two"

REMAINDERS = ("remainder", "mod")  # of numpy


class Calls(Operators):
    """The calls of one function; `Statements` has its statements."""

    def _call(self, node: ast.Call) -> Value:
        target = self.value(node.func)
        function = getattr(target.const, "function", target.const)
        if not target.is_const or not callable(function):
            raise self.refuse(node, ast.unparse(node)[:80], "a call of a function that is known")
        if isinstance(function, type) and hasattr(function, "_fields"):
            return self._record(node, function)
        values = self.spread(node.args)
        if isinstance(function, type) and issubclass(function, Row):
            array = self.array_kind(node, values[0])
            code = (
                self.table(values[0], "row") if values[0].is_const else self.as_kind(values[0], ArrayOf(array.element, (None,)))
            )
            return replace(values[0], kind=ArrayOf(array.element, (function.columns,), function.names), code=code)
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
        parts = [values[name] for name in cls._fields]
        reals = {name for name, kind in cls.__annotations__.items() if kind in ("float", float)}
        kinds = [REAL if name in reals else narrow_kind(widen_kind(v.kind)) for name, v in zip(cls._fields, parts, strict=True)]
        return self.tuple_of(parts, Record(words(cls.__name__), tuple(zip(cls._fields, kinds, strict=True))))

    def call_of(self, node: ast.Call, function: FunctionType, values: list[Value]) -> Value:
        """A call of another translated function."""
        names = [a.arg for a in self.translator.source(function).tree.args.args]
        arguments = dict(zip(names, values, strict=False)) | {str(k.arg): self.value(k.value) for k in node.keywords}
        defaults = dict(zip(names[::-1], (function.__defaults__ or ())[::-1], strict=False))
        arguments = {name: self.const(value) for name, value in defaults.items()} | arguments
        if set(arguments) != set(names) or len(values) > len(names):
            raise self.refuse(node, ast.unparse(node)[:80], f"the arguments {', '.join(names)}")
        argument_values = [arguments[name] for name in names]
        kinds = [v.kind if isinstance(v.const, np.ndarray) else self._passed(v.kind) for v in argument_values]
        instance = self.translator.instance(function, kinds)
        for name, v in arguments.items():
            if name in instance.writes:
                if isinstance(v.const, np.ndarray):
                    raise self.refuse(node, ast.unparse(node)[:80], "an array that may change")
                self.note_written(v)
        if not instance.writes and (instance.returns is None or isinstance(instance.returns, Const)):
            return self.const(instance.returns.value if isinstance(instance.returns, Const) else None)
        self.calls.append(instance)
        codes = [self.argument(arguments[name], kind) for name, kind in instance.given] + [FAILED] * instance.has_failure
        kind = Const(None) if instance.returns is None else instance.returns
        return Value(kind, f"{instance.name}({', '.join(codes)})")

    def _passed(self, kind: Kind) -> Kind:
        """The kind of a parameter: single numbers are no constants, so that there is one function for all of them."""
        return widen_kind(kind) if isinstance(kind, Const) and isinstance(kind.value, bool | int | float) else narrow_kind(kind)

    def argument(self, value: Value, kind: Kind) -> str:
        """The code of an argument; of a record its address."""
        if not isinstance(kind, Record):
            return self.as_kind(value, kind)
        if value.by_pointer:
            return value.code
        is_place = value.code.startswith("(struct ") or value.code.replace(".", "").replace("->", "").replace("_", "").isalnum()
        return f"&{value.code if is_place else self.hoist(value, kind)}"

    def hoist(self, value: Value, kind: Kind) -> str:
        """The name of a variable that holds a value from before the statement."""
        raise NotImplementedError

    def _of_library(self, node: ast.Call, function: Any, values: list[Value]) -> Value:
        """A call of a function of Python, math or numpy on numbers."""
        if function is len and len(values) == 1:
            operand = values[0]
            if isinstance(operand.const, tuple | np.ndarray):
                return self.const(len(operand.const))
            if isinstance(operand.kind, ArrayOf) and operand.kind.shape[0] is not None:
                return self.length(operand, 0)
        if not values or not all(isinstance(widen_kind(v.kind), Scalar) for v in values):
            raise self.refuse(node, ast.unparse(node)[:80], "numbers as arguments")
        if all(v.is_const for v in values):
            try:
                return self.const(function(*(v.const for v in values)))
            except (ArithmeticError, ValueError, TypeError):
                pass
        result = self._of_numbers(function, values)
        if result is None:
            raise self.refuse(node, ast.unparse(node)[:80], ALLOWED)
        return result

    def _of_numbers(self, function: Any, values: list[Value]) -> Value | None:
        operand, name = values[0], getattr(function, "__name__", "")
        module = "numpy" if isinstance(function, np.ufunc) else getattr(function, "__module__", "")
        name = OF_NUMPY.get(name, name) if module == "numpy" else name
        if function in (min, max) and len(values) > 1:
            return self._extreme_call(name, values)
        if module not in ("math", "numpy", "builtins") or len(values) != SAME_IN_C.get(name, 2 if name in REMAINDERS else 1):
            return None
        if function is float:
            return Value(REAL, self.as_real(operand), operand.precedence if operand.kind == REAL else UNARY)
        if function in (int, math.trunc):
            return operand if operand.kind not in REALS else self._whole_number(self.as_real(operand))
        if function is bool:
            return self.truth(ast.Constant(0), operand)
        if function is abs or name == "fabs":
            if widen_kind(operand.kind) == INT:
                return Value(INT, f"tr_abs_int({operand.code})")
            return Value(REAL, f"{self.translator.call('fabs')}({self.as_real(operand)})")
        if module == "math" and name in TO_WHOLE:
            return self._whole_number(f"{self.translator.call(name)}({self.as_real(operand)})")
        if name in ASKED:
            return Value(BOOL, f"{name}({self.as_real(operand)})")
        if name in REMAINDERS and module == "numpy":
            return self.helper_call("modulo_real", values, REAL)
        if name in SAME_IN_C:
            return Value(REAL, f"{self.translator.call(name)}({', '.join(map(self.as_real, values))})")
        return None

    def _whole_number(self, code: str) -> Value:
        """A whole number. Without one, nan or infinity, the effect is left out, as in Python."""
        return Value(INT, f"tr_whole_number({code}, {FAILED})" if self.translator.is_checked else f"tr_whole({code})")

    def _extreme_call(self, name: str, values: list[Value]) -> Value:
        kind = narrow_kind(join_kinds(join_kinds(INT, widen_kind(values[0].kind)), widen_kind(values[1].kind)) or REAL)
        result = self.helper_call(f"{name}_{'real' if kind == REAL else 'int'}", values[:2], kind)
        return self._extreme_call(name, [result, *values[2:]]) if len(values) > 2 else result


# Statements

ENTRIES = ast.Subscript | ast.Attribute  # of an array
COMMENT = re.compile(r"/\*.*?\*/")
ONLY_STORED = re.compile(r"^\s*(?:(?:const )?(?:struct )?\w+ \*?)?\w+ [-+*/|&]?= ")
NAME = re.compile(r"(?<![\w.])(?<!->)[A-Za-z_]\w*")


class Statements(Calls):
    """The statements of one function; `flow.Body` has those that branch and repeat."""

    def __init__(self, translator: Translator, instance: Instance) -> None:
        super().__init__(translator, instance)
        self._tree = instance.source.tree
        self._stores = instance.source.stores
        self._parameters = {a.arg for a in self._tree.args.args}
        self._of_loops = set(instance.source.loops)
        for name, count in instance.source.loops.items():
            if name in self._parameters or self._stores[name] != count:
                raise self.refuse(self._tree, f"{name} of a loop that has another meaning too", "a name of its own for it")
        self._within: list[str] = []
        self._read_before: set[str] = set()
        self._scopes = Scopes()
        self.kinds = {name: widen_kind(kind) if self._stores[name] else kind for name, kind in instance.arguments.items()}
        self.pointers = {n for n, k in instance.arguments.items() if isinstance(k, Record)}
        self.text = ""
        self.found: Any = None

    def run(self) -> None:
        """Translate the whole body once."""
        self.calls, self._number = [], 0
        self._lines: list[str] = []
        self._path: Path = (0,)
        self._blocks = 0
        self._loops: list[str] = []
        self._within = []
        self._scopes.begin()
        has_ended = self.block(self._tree.body, 1)
        if not has_ended and self.instance.returns is not None:
            raise self.refuse(self._tree, "a way to its end without a value", "a return at each end")
        at_top = [name for name in self._scopes.at_top if name in self._read_before]
        lines = [self._declaration(name) for name in at_top if self._is_stored(name)]
        self.text = "".join(f"    {line}\n" for line in lines) + "".join(self._lines)
        for name in [*self.written]:  # a change of a view changes its array
            while (parent := self.parents.get(name)) is not None and parent not in self.written:
                self.written.add(parent)
                name = parent
        self._read_before = self._read_names()
        self.instance.reads = self._parameters & self._read_before
        self.instance.writes = self._parameters & self.written
        self.found = dict(self.kinds), set(self._read_before), set(self.written), self.instance.returns, self.text

    def _read_names(self) -> set[str]:
        """Names whose value is used: not those that are only assigned."""
        names = {name for line in self._lines for name in NAME.findall(ONLY_STORED.sub("", COMMENT.sub("", line)))}
        return {name for name in (*self.kinds, *self._parameters) if safe_name(name) in names}

    # Lines

    def line(self, text: str, depth: int) -> None:
        """Write a line."""
        self._lines.append(f"{'    ' * depth}{text}\n")

    def temporary(self, name: str) -> str:
        """A new name."""
        self._number += 1
        free_name = f"{name}_{self._number}"
        return self.temporary(name) if free_name in self._stores or free_name in self._parameters else free_name

    def hoist(self, value: Value, kind: Kind) -> str:
        """See `Calls`."""
        name = self.temporary("given")
        self.line(f"const {self.translator.declaration(kind)}{name} = {self.as_kind(value, kind)};", self._depth)
        return name

    def guarded_value(self, node: ast.expr, read: Callable[[ast.expr], Value]) -> Value:
        """See `Expressions`."""
        line_count = len(self._lines)
        value = read(node)
        if len(self._lines) > line_count:
            raise self.refuse(node, ast.unparse(node)[:80], "a call with a tuple in a statement of its own, or in an if")
        return value

    def note_place(self, name: str) -> None:
        """See `Expressions`."""
        if name in self._of_loops and name not in self._within:
            raise self.refuse(self._tree, f"{name} behind its loop", "a variable that the loop fills")
        if name not in self._of_loops and name not in self._parameters:
            self._scopes.add_use(name, self._path, False)

    def block(self, statements: Sequence[ast.stmt], depth: int) -> bool:
        """Statements in a row; return whether none of them lets the next one run."""
        for statement in statements:
            self._depth = depth
            method = getattr(self, f"_{type(statement).__name__.lower()}_statement", None)
            if method is None:
                raise self.refuse(statement, ast.unparse(statement)[:60], "assignments, if, for, while and return")
            if method(statement, depth):
                return True
        return False

    @contextmanager
    def braces(self) -> Iterator[None]:
        """Translate what follows within braces."""
        self._blocks += 1
        old_path, self._path = self._path, (*self._path, self._blocks)
        yield
        self._path = old_path

    def inner(self, statements: Sequence[ast.stmt], depth: int) -> bool:
        """A block within braces."""
        with self.braces():
            return self.block(statements, depth)

    # Variables

    def _is_stored(self, name: str) -> bool:
        kind = self.kinds.get(name)
        return not isinstance(kind, Const) and not (isinstance(kind, Record) and not list(kind.stored_fields()))

    def _declaration(self, name: str) -> str:
        kind = self.kinds[name]
        real = self.translator.literal(0.0)
        zero = {INT: "0", REAL: real, WIDE: real}.get(kind, "false") if isinstance(kind, Scalar) else "{0}"
        zero = "0" if isinstance(kind, ArrayOf) and not kind.lengths else zero
        return f"{self.translator.declaration(kind, name in self.written)}{safe_name(name)} = {zero};"

    def assign(self, node: ast.AST, name: str, value: Value, depth: int) -> None:
        """A variable gets a value."""
        kind = value.kind if self._stores[name] == 1 and name not in self._parameters else widen_kind(value.kind)
        known = join_kinds(self.kinds.get(name), kind) if name in self.kinds else kind
        if known is None or (isinstance(known, Const) and known.value is None and value.code):
            raise self.refuse(node, f"{name} of two kinds", "one kind of value for a variable")
        if isinstance(known, Record) and name in self._parameters:
            raise self.refuse(node, f"{name} in place of an argument", "another name")
        self.kinds[name] = known
        if name not in self._parameters:
            self._scopes.add_use(name, self._path, True)
        if isinstance(known, ArrayOf) and value.root is not None:
            self.parents[name] = value.root
            if name in self.written:
                self.written.add(value.root)
        if not self._is_stored(name):
            return
        if self.found is not None and name not in self._read_before:
            if any(one.writes and one.name in value.code for one in self.calls):
                self.line(f"(void){self.code_within(value, 8)};", depth)
            return
        code = self.as_kind(value, known)
        if name in self._parameters or not self._scopes.declares(name, self._path):
            self.line(f"{safe_name(name)} = {code};", depth)
            return
        once = "const " if self._stores[name] == 1 and not isinstance(known, ArrayOf) else ""
        if isinstance(known, Record) and code.startswith("(struct "):
            code = code.partition(")")[2]
        self.line(f"{once}{self.translator.declaration(known, name in self.written)}{safe_name(name)} = {code};", depth)

    def _assign_statement(self, node: ast.Assign, depth: int) -> bool:
        first = node.targets[0]
        if isinstance(first, ast.Tuple):
            self._unpack(node, first, depth)
            return False
        value = self.value(node.value)
        if len(node.targets) > 1 and not value.is_const and isinstance(first, ENTRIES):
            name = self.temporary("same")
            self.line(f"const {self.translator.declaration(widen_kind(value.kind))}{name} = {value.code};", depth)
            value = Value(widen_kind(value.kind), name)
        for target in node.targets[::-1]:
            self.store(node, target, value, depth)
        return False

    def store(self, node: ast.AST, target: ast.expr, value: Value, depth: int) -> None:
        """A variable or an entry of an array gets a value."""
        if isinstance(target, ast.Name):
            self.assign(node, target.id, value, depth)
            return
        if not isinstance(target, ENTRIES):
            raise self.refuse(node, ast.unparse(target)[:80], "a variable or an entry of an array")
        of = self.value(target.value)
        if isinstance(of.kind, Const | Record):
            raise self.refuse(node, f"{ast.unparse(target)} that does not change", "a variable, or an array that is an argument")
        place = self.subscript(target, of) if isinstance(target, ast.Subscript) else self.value(target)
        self.note_written(place)
        if isinstance(place.kind, Scalar):
            self.line(f"{place.code} = {self.as_kind(value, place.kind)};", depth)
            return
        is_row = isinstance(place.kind, ArrayOf) and len(place.kind.shape) == 1 and place.kind.shape[0] is not None
        if not is_row or not isinstance(widen_kind(value.kind), Scalar):
            raise self.refuse(node, ast.unparse(target)[:80], "a number into one entry, or into a whole row")
        assert isinstance(place.kind, ArrayOf)
        entry = self.temporary("entry")
        self.line(f"for (int64_t {entry} = 0; {entry} < {self.length(place, 0).code}; {entry}++) {{", depth)
        self.line(f"    {self.pointer(place)}[{entry}] = {self.as_kind(value, place.kind.element)};", depth)
        self.line("}", depth)

    def _unpack(self, node: ast.Assign, target: ast.Tuple, depth: int) -> None:
        """Several values at once: each is computed before the first is stored, if that makes a difference."""
        if isinstance(node.value, ast.Tuple):
            values = self.spread(node.value.elts)
            if len(values) == len(node.value.elts) == len(target.elts):
                values = self._kept_apart(node.value, target, values, depth)
        else:
            whole = self.value(node.value)
            if not whole.is_const and "(" in whole.code:
                name = self.temporary("found")
                self.line(f"const {self.translator.declaration(whole.kind)}{name} = {self.as_kind(whole, whole.kind)};", depth)
                whole = Value(whole.kind, name)
            values = self.parts(node.value, whole)
        if len(values) != len(target.elts):
            raise self.refuse(node, f"{len(values)} values", f"{len(target.elts)} values")
        for one, value in zip(target.elts, values, strict=True):
            self.store(node, one, value, depth)

    def _kept_apart(self, given: ast.Tuple, target: ast.Tuple, values: list[Value], depth: int) -> list[Value]:
        """Values in temporary variables if an earlier target is a part of a later value."""
        stored: set[str] = set()
        entries = False  # whether one was stored: another name may be that of the same array
        kept = []
        for one, node, value in zip(target.elts, given.elts, values, strict=False):
            names = {n.id for n in ast.walk(node) if isinstance(n, ast.Name)}
            looks_up = any(isinstance(n, ast.Call | ENTRIES) for n in ast.walk(node))
            if (stored & names or (entries and looks_up)) and not value.is_const and isinstance(value.kind, Scalar):
                name = self.temporary("old")
                self.line(f"const {self.translator.declaration(value.kind)}{name} = {value.code};", depth)
                value = Value(value.kind, name)
            stored |= {n.id for n in ast.walk(one) if isinstance(n, ast.Name)}
            entries |= isinstance(one, ENTRIES)
            kept.append(value)
        return kept

    def _annassign_statement(self, node: ast.AnnAssign, depth: int) -> bool:
        if node.value is not None:
            self.store(node, node.target, self.value(node.value), depth)
        return False

    def _augassign_statement(self, node: ast.AugAssign, depth: int) -> bool:
        place = self.value(node.target)
        if isinstance(node.target, ENTRIES):
            self.note_written(place)
        value = self.value(node.value)
        result = self.binary(node, node.op, place, value)
        if isinstance(node.target, ast.Name):
            kind = join_kinds(self.kinds.get(node.target.id), widen_kind(result.kind))
            if kind != self.kinds.get(node.target.id):
                self.assign(node, node.target.id, result, depth)
                return False
        sign = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.BitOr: "|", ast.BitAnd: "&"}.get(type(node.op))
        if sign is None or (sign == "/" and place.kind not in REALS):
            self.store(node, node.target, result, depth)
            return False
        if isinstance(node.target, ast.Name) and self.found is not None and node.target.id not in self._read_before:
            return False
        self.line(f"{place.code} {sign}= {self.as_kind(value, place.kind)};", depth)
        return False

    def _expr_statement(self, node: ast.Expr, depth: int) -> bool:
        if isinstance(node.value, ast.Constant):
            return False  # a docstring
        value = self.value(node.value)
        if value.code and not (value.is_const and value.const is not None):
            self.line(f"{'' if value.is_const else '(void)'}{value.code};", depth)
        return False

    def _pass_statement(self, node: ast.Pass, depth: int) -> bool:  # noqa: ARG002
        return False
