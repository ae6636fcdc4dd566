# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Guesses the topic or channel of each role, without a topics file."""

import math
import re
from collections.abc import Collection, Mapping, Sequence
from types import MappingProxyType
from typing import Literal, NamedTuple

import yaml

from trackres_ros.errors import InputError
from trackres_ros.recording.binding import IN_DEGREES, TopicBinding
from trackres_ros.recording.bindings import EXAMPLE, TIME, Topics
from trackres_ros.recording.channel_file import Channel
from trackres_ros.recording.role_units import UNITS as UNITS_OF_ROLES
from trackres_ros.recording.role_units import conversion
from trackres_ros.recording.roles import POSITION, ROLES, Role, base_role
from trackres_ros.units import DEGREE

NOT_MEASURED = re.compile(
    r"\b(cmd|commands?|commanded|req|requests?|requested|demands?|demanded|dmd|target|desired|set ?point|soll|reference|ref|goal|"
    r"limit|max|min|estimated?|feed ?forward|resistance|trackres|error|variance)\b"
)
"""Words in the name of a topic that was not measured on the vehicle; nothing is guessed from it."""
MEASURED = re.compile(r"\b(measured|meas|actual|act|ist)\b")
"""Words in the name of a torque that was measured; it is preferred."""
WHEEL = re.compile(r"\bwheels?\b(?! based vehicle)")
"""Of a channel: a wheel speed is not that of the vehicle; the wheel-based vehicle speed of J1939 is."""
SCALARS = ("std_msgs/msg/Float64", "std_msgs/msg/Float32")
COUNTS = tuple(f"std_msgs/msg/{name}" for name in ("UInt8", "UInt16", "UInt32", "Int8", "Int16", "Int32"))
UNITS = {
    "speed": (("km/h", r"km ?p?h\b|kph\b"), ("m/s", r"\bmps\b|\bm s\b")),
    "load": (("kN", r"\bkn\b"), ("kg", r"\bkg\b"), ("N", r"\bn\b")),
    "torque": (("kNm", r"\bkn ?m\b"), ("Nm", r"\bn ?m\b")),
    "ambient": (("degC", r"\bdeg ?c\b"),),
    "belt": (("degC", r"\bdeg ?c\b"),),
    "brake": (("bar", r"\bbar\b"), ("kPa", r"\bkpa\b")),
    "steering_angle": (("degrees", r"\bdeg(rees?)?\b"),),
}
"""Units the name of a bare number may carry: unit, and pattern."""


class _Rule(NamedTuple):
    """Message types that may feed a role, the field, and patterns the words of the topic must and must not have."""

    role: str
    types: tuple[str, ...]
    field: str
    words: str = ""
    not_words: str = r"(?!)"


def _by_words(role: str, types: tuple[str, ...], field: str) -> _Rule:
    return _Rule(role, types, field, ROLES[role].words, ROLES[role].not_words)


RULES = (
    _Rule("speed", ("nav_msgs/msg/Odometry",), "twist.twist.linear.x"),
    _Rule("speed", ("geometry_msgs/msg/TwistStamped",), "twist.linear.x"),
    _Rule("speed", ("geometry_msgs/msg/TwistWithCovarianceStamped",), "twist.twist.linear.x"),
    _by_words("speed", SCALARS, "data"),
    _by_words("load", ("geometry_msgs/msg/WrenchStamped",), "wrench.force.z"),
    _by_words("load", SCALARS, "data"),
    _by_words("torque", ("geometry_msgs/msg/WrenchStamped",), "wrench.torque.y"),
    _by_words("torque", SCALARS, "data"),
    _by_words("ambient", ("sensor_msgs/msg/Temperature",), "temperature"),
    _by_words("belt", ("sensor_msgs/msg/Temperature",), "temperature"),
    _Rule("yaw_rate", ("sensor_msgs/msg/Imu",), "angular_velocity.z"),
    _Rule("specific_force", ("sensor_msgs/msg/Imu",), "linear_acceleration.x"),
    _Rule("latitude", (IN_DEGREES,), "latitude"),
    _Rule("longitude", (IN_DEGREES,), "longitude"),
    _Rule("altitude", (IN_DEGREES,), "altitude"),
    _by_words("steering_angle", SCALARS, "data"),
    _by_words("passengers", (*SCALARS, *COUNTS), "data"),
    _by_words("brake", SCALARS, "data"),
)
"""In the order of preference."""


