# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs independent parts of a computation in threads; compiled code releases the interpreter lock."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from trackres_ros.progress import counted

Item = TypeVar("Item")
Result = TypeVar("Result")


def side_by_side(function: Callable[[Item], Result], items: Sequence[Item], what: str) -> list[Result]:
    """Results of a function for each item, in order, the same as in a loop; progress messages name `what` runs.

    There is a thread for each processor, or as many as the variable OMP_NUM_THREADS says: several processes side by side set 1.
    """
    given = os.environ.get("OMP_NUM_THREADS", "")
    with ThreadPoolExecutor(int(given) if given.isdecimal() and int(given) else os.cpu_count()) as threads:
        return list(counted(threads.map(function, items), what, len(items)))
