# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Lines of a topics file that correct how a role is read: they replace its line, with the conversion in it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

from trackres_ros.recording.binding import TopicBinding
from trackres_ros.recording.directions import as_said
from trackres_ros.recording.guess import in_a_line
from trackres_ros.recording.role_units import Conversion
from trackres_ros.recording.roles import base_role

FIGURES = 6


def corrected(role: str, by: Conversion, bindings: Mapping[str, TopicBinding]) -> dict[str, TopicBinding]:
    """The bindings that convert the values of a role as they are read now, in its unit.

    If only its parts are read, such as the torques of two sides, each has a share of the offset.
    """
    parts = [name for name in bindings if base_role(name) == role != name]
    roles = parts if parts and role not in bindings else [role]

    def converted(binding: TopicBinding) -> TopicBinding:
        return replace(
            binding,
            scale=by.scale * binding.scale,
            offset=by.scale * binding.offset + by.offset / len(roles),
            converts=binding.converts or by.scale != 1.0,
        )

    return {one: converted(bindings.get(one, TopicBinding())) for one in roles}


def line_of(role: str, binding: TopicBinding) -> str:
    """The line of a role; of one without a source only its numbers."""
    text, whole = in_a_line(_said(binding)), binding.parts or binding.topic or binding.column
    return f"{in_a_line([role])[1:-1]}: {text if whole else f'{{..., {text[1:]}'}"


def line_to_write(role: str, by: Conversion, *each: Mapping[str, TopicBinding]) -> str:
    """What to write in the topics file for the bindings of each recording, for the end of a sentence."""
    files = dict.fromkeys(tuple(line_of(*one) for one in corrected(role, by, bindings).items()) for bindings in each)
    lines = ", for other recordings ".join(" and ".join(lines) for lines in files)
    return f"{'its line' if all(len(of) == 1 for of in files) else 'its lines'} in the topics file should be {lines}"


def _said(binding: TopicBinding) -> dict[str, Any]:
    """Keys of a line: all that differ from the default, with the unit in the scale, which also replaces that of the file."""
    found: dict[str, Any] = {"sum": [_said(part) for part in binding.parts]} if binding.parts else {}
    for item in fields(TopicBinding):
        value = getattr(binding, item.name)
        given = value != item.default or (item.name == "scale" and binding.converts)
        if given and item.name in ("ways", "valid"):
            found |= {"values": as_said(value)} if item.name == "ways" else {"valid": _said(value)}
        elif given and item.name not in ("parts", "unit", "converts"):
            found[item.name] = float(f"{value:.{FIGURES}g}") if isinstance(value, float) else value
    return found
