# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reports the node's state to systemd, by the protocol of sd_notify(3): ready, alive, its status, stopping.

The protocol is a datagram to the socket in NOTIFY_SOCKET, see https://www.freedesktop.org/software/systemd/man/sd_notify.html.
Without that variable nothing is sent.
"""

from __future__ import annotations

import os
import socket
from contextlib import suppress

EVERY_NS = 200_000_000  # between two signs of life: the shortest sensible WatchdogSec is some times that
LONGEST_STATUS = 500  # characters


class ServiceManager:
    """The service manager that started this process, if any. It never delays: a datagram that cannot be sent at once is lost."""

    def __init__(self) -> None:
        path = os.environ.get("NOTIFY_SOCKET", "")
        self._address = f"\0{path[1:]}" if path.startswith("@") else path  # the first is of Linux's abstract ones
        self._ready = False
        self._sent, self._told_ns, self._status = 0, 0, ""

    def alive(self, sent: int, active: bool, steady: int) -> None:
        """Report that the node is alive, if messages were sent since the last call that did, or it is inactive by request.

        `sent` is the number of messages passed to the middleware so far, `steady` is now by a steady clock [ns].
        """
        if (active and sent == self._sent) or (self._ready and steady - self._told_ns < EVERY_NS):
            return
        self._tell("WATCHDOG=1" if self._ready else "READY=1\nWATCHDOG=1")
        self._ready, self._sent, self._told_ns = True, sent, steady

    def status(self, text: str) -> None:
        """Report the state in a line; `systemctl status` shows it."""
        line = " ".join(text.split())[:LONGEST_STATUS]
        if line != self._status:
            self._tell(f"STATUS={line}")
            self._status = line

    def stopping(self) -> None:
        """Report that the process ends; the loop that runs the node does, as a lifecycle's cleanup ends no process."""
        self._tell("STOPPING=1")

    def _tell(self, text: str) -> None:
        if self._address:
            with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
                sender.setblocking(False)
                sender.sendto(text.encode(), self._address)
