# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Guesses the topic or channel of each role, without a topics file."""

import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import yaml

from trackres_ros.errors import InputError
from trackres_ros.recording.binding import IN_DEGREES, TopicBinding
from trackres_ros.recording.bindings import EXAMPLE, Topics, inside_unit
from trackres_ros.recording.channel_file import Channel
from trackres_ros.recording.directions import STANDARDS, as_said, named_ways, standard_of
from trackres_ros.recording.role_units import UNITS, Conversion, conversion
from trackres_ros.recording.roles import POSITION, ROLES, Role, base_role
from trackres_ros.text import words

NOT_MEASURED = re.compile(
    r"\b(cmd|commands?|commanded|req|requests?|requested|demands?|demanded|dmd|target|desired|set ?point|soll|reference|ref|goal|"
    r"limit|max|min|estimated?|feed ?forward|resistance|trackres|error|variance)\b"
)
"""Words in the name of a topic that was not measured on the vehicle; nothing is guessed from it."""
PREFERRED = {
    "torque": re.compile(r"\b(measured|meas|actual|act|ist)\b"),
    "ambient": re.compile(r"\b(ambient|outside|outdoor)\b"),
}
"""By role: words of the preferred names."""
WHEEL = re.compile(r"\bwheels?\b(?! based (vehicle|machine))")
"""Of a channel: a wheel speed is not that of the vehicle; wheel-based speeds of J1939 and ISO 11783 are."""
ADDED = ("load", "torque")
"""Roles whose values are the sum of those of the parts of the vehicle."""
PART = re.compile(r"\b(left|right|front|rear|axles?|[lr]|[lr]hs?|[fr][lr]|links|rechts|vorne?|hinten|[vh][lr])\d*\b")
"""Words in the name of a load or torque of a part: a side, an axle or a corner; it is not guessed as that of the vehicle."""
SCALARS = ("std_msgs/msg/Float64", "std_msgs/msg/Float32")
COUNTS = tuple(f"std_msgs/msg/{name}" for name in ("UInt8", "UInt16", "UInt32", "Int8", "Int16", "Int32"))
NOT_GUESSED = "not guessed from"
OF_ONE_LETTER = "mnt"
"""Units of one letter that a name may end with; others may be anything, such as a front axle."""


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
            unit = _unit_of(rule, spoken)
            if unit is not None and not re.search(rule.not_words, spoken) and not NOT_MEASURED.search(spoken):
                by_unit, angle = _converted(rule.role, unit), "deg" if rule.role in POSITION else ""
                binding = TopicBinding(
                    topic, available[topic], rule.field, scale=by_unit.scale, offset=by_unit.offset, unit=angle
                )
                found.setdefault(rule.role, []).append((binding, unit))
    if "speed" not in found:
        listed = "; ".join(f"{topic} ({kind})" for topic, kind in sorted(available.items())) or "no topic at all"
        raise InputError(
            "speed", listed, "a topic with a type that holds the vehicle's speed", f"give it in a topics file: {EXAMPLE}"
        )
    of_vehicle = _namespace_of_vehicle(found)
    bindings, notes = dict[str, TopicBinding](), []
    for role, options in found.items():
        options.sort(key=lambda one: _doubts(role, one[0].topic, of_vehicle))
        binding, unit = options[0]
        if _is_part(role, binding.topic):
            best = _doubts(role, binding.topic, of_vehicle)
            alike = [one for one, _ in options if _doubts(role, one.topic, of_vehicle)[:2] == best[:2]]
            notes.append(note_of_parts(role, alike))
            continue
        bindings[role] = binding
        others = ", ".join(other.topic for other, _ in options[1:] if not _is_part(role, other.topic))
        notes.append(
            f"{role}: guessed from {binding.topic} ({binding.type}, {binding.field}) in {unit}"
            + (f"; also possible: {others}" if others else "")
        )
    return Topics(MappingProxyType(bindings), "guessed"), notes


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


class Guesses(NamedTuple):
    """Channels by role: the guessed ones, names of other candidates, and those that measure a part of a role without a guess."""

    bindings: dict[str, TopicBinding]
    others: dict[str, list[str]]
    parts: dict[str, list[TopicBinding]]


def guess_channels(channels: Sequence[Channel], there: Collection[str]) -> Guesses:
    """Guess by name and unit the channels of roles without one; without a unit there is no guess.

    `channels`: with unique names; `there`: roles that have a channel. Returns bindings without the unit that the file gives.
    """
    found = Guesses({}, {}, {})
    for role, about in ROLES.items():
        options = [] if role in there or not about.words else [one for one in channels if _may_be(one, role, about)]
        whole = sorted((one for one in options if not _is_part(role, one.name)), key=lambda one: _rank(role, one.name))
        if whole:
            found.bindings[role] = _of_channel(role, whole[0])
            found.others[role] = [one.name for one in whole[1:]]
        elif options:
            found.parts[role] = [_of_channel(role, one) for one in options]
    _guess_direction(channels, there, found)
    return found


