# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Guesses which topic feeds which role, where no topics file says so."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

from trackres_ros.errors import InputError
from trackres_ros.recording.binding import IN_DEGREES, TopicBinding
from trackres_ros.recording.bindings import EXAMPLE, Topics
from trackres_ros.recording.roles import POSITION, ROLES
from trackres_ros.units import DEGREE

NOT_MEASURED = re.compile(
    r"\b(cmd|commands?|commanded|target|desired|set ?point|reference|ref|goal|limit|max|min|"
    r"estimated?|feed ?forward|resistance|trackres|error|variance)\b"
)
"""Words in a topic name that say its content was not measured on the vehicle; nothing is guessed from it."""
NOT_VEHICLE = r"rpm|\b(engine|motor|wind|fan|angular|yaw|cpu)\b"
"""Words that say a speed, load or torque is not that of the vehicle at its tracks."""
SCALARS = ("std_msgs/msg/Float64", "std_msgs/msg/Float32")
COUNTS = tuple(f"std_msgs/msg/{name}" for name in ("UInt8", "UInt16", "UInt32", "Int8", "Int16", "Int32"))
AMBIENT = r"\b(ambient|outside|outdoor|air)\b"
UNITS = {
    "speed": (("km/h", r"km ?p?h\b|kph\b", 1.0 / 3.6),),
    "load": (("kN", r"\bkn\b", 1e3), ("kg", r"\bkg\b", 9.80665)),
    "torque": (("kNm", r"\bkn ?m\b", 1e3),),
    "brake": (("bar", r"\bbar\b", 1e5), ("kPa", r"\bkpa\b", 1e3)),
    "steering_angle": (("degrees", r"\bdeg(rees?)?\b", DEGREE),),
}
"""Units the topic name of a bare number may carry: unit, pattern, scale to the unit of the role."""


@dataclass(frozen=True, slots=True)
class _Rule:
    """Message types that may feed a role, the field, and patterns the words of the topic must and must not have."""

    role: str
    types: tuple[str, ...]
    field: str
    words: str = ""
    not_words: str = r"(?!)"


RULES = (
    _Rule("speed", ("nav_msgs/msg/Odometry",), "twist.twist.linear.x"),
    _Rule("speed", ("geometry_msgs/msg/TwistStamped",), "twist.linear.x"),
    _Rule("speed", ("geometry_msgs/msg/TwistWithCovarianceStamped",), "twist.twist.linear.x"),
    _Rule("speed", SCALARS, "data", r"speed|velocity", NOT_VEHICLE),
    _Rule("load", ("geometry_msgs/msg/WrenchStamped",), "wrench.force.z", r"\bload\b|weight", NOT_VEHICLE),
    _Rule("load", SCALARS, "data", r"\bload\b|weight", NOT_VEHICLE),
    _Rule("torque", ("geometry_msgs/msg/WrenchStamped",), "wrench.torque.y", "torque", NOT_VEHICLE),
    _Rule("torque", SCALARS, "data", "torque", NOT_VEHICLE),
    _Rule("ambient", ("sensor_msgs/msg/Temperature",), "temperature", AMBIENT),
    _Rule("belt", ("sensor_msgs/msg/Temperature",), "temperature", r"\b(belt|track|rubber)\b", AMBIENT),
    _Rule("yaw_rate", ("sensor_msgs/msg/Imu",), "angular_velocity.z"),
    _Rule("specific_force", ("sensor_msgs/msg/Imu",), "linear_acceleration.x"),
    _Rule("latitude", (IN_DEGREES,), "latitude"),
    _Rule("longitude", (IN_DEGREES,), "longitude"),
    _Rule("altitude", (IN_DEGREES,), "altitude"),
    _Rule("steering_angle", SCALARS, "data", r"steering angle\b", r"\bwheel\b|ratio"),
    _Rule("passengers", (*SCALARS, *COUNTS), "data", r"\bpassengers?\b"),
    _Rule("brake", SCALARS, "data", r"brake pressure", r"park|halt"),
)
"""In the order of preference."""


def guess(available: Mapping[str, str]) -> tuple[Topics, list[str]]:
    """Guess the bindings from message types, and from topic names where types do not decide.

    Acceleration is never guessed: that of an IMU contains the share of gravity on a slope, and is taken for a specific force.

    Parameters
    ----------
    available : mapping of str to str
        Message type by topic.

    Returns
    -------
    topics : Topics
        What was guessed.
    notes : list of str
        One sentence a role, with what else it could have been.

    Raises
    ------
    InputError
        No topic is recognised as the speed; the text lists every topic and type.
    """
    found: dict[str, list[tuple[TopicBinding, str]]] = {}
    for rule in RULES:
        for topic in sorted(available, key=lambda topic: (len(topic), topic)):
            spoken = words(topic)
            if available[topic] not in rule.types or not re.search(rule.words, spoken):
                continue
            if not re.search(rule.not_words, spoken) and not NOT_MEASURED.search(spoken):
                unit, scale = _unit_of(rule, spoken)
                angle: Literal["deg", ""] = "deg" if rule.role in POSITION else ""
                binding = TopicBinding(topic, available[topic], rule.field, scale=scale, unit=angle)
                found.setdefault(rule.role, []).append((binding, unit))
    if "speed" not in found:
        listed = "; ".join(f"{topic} ({kind})" for topic, kind in sorted(available.items())) or "no topic at all"
        raise InputError(
            "speed", listed, "a topic of a type that tells the speed of the vehicle", f"name it in a topics file: {EXAMPLE}"
        )
    notes = []
    for role, options in found.items():
        binding, unit = options[0]
        others = ", ".join(other.topic for other, _ in options[1:])
        notes.append(
            f"{role}: guessed from {binding.topic} ({binding.type}, {binding.field}) in {unit}"
            + (f"; also possible: {others}" if others else "")
        )
    return Topics(MappingProxyType({role: options[0][0] for role, options in found.items()}), "guessed"), notes


def words(topic: str) -> str:
    """Return the words of a topic name, lower case with spaces: of ``/vehicleSpeed_kmh`` "vehicle speed kmh"."""
    spaced = re.sub(r"([a-z0-9])([A-Z])", r"\1 \2", topic).lower()
    return " ".join(re.split(r"[^a-z0-9]+", spaced))


def _unit_of(rule: _Rule, words: str) -> tuple[str, float]:
    if rule.role in POSITION:
        return "degrees", DEGREE
    for unit, pattern, scale in UNITS.get(rule.role, ()) if rule.field == "data" else ():
        if re.search(pattern, words):
            return unit, scale
    return ROLES[rule.role].unit, 1.0
