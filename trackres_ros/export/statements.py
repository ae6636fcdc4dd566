# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Translates the statements of a function, repeatedly until the kinds of its variables are stable."""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

from trackres_ros.export.calls import Calls
from trackres_ros.export.expressions import Value
from trackres_ros.export.functions import Instance, Translator
from trackres_ros.export.kinds import INT, REAL, ArrayOf, Const, Kind, Record, Scalar, joined, safe, widened
from trackres_ros.export.scopes import Path, Scopes

MOST_PASSES = 12
ENTRIES = ast.Subscript | ast.Attribute  # of an array
COMMENT = re.compile(r"/\*.*?\*/")
ONLY_STORED = re.compile(r"^\s*(?:(?:const )?(?:struct )?\w+ \*?)?\w+ [-+*/|&]?= ")
NAME = re.compile(r"(?<![\w.])(?<!->)[A-Za-z_]\w*")


def translate_body(translator: Translator, one: Instance) -> None:
    """Fill in the text, the returned kind and other attributes of an instance."""
    body = Body(translator, one)
    before: Any = None
    for _ in range(MOST_PASSES):
        body.run()
        if body.found == before:
            break
        before = body.found
    one.text = body.text
    one.calls = [called for called in body.calls if f"{called.name}(" in one.text or "tr_call_effect(" in one.text]


