# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Checks the torque sensor at rest: a long reading of zero means no offset."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trackres_ros.diagnosis.prepare.session import DriveSession
from trackres_ros.units import STANDSTILL_MPS

LEAST_S = 60.0  # of stops in which it reads none


def seconds_without_torque(sessions: Sequence[DriveSession], most: float) -> float:
    """How long in all the vehicle rests with a measured torque of none [s]; 0 where that is too short to tell.

    A stop counts if the median of its readings is none: at others the vehicle may be held on a slope, or be about to start.

    Parameters
    ----------
    most
        Torque that is taken for none [Nm].
    """
    seconds = 0.0
    for session in sessions:
        slow = np.abs(session.speed) < STANDSTILL_MPS
        rests = slow & np.roll(slow, 1) & np.roll(slow, -1) & _measured(session)  # nothing of a start is in a step between
        rests[[0, -1]] = False
        ends = np.flatnonzero(np.diff(rests.astype(np.int8)))
        for begin, end in ends.reshape(-1, 2) + 1:
            if abs(float(np.median(session.torque[begin:end]))) <= most:
                seconds += session.step * float(end - begin)
    return seconds if seconds >= LEAST_S else 0.0


def _measured(session: DriveSession) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Steps with a sample of the torque in them."""
    if session.torque_course is None:
        return np.zeros(len(session), dtype=bool)
    edges = np.append(session.time, session.time[-1] + session.step)
    return np.asarray(np.histogram(session.torque_course.at, edges)[0] > 0)
