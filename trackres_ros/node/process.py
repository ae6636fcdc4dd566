# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The process of the node and what is around it: a steady clock, signals, systemd, standard error and slow disks.

Signals are handled from the very start, even while libraries are loaded. So this imports nothing of the package.
"""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from types import FrameType

STEADY = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)  # where a system has no other, it may stop while suspended
STOP = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
SAVE, RESET, RESET_LEARNING = signal.SIGUSR1, signal.SIGUSR2, signal.SIGRTMIN
WHAT: dict[int, str] = {
    SAVE: "the state is saved",
    RESET: "the estimate starts cold",
    RESET_LEARNING: "the learned parameters are reset",
    **dict.fromkeys(STOP, "it ends"),
}
EVERY_NS = 200_000_000  # between two signs of life: the shortest sensible WatchdogSec is some times that
LONGEST_STATUS = 500  # characters
MOST_LINES = 1000


def steady_ns() -> int:
    """Time since the machine's start [ns], that of a suspended machine included: belts cool and speeds age meanwhile."""
    return time.clock_gettime_ns(STEADY)


class SignalRequests:
    """Listens to signals. No work is interrupted, and no signal ends the process without a line of text."""

    def __init__(self) -> None:
        self.to_stop = False
        self._starting = True
        self._pending_signals: list[int] = []

    def listen(self) -> None:
        """Begin to listen; from then on no signal ends the process by itself. Under nohup a closed terminal ends nothing."""
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, WHAT)  # all at once: who sees the first taken may send another
        for number in WHAT:
            if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, self._note)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)

    def start(self) -> None:
        """Begin to carry out requests at once, as the node runs."""
        self._starting = False

    def pending(self) -> Iterator[int]:
        """Requests to carry out now, each once."""
        while self._pending_signals:
            yield self._pending_signals.pop(0)

    def _note(self, number: int, _frame: FrameType | None) -> None:
        if number in STOP:
            self.to_stop = True
        else:
            self._pending_signals.append(number)
        if self._starting:  # written past any buffer, as the main program may be writing now
            text = f"trackres: {signal.Signals(number).name} while starting: {WHAT[number]} as soon as it has started\n"
            with suppress(OSError):  # the log has no reader any more: that ends nothing
                os.write(sys.__stderr__.fileno() if sys.__stderr__ else 2, text.encode())


REQUESTS = SignalRequests()
"""Those of this process, as signals are."""


class ServiceManager:
    """The service manager that started this process, if any: ready, alive, its status, stopping, by sd_notify(3).

    The protocol is a datagram to the socket in NOTIFY_SOCKET, and without that variable nothing. It never delays: a datagram that
    cannot be sent at once is lost. See https://www.freedesktop.org/software/systemd/man/sd_notify.html.
    """

    def __init__(self) -> None:
        path = os.environ.get("NOTIFY_SOCKET", "")
        self._address = f"\0{path[1:]}" if path.startswith("@") else path  # the first is of Linux's abstract ones
        self._ready = False
        self._sent_count, self._notified_ns, self._status = 0, 0, ""

    def alive(self, count: int, is_active: bool, steady_ns: int) -> None:
        """Report that the node is alive, if messages were sent since the last call that did, or it is inactive by request.

        `sent` is the number of messages passed to the middleware so far, `steady_ns` is now by a steady clock [ns].
        """
        if (is_active and count == self._sent_count) or (self._ready and steady_ns - self._notified_ns < EVERY_NS):
            return
        self._notify("WATCHDOG=1" if self._ready else "READY=1\nWATCHDOG=1")
        self._ready, self._sent_count, self._notified_ns = True, count, steady_ns

    def status(self, text: str) -> None:
        """Report the state in a line; `systemctl status` shows it."""
        line = " ".join(text.split())[:LONGEST_STATUS]
        if line != self._status:
            self._notify(f"STATUS={line}")
            self._status = line

    def stopping(self) -> None:
        """Report that the process ends; the loop that runs the node does, as a lifecycle's cleanup ends no process."""
        self._notify("STOPPING=1")

    def _notify(self, text: str) -> None:
        if self._address:
            with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
                sender.setblocking(False)
                sender.sendto(text.encode(), self._address)


class Background:
    """Runs one call at a time on its own thread: the loop that publishes the torque waits for no disk.

    A call that never returns does not keep the program from ending.
    """

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
        self._put_count = self._taken_count = 0
        self._news, self._is_over = threading.Event(), False
        self._thread = threading.Thread(target=self._run, name="log", daemon=True)
        self._thread.start()

    def put(self, line: str) -> None:
        """Have a line written soon."""
        self._lines.append(line)
        self._put_count += 1
        self._news.set()

    def close(self, patience_s: float) -> None:
        """Write the remaining lines, as far as they are read."""
        self._is_over = True
        self._news.set()
        self._thread.join(patience_s)
        if self._thread.is_alive():  # output of the interpreter as it ends must not wait either
            _to_nowhere()

    def _run(self) -> None:
        while not (self._is_over and not self._lines):
            self._news.wait()
            self._news.clear()
            while self._lines:
                line = self._lines.popleft()
                self._taken_count += 1
                lost_count = self._put_count - self._taken_count - len(self._lines)
                if lost_count > 0:
                    self._taken_count += lost_count
                    line = f"[{lost_count} lines of the log were dropped, because nothing read them]\n{line}"
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
    data = text.encode(errors="backslashreplace")
    while data:
        data = data[os.write(number, data) :]


def _to_nowhere() -> None:
    """Have standard error go nowhere from now on."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())
