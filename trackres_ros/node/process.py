# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Requests to the running node by signals: stop, save its state, start cold, reset learning.

Signals are handled from the very start, even while libraries are loaded, and each request is carried out once the node
can. No work is interrupted, and no signal ends the process without a line of text. So this imports nothing of the
package.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from types import FrameType

    from trackres_ros.node.application import Application
    from trackres_ros.node.transport import Level

STOP = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
SAVE, RESET, RESET_LEARNING = signal.SIGUSR1, signal.SIGUSR2, signal.SIGRTMIN
WHAT: dict[int, str] = {
    SAVE: "the state is saved",
    RESET: "the estimate starts cold",
    RESET_LEARNING: "the learned parameters are reset",
    **dict.fromkeys(STOP, "it ends"),
}


class SignalRequests:
    """Listens to signals, and carries out their requests."""

    def __init__(self) -> None:
        self.to_stop = False
        self._starting = True
        self._waiting: list[int] = []

    def listen(self) -> None:
        """Begin to listen; from then on no signal ends the process by itself. Under nohup a closed terminal ends nothing."""
        before = signal.pthread_sigmask(signal.SIG_BLOCK, WHAT)  # all at once: who sees the first taken may send another
        for number in WHAT:
            if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, self._take)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)

    def started(self) -> None:
        """Begin to carry out requests at once, as the node runs."""
        self._starting = False

    def carry_out(self, application: Application) -> Iterator[tuple[Level, str]]:
        """Carry out pending requests; return level and text of each result, for the log."""
        if not self._waiting:
            return
        from trackres_ros.errors import InputError
        from trackres_ros.node.transport import Level

        while self._waiting:
            try:
                do: dict[int, Callable[[], str]] = {
                    SAVE: application.save_state,
                    RESET: application.reset,
                    RESET_LEARNING: application.reset_learning,
                }
                done = do[self._waiting.pop(0)]()
            except InputError as error:
                yield Level.WARN, str(error)
            else:
                yield Level.OK, done

    def _take(self, number: int, _frame: FrameType | None) -> None:
        if number in STOP:
            self.to_stop = True
        else:
            self._waiting.append(number)
        if self._starting:  # written past any buffer, as the main program may be writing now
            text = f"trackres: {signal.Signals(number).name} while starting: {WHAT[number]} as soon as it has started\n"
            with suppress(OSError):  # the log has no reader any more: that ends nothing
                os.write(sys.__stderr__.fileno() if sys.__stderr__ else 2, text.encode())


REQUESTS = SignalRequests()
"""Those of this process, as signals are."""
