# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Keeps the machine code of one compiled function between runs, instead of numba's own cache.

numba's trusts its files: an index that is empty or cut ends the program, and both index and code are pickles, which can run
any code. Here every specialisation is a separate file under a seal, written in one step, so concurrent processes do not damage
each other's files. A file with a broken seal is removed and compiled again.
"""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable
from pathlib import Path
from types import FunctionType
from typing import Any

from trackres_ros.files.cache import drop, fetched, keep
from trackres_ros.progress import tell

COMPILING = "compiling, once"
LARGEST = 64 << 20  # bytes; the largest of ours has less than one million
LIGHT = ("0.68.",)  # versions of numba in which code of the package was tried without numba's library of functions


class CodeCache:
    """Interface of a numba dispatcher's cache (numba 0.57 to 0.68 have the same).

    `by_user` marks a function that may call others of numba's: its library of functions is loaded first, which takes 0.3 s.
    """

    def __init__(self, function: FunctionType, folder: Callable[[], Path | None], by_user: bool = False) -> None:
        self._function, self._folder, self._by_user = function, folder, by_user

    @property
    def cache_path(self) -> str:
        """Folder, for numba's statistics."""
        return str(self._folder() or "")

    def enable(self) -> None:
        """Always is."""

    def disable(self) -> None:
        """Never is."""

    def flush(self) -> None:
        """Remove the cached code of this function."""
        folder = self._folder()
        for path in folder.glob(f"{self._stem}-*") if folder else ():
            drop(path.parent, path.name)

    def any(self) -> bool:
        """Whether intact code of this function is in the cache."""
        folder = self._folder()
        found = folder.glob(f"{self._stem}-*.code") if folder else ()
        return any(fetched(folder, path.name, LARGEST) is not None for path in found)

    def load_overload(self, signature: Any, target: Any) -> Any:
        """The compiled function for a signature, or None."""
        from numba import __version__
        from numba.core import compiler
        from numba.core.runtime.nrt import rtsys

        if __version__.startswith(LIGHT) and not self._by_user:
            rtsys.initialize(target)
        else:
            target.refresh()
        folder, name = self._folder(), self._name(signature, target.codegen())
        payload = fetched(folder, name, LARGEST)
        if payload is None or folder is None:
            tell(COMPILING)
            return None
        try:
            rebuild: Callable[..., Any] = compiler.CompileResult._rebuild
            return rebuild(target, *pickle.loads(payload))  # sealed, in a folder writable only by us
        except Exception:  # compiling again repairs any error
            drop(folder, name)
            return None

    def save_overload(self, signature: Any, compiled: Any) -> None:
        """Keep the compiled function for a signature."""
        from numba.core import serialize

        dumps: Callable[[Any], bytes] = serialize.dumps
        if self._folder() is None or compiled.lifted or compiled.library.has_dynamic_globals:
            return
        keep(self._folder(), self._name(signature, compiled.codegen), dumps(compiled._reduce()))

    @property
    def _stem(self) -> str:
        return f"{self._function.__module__}.{self._function.__qualname__}"

    def _name(self, signature: Any, codegen: Any) -> str:
        parts = repr((signature, codegen.magic_tuple(), self._function.__code__.co_code))
        return f"{self._stem}-{hashlib.sha256(parts.encode()).hexdigest()[:32]}.code"
