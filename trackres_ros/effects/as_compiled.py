# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Loads a user's file for plain Python with the arithmetic of compiled code.

A division by 0, an overflow or a root of a negative number gives inf or nan there, and no error. Other errors stay: of `int`,
`floor` and such where there is no whole number, and of places that a table lacks.
"""

from __future__ import annotations

import ast
import copy
import math
import operator
from collections.abc import Callable
from importlib.machinery import SourceFileLoader
from types import CodeType, ModuleType
from typing import Any

import numpy as np

OPERATORS: dict[type, tuple[Callable[..., Any], Callable[..., Any]]] = {
    ast.Div: (operator.truediv, np.true_divide),
    ast.FloorDiv: (operator.floordiv, np.floor_divide),
    ast.Mod: (operator.mod, np.remainder),
    ast.Pow: (operator.pow, np.float_power),
}
OF_NUMPY = {"pow": "float_power", **{f"a{name}": f"arc{name}" for name in ("sin", "cos", "cosh", "tanh")}}
LARGEST_WHOLE = 9.2e18  # inside of 64 bits


def _without_errors(python: Callable[..., Any], of_numpy: Callable[..., Any]) -> Callable[..., Any]:
    """A function of numbers that answers as numpy where Python raises an error."""

    def apply(*given: Any) -> Any:
        try:
            found = python(*given)
        except (ArithmeticError, ValueError):
            with np.errstate(all="ignore"):
                found = of_numpy(*given).item()
        return math.nan if isinstance(found, complex) else found

    return apply


def _whole(python: Callable[..., Any]) -> Callable[..., Any]:
    """A function that gives whole numbers, with an error where compiled code has no such number."""

    def whole(*given: Any) -> Any:
        if not abs(found := python(*given)) < LARGEST_WHOLE:
            raise OverflowError
        return found

    return whole


def _math() -> ModuleType:
    found = ModuleType("math")
    for name, value in vars(math).items():
        of_numpy = getattr(np, OF_NUMPY.get(name, name), None)
        setattr(found, name, _without_errors(value, of_numpy) if isinstance(of_numpy, np.ufunc) else value)
    found.__dict__.update({name: _whole(getattr(math, name)) for name in ("floor", "ceil", "trunc")})
    return found


MATH = _math()
REPLACED = {id(math): MATH, **{id(value): getattr(MATH, name) for name, value in vars(math).items() if callable(value)}}
APPLIED = {kind.__name__: _without_errors(*both) for kind, both in OPERATORS.items()} | {
    "int": _whole(int), "round": _whole(round), "pow": _without_errors(pow, np.float_power)
}  # fmt: skip
BUILTINS = ("int", "round", "pow")


class _Operators(ast.NodeTransformer):
    def visit_BinOp(self, node: ast.BinOp) -> Any:
        self.generic_visit(node)
        return self._applied(node, node.left, node.right)

    def visit_AugAssign(self, node: ast.AugAssign) -> ast.stmt:
        self.generic_visit(node)
        read = copy.copy(node.target)
        read.ctx = ast.Load()
        applied = self._applied(node, read, node.value)
        return node if applied is node else ast.copy_location(ast.Assign([node.target], applied), node)

    def visit_Call(self, node: ast.Call) -> ast.Call:
        self.generic_visit(node)
        if isinstance(node.func, ast.Name) and node.func.id in BUILTINS:
            node.func.id = f"_{node.func.id}_of_numbers"
        return node

    def _applied(self, node: Any, left: ast.expr, right: ast.expr) -> Any:
        if type(node.op) not in OPERATORS:
            return node
        name = ast.Name(f"_{type(node.op).__name__}_of_numbers", ast.Load())
        return ast.copy_location(ast.Call(name, [left, right], []), node)


class _RealPowers(ast.NodeTransformer):
    """Powers of real numbers, as C has them: of whole ones, machine code gives 0 for 2 ** -1."""

    def visit_BinOp(self, node: ast.BinOp) -> ast.BinOp:
        self.generic_visit(node)
        if isinstance(node.op, ast.Pow) and not (isinstance(node.right, ast.Constant) and isinstance(node.right.value, int)):
            node.left = ast.copy_location(ast.Call(ast.Name("float", ast.Load()), [node.left], []), node.left)
        return node


class AsItIs(SourceFileLoader):
    """Loads a file in its present version: cached bytecode is compared with its file only by whole seconds and size."""

    def path_stats(self, path: str) -> Any:
        """Return no path of bytecode."""
        raise OSError(path)

    def get_code(self, fullname: str) -> CodeType:
        """Compile what `changed` gives."""
        path = self.get_filename(fullname)
        return self.source_to_code(ast.fix_missing_locations(self.changed(ast.parse(self.get_data(path), path))), path)

    def changed(self, tree: ast.AST) -> Any:
        """A file's tree as it is run: with powers of real numbers."""
        return _RealPowers().visit(tree)


class AsCompiled(AsItIs):
    """Loads a file with the arithmetic of compiled code."""

    def changed(self, tree: ast.AST) -> Any:
        """With other operators too."""
        return _Operators().visit(super().changed(tree))

    def exec_module(self, module: ModuleType) -> None:
        """Run the file, and replace what it imported of `math`."""
        module.__dict__.update({f"_{name}_of_numbers": function for name, function in APPLIED.items()})
        super().exec_module(module)
        for name, value in list(vars(module).items()):
            module.__dict__[name] = REPLACED.get(id(value), value)
