# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Guesses channels and topics by their names, units and types, and names those that may hold a torque."""

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

from trackres_ros.errors import InputError
from trackres_ros.files.documents import in_a_line
from trackres_ros.recording.bindings import EXAMPLE, IN_DEGREES, TopicBinding, Topics, inside_unit
from trackres_ros.recording.channel_file import Channel
from trackres_ros.recording.name_units import unit_in
from trackres_ros.recording.roles import (
    POSITION,
    ROLES,
    STANDARDS,
    UNITS,
    Conversion,
    Role,
    as_said,
    base_role,
    conversion,
    named_ways,
    standard_of,
)
from trackres_ros.text import some_of, words

NAMES_SHOWN = 20
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
WHEEL = re.compile(r"\bwheels?\b(?! based (vehicle|machine))|\brad(geschw|dreh)|\b(roue|rueda|ruota)s?\b")
"""Of a channel: a wheel speed is not that of the vehicle; wheel-based speeds of J1939 and ISO 11783 are."""
SYMBOLS = {"speed": re.compile(r"^v( (veh|fzg|ist|act))?( [km]\w*( [hs])?)?$"), "torque": re.compile(r"^(m ?d\b|m k?nm$|par\b)")}
"""By role: symbols of channels, which need a unit; a topic of such a name may be anything."""
ADDED = ("load", "torque")
"""Roles whose values are the sum of those of the parts of the vehicle."""
PART = re.compile(r"\b(left|right|front|rear|axles?|[lr]|[lr]hs?|[fr][lr]|links|rechts|vorne?|hinten|[vh][lr])\d*\b")
"""Words in the name of a load or torque of a part: a side, an axle or a corner; it is not guessed as that of the vehicle."""
SCALARS = ("std_msgs/msg/Float64", "std_msgs/msg/Float32")
COUNTS = tuple(f"std_msgs/msg/{name}" for name in ("UInt8", "UInt16", "UInt32", "Int8", "Int16", "Int32"))
NOT_GUESSED = "not guessed from"
NONE_REFUSED: Mapping[tuple[str, str], str] = MappingProxyType({})


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


def guess(available: Mapping[str, str], refused: Mapping[tuple[str, str], str] = NONE_REFUSED) -> tuple[Topics, list[str]]:
    """Guess the bindings from message types, and from topic names where types do not decide.

    Acceleration is never guessed: that of an IMU contains gravity on a slope, and is treated as a specific force.

    `available`: message type by topic; `refused`: roles and topics that are no guess, by their values, and why. Raises InputError
    if no topic is recognised as the speed; the text lists every topic and type. Returns `topics`: the guesses, and `notes`: one
    sentence per role, with alternatives.
    """
    options_by_role: dict[str, list[tuple[TopicBinding, str]]] = {}
    for rule in RULES:
        for topic in sorted(available, key=lambda topic: (len(topic), topic)):
            topic_words = words(topic)
            is_refused = available[topic] not in rule.types or (rule.role, topic) in refused
            if is_refused or not re.search(rule.words, topic_words):
                continue
            unit = _unit_of(rule, topic_words)
            if unit is not None and not re.search(rule.not_words, topic_words) and not NOT_MEASURED.search(topic_words):
                by_unit, angle = _conversion_of(rule.role, unit), "deg" if rule.role in POSITION else ""
                binding = TopicBinding(
                    topic, available[topic], rule.field, scale=by_unit.scale, offset=by_unit.offset, unit=angle
                )
                options_by_role.setdefault(rule.role, []).append((binding, unit))
    if "speed" not in options_by_role:
        topic_list = "; ".join(
            [
                *(f"{topic}: {reason}" for (role, topic), reason in refused.items() if role == "speed"),
                *(f"{topic} ({kind})" for topic, kind in sorted(available.items())),
            ]
        )
        raise InputError(
            "speed",
            topic_list or "no topic at all",
            "a topic with a type that holds the vehicle's speed",
            f"give it in a topics file: {EXAMPLE}",
        )
    of_vehicle = _namespace_of_vehicle(options_by_role)
    bindings, notes = dict[str, TopicBinding](), []
    for role, options in options_by_role.items():
        options.sort(key=lambda option: _doubts(role, option[0].topic, of_vehicle))
        binding, unit = options[0]
        if _is_part(role, binding.topic):
            best_rank = _doubts(role, binding.topic, of_vehicle)
            rivals = [option for option, _ in options if _doubts(role, option.topic, of_vehicle)[:2] == best_rank[:2]]
            notes.append(note_of_parts(role, rivals))
            continue
        bindings[role] = binding
        other_topics = ", ".join(alternative.topic for alternative, _ in options[1:] if not _is_part(role, alternative.topic))
        notes.append(
            f"{role}: guessed from {binding.topic} ({binding.type}, {binding.field}) in {unit}"
            + (f"; also possible: {other_topics}" if other_topics else "")
        )
    notes += [f"{role}: {NOT_GUESSED} {topic}: {reason}" for (role, topic), reason in refused.items()]
    return Topics(MappingProxyType(bindings), "guessed"), notes


