# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Compares measured and expected torque, row by row: lasting differences and disturbances.

It only reads the estimate: no disturbance enters an expected torque or the feed-forward.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from trackres_ros.estimator import columns as at
from trackres_ros.estimator.disturbance import Belief, DisturbanceWatch
from trackres_ros.node.measured_torque import Mismatch, MismatchDetector, MismatchSettings
from trackres_ros.node.notices import Notice
from trackres_ros.vehicle import Disturbance

TIME_RESET, CLOCK_JUMPED = int(at.Reason.TIME_RESET), int(at.Reason.CLOCK_JUMPED)


class Comparison:
    """Compares rows of results; `verdict` and `belief` are the results.

    Rows that the detector does not compare are not watched for disturbances either. There is no disturbance to watch for
    without one in the vehicle file, or without a measured torque.
    """

    def __init__(self, settings: MismatchSettings, disturbance: Disturbance | None) -> None:
        self._detector = MismatchDetector(settings)
        self._watch = None if disturbance is None else DisturbanceWatch(disturbance)
        self.belief = None if self._watch is None else self._watch.belief(0)
        self._set_ns = 0

    @property
    def verdict(self) -> Mismatch:
        """Whether measured and expected torque, corrected for a disturbance, differ significantly."""
        return self._detector.verdict

    def restart(self) -> None:
        """Reset after a restart of the estimate."""
        self._detector.restart()
        if self._watch is not None:
            self._watch.restart()
            self.belief = self._watch.belief(0)

    def change(self, settings: MismatchSettings) -> None:
        """Continue with other settings; the detector restarts with them."""
        if settings != self._detector.settings:
            self._detector = MismatchDetector(settings)

    def take(self, stamp_ns: int, row: Sequence[float], arrival_ns: int, set_ns: int = 0) -> str:
        """Take the results of a step, its stamp and its arrival [ns]; return a text for the log, or an empty one.

        `set_ns` is how far this machine's clock was set since the start, where stamps do not show it.
        """
        if int(row[at.Results.reasons]) & TIME_RESET:
            self.restart()
        jumped = bool(int(row[at.Results.reasons]) & CLOCK_JUMPED) or set_ns != self._set_ns
        self._set_ns = set_ns
        residual, speed, accel = row[at.Results.residual_nm], row[at.Results.speed_mps], row[at.Results.accel_mps2]
        before, explained = self.belief, 0.0
        if self._watch is not None:
            counts = self._detector.settings.compares(speed, accel)
            now_ns = stamp_ns + set_ns
            self.belief = self._watch.take(now_ns, residual if counts else math.nan, speed, now_ns - arrival_ns, jumped)
            explained = 0.0 if self.belief.overdue else self.belief.torque_nm * math.copysign(1.0, speed)
        self._detector.take(
            stamp_ns, residual - explained, row[at.Results.drive_torque_nm], row[at.Results.resistance_std_nm], speed, accel
        )
        return _turned(before, self.belief)

    def notices(self, command: str) -> list[Notice]:
        """Present notices; `command` explains a mismatch."""
        verdict, belief = self.verdict, self.belief
        return [
            *([Notice("MISMATCH", f"{verdict.text}; investigate with: {command}")] if verdict.parted else []),
            *([Notice("DISTURBANCE", belief.text)] if belief is not None and belief.present else []),
        ]


def _turned(before: Belief | None, now: Belief | None) -> str:
    """Text that a spell begins or is over; empty if neither."""
    if before is None or now is None or before.present is now.present:
        return ""
    return f"{'the disturbance begins' if now.present else 'the disturbance is over'}: {now.text}"
