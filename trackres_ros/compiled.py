"""The decorators of the kernels: numba where it is installed, plain Python where it is not.

The numerical kernels are written once, in the subset both run; the environment variable TRACKRES_INTERPRETED=1 leaves
numba out, which the tests use to show that both give the same numbers.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

from trackres_ros.resources import cache_dir

Function = TypeVar("Function", bound=Callable[..., Any])

try:
    if os.environ.get("TRACKRES_INTERPRETED"):
        raise ImportError("left out on request")
    import numba
except ImportError:
    HAVE_NUMBA = False
else:
    HAVE_NUMBA = True


def _sources_digest() -> str:
    """Digest of every source file that compiled code can come from."""
    package = Path(__file__).parent
    digest = hashlib.sha256()
    for path in sorted((*package.glob("model/*.py"), *package.glob("estimator/*.py"))):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


# numba looks only at the file of the function itself, not at those it calls: after a change in one of them it would run the
# old machine code. So the folder of its cache is named after all of them.
_CACHE_NAME = f"compiled-{_sources_digest()}"


def compiled(function: Function) -> Function:
    """Compile `function` with numba (cached on disk) where numba is there."""
    return _compile(function, "never")


def inlined(function: Function) -> Function:
    """Compile `function` into each of its callers: between functions every array costs counting who holds it."""
    return _compile(function, "always")


def _compile(function: Function, inline: str) -> Function:
    if not HAVE_NUMBA:
        return function
    library: Any = numba
    config = library.config
    others = config.CACHE_DIR
    config.CACHE_DIR = str(Path(others or cache_dir()) / _CACHE_NAME)
    try:
        return cast(Function, library.njit(cache=True, nogil=True, error_model="numpy", inline=inline)(function))
    finally:
        config.CACHE_DIR = others
