# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs work that waits for a disk or a terminal on its own thread: the loop that publishes the torque never waits for it."""

from __future__ import annotations

import os
import sys
import threading
from collections import deque
from collections.abc import Callable

MOST_LINES = 1000


class Background:
    """One call at a time. A call that never returns does not keep the program from ending."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._thread: threading.Thread | None = None

    @property
    def busy(self) -> bool:
        """Whether the last call still runs."""
        return self._thread is not None and self._thread.is_alive()

    def start(self, call: Callable[[], None]) -> None:
        """Begin a call; the last one must be over."""
        self._thread = threading.Thread(target=call, name=self._name, daemon=True)
        self._thread.start()

    def wait(self, patience_s: float) -> bool:
        """Wait for the call that runs; whether it is over."""
        if self._thread is not None:
            self._thread.join(patience_s)
        return not self.busy


class ErrorLines:
    """Writes lines to standard error. If nothing reads them, the oldest are dropped, and a line reports how many."""

    def __init__(self) -> None:
        self._lines: deque[str] = deque(maxlen=MOST_LINES)
        self._put = self._taken = 0
        self._news, self._over = threading.Event(), False
        self._thread = threading.Thread(target=self._run, name="log", daemon=True)
        self._thread.start()

    def put(self, line: str) -> None:
        """Have a line written soon."""
        self._lines.append(line)
        self._put += 1
        self._news.set()

    def close(self, patience_s: float) -> None:
        """Write the remaining lines, as far as they are read."""
        self._over = True
        self._news.set()
        self._thread.join(patience_s)
        if self._thread.is_alive():  # output of the interpreter as it ends must not wait either
            _to_nowhere()

    def _run(self) -> None:
        while not (self._over and not self._lines):
            self._news.wait()
            self._news.clear()
            while self._lines:
                line = self._lines.popleft()
                self._taken += 1
                dropped = self._put - self._taken - len(self._lines)
                if dropped > 0:
                    self._taken += dropped
                    line = f"[{dropped} lines of the log were dropped, because nothing read them]\n{line}"
                self._write(line)

    def _write(self, line: str) -> None:
        try:
            _write_to_error(f"{line}\n")
        except BrokenPipeError:  # the log has no reader any more, which must end neither the node nor its exit code
            _to_nowhere()
        except (OSError, ValueError):  # a full disk loses this line alone; a closed stream loses all
            pass


def _write_to_error(text: str) -> None:
    """Write on standard error, past its buffer, if it is a file. A blocked write would hold the buffer's lock, and the
    interpreter waits for that lock as it ends.
    """
    try:
        number = sys.stderr.fileno()
    except (AttributeError, OSError, ValueError):
        print(text, end="", file=sys.stderr, flush=True)
        return
    left = text.encode(errors="backslashreplace")
    while left:
        left = left[os.write(number, left) :]


def _to_nowhere() -> None:
    """Have standard error go nowhere from now on."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())
