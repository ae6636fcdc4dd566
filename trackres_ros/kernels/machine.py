# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Loads the compiled kernels, if they were built of the sources that are here now."""

from __future__ import annotations

import hashlib
import logging
import os
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType

ROOMS = ("model", "estimator", "effects", "kernels", "route", "diagnosis/prepare", "diagnosis/base", "diagnosis/empirical")
FILES = ("units.py",)
"""Sources of compiled code, and of constants, which become part of it."""
NAME = "trackres_ros.kernels.built"
SLOWER = 100  # times that a step in plain Python takes longer, at least: 450 us against 1.5 us of `Session.handle`
BUILD = "tools/kernels"

_log = logging.getLogger("trackres")


@cache
def sources_digest() -> str:
    """Digest of every source file that compiled code can come from."""
    package = Path(__file__).parents[1]
    digest = hashlib.sha256()
    found = [Path(folder, name) for room in ROOMS for folder, _, names in os.walk(package / room) for name in names]
    for path in (*sorted(path for path in found if path.suffix in (".py", ".c")), *(package / file for file in FILES)):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:32]


def interpreted() -> bool:
    """Whether plain Python is requested."""
    return bool(os.environ.get("TRACKRES_INTERPRETED"))


def _loaded() -> ModuleType | None:
    if interpreted():
        return None
    try:
        found = import_module(NAME)
    except ImportError as error:
        missing = error.name == NAME
        why = "they were not compiled when the package was built: a C compiler or Python.h was missing" if missing else str(error)
        found = None
    else:
        assert found is not None
        if sources_digest() == found.SOURCES:
            return found
        why = f"their sources have changed since they were compiled; in a checkout run {BUILD}"
    _log.warning("trackres: the kernels run in plain Python, a step about %d times slower, as %s", SLOWER, why)
    return None


MACHINE = _loaded()
"""The module of compiled kernels; None in plain Python."""
