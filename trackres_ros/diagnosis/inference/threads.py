# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Independent parts of a computation side by side: most of each is compiled, and leaves the interpreter to the others."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def side_by_side(function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """Results of a function of each item, in their order; the same as one after the other."""
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        return list(threads.map(function, items))
