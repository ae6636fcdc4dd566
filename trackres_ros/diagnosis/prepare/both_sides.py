# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Gives a replay the acceleration that a diagnosis has, from the speeds before and after, and compares its torques as a diagnosis
does: in means over its steps, in the steps that it compares.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from trackres_ros.diagnosis.prepare.gate import gate, step_of
from trackres_ros.diagnosis.prepare.resample import smoothed_motion
from trackres_ros.diagnosis.prepare.session import Array, DriveSession
from trackres_ros.diagnosis.prepare.settings import GateSettings
from trackres_ros.errors import InputError
from trackres_ros.estimator.columns import Results
from trackres_ros.estimator.estimate import Steps
from trackres_ros.recording.recording import Recording, stamped
from trackres_ros.recording.samples import Series
from trackres_ros.text.numbers import number_of
from trackres_ros.units import SECOND_NS

GIVEN = "the acceleration is recorded, so it is not computed from the speeds on both sides"


def with_acceleration(recording: Recording, settings: GateSettings) -> Recording:
    """A recording with an acceleration [m/s^2] at each of its speeds, from those before and after; logged just before the speed.

    One with a recorded acceleration keeps that, with a note. Raises InputError for a recording without two speeds.
    """
    if "accel" in recording.series:
        return replace(recording, notes=(*recording.notes, GIVEN))
    own, speed = recording.series["speed"], stamped(recording).series["speed"]
    finite = np.flatnonzero(np.isfinite(speed.value))
    stamps, first, each = np.unique(speed.stamp_ns[finite], return_index=True, return_inverse=True)
    if len(stamps) < 2:
        raise InputError(
            recording.name, number_of(len(stamps), "usable speed"), "two or more, for an acceleration from both sides"
        )
    at = (stamps - stamps[0]) / SECOND_NS
    accel = smoothed_motion(at, speed.value[finite][first], at, step_of([recording], settings), settings.slowest).accel[each]
    known = np.isfinite(accel)
    rows, order = finite[known], recording.log_order()
    before = np.flatnonzero(order == list(recording.series).index("speed"))[rows]
    return replace(
        recording,
        series={**recording.series, "accel": Series(own.stamp_ns[rows], own.arrival_ns[rows], accel[known])},
        order=np.insert(order, before, np.int16(len(recording.series))),
    )


@dataclass(frozen=True, eq=False)
class ComparedTorque:
    """Residual torque of a replay in the steps that a diagnosis compares."""

    session: DriveSession
    start_ns: int
    _sum: Array = field(init=False, repr=False)  # of the residuals in each step [Nm]
    _number: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        for name in ("_sum", "_number"):
            object.__setattr__(self, name, np.zeros(len(self.session)))

    @classmethod
    def of(cls, recording: Recording, settings: GateSettings) -> ComparedTorque:
        """The steps of a recording. Raises InputError where a diagnosis would refuse it, with the reason."""
        (session,) = gate([recording], settings).sessions
        return cls(session, stamped(recording).start_ns)

    def before(self, write: Callable[[Steps], None]) -> Callable[[Steps], None]:
        """What takes rows of a replay, and writes them then."""

        def take(steps: Steps) -> None:
            self._add(steps)
            write(steps)

        return take

    def _add(self, steps: Steps) -> None:
        residual = steps.rows[:, Results.residual_nm]
        step = ((steps.stamp_ns - self.start_ns) / (self.session.step * SECOND_NS)).astype(int)
        inside = np.isfinite(residual) & (step >= 0) & (step < len(self.session))
        np.add.at(self._sum, step[inside], residual[inside])
        np.add.at(self._number, step[inside], 1.0)

    @property
    def error_nm(self) -> float:
        """Mean absolute residual of the steps' means [Nm]; nan without any."""
        compared = self.session.used & (self._number > 0.0)
        return float(np.abs(self._sum[compared] / self._number[compared]).mean()) if compared.any() else float("nan")

    def as_dict(self) -> dict[str, Any]:
        """The error, the length of a step and the number of steps compared, ready for JSON."""
        number = int((self.session.used & (self._number > 0.0)).sum())
        return {"mean_error_nm": self.error_nm if number else None, "step_s": self.session.step, "steps": number}
