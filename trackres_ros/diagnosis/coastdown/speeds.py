# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Speeds over time of coast-downs, measured and modelled, for pictures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.coastdown.fitted import Coastdown
from trackres_ros.units import GRAVITY

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Rollout:
    """Speeds of one coast-down; series of shape (n,).

    Attributes
    ----------
    name
        Name of the recording.
    time, measured
        Since the start of the recording [s]; speed [m/s].
    by_file, by_found
        Speed with the vehicle file, and with the fitted values, from the first measured one on [m/s].
    over_file, over_found
        Excess resistance torque [Nm].
    """

    name: str
    time: Array
    measured: Array
    by_file: Array
    by_found: Array
    over_file: Array
    over_found: Array


def rollouts_of(found: Coastdown) -> list[Rollout]:
    """All coast-downs of a result, in order."""
    base, listed = found.loaded.base, []
    for stretch in found.rolled.stretches:
        session, at = found.rolled.sessions[stretch.session], slice(stretch.begin, stretch.end)
        sense = np.sign(session.speed[at])
        per_acceleration = session.weight[at] / GRAVITY * base.rotating_mass_factor * base.facts.radius
        over = [sense * (torque[stretch.session][at] - session.torque[at]) for torque in (found.nominal, found.fitted)]
        # Excess torque of a model adds deceleration; the effect of the changed speed is neglected.
        behind = [np.concatenate(([0.0], np.cumsum(x / per_acceleration)[:-1])) * session.step for x in over]
        measured = np.abs(session.speed[at])
        listed.append(Rollout(session.name, session.time[at], measured, *(measured - b for b in behind), *over))
    return listed