def _guess_direction(channels: Sequence[Channel], there: Collection[str], found: Guesses) -> None:
    """Guess the direction: a channel of a standard, first one in the message of the speed."""
    options = [one for one in channels if standard_of(one.name) and not NOT_MEASURED.search(words(one.name))]
    speed = found.bindings.get("speed")
    if "direction" in there or not options or not speed:
        return
    group = next(one.group for one in channels if one.name == speed.column)
    options.sort(key=lambda one: (one.group != group, "selected" in words(one.name), len(one.name), one.name))
    best = options[0]
    ways = named_ways(best.named) or STANDARDS[standard_of(best.name)]
    found.bindings["direction"] = TopicBinding(column=best.name, ways=ways)
    found.others["direction"] = [one.name for one in options[1:]]


def _of_channel(role: str, channel: Channel) -> TopicBinding:
    unit = "" if channel.unit or role in POSITION else _unit_in(role, words(channel.name))
    scale, offset = _converted(role, unit or ROLES[role].unit)
    return TopicBinding(column=channel.name, scale=scale, offset=offset)


def note_of_parts(role: str, parts: Sequence[TopicBinding]) -> str:
    """Note on sources that measure a part of a role each, with the line of a topics file for their sum."""
    names = ", ".join(one.topic or one.column for one in parts)
    line, whole = topics_line(role, parts[0]), "it"
    if len(parts) > 1:
        each = ", ".join(topics_line(role, one).removeprefix(f"{role}: ") for one in parts)
        line, whole = f"{role}: {{sum: [{each}]}}", "their sum"
    return (
        f"{role}: {NOT_GUESSED} {names}, which may be of a side or an axle only; if {whole} is that of the whole vehicle, write "
        f"in a topics file: {line}"
    )


def _doubts(role: str, topic: str, of_vehicle: str) -> tuple[bool, bool, bool]:
    """Key that sorts the topics for a role, the best one first: of another vehicle, of a part, not preferred."""
    return not topic.startswith(of_vehicle), _is_part(role, topic), not _is_preferred(role, words(topic))


def _rank(role: str, name: str) -> tuple[bool, bool, int, str]:
    """Key that sorts the candidates for a role, the best one first."""
    spoken = words(name)
    return "vehicle" not in spoken, not _is_preferred(role, spoken), len(name), name


def _is_preferred(role: str, words: str) -> bool:
    """Whether the name has one of the words that are preferred for its role; true for roles without any."""
    return role not in PREFERRED or bool(PREFERRED[role].search(words))


def _may_be(channel: Channel, role: str, about: Role) -> bool:
    spoken = words(channel.name)
    if not re.search(about.words, spoken) or any(re.search(no, spoken) for no in (about.not_words, NOT_MEASURED, WHEEL)):
        return False
    if not channel.unit:
        return role in POSITION or bool(_unit_in(role, spoken))
    return conversion(channel.unit, about.unit) is not None


def topics_line(role: str, binding: TopicBinding) -> str:
    """The line of a topics file for the source of a role or the time, in the unit of the raw numbers if known."""
    inside = inside_unit(role)
    keys = ("topic", "type", "field") if binding.topic else ("column",)
    line: dict[str, object] = {"channel" if key == "column" else key: getattr(binding, key) for key in keys}
    unit = next((name for name, one in UNITS[inside].items() if one == (binding.scale, binding.offset)), "")
    if unit and binding.ways is None and not (role in POSITION and not binding.unit):
        line["unit"] = unit
    elif (binding.scale, binding.offset) != (1.0, 0.0):
        line |= {"scale": binding.scale, "offset": binding.offset}
    if binding.ways is not None:
        line["values"] = as_said(binding.ways)
    if base_role(role) == "belt":  # as it is read now: that of a line without it is the surface
        line["sensor"] = binding.sensor or "mean"
    return f"{in_a_line([role])[1:-1]}: {in_a_line(line)}"


def in_a_line(content: object) -> str:
    """A list or mapping as YAML in one line."""
    return yaml.safe_dump(content, default_flow_style=True, sort_keys=False, width=math.inf, allow_unicode=True).strip()


def _is_part(role: str, name: str) -> bool:
    """Whether a name is that of a part of what the whole vehicle has."""
    return role in ADDED and bool(PART.search(words(name)))


def _unit_of(rule: _Rule, spoken: str) -> str | None:
    """The unit of a topic; None if its name has that of another quantity."""
    if rule.role in POSITION:
        return "degrees"
    of_name = _unit_in(rule.role, spoken) if rule.field == "data" else ""
    return of_name if of_name is None else of_name or ROLES[rule.role].unit


def _unit_in(role: str, spoken: str) -> str | None:
    """The unit that the words of a name carry; empty without one, None if they end with that of another quantity."""
    inside = ROLES[role].unit
    for text, ends in _texts(spoken.split()):
        of_text = "m/s" if (role, text) == ("speed", "ms") else text  # a speed is not in milliseconds
        found = conversion(of_text, inside)
        if found and (len(text) > 1 or (ends and text in OF_ONE_LETTER)):
            return next(unit for unit, one in UNITS[inside].items() if one == found)
        if ends and len(text) > 1 and any(conversion(text, other) for other in UNITS):
            return None
    return ""


def _texts(each: Sequence[str]) -> Iterator[tuple[str, bool]]:
    """Texts of one to three words that may be a unit, and whether they end the name; the last and longest come first."""
    for end in range(len(each), 0, -1):
        for count in (3, 2, 1):
            several = each[max(end - count, 0) : end]
            yield from ((mark.join(several), end == len(each)) for mark in ("", "/"))


def _converted(role: str, unit: str) -> Conversion:
    found = conversion(unit, ROLES[role].unit)
    assert found is not None
    return found
