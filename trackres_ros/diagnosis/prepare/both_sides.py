# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Gives a replay the acceleration that a diagnosis has, from the speeds before and after, and compares its torques as a diagnosis
does: in means over its steps, in the steps that it compares.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from trackres_ros.diagnosis.prepare.gate import gate, step_of
from trackres_ros.diagnosis.prepare.resample import smoothed_motion
from trackres_ros.diagnosis.prepare.settings import GateSettings
from trackres_ros.errors import InputError
from trackres_ros.estimator.columns import Results
from trackres_ros.estimator.records import Steps
from trackres_ros.recording.recording import Recording, stamped
from trackres_ros.recording.samples import Series
from trackres_ros.text.numbers import number_of
from trackres_ros.units import SECOND_NS

GIVEN = "the acceleration is recorded, so it is not computed from the speeds on both sides"


def with_acceleration(recording: Recording, settings: GateSettings) -> Recording:
    """A recording with an acceleration [m/s^2] at each of its speeds, from those before and after; logged just before the speed.

    One with a recorded acceleration keeps that, with a note. Raises InputError for a recording without two speeds.
    """
    if "accel" in recording.series and np.isfinite(recording.series["accel"].value).any():
        return replace(recording, notes=(*recording.notes, GIVEN))
    recording = recording.without(["accel"])  # a role may have no sample
    logged, speed = recording.series["speed"], stamped(recording).series["speed"]
    finite = np.flatnonzero(np.isfinite(speed.value))
    stamps, first, stamp_of = np.unique(speed.stamp_ns[finite], return_index=True, return_inverse=True)
    if len(stamps) < 2:
        raise InputError(
            recording.name, number_of(len(stamps), "usable speed"), "two or more, for an acceleration from both sides"
        )
    at = (stamps - stamps[0]) / SECOND_NS
    accel = smoothed_motion(at, speed.value[finite][first], at, step_of([recording], settings), settings.slowest).accel[stamp_of]
    finite_accel = np.isfinite(accel)
    rows, order = finite[finite_accel], recording.log_order()
    places = np.flatnonzero(order == list(recording.series).index("speed"))[rows]
    return replace(
        recording,
        series={**recording.series, "accel": Series(logged.stamp_ns[rows], logged.arrival_ns[rows], accel[finite_accel])},
        order=np.insert(order, places, np.int16(len(recording.series))),
    )


class ComparedTorque:
    """Residual torque of a replay in the steps that a diagnosis compares."""

    def __init__(self, recording: Recording, settings: GateSettings) -> None:
        """Take the steps of a recording. Raises InputError where a diagnosis would refuse it, with the reason."""
        (self._session,) = gate([recording], settings).sessions
        self._start_ns = stamped(recording).start_ns
        self._sum, self._number = np.zeros((2, len(self._session)))  # of the residuals in each step [Nm]

    def writer(self, write: Callable[[Steps], None]) -> Callable[[Steps], None]:
        """A function that adds rows of a replay to the comparison, and writes them."""

        def take(steps: Steps) -> None:
            self._add(steps)
            write(steps)

        return take

    def _add(self, steps: Steps) -> None:
        residual = steps.rows[:, Results.residual_nm]
        step = np.floor((steps.stamp_ns - self._start_ns) / (self._session.step * SECOND_NS)).astype(int)
        inside = np.isfinite(residual) & (step >= 0) & (step < len(self._session))
        np.add.at(self._sum, step[inside], residual[inside])
        np.add.at(self._number, step[inside], 1.0)

    def as_dict(self) -> dict[str, Any]:
        """Mean absolute residual of the steps' means [Nm], the length of a step and the number of steps, ready for JSON."""
        steps = self._session.used & (self._number > 0.0)
        means = self._sum[steps] / self._number[steps]
        error = float(np.abs(means).mean()) if steps.any() else None
        return {"mean_error_nm": error, "step_s": self._session.step, "steps": int(steps.sum())}
