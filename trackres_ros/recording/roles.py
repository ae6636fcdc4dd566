# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The one table of roles: meaning, internal unit and known column names of each kind of input."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType


@dataclass(frozen=True, slots=True)
class Role:
    """Definition of a kind of input."""

    unit: str  # internal unit of its values, a key of `trackres_ros.recording.role_units.UNITS`
    text: str
    parts: bool = False  # whether it may be given for each axle, assembly or wheel (``load/front``, ``wheel_speed/rear_left``)
    lively: bool = False  # whether a moving vehicle changes it all the time, so that a constant value means a stuck sensor
    columns: Mapping[str, str] = field(default_factory=dict)  # names of columns for it, and the unit of each
    # patterns that the words of a channel must and must not match for it to be guessed; never guessed without `words`
    words: str = ""
    not_words: str = r"(?!)"


NOT_VEHICLE = (
    r"rpm|\b(engine|motor|wind|fan|angular|yaw|cpu)\b|"
    r"^(?!.*\bveh(icle)? ?(speed|velocity|spd)\b).*\b(eng|e?mot)\d*\b"  # which may send the vehicle's speed too
)
"""Words for a speed, load or torque that is not that of the vehicle at its tracks."""
AMBIENT = r"\b(ambient|outside|outdoor|air)\b"
NOT_AMBIENT = (
    r"inlet|intake|outlet|manifold|charge|compress|cooler|exhaust|condition(er|ing|ed)|\bair ?cond(ition)?\b|\bac\b|"
    r"interior|inside|indoor|cargo|surface|\beng(ine)?\d*\b|^(?!.*\b(outside|outdoor)\b).*\bcab(in)?\d*\b"
)
"""Words for the air in a part of the vehicle, or the ground; ambient conditions are a group of J1939 that has both."""
OF_VEHICLE = r"veh(icle)? ?(speed|velocity|spd)"
CRUISE = (
    r"^(?=.*\bset\b).*\bcruise\b|"
    rf"^(?!.*(?<!cruise control )(?<!cruise ctrl )\b{OF_VEHICLE}).*"
    rf"\bcruise\b(?! (control|ctrl) {OF_VEHICLE}\d*( [km]\w*( [hs])?)?$)"
)
"""Words for a speed of the cruise control, in whose group of J1939 the vehicle's is too."""

ROLES: Mapping[str, Role] = MappingProxyType(
    {
        "speed": Role("m/s", "forward speed of the vehicle",
            lively=True, columns={"speed_mps": "m/s", "speed_kmh": "km/h"}, words=r"speed|velocity|\bspd\b",
            not_words=NOT_VEHICLE + "|" + CRUISE + r"|\bset ?(speed|spd)\b|\bforward veh|\bpreceding\b|"
            r"\brelative\b(?! to ground)"),
        "direction": Role("1", "the way a speed without a sign is driven: 1 forward, -1 backwards, 0 neutral",
            columns={"reverse": "1", "travel_direction": "1"}),
        "load": Role("N", "weight carried by the tracks, total or of an axle or assembly",
            parts=True, columns={"weight_n": "N", "weight_kn": "kN"}, words=r"\bload\b|weight",
            not_words=NOT_VEHICLE + r"|pay ?load|cargo|trailer|^(?!.*\bpowered veh).*combination|"
            r"\b(empty|tare|unladen|kerb|curb)\b"),
        "torque": Role("Nm", "measured torque at the sprockets, of the whole vehicle or of an assembly",
            parts=True, lively=True, columns={"torque_nm": "Nm"}, words=r"torque|\btrq\b",
            not_words=NOT_VEHICLE + r"|brak|brems|steer|lenk|retard|clutch|\bpto\b"),
        "ambient": Role("degC", "temperature of the air", columns={"ambient_degc": "degC"}, words=AMBIENT, not_words=NOT_AMBIENT),
        "belt": Role("degC", "measured temperature of the rubber belt",
            parts=True, columns={"belt_degc": "degC"}, words=r"\b(belt|track|rubber)\b", not_words=AMBIENT),
        "accel": Role("m/s2", "acceleration along the track, without gravity", lively=True, columns={"accel_mps2": "m/s2"}),
        "specific_force": Role("m/s2", "what an IMU measures along the track: acceleration and, on a slope, gravity",
            lively=True, columns={"specific_force_mps2": "m/s2"}),
        "grade": Role("1", "slope as rise over run, positive uphill", columns={"grade": "1"}),
        "yaw_rate": Role("rad/s", "turning rate about the upward axis",
            lively=True, columns={"yaw_rate_radps": "rad/s"}, words=r"\byaw ?rate\b"),
        "heading": Role("rad", "angle about the upward axis at which the vehicle points", columns={"heading_rad": "rad"}),
        "distance": Role("m", "distance travelled", columns={"distance_m": "m"}),
        "stood": Role("s", "standing time before the recording began; one value", columns={"stood_s": "s"}),
        "latitude": Role("rad", "latitude, positive north",
            columns={"latitude_deg": "deg", "latitude_rad": "rad"}, words=r"\blatitude\b"),
        "longitude": Role("rad", "longitude, positive east",
            columns={"longitude_deg": "deg", "longitude_rad": "rad"}, words=r"\blongitude\b"),
        "altitude": Role("m", "height above a fixed level", columns={"altitude_m": "m"}, words=r"\baltitude\b"),
        "steering_angle": Role("rad", "angle of the steered wheels, positive to the left",
            columns={"steering_angle_rad": "rad"}, words=r"steering angle\b", not_words=r"\bwheel\b|ratio"),
        "passengers": Role("1", "people on board, added to the empty vehicle",
            columns={"passengers": "1"}, words=r"\bpassengers?\b"),
        "brake": Role("Pa", "pressure of the friction brakes, or a switch (0 or 1)",
            columns={"brake_pa": "Pa", "brake_on": "Pa"}, words=r"brake pressure", not_words=r"park|halt"),
        "wheel_speed": Role("m/s", "circumferential speed of a wheel", parts=True, columns={"wheel_speed_mps": "m/s"}),
        "enable": Role("1", "request for the feed-forward: 1 or 0, or a mode that `values` maps to them",
            columns={"enable": "1"}),
    }
)  # fmt: skip


POSITION = ("latitude", "longitude")
GROUND = ("altitude", "specific_force")
"""Roles that show the rise of the ground, for learning from a measured torque; the estimate itself needs none of them."""
PASSENGER_KG = 70.0
"""Default mass of a passenger; assumed. UN regulation 107 has 68 kg in a city bus, 71 kg with luggage."""
BRAKE_ON_PA = 10e3
"""Default pressure from which a friction brake is on; assumed: springs hold its shoes off below."""


def base_role(role: str) -> str:
    """Return the role without its axle or assembly: ``load`` of ``load/front``."""
    return role.partition("/")[0]


def names_a_part(name: str) -> bool:
    """Whether a role may end in this name of an axle, assembly or wheel, in a topics file as in a table."""
    return bool(name) and name.isprintable()
