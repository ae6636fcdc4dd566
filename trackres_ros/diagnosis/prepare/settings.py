# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Facts of a vehicle for the preparation of recordings, and the common time step."""

from __future__ import annotations

from dataclasses import dataclass

from trackres_ros.recording.roles import PASSENGER_KG

STEP_S = 1.0  # mean torque over a step against the change of speed over it: exact, whatever happens within
LEAST_SAMPLES = 5  # in a step: of fewer, the change of speed and the mean torque are as much the sampling's as the drive's
SLOWEST_MPS, SLOWEST_SHARE = 0.3, 0.1  # of the greatest speed; below both friction may be static


def pace(step: float) -> float:
    """Time scale of a recording over that of a drive: 1, or less where a quick machine asks for steps of less than `STEP_S`.

    Times of a drive that the diagnosis has built in (how long a piece is, which gap is long) are meant in steps of `STEP_S`: of
    a machine they are so many times as long.
    """
    return min(1.0, step / STEP_S)


@dataclass(frozen=True, slots=True)
class GateSettings:
    """Facts of a vehicle for the checks of its recordings.

    Attributes
    ----------
    weight, max_speed, ambient
        [N], [m/s], [degC]; the first and last stand in where nothing is recorded.
    friction_brakes
        Whether brakes help a torque that brakes, where nothing is recorded of them; None where there are none at all.
    belt_shows_surface
        Whether a measured belt temperature is that of the surface, as infrared sees it, or the mean.
    motor_ratio
        Turns of the motor to one of the sprocket; None where the file does not say.
    torque_scale
        Least and most times the expected torque that the file allows to be shown.
    passenger_kg
        Mass of a passenger [kg].
    track_width
        Distance of left from right wheels [m]; None where the file does not say.
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
