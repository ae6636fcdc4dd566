# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The node's time beside a steady clock."""

from __future__ import annotations

import time
from collections.abc import Callable

from trackres_ros.node.guard import Guard
from trackres_ros.node.transport import Transport, nearest_usable
from trackres_ros.units import NANOSECOND

STEADY = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)  # where a system has no other, it may stop while suspended
SET_NS = 50_000_000  # assumed: the machine's clock is slewed over less, with the steady clock; over more it is set
Arrival = tuple[int, int]
"""When a message came, by the steady clock and by the node's time [ns]."""


def steady_ns() -> int:
    """Time since the machine's start [ns], that of a suspended machine included: belts cool and speeds age meanwhile."""
    return time.clock_gettime_ns(STEADY)


class NodeClock:
    """The node's time, the machine's or a simulated one, and the steady time that counts ages and periods; all in ns."""

    def __init__(self, transport: Transport, simulated: bool, steady_ns: Callable[[], int], guard: Guard) -> None:
        self.simulated, self.steady_ns = simulated, steady_ns
        self.offset_ns = time.time_ns() - steady_ns()  # of the machine's clock at the start against steady time
        self._transport, self._guard = transport, guard
        self._refused_ns = 0  # last negative time

    @property
    def lack(self) -> str:
        """Why there is no simulated time."""
        if self._refused_ns:
            given = f"/clock shows {self._refused_ns * NANOSECOND:.1f} s: a time before 0 is none"
            return f"use_sim_time is set and {given}; let the simulation start at 0 or later"
        return "use_sim_time is set and no /clock message has arrived"

    def arrival(self) -> Arrival:
        """The arrival of a message that comes now."""
        steady = self.steady_ns()
        return steady, self.now_ns(steady)

    def now_ns(self, steady: int) -> int:
        """The node's time: the machine's where a clock cannot be read; 0, none, for a simulated one or where it is negative."""
        now = self._guard("the clock", self._transport.now_ns)
        if not self.simulated:
            return now if now is not None else steady + self.offset_ns
        self._refused_ns = min(0, now or 0)
        return max(0, now or 0)

    def recorded_ns(self, steady: int, now: int) -> int:
        """An arrival as it is recorded: steady like the ages of samples, or simulated."""
        return now if self.simulated else steady + self.offset_ns

    def set_by_ns(self, now: int, recorded: int) -> int:
        """How far the machine's clock has been set since the start, as an arrival shows by both times."""
        return now - recorded if abs(now - recorded) > SET_NS else 0

    def pace_ns(self, steady: int) -> int:
        """Time of the feed-forward's motion: the controller's, or the simulated one."""
        return nearest_usable(self.now_ns(steady)) if self.simulated else steady
