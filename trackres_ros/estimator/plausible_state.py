# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Checks that the numbers of a stored state are within the range that the estimate can reach.

The seal shows that a file is unchanged; these checks show that its content is a valid state. Both are needed, so that no
restored number moves a vehicle unless a drive could have produced it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trackres_ros.arrays import Array
from trackres_ros.estimator import columns as at
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.guards import Memory
from trackres_ros.estimator.plausible_speed import NOTHING_TRACKED
from trackres_ros.estimator.records import FARTHEST_NS
from trackres_ros.route.follower import NOTHING_YET

BELT_DEGC = (-100.0, 400.0)  # wider than any rubber lives through
MOST_DEPARTURE = 10.0  # relative to the file's value
LARGEST_DEPARTURE = 1000.0  # K, of a standard deviation of any cause
SPEED_REACH = 3.0  # of the greatest speed: the filter may overshoot, and effects scale the speed
LARGEST_ACCEL = 1e4  # m/s^2, by a filter on stamps that differ by a few microseconds
LARGEST_COVARIANCE = 1e6
ROUNDING = 1e-9
NO_QUANTUM = 1e9  # as `kernel.start` begins
TORQUE_REACH = 1e4  # of weight times sprocket radius: inertia by the acceleration above
STARTED = (at.START_ANEW, at.START_COLD, 0.0, at.RESTS, 1.0)
MOST_SUSPECTS = 1000
FARTHEST_FOLLOWED = 1e9  # metres, Nm, and seconds
LONGEST_TURN = 1e10  # s: times are at most so far apart
LONGEST_AGE = 60.0  # s: the settings allow no more
LARGEST_EFFECT = 1e12  # distance [m], time constant [s], or the state of an effect in any unit


def check_state(estimator: Estimator, belts: Array, motion: Array) -> None:
    """Raise ValueError for belts or a motion that no drive can produce."""
    _within("belt temperatures", belts[:, :, at.Belt.temperature], *BELT_DEGC)
    _within("departures of belt temperatures", belts[:, :, at.FIRST_DEPARTURE :], -LARGEST_DEPARTURE, LARGEST_DEPARTURE)
    speed = SPEED_REACH * estimator.vehicle.chassis.max_speed
    k = estimator.constants.assembly
    torque = TORQUE_REACH * float(k[:, at.Assembly.nominal_load] @ k[:, at.Assembly.radius])
    left = at.Motion(motion)
    for name, value, low, high in (
        ("filtered speed", left.filtered_speed, -speed, speed),
        ("last speed", left.last_speed, -speed, speed),
        ("acceleration", left.filtered_accel, -LARGEST_ACCEL, LARGEST_ACCEL),
        ("covariance of the speed", left.cov_speed, -ROUNDING, LARGEST_COVARIANCE),
        ("covariance of speed and acceleration", left.cov_both, -LARGEST_COVARIANCE, LARGEST_COVARIANCE),
        ("covariance of the acceleration", left.cov_accel, -ROUNDING, LARGEST_COVARIANCE),
        ("smallest step of the speed", left.quantum, 0.0, NO_QUANTUM),
        ("feed-forward", left.feedforward, -torque, torque),
        ("target of the feed-forward", left.feedforward_target, -torque, torque),
        ("mark of rolling", left.rolls, 0.0, 1.0),
        ("drive torque", left.last_drive, -torque, torque),
        ("drive torque but for belts and effects", left.last_others, -torque, torque),
        ("turn of the feed-forward", left.turned, 0.0, LONGEST_TURN),
        ("mark of no feed-forward", left.unfed, 0.0, 1.0),
        ("air", left.air, *BELT_DEGC),
        ("standard deviation of the air", left.air_std, 0.0, LARGEST_DEPARTURE),
        ("longest age of the speed", left.longest_age, 0.0, LONGEST_AGE),
    ):
        _within(name, value, low, high)
    if left.started not in STARTED:
        raise ValueError("started is none of its values")


def check_effects(memory: Array) -> None:
    """Raise ValueError for an impossible memory of effects; nan is an effect that has not acted yet."""
    _within("memory of effects", memory[~np.isnan(memory)], -LARGEST_EFFECT, LARGEST_EFFECT)


def check_learned(estimator: Estimator, learned: Array) -> None:
    """Raise ValueError for impossible learned values."""
    k = estimator.constants.assembly
    torque = TORQUE_REACH * float(k[:, at.Assembly.nominal_load] @ k[:, at.Assembly.radius])
    departures = learned[at.Learned.departures]
    _within("mark of what acts", learned[at.Learned.on], 0.0, 1.0)
    _within("departures", np.delete(departures, at.OF_BELT), -1.0, MOST_DEPARTURE)
    _within("departure of the belts", departures[at.OF_BELT], -LARGEST_DEPARTURE, LARGEST_DEPARTURE)
    _within("torques that were learned", learned[at.Learned.torque : at.Learned.factor.start], -torque, torque)
    _within("covariance of what was learned", learned[at.Learned.factor], -LARGEST_DEPARTURE, LARGEST_DEPARTURE)
    _within("sensitivities", learned[at.Learned.sensitivities], -torque, torque)


def check_memory(memory: Memory, limits: Array) -> None:
    """Raise ValueError for a memory of the guards that no stream of messages can produce."""
    known = ~np.isnan(memory.values)
    if ((memory.values < limits[:, 0]) | (memory.values > limits[:, 1]))[known].any():
        raise ValueError("last values outside of the plausible range of their channels")
    _within("times", memory.times, -FARTHEST_NS, FARTHEST_NS)
    _within("marks of channels", memory.times[:, [at.Times.seen, at.Times.fresh]], 0, 1)
    _within("suspects", memory.times[:, at.Times.suspects], 0, MOST_SUSPECTS)
    if (known != (memory.times[:, at.Times.seen] == 1)).any():
        raise ValueError("channels with a time and no value, or the other way round")
    _within("doubts", memory.times[:, at.Times.doubts], 0, FARTHEST_NS)
    _within("periods", memory.times[:, at.Times.period], 0, FARTHEST_NS)
    _within("references", memory.runs[~np.isnan(memory.runs)], -FARTHEST_FOLLOWED, FARTHEST_FOLLOWED)
    for name, values, at_first in (
        ("comparison with the odometer", memory.tracked, NOTHING_TRACKED),
        ("place on a route", memory.followed, NOTHING_YET),
    ):
        is_number = ~np.isnan(values)
        _within(name, values[is_number], -FARTHEST_FOLLOWED, FARTHEST_FOLLOWED)
        if not is_number[~np.isnan(at_first)].all():
            raise ValueError(f"{name}: no number where there is always one")
    _within("counters", memory.counters, 0, FARTHEST_NS)
    _within("counts of reasons", memory.reasons, 0, FARTHEST_NS)


def _within(name: str, given: ArrayLike, low: float, high: float) -> None:
    values: NDArray[Any] = np.asarray(given)
    if not ((values >= low) & (values <= high)).all():  # nan is not either
        raise ValueError(f"{name} outside of {low:g} to {high:g}")
