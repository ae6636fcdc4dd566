# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Keeps code and settings in the current folder, such as among unpacked recordings, from being used.

A process started here finds the modules of this one and none in the current folder; libraries do not read settings there.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

ROOT = str(Path(__file__).resolve().parents[2])

SAFE = {"PYTHONSAFEPATH": "1"}
"""Variables for what any library starts: it cannot be given `-P`, by which `-c` and `-m` leave out the current folder."""


def python(module: str, *words: object, **variables: str) -> dict[str, Any]:
    """Arguments of `subprocess` that run a module with some words: `args`, and `env` with further variables.

    With `-m` alone, Python looks for every module in the current folder first, and that may be a folder of unpacked recordings.
    What `multiprocessing` starts there has `-P` too.
    """
    places = [place for place in sys.path if place]  # "" is the current folder
    path = os.pathsep.join(places if ROOT in places else [*places, ROOT])
    return {
        "args": [sys.executable, "-P", "-m", module, *map(str, words)],
        "env": {**os.environ, "PYTHONPATH": path, **variables},
    }


@contextmanager
def leave_unread(name: str) -> Iterator[None]:
    """Import a library that reads a file of this name in the current folder, from the root folder if there is one.

    An older matplotlib can be made to run code by such a file. It has no option to leave it out.
    """
    if not os.path.lexists(name):
        yield
        return
    folder = os.open(".", os.O_PATH)
    os.chdir("/")
    try:
        yield
    finally:
        os.fchdir(folder)
        os.close(folder)
