# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a torque sensor shows at rest: where it reads none for long, it has no offset."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trackres_ros.diagnosis.prepare.session import Session
from trackres_ros.units import STANDSTILL_MPS

LEAST_S = 60.0  # of rest in all


def seconds_without_torque(sessions: Sequence[Session], most: float) -> float:
    """How long the vehicles rest with a measured torque of none [s]; 0 where that is too short to tell, or a torque is shown.

    A step rests if the steps before and after it rest too, so that nothing of a start or a stop is in it.

    Parameters
    ----------
    most
        Torque that is taken for none [Nm]: the median at rest lies within it.
    """
    found, seconds = list[float](), 0.0
    for session in sessions:
        slow = np.abs(session.speed) < STANDSTILL_MPS
        rests = slow & np.roll(slow, 1) & np.roll(slow, -1) & _measured(session)
        rests[[0, -1]] = False
        found += session.torque[rests].tolist()
        seconds += session.step * float(rests.sum())
    return seconds if seconds >= LEAST_S and abs(float(np.median(found))) <= most else 0.0


def _measured(session: Session) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Steps with a sample of the torque in them."""
    if session.torque_course is None:
        return np.zeros(len(session), dtype=bool)
    edges = np.append(session.time, session.time[-1] + session.step)
    return np.asarray(np.histogram(session.torque_course.at, edges)[0] > 0)
