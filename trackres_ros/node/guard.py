# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Guards the calls of the node's loop: a failing part is reported, and everything else continues."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import ParamSpec, TypeVar

from trackres_ros.node.notices import Notice

SHOWN_NS = 5_000_000_000  # since it last failed

P = ParamSpec("P")
T = TypeVar("T")


@dataclass(slots=True)
class _Failure:
    """The last failure of a part."""

    text: str
    at_ns: int
    essential: bool


class Guard:
    """Calls the parts of the node, and keeps an exception in one of them from ending or silencing another.

    The failure of an essential part (reading a message, a step, publishing) is an error: there is no usable estimate. For
    any other part (the disk, the log, other nodes, learning, recording, the statuses) it is a warning.
    `report` logs a failure, once for each text while it lasts; `steady_ns` is a monotonic clock [ns].
    """

    def __init__(self, report: Callable[[str], None], steady_ns: Callable[[], int]) -> None:
        self._report, self._steady_ns = report, steady_ns
        self._failures: dict[str, _Failure] = {}

    def __call__(self, part: str, do: Callable[P, T], *args: P.args, **named: P.kwargs) -> T | None:
        """Call a part; return its result, or None if it fails."""
        try:
            return do(*args, **named)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # whatever a library raises to end a program must not end this one
            self.failed(part, error, essential=False)
        return None

    def essential(self, part: str, do: Callable[P, T], *args: P.args, **named: P.kwargs) -> T | None:
        """Call a part that the estimate needs. Written out, as each message passes here: one more call costs 400 ns."""
        try:
            return do(*args, **named)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # as above
            self.failed(part, error, essential=True)
        return None

    def taking(self, part: str, take: Callable[[], Iterable[T]]) -> Callable[[], Sequence[T]]:
        """A function that takes the waiting messages of an input; none if it fails."""
        return lambda: self.essential(part, lambda: list(take())) or ()

    def failed(self, part: str, error: BaseException, essential: bool) -> None:
        """Take note of a failure."""
        text, now = f"{type(error).__name__}: {error}", self._steady_ns()
        before = self._failures.get(part)
        self._failures[part] = _Failure(text, now, essential)
        if before is None or before.text != text or now - before.at_ns > SHOWN_NS:
            self._report(f"{part} failed because of a bug: {''.join(traceback.format_exception(error))}")

    def notices(self, steady: int) -> list[Notice]:
        """The parts that have failed recently."""
        return [
            Notice("INTERNAL_ERROR", f"{part} failed because of a bug: {failure.text}")
            if failure.essential
            else Notice("PART_FAILED", f"{part} failed because of a bug, and the estimate continues: {failure.text}")
            for part, failure in list(self._failures.items())
            if steady - failure.at_ns < SHOWN_NS
        ]
