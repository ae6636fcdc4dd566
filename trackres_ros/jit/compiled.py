# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The decorators of the kernels use numba if it is installed, else plain Python.

The numerical kernels are written once, in the subset that both run. The environment variable TRACKRES_INTERPRETED=1 disables
numba, which the tests use to show that both give the same numbers.
"""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Callable
from functools import cache
from inspect import signature
from pathlib import Path
from types import FunctionType
from typing import Any, TypeVar, cast, get_type_hints

from trackres_ros.files.cache import usable
from trackres_ros.files.resources import cache_dir
from trackres_ros.files.settings_here import unread
from trackres_ros.jit.code_cache import CodeCache

COMPILED_ROOMS = ("model", "estimator", "effects", "jit", "route", "diagnosis/prepare", "diagnosis/base", "diagnosis/empirical")
"""Sources of compiled code."""
CONSTANTS = "units.py"
"""Other sources of constants, which become part of the code."""
TRIED = ("0.58.", "0.68.")  # versions of numba whose insides were tried as `_PartLibrary` uses them
ENVIRONMENT = "NumbaEnv"

Function = TypeVar("Function", bound=Callable[..., Any])

sys.modules.setdefault("coverage", cast(Any, None))  # numba loads it where colcon has installed it: a sixth of its own start
try:
    if os.environ.get("TRACKRES_INTERPRETED"):
        raise ImportError("left out on request")
    with unread(".numba_config.yaml"):
        import numba
        import numba.core.config
    from llvmlite.binding import get_host_cpu_name, parse_assembly
    from numba.core.codegen import JITCodeLibrary
    from numba.core.compiler import Compiler
    from numba.core.registry import CPUDispatcher
except ImportError:
    HAVE_NUMBA = False
    _library: Any = None
else:
    HAVE_NUMBA = True
    _library = numba
    numba.core.config._config_fname = os.devnull  # it is looked for again at each compilation

    _OF_CODE: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
    _OF_PART = {"nopython": True, "boundscheck": None, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}

    class _PartLibrary(JITCodeLibrary):
        """The code of a part, for the functions that contain it. These optimise it as their own, and only they are run."""

        def _optimize_final_module(self) -> None:
            """Leave it to the functions that contain it."""

        def _finalize_final_module(self) -> None:
            """Keep the code, but make machine code only of numba's pointers to what Python knows of a function."""
            self._finalized = True
            pointers = [one.name for one in self._get_module_for_linking().global_variables if ENVIRONMENT in one.name]
            rest = [f'@"{name}" = common global i64 0' for name in pointers]
            self._final_module = parse_assembly("\n".join([str(self._codegen._create_empty_module(self.name)), *rest]))
            super()._finalize_final_module()

    class _PartCompiler(Compiler):
        def __init__(self, typing_context: Any, target: Any, library: Any, *others: Any) -> None:
            own = _PartLibrary(target.codegen(), "part")
            own.enable_object_caching()
            super().__init__(typing_context, target, library or own, *others)

    class _Part(CPUDispatcher):
        """A function that is called compiled only from compiled code: from Python it runs as Python.

        So it needs no entry from Python or C, which took a third of the time to compile, and no machine code, a quarter.
        """

        def __init__(self, function: FunctionType, local_types: dict[str, Any], options: dict[str, Any]) -> None:
            compiler = _PartCompiler if _library.__version__.startswith(TRIED) else Compiler
            super().__init__(function, local_types, {**_OF_CODE, **_OF_PART, **options}, pipeline_class=compiler)

        def __call__(self, *args: Any) -> Any:
            return self.py_func(*args)

finally:
    if sys.modules["coverage"] is None:
        del sys.modules["coverage"]


def sources_digest() -> str:
    """Digest of every source file that compiled code can come from."""
    package = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for path in (*sorted(path for room in COMPILED_ROOMS for path in (package / room).rglob("*.py")), package / CONSTANTS):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _cache_name() -> str:
    """Name of the folder of compiled code: it contains a digest of sources, numba and processor.

    numba itself checks only the file of the function, not those it calls: after a change in one of them it would run the
    old machine code.
    """
    parts = [sources_digest(), sys.implementation.cache_tag]
    if HAVE_NUMBA:
        parts += [_library.__version__, get_host_cpu_name()]
    return f"compiled-{'-'.join(parts)}"