class Body(Calls):
    """The statements of one function."""

    def __init__(self, translator: Translator, one: Instance) -> None:
        super().__init__(translator, one)
        self._tree = one.source.tree
        self._stores = Counter(_stored_names(self._tree))
        self._parameters = {a.arg for a in self._tree.args.args}
        loops = [
            node.target.id for node in ast.walk(self._tree) if isinstance(node, ast.For) and isinstance(node.target, ast.Name)
        ]
        self._of_loops = set(loops)
        for name, count in Counter(loops).items():
            if name in self._parameters or self._stores[name] != count:
                raise self.refuse(self._tree, f"{name} of a loop that has another meaning too", "a name of its own for it")
        self._within: list[str] = []
        self._read_before: set[str] = set()
        self._scopes = Scopes()
        for name, kind in one.arguments.items():
            changes = self._stores[name] > 0
            self.kinds[name] = widened(kind) if changes else kind
        self.pointers = {n for n, k in one.arguments.items() if isinstance(k, Record)}
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
        ended = self.block(self._tree.body, 1)
        if not ended and self.one.returns is not None:
            raise self.refuse(self._tree, "a way to its end without a value", "a return at each end")
        at_top = [name for name in self._scopes.at_top if name in self._read_before]
        declared = [self._declaration(name) for name in at_top if self._is_stored(name)]
        self.text = "".join(f"    {line}\n" for line in declared) + "".join(self._lines)
        self._close_over_parents()
        self._read_before = self._read_names()
        self.one.reads = self._parameters & self._read_before
        self.one.writes = self._parameters & self.written
        self.found = dict(self.kinds), set(self._read_before), set(self.written), self.one.returns, self.text

    def _read_names(self) -> set[str]:
        """Names whose value is used: not those that are only assigned."""
        found: set[str] = set()
        for line in self._lines:
            needed = ONLY_STORED.sub("", COMMENT.sub("", line))
            found.update(NAME.findall(needed))
        return {name for name in (*self.kinds, *self._parameters) if safe(name) in found}

    def _close_over_parents(self) -> None:
        """Record that a change of a view changes its array."""
        for name in [*self.written]:
            parent = self.parents.get(name)
            while parent is not None and parent not in self.written:
                self.written.add(parent)
                parent = self.parents.get(parent)

    # Lines

    def line(self, text: str, depth: int) -> None:
        """Write a line."""
        self._lines.append(f"{'    ' * depth}{text}\n")

    def temporary(self, name: str) -> str:
        """A new name."""
        self._number += 1
        return f"{name}_{self._number}"

    def hoisted(self, value: Value, kind: Kind) -> str:
        """See `Calls`."""
        name = self.temporary("given")
        self.line(f"const {self.translator.declared(kind)}{name} = {self.as_kind(value, kind)};", self._depth)
        return name

    def note_place(self, name: str) -> None:
        """See `Expressions`."""
        if name in self._of_loops and name not in self._within:
            raise self.refuse(self._tree, f"{name} behind its loop", "a variable that the loop fills")
        if name not in self._of_loops and name not in self._parameters:
            self._scopes.see(name, self._path, False)

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

    def inner(self, statements: Sequence[ast.stmt], depth: int) -> bool:
        """A block within braces."""
        self._blocks += 1
        outer, self._path = self._path, (*self._path, self._blocks)
        ended = self.block(statements, depth)
        self._path = outer
        return ended

    # Variables

    def _is_stored(self, name: str) -> bool:
        """Whether a variable has storage in C."""
        kind = self.kinds.get(name)
        return not isinstance(kind, Const) and not (isinstance(kind, Record) and not list(kind.stored()))

    def _declaration(self, name: str) -> str:
        kind = self.kinds[name]
        zero = {INT: "0", REAL: self.translator.literal(0.0)}.get(kind, "false") if isinstance(kind, Scalar) else "{0}"
        zero = "0" if isinstance(kind, ArrayOf) else zero
        return f"{self.translator.declared(kind, name in self.written)}{safe(name)} = {zero};"

    def assign(self, node: ast.AST, name: str, value: Value, depth: int) -> None:
        """A variable gets a value."""
        kind = value.kind if self._stores[name] == 1 and name not in self._parameters else widened(value.kind)
        known = joined(self.kinds.get(name), kind) if name in self.kinds else kind
        if known is None or (isinstance(known, Const) and known.value is None and value.code):
            raise self.refuse(node, f"{name} of two kinds", "one kind of value for a variable")
        if isinstance(known, Record) and name in self._parameters:
            raise self.refuse(node, f"{name} in place of an argument", "another name")
        self.kinds[name] = known
        if name not in self._parameters:
            self._scopes.see(name, self._path, True)
        if isinstance(known, ArrayOf) and value.root is not None:
            self.parents[name] = value.root
            if name in self.written:
                self.written.add(value.root)
        if not self._is_stored(name):
            return
        if self.found is not None and name not in self._read_before:
            if any(one.changes_something and one.name in value.code for one in self.calls):
                self.line(f"(void){self.within(value, 8)};", depth)
            return
        code = self.as_kind(value, known)
        if name in self._parameters or not self._scopes.declares(name, self._path):
            self.line(f"{safe(name)} = {code};", depth)
            return
        once = "const " if self._stores[name] == 1 and not isinstance(known, ArrayOf) else ""
        if isinstance(known, Record) and code.startswith("(struct "):
            code = code.partition(")")[2]
        self.line(f"{once}{self.translator.declared(known, name in self.written)}{safe(name)} = {code};", depth)

    def _assign_statement(self, node: ast.Assign, depth: int) -> bool:
        first = node.targets[0]
        if isinstance(first, ast.Tuple):
            self._unpack(node, first, depth)
            return False
        value = self.value(node.value)
        if len(node.targets) > 1 and not value.is_const and isinstance(first, ENTRIES):
            name = self.temporary("same")
            self.line(f"const {self.translator.declared(widened(value.kind))}{name} = {value.code};", depth)
            value = Value(widened(value.kind), name)
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
        length = place.kind.shape[0] if isinstance(place.kind, ArrayOf) and len(place.kind.shape) == 1 else None
        if length is None or not isinstance(widened(value.kind), Scalar):
            raise self.refuse(node, ast.unparse(target)[:80], "a number into one entry, or into a whole row")
        assert isinstance(place.kind, ArrayOf)
        entry = self.temporary("entry")
        self.line(f"for (int64_t {entry} = 0; {entry} < {length}; {entry}++) {{", depth)
        self.line(f"    ({place.code})[{entry}] = {self.as_kind(value, place.kind.of)};", depth)
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
                self.line(f"const {self.translator.declared(whole.kind)}{name} = {self.as_kind(whole, whole.kind)};", depth)
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
                self.line(f"const {self.translator.declared(value.kind)}{name} = {value.code};", depth)
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
            kind = joined(self.kinds.get(node.target.id), widened(result.kind))
            if kind != self.kinds.get(node.target.id):
                self.assign(node, node.target.id, result, depth)
                return False
        sign = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.BitOr: "|", ast.BitAnd: "&"}.get(type(node.op))
        if sign is None or (sign == "/" and place.kind != REAL):
            self.store(node, node.target, result, depth)
            return False
        if isinstance(node.target, ast.Name) and self.found is not None and node.target.id not in self._read_before:
            return False
        self.line(f"{place.code} {sign}= {self.as_kind(value, place.kind)};", depth)
        return False

    # Flow

    def _expr_statement(self, node: ast.Expr, depth: int) -> bool:
        if isinstance(node.value, ast.Constant):
            return False  # a docstring
        value = self.value(node.value)
        if value.code and not (value.is_const and value.const is not None):
            self.line(f"{'' if value.is_const else '(void)'}{value.code};", depth)
        return False

    def _pass_statement(self, node: ast.Pass, depth: int) -> bool:  # noqa: ARG002
        return False

    def _if_statement(self, node: ast.If, depth: int, chained: str = "") -> bool:
        test = self.truth(node.test, self.value(node.test))
        if test.is_const:
            taken = node.body if test.const else node.orelse
            if not chained:
                return self.block(taken, depth)
            self.line("} else {", depth)
            ended = self.inner(taken, depth + 1)
            self.line("}", depth)
            return ended
        self.line(f"{chained}if ({test.code}) {{", depth)
        ended = self.inner(node.body, depth + 1)
        if len(node.orelse) == 1 and isinstance(node.orelse[0], ast.If):
            self._blocks += 1
            outer, self._path = self._path, (*self._path, self._blocks)
            self._depth = depth
            before = len(self._lines)
            other = self._if_statement(node.orelse[0], depth, "} else ")
            self._path = outer
            if self._lines[before:] == [f"{'    ' * depth}}} else {{\n", f"{'    ' * depth}}}\n"]:
                self._lines[before:] = [f"{'    ' * depth}}}\n"]
            return ended and other
        other = False
        if node.orelse:
            self.line("} else {", depth)
            other = self.inner(node.orelse, depth + 1)
        self.line("}", depth)
        return ended and other

    def _return_statement(self, node: ast.Return, depth: int) -> bool:
        value = self.const(None) if node.value is None else self.value(node.value)
        if value.const is None and value.is_const:
            if self.one.returns is not None:
                raise self.refuse(node, "None", "a value, as at the other ends")
            self.line("return;", depth)
            return True
        if isinstance(value.kind, ArrayOf):
            self.note_written(value)
        elif value.is_const and not isinstance(value.const, bool | int | float | tuple):
            raise self.refuse(node, ast.unparse(node)[:80], "numbers, or a tuple of them")
        kind = joined(self.one.returns, value.kind)
        if kind is None:
            raise self.refuse(node, ast.unparse(node)[:80], "the kind of value that the other ends give")
        self.one.returns = kind
        if not isinstance(kind, Const):
            self.line(f"return {self.as_kind(value, kind)};", depth)
        elif self.written:
            self.one.returns = widened(kind)
        return True

    def _for_statement(self, node: ast.For, depth: int) -> bool:
        if not isinstance(node.target, ast.Name):
            raise self.refuse(node, ast.unparse(node.target), "one variable in a loop")
        head = self._range(node, depth) if _is_range(node.iter) else self._entries(node, depth)
        if head is None:
            return False
        completed = self.temporary("completed") if node.orelse else ""
        if completed:
            self.line(f"bool {completed} = true;", depth)
        self._loops.append(completed)
        self.line(f"{head[0]} {{", depth)
        name = node.target.id
        self._blocks += 1
        outer, self._path = self._path, (*self._path, self._blocks)
        self.kinds[name] = joined(self.kinds.get(name), head[1].kind) or INT
        self._within.append(name)
        if head[1].code and (self.found is None or name in self._read_before):
            self.line(f"const {self.translator.declared(self.kinds[name])}{safe(name)} = {head[1].code};", depth + 1)
        self.block(node.body, depth + 1)
        self._path = outer
        self._within.pop()
        self.line("}", depth)
        self._loops.pop()
        if completed:
            self.line(f"if ({completed}) {{", depth)
            self.inner(node.orelse, depth + 1)
            self.line("}", depth)
        return False

    def _range(self, node: ast.For, depth: int) -> tuple[str, Value] | None:
        """The head of a loop over integers; None if it never runs."""
        assert isinstance(node.iter, ast.Call)
        assert isinstance(node.target, ast.Name)
        given = self.spread(node.iter.args)
        first, until = (self.const(0), given[0]) if len(given) == 1 else given[:2]
        step = given[2] if len(given) > 2 else self.const(1)
        if not step.is_const or step.const == 0 or not all(widened(v.kind) == INT for v in (first, until)):
            raise self.refuse(node, ast.unparse(node.iter), "a range of whole numbers with a step that is known")
        if first.is_const and until.is_const and not range(first.const, until.const, step.const):
            return None
        if not until.is_const and not until.code.isidentifier():
            name = self.temporary("until")
            self.line(f"const int64_t {name} = {until.code};", depth)
            until = Value(INT, name)
        name = safe(node.target.id)
        sign, by = (
            ("<", "++") if step.const == 1 else ("<", f" += {step.const}") if step.const > 0 else (">", f" -= {-step.const}")
        )
        return f"for (int64_t {name} = {first.code}; {name} {sign} {until.code}; {name}{by})", Value(INT, "")

    def _entries(self, node: ast.For, depth: int) -> tuple[str, Value] | None:
        """The head of a loop over the numbers of a tuple."""
        values = self.parts(node.iter, self.value(node.iter))
        kind: Kind | None = None
        for value in values:
            kind = joined(kind, widened(value.kind))
        if not isinstance(kind, Scalar):
            raise self.refuse(node, ast.unparse(node.iter)[:80], "range, or a tuple of numbers")
        name, index = self.temporary("entries"), self.temporary("entry")
        codes = ", ".join(self.as_kind(value, kind) for value in values)
        self.line(f"const {self.translator.number(kind)} {name}[{len(values)}] = {{{codes}}};", depth)
        return f"for (int64_t {index} = 0; {index} < {len(values)}; {index}++)", Value(kind, f"{name}[{index}]")

    def _while_statement(self, node: ast.While, depth: int) -> bool:
        if node.orelse:
            raise self.refuse(node, "else of a while", "a while without else")
        test = self.truth(node.test, self.value(node.test))
        if test.is_const and not test.const:
            return False
        self.line(f"while ({test.code}) {{", depth)
        self._loops.append("")
        self.inner(node.body, depth + 1)
        self._loops.pop()
        self.line("}", depth)
        return False

    def _break_statement(self, node: ast.Break, depth: int) -> bool:  # noqa: ARG002
        if self._loops[-1]:
            self.line(f"{self._loops[-1]} = false;", depth)
        self.line("break;", depth)
        return True

    def _continue_statement(self, node: ast.Continue, depth: int) -> bool:  # noqa: ARG002
        self.line("continue;", depth)
        return True


def _is_range(node: ast.expr) -> bool:
    return isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "range"


def _stored_names(tree: ast.AST) -> Iterator[str]:
    """Each assigned name, as often as it is assigned."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        if isinstance(node, ast.AugAssign) and isinstance(node.target, ast.Name):
            yield node.target.id
