# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Checks the torque sensor at rest: a long reading of zero means no offset."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trackres_ros.diagnosis.prepare.session import DriveSession
from trackres_ros.units import STANDSTILL_MPS

LEAST_S = 60.0  # of stops with a reading of zero


def seconds_without_torque(sessions: Sequence[DriveSession], most: float) -> float:
    """Total time at rest with a measured torque of zero [s]; 0 where too short to decide.

    A stop is included if the median of its readings is zero: at others a slope may hold a torque, or a start is near.

    Parameters
    ----------
    most
        Largest torque treated as zero [Nm].
    """
    seconds = 0.0
    for session in sessions:
        slow = np.abs(session.speed) < STANDSTILL_MPS
        rests = slow & np.roll(slow, 1) & np.roll(slow, -1) & _measured(session)  # no part of a start within the step
        rests[[0, -1]] = False
        ends = np.flatnonzero(np.diff(rests.astype(np.int8)))
        for begin, end in ends.reshape(-1, 2) + 1:
            if abs(float(np.median(session.torque[begin:end]))) <= most:
                seconds += session.step * float(end - begin)
    return seconds if seconds >= LEAST_S else 0.0


def _measured(session: DriveSession) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Steps that contain a torque sample."""
    if session.torque_course is None:
        return np.zeros(len(session), dtype=bool)
    edges = np.append(session.time, session.time[-1] + session.step)
    return np.asarray(np.histogram(session.torque_course.at, edges)[0] > 0)
