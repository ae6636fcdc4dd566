# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Compiles C with the compiler of the machine, so that it gives the bits of Python."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sysconfig
import tempfile
from pathlib import Path
from types import ModuleType

FROM_LIBRARY = (
    "pow", "exp", "expm1", "log", "log1p", "log2", "log10", "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh",
    "tanh", "asinh", "acosh", "atanh", "hypot", "cbrt", "erf", "erfc",
)  # fmt: skip
INLINING = ("--param=inline-unit-growth=1000", "--param=max-inline-insns-auto=1000")  # a sixth of a step
FLAGS = ("-O3", *INLINING, "-ffp-contract=off", "-fno-math-errno", *(f"-fno-builtin-{name}" for name in FROM_LIBRARY))
"""As in Python, each product and sum is rounded, and functions are those of the C library. A compiler rounds those of
constants in another way.
"""


def compiler() -> str | None:
    """Path of the C compiler of this machine."""
    return shutil.which(os.environ.get("CC") or "cc")


def compile_text(text: str, *options: str) -> bytes | None:
    """The content of a shared library of some C; None without a compiler, or if it refuses the text."""
    path = compiler()
    if path is None:
        return None
    with tempfile.TemporaryDirectory(prefix="trackres") as folder:
        source, library = Path(folder, "source.c"), Path(folder, "library.so")
        source.write_text(text, encoding="utf-8")
        command = [path, *FLAGS, *options, "-shared", "-fPIC", str(source), "-o", str(library), "-lm"]
        process = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, cwd=folder, check=False)
        return library.read_bytes() if process.returncode == 0 else None


def load_module(name: str, text: str, *options: str) -> ModuleType | None:
    """A module of Python from its C; None without a compiler or Python.h. Its file is gone as soon as it is loaded."""
    library = compile_text(text, f"-I{sysconfig.get_paths()['include']}", *options)
    if library is None:
        return None
    with tempfile.TemporaryDirectory(prefix="trackres") as folder:
        path = Path(folder, f"{name}.abi3.so")
        path.write_bytes(library)
        spec = importlib.util.spec_from_file_location(name, path)
        assert spec is not None
        module = importlib.util.module_from_spec(spec)
        assert spec.loader is not None
        spec.loader.exec_module(module)
    return module