_CACHE_NAME = _cache_name()


def _base() -> Path | None:
    return Path(_library.config.CACHE_DIR) if HAVE_NUMBA and _library.config.CACHE_DIR else cache_dir()


@cache
def _folder(base: Path | None) -> Path | None:
    checked = usable(base)
    return None if checked is None else usable(checked / _CACHE_NAME)


def code_folder() -> Path | None:
    """Folder of compiled code, or None."""
    return _folder(_base())


def keep_code_in(base: Path) -> None:
    """From now on keep compiled code below another folder."""
    _library.config.CACHE_DIR = str(base)


def compiled(function: Function) -> Function:
    """Compile `function` with numba (cached on disk) if it is installed."""
    return _compile(function, False)


def inlined(function: Function) -> Function:
    """The same as a part of each of its callers: passing all constants costs as much as a step's arithmetic."""
    return _compile(function, True)


def part(function: FunctionType, boundscheck: bool = False) -> Any:
    """A function that becomes part of one cached function, or of none; needs numba."""
    return _Part(function, {}, {"boundscheck": boundscheck})


def _compile(function: Function, into_callers: bool) -> Function:
    if not HAVE_NUMBA:
        return function
    # No kernel makes an array, so reference counting is disabled: it cost a third of a step.
    dispatcher: Any
    if into_callers:
        dispatcher = _Part(cast(FunctionType, function), {}, {"_nrt": False, "forceinline": True})
    else:
        dispatcher = _library.njit(**_OF_CODE, _nrt=False)(function)
    dispatcher._cache = CodeCache(cast(FunctionType, function), code_folder)
    return cast(Function, dispatcher)


def is_cached(function: Callable[..., Any]) -> bool:
    """Whether intact machine code of a compiled function is in the cache; true without numba, which compiles nothing."""
    return not hasattr(function, "py_func") or CodeCache(function.py_func, code_folder).any()


def interpreted(function: Function, _known: dict[Any, Any] | None = None) -> Function:
    """A copy in plain Python of a compiled function and of all compiled ones it calls: the same numbers, without compiling."""
    known = {} if _known is None else _known
    python = getattr(function, "py_func", None)
    if python is None:
        return function
    if function not in known:
        names = dict(python.__globals__)
        known[function] = FunctionType(python.__code__, names, python.__name__, python.__defaults__, python.__closure__)
        for name, value in python.__globals__.items():
            if hasattr(value, "py_func"):
                names[name] = interpreted(value, known)
    return cast(Function, known[function])


def entry(function: Callable[..., Any]) -> Callable[..., Any]:
    """An entry to a compiled function whose parameters are records: it takes the fields of each instead of the record.

    A call from Python costs more for a named tuple than for its arrays one by one. For those of a message it doubles the
    cost of the call (benchmarks/bench_ways.py).

    Parameters
    ----------
    function
        Compiled as `inlined`. For a parameter that is a `NamedTuple`, the entry takes its fields; for a field that is a
        `NamedTuple` itself, it takes an array of one numpy record with the same fields, or a list with it.
    """
    python = cast(FunctionType, getattr(function, "py_func", function))
    known: dict[str, Any] = {"inner": function}
    parameters: list[str] = []
    given: list[str] = []
    kinds = get_type_hints(python)
    for name in signature(python).parameters:
        kind = kinds[name]
        if not _is_record(kind):
            parameters.append(name)
            given.append(name)
            continue
        known[kind.__name__] = kind
        fields = {f"{name}_{field}": "[0]" * _is_record(inside) for field, inside in get_type_hints(kind).items()}
        parameters += fields
        given.append(f"{kind.__name__}({', '.join(field + only for field, only in fields.items())})")
    exec(f"def entry({', '.join(parameters)}):\n    return inner({', '.join(given)})", known)
    made = cast(FunctionType, known["entry"])
    made.__module__, made.__qualname__, made.__doc__ = python.__module__, f"{python.__qualname__}.entry", python.__doc__
    return compiled(made)


def _is_record(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, tuple) and hasattr(kind, "_fields")
