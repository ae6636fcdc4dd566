# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Finds the lowest torque at which the motor brakes alone, if no friction brake is recorded."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trackres_ros.diagnosis.prepare.robust import robust_least_squares
from trackres_ros.diagnosis.prepare.session import Array, DriveSession, Mask
from trackres_ros.units import GRAVITY, MAD_TO_STD

FEWEST_DRIVING = 300  # steps
FEWEST_OF_A_LEVEL, LEVELS = 40, 25
FAR_STDS = 4.0  # of driving steps: a larger residual means a friction brake
MOST_FAR = 0.1  # of the steps of a level, beyond the share while driving; a fit tolerates a few outliers
MOST_LOST = 0.2  # of a braking torque: a gear loss of a tenth in both directions


def motor_brakes_alone(sessions: Sequence[DriveSession], compared: Sequence[Mask]) -> float:
    """Torque in the direction of travel [Nm], zero or negative, down to which the motor brakes alone; zero where unknown.

    The torque of driving steps depends on speed, acceleration and slope. With friction brakes, the vehicle decelerates more
    than its torque explains: much more in some steps of a torque level, or a little in all of them. Braking steps are checked
    level by level, from the smallest torque on, up to the first level with either sign. Compared are the moving steps of each
    session with known speed and torque.
    """
    torque, columns = (np.concatenate(rows) for rows in zip(*map(_rows, sessions, compared), strict=True))
    drives = np.concatenate([~near(s.torque * s.ahead <= 0.0)[m] for s, m in zip(sessions, compared, strict=True)])
    if drives.sum() < FEWEST_DRIVING:
        return 0.0
    values = robust_least_squares(columns[drives], torque[drives])
    left = torque - columns @ values
    middle = float(np.median(left[drives]))
    std = MAD_TO_STD * float(np.median(np.abs(left[drives] - middle)))
    usual = float((left[drives] > middle + FAR_STDS * std).mean())
    brakes = np.flatnonzero(torque <= 0.0)
    order = brakes[np.argsort(-torque[brakes])]
    alone = 0.0
    for level in np.array_split(order, max(1, min(LEVELS, len(order) // FEWEST_OF_A_LEVEL))):
        if len(level) < FEWEST_OF_A_LEVEL:
            break
        of_level = float(np.median(left[level]))
        far = float((left[level] > of_level + FAR_STDS * std).mean())
        if far > usual + MOST_FAR or of_level - middle > std + MOST_LOST * abs(float(np.median(torque[level]))):
            break
        alone = float(torque[level[-1]])
    return alone


def near(steps: Mask) -> Mask:
    """Steps and their neighbours."""
    return np.asarray(np.convolve(steps, np.ones(3), mode="same") > 0)


def _rows(session: DriveSession, compared: Mask) -> tuple[Array, Array]:
    """The torque in the direction of travel, and its possible dependencies."""
    v, weight, ahead = session.speed * session.ahead, session.weight, session.ahead
    columns = (weight, weight * v, v**2, weight * session.accel * ahead / GRAVITY, weight * np.nan_to_num(session.grade) * ahead)
    return (session.torque * ahead)[compared], np.column_stack(columns)[compared]
