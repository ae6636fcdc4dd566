# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Compiles a kernel of the proofs, which are no part of the package and so not built with it."""

from __future__ import annotations

from functools import cache
from types import FunctionType
from typing import Any

from trackres_ros.kernels.compiler import loaded
from trackres_ros.kernels.extension import Extension
from trackres_ros.kernels.flow import translate_body
from trackres_ros.kernels.functions import Translator
from trackres_ros.kernels.marks import interpreted


@cache
def native(kernel: FunctionType) -> Any:
    """The kernel as C; itself where plain Python is requested or no compiler is there. It takes a second, once in a process."""
    if interpreted():
        return kernel
    translator = Translator(translate_body)
    translator.checked = False
    name = f"proofs_{kernel.__name__}"
    module = loaded(name, Extension(name, translator, {kernel.__name__: kernel}).text())
    return kernel if module is None else getattr(module, kernel.__name__)
