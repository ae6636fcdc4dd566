# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Loads a user's file of effects with the arithmetic of C.

A division by 0, an overflow or a root of a negative number gives inf or nan there, and no error: in plain Python so do numpy's
numbers, with which `Effect.run` calls it, and these functions. Other errors stay: of `int`, `floor` and such where there is no
whole number, and of places that a table lacks.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from importlib.machinery import SourceFileLoader
from types import CodeType, ModuleType
from typing import Any

import numpy as np

from trackres_ros.kernels.kinds import LARGEST_WHOLE

OF_NUMPY = {"pow": "float_power", **{f"a{name}": f"arc{name}" for name in ("sin", "cos", "cosh", "tanh")}}


class Function:
    """A function of `math` or of Python; in C it is that `of` which it is made."""

    def __init__(self, of: Callable[..., Any]) -> None:
        self.of = of


class Forgiving(Function):
    """It answers as numpy where Python raises an error."""

    def __call__(self, *given: Any) -> Any:
        """Call it."""
        try:
            return self.of(*given)
        except (ArithmeticError, ValueError):
            name = self.of.__name__
            return getattr(np, OF_NUMPY.get(name, name))(*given)


class Whole(Function):
    """It gives a whole number, with an error where C has no such number."""

    def __call__(self, *given: Any) -> Any:
        """Call it."""
        if not abs(found := self.of(*given)) < LARGEST_WHOLE:
            raise OverflowError
        return found


def _replaced(value: Any) -> Any:
    name = getattr(value, "__name__", "")
    if value in (int, math.floor, math.ceil, math.trunc):
        return Whole(value)
    return Forgiving(value) if isinstance(getattr(np, OF_NUMPY.get(name, name), None), np.ufunc) else value


MATH = ModuleType("math")
MATH.__dict__.update({name: _replaced(value) for name, value in vars(math).items()})
REPLACED = {id(math): MATH, id(int): _replaced(int), **{id(value): vars(MATH)[name] for name, value in vars(math).items()}}


class AsItIs(SourceFileLoader):
    """Loads a file in its present version: cached bytecode is compared with its file only by whole seconds and size."""

    def get_code(self, fullname: str) -> CodeType:
        """Compile it."""
        path = self.get_filename(fullname)
        return self.source_to_code(self.get_data(path), path)

    def exec_module(self, module: ModuleType) -> None:
        """Run the file, and replace what it knows of `math`."""
        super().exec_module(module)
        module.__dict__.update({name: REPLACED.get(id(value), value) for name, value in vars(module).items()})
        module.__dict__["int"] = REPLACED[id(int)]
