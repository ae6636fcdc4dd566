# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Translates branches, loops and returns, and the whole of a function: repeatedly until the kinds of its variables are stable."""

from __future__ import annotations

import ast
from typing import Any

from trackres_ros.kernels.expressions import UNARY, Value
from trackres_ros.kernels.functions import Instance, Translator
from trackres_ros.kernels.kinds import FAILED, INT, ArrayOf, Const, Kind, Scalar, join_kinds, narrow_kind, safe_name, widen_kind
from trackres_ros.kernels.statements import Statements

MOST_PASSES = 12


def translate_body(translator: Translator, instance: Instance) -> None:
    """Fill in the text, the returned kind and other attributes of an instance."""
    body = Body(translator, instance)
    state: Any = None
    for _ in range(MOST_PASSES):
        body.run()
        if body.found == state:
            break
        state = body.found
    instance.text = body.text
    instance.has_failure = FAILED in instance.text
    instance.calls = [callee for callee in body.calls if f"{callee.name}(" in instance.text or "tr_call_effect(" in instance.text]


class Body(Statements):
    """The whole body of one function."""

    def _if_statement(self, node: ast.If, depth: int, chained: str = "") -> bool:
        line_count = len(self._lines)
        test = self.condition(node.test)
        if chained and len(self._lines) > line_count:  # what the test needs is computed only where it is reached
            del self._lines[line_count:]
            self.line("} else {", depth)
            has_ended = self.inner([node], depth + 1)
            self.line("}", depth)
            return has_ended
        if test.is_const:
            branch = node.body if test.const else node.orelse
            if not chained:
                return self.block(branch, depth)
            self.line("} else {", depth)
            has_ended = self.inner(branch, depth + 1)
            self.line("}", depth)
            return has_ended
        self.line(f"{chained}if ({test.code}) {{", depth)
        has_ended = self.inner(node.body, depth + 1)
        if len(node.orelse) == 1 and isinstance(node.orelse[0], ast.If):
            self._depth = depth
            line_count = len(self._lines)
            with self.braces():
                else_ended = self._if_statement(node.orelse[0], depth, "} else ")
            if self._lines[line_count:] == [f"{'    ' * depth}}} else {{\n", f"{'    ' * depth}}}\n"]:
                self._lines[line_count:] = [f"{'    ' * depth}}}\n"]
            return has_ended and else_ended
        else_ended = False
        if node.orelse:
            self.line("} else {", depth)
            else_ended = self.inner(node.orelse, depth + 1)
        self.line("}", depth)
        return has_ended and else_ended

    def _return_statement(self, node: ast.Return, depth: int) -> bool:
        value = self.const(None) if node.value is None else self.value(node.value)
        if value.const is None and value.is_const:
            if self.instance.returns is not None:
                raise self.refuse(node, "None", "a value, as at the other ends")
            self.line("return;", depth)
            return True
        if isinstance(value.kind, ArrayOf):
            self.note_written(value)
        elif value.is_const and not isinstance(value.const, bool | int | float | tuple):
            raise self.refuse(node, ast.unparse(node)[:80], "numbers, or a tuple of them")
        kind = join_kinds(self.instance.returns, narrow_kind(value.kind))
        if kind is None:
            raise self.refuse(node, ast.unparse(node)[:80], "the kind of value that the other ends give")
        self.instance.returns = kind
        if not isinstance(kind, Const):
            self.line(f"return {self.as_kind(value, kind)};", depth)
        elif self.written:
            self.instance.returns = widen_kind(kind)
        return True

    def _for_statement(self, node: ast.For, depth: int) -> bool:
        if not isinstance(node.target, ast.Name):
            raise self.refuse(node, ast.unparse(node.target), "one variable in a loop")
        if node.target.id in self._within:
            raise self.refuse(node, f"{node.target.id} of a loop within its own", "a name of its own for each loop")
        of_range = isinstance(node.iter, ast.Call) and isinstance(node.iter.func, ast.Name) and node.iter.func.id == "range"
        head = self._range(node, depth) if of_range else self._entries(node, depth)
        if head is None:
            return False
        flag = self.temporary("completed") if node.orelse else ""
        if flag:
            self.line(f"bool {flag} = true;", depth)
        self._loops.append(flag)
        self.line(f"{head[0]} {{", depth)
        name = node.target.id
        with self.braces():
            self.kinds[name] = join_kinds(self.kinds.get(name), head[1].kind) or INT
            self._within.append(name)
            if head[1].code and (self.found is None or name in self._read_before):
                self.line(f"const {self.translator.declaration(self.kinds[name])}{safe_name(name)} = {head[1].code};", depth + 1)
            self.block(node.body, depth + 1)
        self._within.pop()
        self.line("}", depth)
        self._loops.pop()
        if flag:
            self.line(f"if ({flag}) {{", depth)
            self.inner(node.orelse, depth + 1)
            self.line("}", depth)
        return False

    def _range(self, node: ast.For, depth: int) -> tuple[str, Value] | None:
        """The head of a loop over integers; None if it never runs."""
        assert isinstance(node.iter, ast.Call)
        assert isinstance(node.target, ast.Name)
        arguments = self.spread(node.iter.args)
        start, stop = (self.const(0), arguments[0]) if len(arguments) == 1 else arguments[:2]
        step = arguments[2] if len(arguments) > 2 else self.const(1)
        if not step.is_const or step.const == 0 or not all(widen_kind(v.kind) == INT for v in (start, stop)):
            raise self.refuse(node, ast.unparse(node.iter), "a range of whole numbers with a step that is known")
        if start.is_const and stop.is_const and not range(start.const, stop.const, step.const):
            return None
        if not stop.is_const:  # the loop may change what it is computed from
            name = self.temporary("until")
            self.line(f"const int64_t {name} = {stop.code};", depth)
            stop = Value(INT, name)
        name, sign = safe_name(node.target.id), "<" if step.const > 0 else ">"
        increment = "++" if step.const == 1 else f" += {step.const}" if step.const > 0 else f" -= {-step.const}"
        return f"for (int64_t {name} = {start.code}; {name} {sign} {stop.code}; {name}{increment})", Value(INT, "")

    def _entries(self, node: ast.For, depth: int) -> tuple[str, Value] | None:
        """The head of a loop over the numbers of a tuple."""
        values = self.parts(node.iter, self.value(node.iter))
        kind: Kind | None = None
        for value in values:
            kind = join_kinds(kind, widen_kind(value.kind))
        if not isinstance(kind, Scalar):
            raise self.refuse(node, ast.unparse(node.iter)[:80], "range, or a tuple of numbers")
        name, index = self.temporary("entries"), self.temporary("entry")
        codes = ", ".join(self.as_kind(value, kind) for value in values)
        self.line(f"const {self.translator.number(kind)} {name}[{len(values)}] = {{{codes}}};", depth)
        return f"for (int64_t {index} = 0; {index} < {len(values)}; {index}++)", Value(kind, f"{name}[{index}]")

    def _while_statement(self, node: ast.While, depth: int) -> bool:
        if node.orelse:
            raise self.refuse(node, "else of a while", "a while without else")
        line_count = len(self._lines)
        test = self.condition(node.test)
        if test.is_const and not test.const:
            return False
        has_setup = len(self._lines) > line_count  # what the test needs is computed before each round
        del self._lines[line_count:]
        self.line(f"while ({'true' if has_setup else test.code}) {{", depth)
        self._loops.append("")
        with self.braces():
            if has_setup:
                self._depth = depth + 1
                test = self.condition(node.test)
                self.line(f"if (!{self.code_within(test, UNARY)}) {{", depth + 1)
                self.line("    break;", depth + 1)
                self.line("}", depth + 1)
            self.block(node.body, depth + 1)
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