def _namespace_of_vehicle(options_by_role: Mapping[str, Sequence[tuple[TopicBinding, str]]]) -> str:
    """The namespace of the first speed, in a bag of several vehicles; else empty.

    It is /truck1/ where /truck2/ has a speed of the same name, and topics of other roles too.
    """
    first_parts, *other_parts = (binding.topic.split("/") for binding, _ in options_by_role["speed"])
    rest = [binding.topic for role, options in options_by_role.items() if role != "speed" for binding, _ in options]
    for parts_of_other in other_parts:
        differing_places = [
            place
            for place, (own_part, other_part) in enumerate(zip(first_parts, parts_of_other, strict=False))
            if own_part != other_part
        ]
        if len(parts_of_other) == len(first_parts) and len(differing_places) == 1 and differing_places[0] < len(first_parts) - 1:
            own_part, other_part = ("/".join([*parts[: differing_places[0] + 1], ""]) for parts in (first_parts, parts_of_other))
            if any(topic.startswith(other_part) for topic in rest):
                return own_part
    return ""


class Guesses(NamedTuple):
    """Channels by role: the guessed ones, other candidates, and those that measure a part of a role without a guess."""

    bindings: dict[str, TopicBinding]
    alternatives: dict[str, list[TopicBinding]]
    parts: dict[str, list[TopicBinding]]


def guess_channels(
    channels: Sequence[Channel], present_roles: Collection[str], refused: Collection[tuple[str, str]] = ()
) -> Guesses:
    """Guess by name and unit the channels of roles without one; without a unit there is no guess.

    `channels`: with unique names; `present_roles`: roles that have a channel; `refused`: roles and names that are no guess.
    Returns bindings without the unit that the file gives.
    """
    guesses = Guesses({}, {}, {})
    for role, entry in ROLES.items():
        is_open = role not in present_roles and bool(entry.words)
        options = [
            channel for channel in channels if is_open and (role, channel.name) not in refused and _may_be(channel, role, entry)
        ]
        whole_channels = sorted(
            (channel for channel in options if not _is_part(role, channel.name)), key=lambda channel: _rank(role, channel.name)
        )
        if whole_channels:
            guesses.bindings[role], *guesses.alternatives[role] = [_of_channel(role, channel) for channel in whole_channels]
        elif options:
            guesses.parts[role] = [_of_channel(role, channel) for channel in options]
    if "direction" not in present_roles and "speed" in guesses.bindings:
        _guess_direction([channel for channel in channels if ("direction", channel.name) not in refused], channels, guesses)
    return guesses


def _guess_direction(options: Sequence[Channel], channels: Sequence[Channel], guesses: Guesses) -> None:
    """Guess the direction: a channel of a standard, first one in the message of the speed."""
    options = [channel for channel in options if standard_of(channel.name) and not NOT_MEASURED.search(words(channel.name))]
    group = next(channel.group for channel in channels if channel.name == guesses.bindings["speed"].column)
    options.sort(key=lambda channel: (channel.group != group, "selected" in words(channel.name), len(channel.name), channel.name))
    bindings = [
        TopicBinding(column=channel.name, ways=named_ways(channel.value_names) or STANDARDS[standard_of(channel.name)])
        for channel in options
    ]
    if bindings:
        guesses.bindings["direction"], *guesses.alternatives["direction"] = bindings


def _of_channel(role: str, channel: Channel) -> TopicBinding:
    unit = "" if channel.unit or role in POSITION else unit_in(role, channel.name)
    scale, offset = _conversion_of(role, unit or ROLES[role].unit)
    return TopicBinding(column=channel.name, scale=scale, offset=offset)


def note_of_parts(role: str, parts: Sequence[TopicBinding]) -> str:
    """Note on sources that measure a part of a role each, with the line of a topics file for their sum."""
    names = ", ".join(binding.topic or binding.column for binding in parts)
    line, sensor = topics_line(role, parts[0]), "it"
    if len(parts) > 1:
        part_lines = ", ".join(topics_line(role, binding).removeprefix(f"{role}: ") for binding in parts)
        line, sensor = f"{role}: {{sum: [{part_lines}]}}", "their sum"
    return (
        f"{role}: {NOT_GUESSED} {names}, which may be of a side or an axle only; if {sensor} is that of the whole vehicle, write "
        f"in a topics file: {line}"
    )


def _doubts(role: str, topic: str, of_vehicle: str) -> tuple[bool, bool, bool]:
    """Key that sorts the topics for a role, the best one first: of another vehicle, of a part, not preferred."""
    return not topic.startswith(of_vehicle), _is_part(role, topic), not _is_preferred(role, words(topic))


