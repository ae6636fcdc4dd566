# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Torque residuals of a fit, and torques as a resistance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.prepare.session import Array, DriveSession


def torque_residuals(found: Fit) -> list[Array]:
    """Measured less expected torque of each session [Nm]."""
    return [s.torque - p.torque for s, p in zip(found.problem.sessions, found.predicted, strict=True)]


def against_travel(sessions: Sequence[DriveSession], torques: Sequence[Array]) -> list[Array]:
    """A torque as a resistance: positive against travel in both directions."""
    return [x * np.sign(s.speed) for s, x in zip(sessions, torques, strict=True)]
