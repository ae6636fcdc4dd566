# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Sees to it that the speed has one source, and notices where two publishers of its topic disagree."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from trackres_ros.estimator.constants import LATEST_S
from trackres_ros.estimator.plausible import SHARE
from trackres_ros.units import NANOSECOND

RESOLUTION_MPS = 1.0 / 3.6  # of a bus that sends whole km/h
REMEMBERED_NS = 2_000_000_000  # two messages of the slowest usual publisher, 1 Hz


@dataclass(slots=True)
class Heard:
    """The last speed of a publisher [m/s], and its arrival [ns]."""

    speed: float
    arrival_ns: int


class SpeedSources:
    """Uses the speed of one publisher, the first that is heard; another one only once that is silent for `max_age_s`.

    Two publishers disagree once their speeds have differed for `max_age_s`: by more than a quarter and the resolution of a bus,
    so a delay of 0.1 s between two sensors is no difference for longer than 0.4 s after a start from rest (ours). Speeds that
    came at different times may also differ by what the vehicle gains in between. While two disagree, and for 2 s after they last
    differed, none is used.

    A middleware that does not tell publishers apart passes all as one. Where there are several (`mixed`), a speed that differs
    from the last one used is of another publisher.
    """

    def __init__(self, max_acceleration: float, max_age_s: Callable[[], float]) -> None:
        self._max_acceleration, self._max_age_s = max_acceleration, max_age_s
        self._heard: dict[int, Heard] = {}
        self._used: int | None = None
        self._first_ns: int | None = None  # since when they differ
        self._last_ns = 0
        self._both: tuple[tuple[int, float], tuple[int, float]] | None = None

    def disagreeing(self, now_ns: int) -> tuple[tuple[int, float], tuple[int, float]] | None:
        """Two publishers with the speed of each [m/s], when they last differed; None while none disagree."""
        return self._both if self._parted(now_ns) else None

    def takes(self, source: int, speed: float, arrival_ns: int, mixed: bool = False) -> bool:
        """Whether to use a speed [m/s] of a publisher, or with `mixed` of one of several, that arrives now [ns]."""
        if not math.isfinite(speed):
            return True  # it is refused and counted
        if any(arrival_ns < heard.arrival_ns for heard in self._heard.values()):  # time went back
            self._heard.clear()
            self._used = self._first_ns = None
        if self._differs(source, speed, arrival_ns, mixed) and mixed:
            return False
        used = self._heard.get(self._used) if self._used is not None else None
        if used is None or (arrival_ns - used.arrival_ns) * NANOSECOND > self._max_age_s():
            self._used = source
        self._heard[source] = Heard(speed, arrival_ns)
        for silent in [s for s, heard in self._heard.items() if arrival_ns - heard.arrival_ns > REMEMBERED_NS]:
            del self._heard[silent]
        return source == self._used and not self._parted(arrival_ns)

    def _differs(self, source: int, speed: float, arrival_ns: int, mixed: bool) -> bool:
        agrees = False
        for other, heard in self._heard.items():
            age_s = (arrival_ns - heard.arrival_ns) * NANOSECOND
            if age_s > self._max_age_s() or (other == source and not mixed):
                continue
            apart = abs(speed - heard.speed) - SHARE * max(abs(speed), abs(heard.speed)) - RESOLUTION_MPS
            agrees |= apart <= 0.0
            if apart > self._max_acceleration * max(0.0, age_s - LATEST_S):
                if self._first_ns is None or arrival_ns - self._last_ns > REMEMBERED_NS:
                    self._first_ns = arrival_ns
                self._last_ns, self._both = arrival_ns, ((other, heard.speed), (source, speed))
                return True
        if agrees and not mixed and not self._parted(arrival_ns):
            self._first_ns = None
        return False

    def _parted(self, now_ns: int) -> bool:
        if self._first_ns is None or now_ns - self._last_ns > REMEMBERED_NS:
            return False
        return (self._last_ns - self._first_ns) * NANOSECOND > self._max_age_s()