def _rank(role: str, name: str) -> tuple[bool, bool, int, str]:
    """Key that sorts the candidates for a role, the best one first."""
    name_words = words(name)
    return "vehicle" not in name_words, not _is_preferred(role, name_words), len(name), name


def _is_preferred(role: str, words: str) -> bool:
    """Whether the name has one of the words that are preferred for its role; true for roles without any."""
    return role not in PREFERRED or bool(PREFERRED[role].search(words))


def _may_be(channel: Channel, role: str, entry: Role) -> bool:
    name_words = words(channel.name).strip()
    is_named = re.search(entry.words, name_words) or (role in SYMBOLS and SYMBOLS[role].search(name_words))
    if not is_named or any(re.search(pattern, name_words) for pattern in (entry.not_words, NOT_MEASURED, WHEEL)):
        return False
    if not channel.unit:
        return role in POSITION or bool(unit_in(role, channel.name))
    return conversion(channel.unit, entry.unit) is not None


def topics_line(role: str, binding: TopicBinding) -> str:
    """The line of a topics file for the source of a role or the time, in the unit of the raw numbers if known."""
    si_unit = inside_unit(role)
    keys = ("topic", "type", "field") if binding.topic else ("column",)
    line: dict[str, object] = {"channel" if key == "column" else key: getattr(binding, key) for key in keys}
    unit = next(
        (name for name, known_conversion in UNITS[si_unit].items() if known_conversion == (binding.scale, binding.offset)), ""
    )
    if unit and binding.ways is None and not (role in POSITION and not binding.unit):
        line["unit"] = unit
    elif (binding.scale, binding.offset) != (1.0, 0.0):
        line |= {"scale": binding.scale, "offset": binding.offset}
    if binding.ways is not None:
        line["values"] = as_said(binding.ways)
    if base_role(role) == "belt":  # as it is read now: that of a line without it is the surface
        line["sensor"] = binding.sensor or "mean"
    return f"{in_a_line([role])[1:-1]}: {in_a_line(line)}"


def _is_part(role: str, name: str) -> bool:
    """Whether a name is that of a part of what the whole vehicle has."""
    return role in ADDED and bool(PART.search(words(name)))


def _unit_of(rule: _Rule, name_words: str) -> str | None:
    """The unit of a topic; None if its name has that of another quantity."""
    if rule.role in POSITION:
        return "degrees"
    of_name = unit_in(rule.role, name_words) if rule.field == "data" else ""
    return of_name if of_name is None else of_name or ROLES[rule.role].unit


def _conversion_of(role: str, unit: str) -> Conversion:
    factor = conversion(unit, ROLES[role].unit)
    assert factor is not None
    return factor


def listed_names(names: Sequence[str]) -> str:
    """Names as far as anybody reads them."""
    return some_of(names, NAMES_SHOWN)


TORQUE_LIKE = re.compile(r"torque|moment|effort|couple|\bk?n ?m\b|tractive|traction force|zugkraft")
"""Words and units in the name of a column or topic that may hold a torque, or a force that is one by a radius."""
TYPES = ("geometry_msgs/msg/WrenchStamped", "geometry_msgs/msg/Wrench", "sensor_msgs/msg/JointState", *SCALARS)
"""Types of messages that may hold a torque; plain numbers if the topic sounds like one."""


def torque_columns(names: Iterable[str]) -> list[str]:
    """Those of some columns that may hold a torque."""
    return [name for name in names if _sounds_like_torque(name)]


def torque_topics(types: Mapping[str, str]) -> list[str]:
    """Those of some topics that may hold a torque, of which the message types are given."""
    return [
        topic
        for topic, kind in sorted(types.items())
        if kind in TYPES and (_sounds_like_torque(topic) or kind not in SCALARS) and not NOT_MEASURED.search(words(topic))
    ]


def torque_note(candidates: Sequence[str], roles: Iterable[str]) -> list[str]:
    """Notes of a recording on candidates; empty if a torque was read."""
    if not candidates or any(base_role(role) == "torque" for role in roles):
        return []
    return [f"no torque channel is in use; candidates: {listed_names(candidates)}"]


def torque_remedy(candidates: Sequence[str], of_topics: bool) -> str:
    """Remedy for a recording without a torque; `of_topics`: whether it is a bag."""
    if of_topics:
        line, part_text = "torque: {topic: NAME, type: TYPE, field: FIELD}", "{topic: ...}, {topic: ...}"
    else:
        line, part_text = "torque: {column: NAME, unit: Nm}", "{column: ...}, {column: ...}"
    sum_remedy = f", or the sum of left and right: torque: {{sum: [{part_text}]}}" if len(candidates) > 1 else ""
    where = f"it may be in {listed_names(candidates)}: " if candidates else ""
    return f"{where}give it in a topics file: {line}{sum_remedy}"


def _sounds_like_torque(name: str) -> bool:
    name_words = words(name)
    return bool(TORQUE_LIKE.search(name_words)) and not NOT_MEASURED.search(name_words)
