# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Compares the measured with the expected torque of a replay, while the live node would compare them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from trackres_ros.arrays import Array
from trackres_ros.estimator.columns import Results
from trackres_ros.estimator.disturbance import LARGEST_NM
from trackres_ros.node.measured_torque import MismatchSettings
from trackres_ros.recording.bindings import TopicBinding
from trackres_ros.recording.topics_files import TorqueCause, torque_causes, torque_line
from trackres_ros.text import decimals, figures

LIKE = (0.62, 1.7)  # times the expected torque: load, ground and a data sheet's values do that; one side of two does not
NEAR = 1.35  # either way of a factor
CLEARLY = 0.5  # of the error without the factor
RATIOS = (5.0, 500.0)  # of a gear that a vehicle file lacks: less may be the vehicle's resistance, more it does not accept


@dataclass(frozen=True, slots=True)
class MeasuredTorque:
    """Measured and expected torque of a replay over the driving that the live node compares.

    Torques [Nm] are means over time in the direction of travel: a torque that drives is positive, also in reverse. They are nan
    without such driving.

    Attributes
    ----------
    minutes
        Time of the compared driving [min]: torque measured, from `mismatch_min_speed_mps`, up to `mismatch_max_accel`.
    measured_nm, expected_nm, difference_nm
        Means of both, and of measured less expected [Nm].
    difference_percent
        The mean difference relative to the mean size of the expected torque [%].
    scatter_nm
        Standard deviation of the difference [Nm].
    finding
        What the torque may be instead, with the line for the topics file; empty if the data show nothing of the kind.
    """

    minutes: float
    measured_nm: float
    expected_nm: float
    difference_nm: float
    difference_percent: float
    scatter_nm: float
    finding: str

    @property
    def text(self) -> str:
        """The numbers in a sentence."""
        if not self.minutes:
            return "Measured torque: not compared, as the vehicle never drives steadily with it"
        difference, percent = (decimals(x, signed=True) for x in (self.difference_nm, self.difference_percent))
        means = (
            f"mean {_torque(self.measured_nm)}, expected {_torque(self.expected_nm)}, difference {difference} Nm ({percent} %)"
        )
        minutes = decimals(self.minutes, 1)
        return f"Measured torque: {means}, scatter {decimals(self.scatter_nm)} Nm, over {minutes} min of steady driving"

    def as_dict(self) -> dict[str, Any]:
        """The same, ready for JSON: without compared driving the torques are None."""
        values = {name: None if value != value else value for name, value in asdict(self).items()}
        return {**values, "text": self.text}


def _torque(value: float) -> str:
    """A torque with its unit; a small one, as of a motor in place of the sprockets, with more than whole numbers."""
    return f"{decimals(value) if abs(value) >= 100.0 else figures(value)} Nm"


class TorqueTotals:
    """Sums over the compared rows of a replay, block by block; the same to the bit, however the rows are divided."""

    def __init__(self, settings: MismatchSettings) -> None:
        self._settings, self._sums = settings, np.zeros(7)

    def add(self, step_s: Array, rows: Array) -> None:
        """Add rows of results, shape (rows, columns), with the time from the row before to each [s], shape (rows,)."""
        speed, measured, expected = (rows[:, i] for i in (Results.speed_mps, Results.measured_torque_nm, Results.drive_torque_nm))
        compared = self._settings.compares(speed, rows[:, Results.accel_mps2])
        compared &= (np.abs(measured) < LARGEST_NM) & (np.abs(expected) < LARGEST_NM)
        ahead, step = np.sign(speed[compared]), step_s[compared]
        m, e = ahead * measured[compared], ahead * expected[compared]
        parts = np.stack([np.ones(len(m)), m, e, np.abs(e), m * m, m * e, e * e]) * step
        self._sums = np.cumsum(np.column_stack([self._sums, parts]), axis=1)[:, -1]

    def result(self, bindings: Mapping[str, TopicBinding], motor_ratio: float | None) -> MeasuredTorque:
        """The comparison, with a finding where another reading of the torque fits clearly better.

        `bindings`: of the recording; `motor_ratio`: of the vehicle file, if it has one.
        """
        seconds, *sums = self._sums.tolist()
        if not seconds:
            return MeasuredTorque(0.0, math.nan, math.nan, math.nan, math.nan, math.nan, "")
        m, e, size, mm, me, ee = (x / seconds for x in sums)
        scatter = math.sqrt(max(mm - 2.0 * me + ee - (m - e) ** 2, 0.0))
        percent = 100.0 * (m - e) / size if size else math.nan
        return MeasuredTorque(seconds / 60.0, m, e, m - e, percent, scatter, _finding(mm, me, ee, bindings, motor_ratio))


def _finding(mm: float, me: float, ee: float, bindings: Mapping[str, TopicBinding], motor_ratio: float | None) -> str:
    """What the torque may be, if it is far off the expected one and another reading fits clearly better.

    `mm`, `me`, `ee` are mean products of measured and expected torque [Nm^2].
    """

    def error(factor: float) -> float:
        return math.sqrt(max(factor * factor * mm - 2.0 * factor * me + ee, 0.0))

    share = me / ee if ee else 0.0
    if not mm or LIKE[0] <= share <= LIKE[1] or not share:
        return ""
    sign = math.copysign(1.0, share)
    causes = torque_causes(motor_ratio, bindings)
    if share < 0.0:
        causes |= {"": TorqueCause(1.0)}  # of its sign alone
    likely = [name for name, cause in causes.items() if 1.0 / NEAR < abs(share) * cause.factor < NEAR]
    best = min(likely, key=lambda name: error(sign * causes[name].factor), default=None)
    statement = f"The measured torque is about {figures(share, 2)} times the expected torque. If "
    if best is not None and error(sign * causes[best].factor) <= CLEARLY * error(1.0):
        reading = " and ".join([f"it is {best}"] * bool(best) + ["its sign is reversed"] * (sign < 0.0))
        return f"{statement}{reading}, {torque_line(causes[best], sign, bindings)}"
    ratio = me / mm
    if motor_ratio is None and RATIOS[0] <= abs(ratio) <= RATIOS[1] and error(ratio) <= CLEARLY * error(0.0):
        reading = f"it is at the motor, behind a gear of about {figures(abs(ratio), 2)}"
        line = torque_line(TorqueCause(abs(ratio), "motor"), sign, bindings)
        return f"{statement}{reading}, give motor_ratio in the vehicle file; {line}"
    return ""
