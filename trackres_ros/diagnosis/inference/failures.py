# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Steps of a diagnosis that may fail alone, and its single thread of linear algebra."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

from trackres_ros.diagnosis.prepare.session import WarningNote


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """One thread for matrices: they are small here, and further threads would wait more than they compute.

    Without threadpoolctl the threads stay as they are.
    """
    try:
        from threadpoolctl import threadpool_limits
    except ImportError:
        yield
        return
    with threadpool_limits(1, user_api="blas"):
        yield


Result = TypeVar("Result")

_notes: ContextVar[dict[str, None] | None] = ContextVar("failures", default=None)


@contextmanager
def failures() -> Iterator[dict[str, None]]:
    """The notes on attempts that fail meanwhile, each once, as the keys of a growing dictionary."""
    notes = dict[str, None]()
    token = _notes.set(notes)
    try:
        yield notes
    finally:
        _notes.reset(token)


def attempt(task: str, part: Callable[[], Result]) -> Result | None:
    """The result of a part of a diagnosis; None with a note if it fails.

    Outside `failures` nobody would read the note, so the error is raised.
    """
    notes = _notes.get()
    if notes is None:
        return part()
    try:
        return part()
    except Exception as error:  # of any kind: a finder adds to a diagnosis, and never ends it
        text = f"{task} was not looked for: its search failed with {type(error).__name__}: {error}; please report this"
        notes[WarningNote(text)] = None
        return None
