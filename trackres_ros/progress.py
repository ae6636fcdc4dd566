# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reports the progress of long work to listeners; imports nothing. Only the terminal listens."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TypeVar

Item = TypeVar("Item")
Listener = Callable[[str, int, int], None]  # description, finished amount, total (0 if unknown)

_listeners: list[Listener] = []


@contextmanager
def listening(listener: Listener) -> Iterator[None]:
    """Call a function with the progress made meanwhile, from any thread."""
    _listeners.append(listener)
    try:
        yield
    finally:
        _listeners.remove(listener)


def tell(part: str, count: int = 0, total: int = 0) -> None:
    """That so much of something is done; without a total, that it began."""
    for listener in list(_listeners):
        listener(part, count, total)


def counted(items: Iterable[Item], part: str, total: int) -> Iterator[Item]:
    """The items, one after the other; each counts as done when the next is requested."""
    for count, item in enumerate(items):
        tell(part, count, total)
        yield item