def guess(available: Mapping[str, str]) -> tuple[Topics, list[str]]:
    """Guess the bindings from message types, and from topic names where types do not decide.

    Acceleration is never guessed: that of an IMU contains gravity on a slope, and is treated as a specific force.

    `available`: message type by topic. Raises InputError if no topic is recognised as the speed; the text lists every topic and
    type. Returns `topics`: the guesses, and `notes`: one sentence per role, with alternatives.
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
            "speed", listed, "a topic with a type that holds the vehicle's speed", f"give it in a topics file: {EXAMPLE}"
        )
    of_vehicle = _namespace_of_vehicle(found)
    notes = []
    for role, options in found.items():
        options.sort(key=lambda one: (not one[0].topic.startswith(of_vehicle), not _says_measured(role, words(one[0].topic))))
        binding, unit = options[0]
        others = ", ".join(other.topic for other, _ in options[1:])
        notes.append(
            f"{role}: guessed from {binding.topic} ({binding.type}, {binding.field}) in {unit}"
            + (f"; also possible: {others}" if others else "")
        )
    return Topics(MappingProxyType({role: options[0][0] for role, options in found.items()}), "guessed"), notes


def _namespace_of_vehicle(found: Mapping[str, Sequence[tuple[TopicBinding, str]]]) -> str:
    """The namespace of the first speed, in a bag of several vehicles; else empty.

    It is /truck1/ where /truck2/ has a speed of the same name, and topics of other roles too.
    """
    first, *others = (binding.topic.split("/") for binding, _ in found["speed"])
    rest = [binding.topic for role, options in found.items() if role != "speed" for binding, _ in options]
    for other in others:
        differ = [place for place, (mine, theirs) in enumerate(zip(first, other, strict=False)) if mine != theirs]
        if len(other) == len(first) and len(differ) == 1 and differ[0] < len(first) - 1:
            mine, theirs = ("/".join([*parts[: differ[0] + 1], ""]) for parts in (first, other))
            if any(topic.startswith(theirs) for topic in rest):
                return mine
    return ""


def guess_channels(channels: Sequence[Channel], there: Collection[str]) -> tuple[dict[str, TopicBinding], dict[str, list[str]]]:
    """Guess by name and unit the channels of roles without one; without a unit there is no guess.

    `channels`: with unique names; `there`: roles that have a channel. Returns `bindings`: by role, without the unit, which the
    file gives, and `others`: by role: names of other candidates.
    """
    bindings: dict[str, TopicBinding] = {}
    others: dict[str, list[str]] = {}
    for role, about in ROLES.items():
        options = [] if role in there or not about.words else [one for one in channels if _may_be(one, role, about)]
        if options:
            first, *rest = sorted(options, key=lambda one: _rank(role, one.name))
            unit = "" if first.unit else _unit_in(role, words(first.name))
            bindings[role] = TopicBinding(column=first.name, scale=_scale(role, unit) if unit else 1.0)
            others[role] = [one.name for one in rest]
    return bindings, others


def _rank(role: str, name: str) -> tuple[bool, bool, int, str]:
    """Key that sorts the candidates for a role, the best one first."""
    spoken = words(name)
    return "vehicle" not in spoken, not _says_measured(role, spoken), len(name), name


def _says_measured(role: str, words: str) -> bool:
    """Whether the name of a torque says that it was measured; true for other roles, whose names need not say so."""
    return role != "torque" or bool(MEASURED.search(words))


def _may_be(channel: Channel, role: str, about: Role) -> bool:
    spoken = words(channel.name)
    if not re.search(about.words, spoken) or any(re.search(no, spoken) for no in (about.not_words, NOT_MEASURED, WHEEL)):
        return False
    if not channel.unit:
        return role in POSITION or bool(_unit_in(role, spoken))
    return conversion(channel.unit, about.unit) is not None


def topics_line(role: str, binding: TopicBinding) -> str:
    """The line of a topics file for the source of a role or the time, in the unit of the raw numbers if known."""
    inside = "s" if role == TIME else ROLES[base_role(role)].unit
    keys = ("topic", "type", "field") if binding.topic else ("column",)
    line: dict[str, object] = {"channel" if key == "column" else key: getattr(binding, key) for key in keys}
    unit = next((name for name, one in UNITS_OF_ROLES[inside].items() if one == (binding.scale, binding.offset)), "")
    if unit and not (role in POSITION and not binding.unit):
        line["unit"] = unit
    elif (binding.scale, binding.offset) != (1.0, 0.0):
        line |= {"scale": binding.scale, "offset": binding.offset}
    return f"{role}: {yaml.safe_dump(line, default_flow_style=True, sort_keys=False, width=math.inf, allow_unicode=True).strip()}"


def words(topic: str) -> str:
    """Return the words of a topic name, lower case with spaces: of ``/vehicleSpeed_kmh`` "vehicle speed kmh"."""
    spaced = re.sub(r"([a-z0-9])([A-Z])", r"\1 \2", topic).lower()
    return " ".join(re.split(r"[^a-z0-9]+", spaced))


def _unit_of(rule: _Rule, words: str) -> tuple[str, float]:
    if rule.role in POSITION:
        return "degrees", DEGREE
    unit = (_unit_in(rule.role, words) if rule.field == "data" else "") or ROLES[rule.role].unit
    return unit, _scale(rule.role, unit)


def _unit_in(role: str, words: str) -> str:
    """The unit that the words of a name carry, if any."""
    return next((unit for unit, pattern in UNITS.get(role, ()) if re.search(pattern, words)), "")


def _scale(role: str, unit: str) -> float:
    found = conversion(unit, ROLES[role].unit)
    assert found is not None
    return found.scale
