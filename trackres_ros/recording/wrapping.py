# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Continues the times of a clock of the day, or of a counter, that begins anew: at midnight, or after its last number."""

from collections.abc import Iterator

import numpy as np

from trackres_ros.recording.samples import Finding, FloatArray
from trackres_ros.text import figures

DAY_S = 86400.0
CLOCKS_S = (3600.0, 43200.0, DAY_S, 604800.0)
"""Clocks begin anew after an hour (mm:ss), half a day, a day, or a week of GPS [s]."""
COUNTERS = (2.0**16, 2.0**24, 2.0**31, 2.0**32)
"""Counters of whole numbers begin anew after the numbers that fit in 16, 24, 31 or 32 bits."""
MOST_STEPS = 3.0
"""The step across the new beginning is at most so many usual ones. Assumed: a longer one is more likely another clock."""
RESET_S = 60.0
"""A clock that starts so near to 0, or to its first time, was set, or its logger restarted [s]; unless it ended so near to
midnight. Assumed."""


class WrappingClock:
    """The times of one column, block by block, without its new beginnings.

    A time that steps back belongs to a new turn in two cases. Either the step forward across the end of the clock is a usual one.
    Or it is a pause over midnight: a clock of the day goes back by more than half a day, and not to its start. Any other step
    back stays, as the clock was set.

    `scale`: seconds in a unit of the column.
    """

    def __init__(self, scale: float) -> None:
        self._scale, self._turns, self._first, self._last, self._highest = scale, 0.0, np.nan, np.nan, 0.0
        self._step = np.nan
        self._is_whole = True
        self._wraps: list[tuple[float, float, float]] = []  # period and step across it [s], and time from the first one [s]

    def continued(self, times: FloatArray) -> FloatArray:
        """The times of the next rows, in the unit of the column, shape (n,)."""
        if not len(times) or not np.isfinite(times).all():  # refused as they are
            return times
        previous = np.concatenate([[times[0] if np.isnan(self._last) else self._last], times[:-1]])
        steps = times - previous
        self._first = times[0] if np.isnan(self._first) else self._first
        forward = steps[steps > 0.0]
        self._step = float(np.median(forward)) if len(forward) else self._step
        self._is_whole = self._is_whole and bool((times == np.rint(times)).all())
        highest_times = np.maximum.accumulate(np.concatenate([[self._highest], times]))
        turns = np.zeros(len(times))
        for row in np.flatnonzero(steps < 0.0).tolist():
            period = self._period(float(previous[row]), float(times[row]), float(highest_times[row]))
            if period:
                turns[row] = period
                begin_s = self._scale * (times[row] + self._turns + turns[: row + 1].sum() - self._first)
                self._wraps.append((self._scale * period, self._scale * (period + steps[row]), begin_s))
        self._last, self._highest = float(times[-1]), float(highest_times[-1])
        if not turns.any() and not self._turns:
            return times
        sums = self._turns + np.cumsum(turns)
        self._turns = float(sums[-1])
        return np.asarray(times + sums)

    def _period(self, last: float, time: float, highest: float) -> float:
        """The period of the clock whose new beginning lies between two times; 0 if the clock was set."""
        day, reset = DAY_S / self._scale, RESET_S / self._scale
        periods = [seconds / self._scale for seconds in CLOCKS_S] + list(COUNTERS if self._is_whole else ())
        for period in periods:
            is_in_period = highest < period and (time >= 0.0 or period in COUNTERS)
            longest_step = max(MOST_STEPS * self._step, reset if period >= day and period not in COUNTERS else 0.0)
            if is_in_period and 0.0 < time - last + period <= longest_step:
                return period
        is_over_midnight = time >= 0.0 and highest < day and last - time > 0.5 * day
        is_set = min(time, self._first, abs(time - self._first)) < reset
        return day if is_over_midnight and not is_set else 0.0

    def findings(self) -> Iterator[Finding]:
        """One finding for each period."""
        for period in dict.fromkeys(period for period, _, _ in self._wraps):
            of_period = [(step, begin) for other, step, begin in self._wraps if other == period]
            count, longest = len(of_period), max(step for step, _ in of_period)
            counter = next((name for name in COUNTERS if name == period / self._scale), 0.0)
            begins = (
                f"after its {counter:.0f} numbers"
                if counter
                else "at midnight"
                if period == DAY_S
                else f"after {figures(period, 6)} s"
            )
            times = "once" if count == 1 else f"{count} times"
            is_pause = longest > max(RESET_S, MOST_STEPS * self._scale * self._step)
            pause = f", with a pause of up to {figures(longest / 3600.0)} h" if is_pause else ""
            yield Finding(
                "", "new_turn", count, of_period[0][1], f"the clock begins anew {begins}, {times}: its times go on{pause}"
            )
