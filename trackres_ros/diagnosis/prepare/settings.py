# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Facts of a vehicle for the preparation of recordings, and the common time step."""

from __future__ import annotations

from dataclasses import dataclass

from trackres_ros.recording.roles import PASSENGER_KG

STEP_S = 1.0  # mean torque over a step against its change of speed: exact for any course within
LEAST_SAMPLES = 5  # in a step: with fewer, sampling affects the change of speed and the mean torque as much as the drive does
SLOWEST_MPS, SLOWEST_SHARE = 0.3, 0.1  # of the greatest speed; below both friction may be static


def pace(step: float) -> float:
    """Time scale of a recording over that of a drive: 1, or less for a quick machine with steps of less than `STEP_S`.

    Built-in times of the diagnosis (length of a piece, of a long gap) refer to steps of `STEP_S`. For a machine, this
    factor scales them.
    """
    return min(1.0, step / STEP_S)


@dataclass(frozen=True, slots=True)
class GateSettings:
    """Facts of a vehicle for the checks of its recordings.

    Attributes
    ----------
    weight, max_speed, ambient
        [N], [m/s], [degC]; the first and last replace missing measurements.
    friction_brakes
        Whether friction brakes may add to a braking torque, if not recorded; None for a vehicle without.
    belt_shows_surface
        Whether a measured belt temperature is that of the surface, as from infrared, or the mean.
    motor_ratio
        Motor turns per sprocket turn; None if not in the file.
    torque_scale
        Lower and upper limit of shown over expected torque, from the file.
    passenger_kg
        Mass of a passenger [kg].
    track_width
        Distance of left from right wheels [m]; None if not in the file.
    """

    weight: float
    max_speed: float
    ambient: float
    friction_brakes: bool | None
    belt_shows_surface: bool = False
    motor_ratio: float | None = None
    torque_scale: tuple[float, float] = (1.0, 1.0)
    passenger_kg: float = PASSENGER_KG
    track_width: float | None = None

    @property
    def slowest(self) -> float:
        """Speed below which friction may be static [m/s]."""
        return min(SLOWEST_MPS, SLOWEST_SHARE * self.max_speed)
