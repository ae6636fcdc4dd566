# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Estimates the delay of the measured torque behind the speed [s], with its standard deviation.

Each window of 20 s with changes of speed gives a delay. The delays of the last windows give the mean, and their scatter its
standard deviation.

References
----------
R. T. Birge, The calculation of errors by the method of least squares, Phys. Rev. 40 (1932) 207-227.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from trackres_ros.arrays import Array
from trackres_ros.learning.delay_window import LONGEST_GAP_S, SPAN_S, WINDOW_S, window_delay
from trackres_ros.units import NANOSECOND, SECOND_NS

APART_NS = 9_000_000  # between two kept samples: at 100 Hz all are kept
PAST = 40  # windows that are kept
LEAST_WINDOW_STD_S = 0.01  # assumed: no window is better, as a filter delays slow changes more than fast ones
LEAST_STD_S = 0.003  # assumed: common to all windows
FIRST_STD_S = 0.3  # assumed: prior
OUTLIER = 3.0  # standard deviations: a window further off has a lower weight
AS_SAID = 4.0  # assumed number of prior windows whose scatter agrees with their variances
LATE = 3  # last windows that can reveal a changed delay
CHANGED_STDS, CHANGED_S = 4.0, 0.015  # by which their mean is then off
LEAST_WINDOWS = 6
KNOWN_STD_S = 0.01  # so that 95 % are within 20 ms


@dataclass
class KeptDelays:
    """Delays of the last windows; all of it is kept over a restart. Window number n is at n modulo `PAST`."""

    count: int = 0  # windows with a delay so far
    fresh: int = 0  # those since the last start: another topics file may have moved the torque since
    delays: Array = field(default_factory=lambda: np.zeros(PAST))  # s
    variances: Array = field(default_factory=lambda: np.zeros(PAST))  # s^2; 0 for none

    def see(self, delay: float, variance: float) -> None:
        """Add the delay of a window; forget the earlier ones if the last ones agree on another."""
        place = self.count % PAST
        self.delays[place], self.variances[place] = delay, max(variance, LEAST_WINDOW_STD_S**2)
        self.count += 1
        self.fresh += 1
        late = [(self.count - 1 - back) % PAST for back in range(LATE)]
        before = self.variances.copy()
        before[late] = 0.0
        if np.count_nonzero(before) < LATE:
            return
        old, old_std = _together(self.delays, before)
        new, new_std = _together(self.delays[late], self.variances[late])
        if abs(new - old) > max(CHANGED_STDS * math.hypot(old_std, new_std), CHANGED_S):
            before[before > 0.0] = 0.0
            before[late] = self.variances[late]
            self.variances[:] = before

    @property
    def value(self) -> tuple[float, float]:
        """The delay and its standard deviation [s]."""
        return _together(self.delays, self.variances)

    @property
    def known(self) -> bool:
        """Whether the delay is known: from enough consistent windows, some of them since the start."""
        enough = np.count_nonzero(self.variances) >= LEAST_WINDOWS and self.fresh >= LATE
        return bool(enough) and self.value[1] < KNOWN_STD_S


def _together(delays: Array, variances: Array) -> tuple[float, float]:
    """Robust weighted mean of windows and its standard deviation [s], from their scatter if that exceeds their variances."""
    some = variances > 0.0
    n = int(np.count_nonzero(some))
    if n == 0:
        return 0.0, FIRST_STD_S
    x, weights = delays[some], 1.0 / variances[some]
    order = np.argsort(x, kind="stable")
    middle = int(np.searchsorted(np.cumsum(weights[order]), 0.5 * weights.sum()))
    mean, scale, trust = float(x[order][middle]), 1.0, np.ones(n)
    for _ in range(5):
        off = np.abs(x - mean) * np.sqrt(weights) / scale
        trust = OUTLIER / np.maximum(off, OUTLIER)
        used = weights * trust
        mean = float((used * x).sum() / used.sum())
        if n > 1:
            free = AS_SAID + n - 1.0
            scale = math.sqrt(max((AS_SAID + float((used * (x - mean) ** 2).sum())) / free, 1.0))
    few = (AS_SAID + n - 1.0) / (AS_SAID + n - 3.0)  # Student's t: the scatter of few is uncertain
    variance = scale * scale * few / float((weights * trust).sum())
    known = 1.0 / (1.0 / variance + FIRST_STD_S**-2)
    return mean * known / variance, math.hypot(math.sqrt(known), LEAST_STD_S)


@dataclass
class DelaySamples:
    """Samples of a window with its margins: times [s] since its beginning, and values."""

    speed: list[tuple[float, float, float, float]] = field(default_factory=list)  # time, speed, resistance, inertia by m/s^2
    torque: list[tuple[float, float]] = field(default_factory=list)


class DelayEstimator:
    """Takes steps one by one, of a vehicle with a rolling resistance torque [Nm]; each window of them gives a delay."""

    def __init__(self, rolling_nm: float) -> None:
        self._rolling_nm = rolling_nm
        self.reset()

    def reset(self) -> None:
        """Forget all."""
        self.kept = KeptDelays()
        self._begin(0)

    def restart(self) -> None:
        """Restart the time; delays of earlier windows stay, but need confirmation."""
        self.kept.fresh = 0
        self._begin(0)

    def _begin(self, stamp_ns: int) -> None:
        self._origin_ns, self._seen_ns, self._torque_ns = stamp_ns, 0, 0
        self._samples = DelaySamples()

    def take(
        self,
        stamp_ns: int,  # of the speed
        speed: float,  # m/s
        resisting_nm: float,  # modelled drive torque without inertia
        inertia: float,  # torque of the inertia per m/s^2 [Nm s^2/m]
        torque_ns: int,  # stamp of the measured torque
        torque_nm: float,
        usable: bool = True,  # whether speed and estimate can be trusted now; if not, the whole window is discarded
    ) -> None:
        """Add a speed and the last measured torque."""
        samples, origin = self._samples, self._origin_ns
        passed_ns = stamp_ns - self._seen_ns
        behind = torque_ns < self._torque_ns  # the clock of the torque was set back
        if not usable or behind or not samples.speed or not 0 <= passed_ns <= LONGEST_GAP_S * SECOND_NS:
            self._begin(stamp_ns)
            samples, origin = self._samples, stamp_ns
            if not usable:
                return
        elif passed_ns < APART_NS:
            return
        self._seen_ns = stamp_ns
        now = (stamp_ns - origin) * NANOSECOND
        samples.speed.append((now, speed, resisting_nm, inertia))
        if torque_ns >= self._torque_ns + APART_NS and torque_ns > origin - SECOND_NS and math.isfinite(torque_nm):
            self._torque_ns = torque_ns
            samples.torque.append(((torque_ns - origin) * NANOSECOND, torque_nm))
        if now < SPAN_S + LONGEST_GAP_S:
            return
        self._advance()
        found = window_delay(np.array(samples.speed), np.array(samples.torque).reshape(-1, 2), self._rolling_nm)
        if found:
            self.kept.see(*found)

    def _advance(self) -> None:
        """Begin the next window at the end of this one."""
        self._origin_ns += round(WINDOW_S * SECOND_NS)
        self._samples = DelaySamples(
            [(time - WINDOW_S, v, r, i) for time, v, r, i in self._samples.speed if time >= WINDOW_S - LONGEST_GAP_S],
            [(time - WINDOW_S, torque) for time, torque in self._samples.torque if time >= WINDOW_S - LONGEST_GAP_S],
        )
