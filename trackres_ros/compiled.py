"""The `compiled` decorator: numba where it is installed, plain Python where it is not.

The numerical kernels are written once, in the subset both run; the environment variable TRACKRES_INTERPRETED=1 leaves
numba out, which the tests use to show that both give the same numbers.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any, TypeVar

Function = TypeVar("Function", bound=Callable[..., Any])

try:
    if os.environ.get("TRACKRES_INTERPRETED"):
        raise ImportError("left out on request")
    import numba
except ImportError:
    HAVE_NUMBA = False
else:
    HAVE_NUMBA = True


def compiled(function: Function) -> Function:
    """Compile `function` with numba (cached on disk) where numba is there."""
    if not HAVE_NUMBA:
        return function
    return numba.njit(cache=True, error_model="numpy")(function)  # type: ignore[no-any-return]
