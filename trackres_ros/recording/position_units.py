# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Distinguishes degrees from radians by the values of a position, and converts it to radians."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from trackres_ros.recording.binding import TopicBinding
from trackres_ros.recording.roles import POSITION
from trackres_ros.recording.samples import SampleBlock
from trackres_ros.units import DEGREE

LARGEST_RAD = {"latitude": 0.5 * math.pi, "longitude": math.pi}


class PositionUnits:
    """The unit of latitude and longitude if neither topics file, column nor message type gives it.

    There is no land within both 1.6 degrees of the equator and 3.2 degrees of the prime meridian. So a vehicle whose latitudes
    and longitudes are all within the range of angles in radians is recorded in radians.

    `bindings`: of the source, by role.
    """

    def __init__(self, bindings: Mapping[str, TopicBinding]) -> None:
        given = {role: bindings[role].unit for role in POSITION if role in bindings}
        said = {unit for unit in given.values() if unit}
        self._open = [role for role, unit in given.items() if not unit]
        self._scale = math.nan
        self.notes: tuple[str, ...] = ()
        if self._open and said:  # one receiver provides both
            self._decide(said == {"deg"}, f"as {', '.join(set(given) - set(self._open))}")

    def _decide(self, degrees: bool, why: str) -> None:
        self._scale = DEGREE if degrees else 1.0
        self.notes = (f"{', '.join(self._open)}: treated as {'degrees' if degrees else 'radians'}, {why}",)

    def in_radians(self, block: SampleBlock, roles: Sequence[str]) -> SampleBlock:
        """A block with its position in radians; nan until the unit is known.

        `block`: the next one of the source; `roles`: those of the source.
        """
        if not self._open:
            return block
        where = {role: block.role == roles.index(role) for role in self._open}
        if math.isnan(self._scale):
            seen = {role: np.abs(block.value[rows & np.isfinite(block.value)]) for role, rows in where.items()}
            if any((seen[role] > most).any() for role, most in LARGEST_RAD.items() if role in seen):
                self._decide(True, "by the values")
            elif all(values.any() for values in seen.values()):  # a receiver without a fix sends zeros
                self._decide(False, "by the values")
        value = block.value.copy()
        for rows in where.values():
            value[rows] *= self._scale
        return SampleBlock(block.role, block.stamp_ns, block.arrival_ns, value)
