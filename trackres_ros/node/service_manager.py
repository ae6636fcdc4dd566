# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Tells systemd how the node is, by the protocol of sd_notify(3): ready, alive, its status, stopping.

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
    """The service manager that started this process, if one did. It never delays: what it does not take at once is lost."""

    def __init__(self) -> None:
        path = os.environ.get("NOTIFY_SOCKET", "")
        self._address = f"\0{path[1:]}" if path.startswith("@") else path  # the first is of Linux's abstract ones
        self._ready = False
        self._sent, self._told_ns, self._status = 0, 0, ""

    def alive(self, sent: int, active: bool, steady: int) -> None:
        """Say that the node is alive, if messages have left since the last call that did, or it is inactive by request.

        Parameters
        ----------
        sent
            How many messages the middleware has taken so far.
        active
            Whether the node is to publish.
        steady
            Now, by a steady clock [ns].
        """
        if (active and sent == self._sent) or (self._ready and steady - self._told_ns < EVERY_NS):
            return
        self._tell("WATCHDOG=1" if self._ready else "READY=1\nWATCHDOG=1")
        self._ready, self._sent, self._told_ns = True, sent, steady

    def status(self, text: str) -> None:
        """Say in a line how it is; `systemctl status` shows it."""
        line = " ".join(text.split())[:LONGEST_STATUS]
        if line != self._status:
            self._tell(f"STATUS={line}")
            self._status = line

    def stopping(self) -> None:
        """Say that it ends by request."""
        self._tell("STOPPING=1")

    def _tell(self, text: str) -> None:
        if self._address:
            with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
                sender.setblocking(False)
                sender.sendto(text.encode(), self._address)
