# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes lines of topics files: guesses about a recording, corrections of a role; lists the shipped files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal

from trackres_ros.files.documents import in_a_line
from trackres_ros.files.resources import shipped_topics
from trackres_ros.recording.bindings import TIME, TopicBinding, Topics
from trackres_ros.recording.channel_source import ChannelSource
from trackres_ros.recording.choosing import TIME_S, time_line
from trackres_ros.recording.guessing import NOT_GUESSED, topics_line
from trackres_ros.recording.opening import open_source
from trackres_ros.recording.roles import Conversion, as_said, base_role
from trackres_ros.text import table

FIGURES = 6


def correct_bindings(role: str, correction: Conversion, bindings: Mapping[str, TopicBinding]) -> dict[str, TopicBinding]:
    """The bindings that convert the values of a role as they are read now, in its unit.

    If only its parts are read, such as the torques of two sides, each has a share of the offset.
    """
    parts = [name for name in bindings if base_role(name) == role != name]
    roles = parts if parts and role not in bindings else [role]

    def convert(binding: TopicBinding) -> TopicBinding:
        return replace(
            binding,
            scale=correction.scale * binding.scale,
            offset=correction.scale * binding.offset + correction.offset / (len(roles) * binding.gear_ratio),
            converts=binding.converts or correction.scale != 1.0,
        )

    return {role_name: convert(bindings.get(role_name, TopicBinding())) for role_name in roles}


def line_of(role: str, binding: TopicBinding) -> str:
    """The line of a role; of one without a source only its numbers."""
    text, is_whole = in_a_line(_line_content(binding)), binding.parts or binding.topic or binding.column
    return f"{in_a_line([role])[1:-1]}: {text if is_whole else f'{{..., {text[1:]}'}"


def line_to_write(role: str, correction: Conversion, *binding_maps: Mapping[str, TopicBinding]) -> str:
    """What to write in the topics file for the bindings of each recording, for the end of a sentence."""
    files = dict.fromkeys(
        tuple(line_of(*item) for item in correct_bindings(role, correction, bindings).items()) for bindings in binding_maps
    )
    lines = ", for other recordings ".join(" and ".join(lines) for lines in files)
    return (
        f"{'its line' if all(len(file_lines) == 1 for file_lines in files) else 'its lines'} in the topics file should be {lines}"
    )


@dataclass(frozen=True, slots=True)
class TorqueCause:
    """Why a measured torque may be a multiple of the torque at the sprockets."""

    factor: float  # which it lacks
    at: Literal["sprockets", "motor", ""] = ""  # where it acts instead, if that is the cause


def torque_causes(
    motor_ratio: float | None, *binding_maps: Mapping[str, TopicBinding], is_vehicle: bool = True
) -> dict[str, TorqueCause]:
    """Likely causes by their names, for "if it is ...". `motor_ratio`: of the vehicle file; `binding_maps`: of the recordings."""
    causes = {"in kNm": TorqueCause(1e3), "in mNm": TorqueCause(1e-3)}
    if is_vehicle:
        causes |= {"counted twice": TorqueCause(0.5)} | {f"one of {n} equal parts": TorqueCause(float(n)) for n in (2, 3, 4)}
    if motor_ratio:
        at_motor = any(torque.at == "motor" for bindings in binding_maps for torque in _torques_of(bindings).values())
        causes |= {"at the sprockets": TorqueCause(1.0 / motor_ratio, "sprockets")} if at_motor else {}
        causes |= {} if at_motor else {"at the motor": TorqueCause(motor_ratio, "motor")}
    return causes


def torque_line(cause: TorqueCause, sign: float, *binding_maps: Mapping[str, TopicBinding]) -> str:
    """As `line_to_write`, for a torque with such a cause, and a sign of 1 or -1."""
    if not cause.at:
        return line_to_write("torque", Conversion(sign * cause.factor), *binding_maps)
    torque_maps = [_torques_of(bindings) or {"torque": TopicBinding()} for bindings in binding_maps]
    corrected = [{role: replace(torque, at=cause.at) for role, torque in torques.items()} for torques in torque_maps]
    return line_to_write("torque", Conversion(sign), *corrected)


def _torques_of(bindings: Mapping[str, TopicBinding]) -> dict[str, TopicBinding]:
    return {role: torque for role, torque in bindings.items() if base_role(role) == "torque"}


def _line_content(binding: TopicBinding) -> dict[str, Any]:
    """Keys of a line: all that differ from the default, with the unit in the scale, which also replaces that of the file."""
    content: dict[str, Any] = {"sum": [_line_content(part) for part in binding.parts]} if binding.parts else {}
    for item in fields(TopicBinding):
        value = getattr(binding, item.name)
        is_given = value != item.default or (item.name == "scale" and binding.converts)
        if is_given and item.name in ("ways", "valid"):
            content |= {"values": as_said(value)} if item.name == "ways" else {"valid": _line_content(value)}
        elif is_given and item.name not in ("parts", "unit", "converts", "gear_ratio"):
            content[item.name] = float(f"{value:.{FIGURES}g}") if isinstance(value, float) else value
    return content


ALSO = "also possible: "


def guessed_topics(recording: Sequence[Path], topics: Topics | None) -> list[str]:
    """Lines of a topics file, with alternatives.

    `recording`: bags, or one other file; `topics`: which names the databases of a bus, if needed. Raises InputError for a file
    that cannot be read, or without a speed that can be guessed.
    """
    source = open_source(recording, topics)
    lines = [f"# Guessed from {source.name}: check each line."]
    if topics and topics.dbc:
        lines.append(f"dbc: {in_a_line([str(file) for _, file in topics.dbc])}")
    time = source.time if isinstance(source, ChannelSource) else None
    guesses = {TIME: time_line(time)} if time and time.column != TIME_S else {}
    guesses |= {role: topics_line(role, binding) for role, binding in source.bindings.items()}
    for role, line in guesses.items():
        alternatives = [note.partition(ALSO)[2] for note in source.notes if note.startswith(f"{role}: ") and ALSO in note]
        lines.append(line + (f"  # or {alternatives[0]}" if alternatives else ""))
    return [*lines, *(f"# {note}" for note in source.notes if f": {NOT_GUESSED} " in note)]


def shipped_files() -> list[dict[str, Any]]:
    """Name, use, roles and path of each shipped topics file: ``topics`` serve bags and the live node, ``columns`` tables."""
    entries = []
    for name, path in shipped_topics().items():
        topics = Topics.load(path)
        of_bags = any(binding.topic for binding in topics.bindings.values())
        entries.append({"name": name, "names": "topics" if of_bags else "columns", "roles": list(topics), "file": str(path)})
    return entries


def shipped_text(entries: Iterable[Mapping[str, Any]]) -> str:
    """The same for people."""
    rows = [
        (entry["name"], entry["names"], ", ".join(dict.fromkeys(base_role(role) for role in entry["roles"])), entry["file"])
        for entry in entries
    ]
    return table(rows, ("name", "names", "roles", "file"), numbers=False)
