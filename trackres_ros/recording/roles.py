# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Lists the roles that samples may have: what each kind of input means, and its unit inside the program."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType


@dataclass(frozen=True, slots=True)
class Role:
    """What a kind of input means.

    Attributes
    ----------
    unit : str
        Unit of its values inside the program.
    text : str
        What it is.
    parts : bool
        Whether it may be given for each axle, assembly or wheel (``load/front``, ``wheel_speed/rear_left``).
    lively : bool
        Whether a moving vehicle changes it all the time, so that a constant value means a stuck sensor.
    """

    unit: str
    text: str
    parts: bool = False
    lively: bool = False


ROLES: Mapping[str, Role] = MappingProxyType(
    {
        "speed": Role("m/s", "forward speed of the vehicle", lively=True),
        "load": Role("N", "weight carried by the tracks, total or of an axle or assembly", parts=True),
        "torque": Role("Nm", "measured torque at the sprockets, whole vehicle or of an assembly", parts=True, lively=True),
        "ambient": Role("degC", "temperature of the air"),
        "belt": Role("degC", "measured temperature of the rubber belt", parts=True),
        "accel": Role("m/s2", "acceleration along the track, without the share of gravity", lively=True),
        "specific_force": Role(
            "m/s2", "what an IMU feels along the track: acceleration and, on a slope, the share of gravity", lively=True
        ),
        "grade": Role("1", "slope as rise over run, positive uphill"),
        "yaw_rate": Role("rad/s", "turning rate about the upward axis", lively=True),
        "heading": Role("rad", "direction of travel about the upward axis"),
        "distance": Role("m", "distance travelled"),
        "stood": Role("s", "how long it had stood when the recording began; one value"),
        "latitude": Role("rad", "latitude, positive north"),
        "longitude": Role("rad", "longitude, positive east"),
        "altitude": Role("m", "height above a fixed level"),
        "steering_angle": Role("rad", "angle of the steered wheels, positive to the left"),
        "passengers": Role("1", "people on board, who come on top of the empty vehicle"),
        "brake": Role("Pa", "pressure of the friction brakes, or 0 and 1 of a switch"),
        "wheel_speed": Role("m/s", "speed of the rim of a wheel", parts=True),
        "enable": Role("1", "whether the feed-forward is wanted: 1 or 0, or a mode, which `values` turns into them"),
    }
)


POSITION = ("latitude", "longitude")
GROUND = ("altitude", "specific_force")
"""Roles that show how the ground rises to who learns from a measured torque; the estimate itself needs none of them."""
ANGLES = (*POSITION, "heading", "steering_angle")
"""Roles in rad that may be given in degrees, with ``unit: deg``."""
PASSENGER_KG = 70.0
"""Mass of a passenger where nobody says; assumed. UN regulation 107 counts 68 kg in a city bus, 71 kg with luggage."""
BRAKE_ON_PA = 10e3
"""Pressure from which a friction brake counts as on, where nobody says; assumed: springs hold its shoes off below."""


def base_role(role: str) -> str:
    """Return the role without its axle or assembly: ``load`` of ``load/front``."""
    return role.partition("/")[0]
