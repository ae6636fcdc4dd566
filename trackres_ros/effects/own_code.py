# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Compiles the functions of a user's effects, where the machine has a C compiler; the code is kept in the cache."""

from __future__ import annotations

import ctypes
import hashlib
import logging
import os
import platform
from functools import cache
from typing import Any

from trackres_ros.errors import InputError
from trackres_ros.files.cache import fetched, keep, usable
from trackres_ros.files.resources import cache_dir
from trackres_ros.kernels.compiler import FLAGS, compiled, compiler
from trackres_ros.kernels.machine import SLOWER, interpreted

LARGEST = 16 << 20  # bytes; a usual one has 16 kB
NAME = "trackres_effect"

_log = logging.getLogger("trackres")


@cache
def address_of(kind: type[Any], method: str, names: tuple[str, ...]) -> int | None:
    """The address of C of a function of an effect; None if it must run in plain Python, which is logged."""
    if interpreted():
        return None
    if compiler() is None:
        _say(f"effect {kind.__name__}", "there is no C compiler")
        return None
    try:
        text = _text(kind, method, names)
    except InputError as error:
        _say(f"effect {kind.__name__}", str(error))
        return None
    library = _library(text)
    if library is None:
        _say(f"effect {kind.__name__}", f"{compiler()} does not compile it")
        return None
    return ctypes.cast(getattr(library, NAME), ctypes.c_void_p).value


def _text(kind: type[Any], method: str, names: tuple[str, ...]) -> str:
    """The C of a function, which answers nan where Python raises an error."""
    from trackres_ros.effects.translated import effect_function
    from trackres_ros.kernels.extension import used_helpers
    from trackres_ros.kernels.flow import translate_body
    from trackres_ros.kernels.functions import Translator

    translator = Translator(translate_body)
    one = effect_function(translator, kind, method, names)
    functions = translator.text_of_functions([one])
    given = ", ".join([*(name for name, _ in one.given), *["&failed"] * one.fails])
    return "\n".join(
        (
            "#include <math.h>\n#include <stdbool.h>\n#include <stdint.h>\n",
            used_helpers(translator, functions),
            translator.text_of_structs(functions),
            translator.text_of_tables(),
            functions,
            f"void {NAME}(const double *x, const double *p, double *out)\n{{",
            f"    bool failed = false;\n    {one.name}({given});\n    if (failed) {{\n        out[0] = NAN;\n    }}\n}}\n",
        )
    )


@cache
def _library(text: str) -> ctypes.CDLL | None:
    """The loaded library of some C, from the cache or compiled now."""
    parts = "\n".join((platform.machine(), *FLAGS, text))
    name = f"{hashlib.sha256(parts.encode()).hexdigest()[:32]}.code"
    base = cache_dir()
    folder = usable(None if base is None else base / "effects")
    code = fetched(folder, name, LARGEST)
    if code is None:
        code = compiled(text)
        if code is None:
            return None
        keep(folder, name, code)
    # What was checked is what is loaded, whoever may change files meanwhile. It stays open: the loader knows it by its path.
    file = os.memfd_create(NAME, os.MFD_CLOEXEC)
    os.write(file, code)
    return ctypes.CDLL(f"/proc/self/fd/{file}")


@cache
def _say(what: str, why: str) -> None:
    _log.warning("trackres: %s runs in plain Python, about %d times slower: %s", what, SLOWER, why)
