# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Names the columns or topics that may hold the torque, if none was read."""

import re
from collections.abc import Iterable, Mapping, Sequence

from trackres_ros.recording.choosing import listed_names
from trackres_ros.recording.guess import NOT_MEASURED, SCALARS
from trackres_ros.recording.roles import base_role
from trackres_ros.text import words

TORQUE_LIKE = re.compile(r"torque|moment|effort|couple|\bk?n ?m\b|tractive|traction force|zugkraft")
"""Words and units in the name of a column or topic that may hold a torque, or a force that is one by a radius."""
TYPES = ("geometry_msgs/msg/WrenchStamped", "geometry_msgs/msg/Wrench", "sensor_msgs/msg/JointState", *SCALARS)
"""Types of messages that may hold a torque; plain numbers if the topic sounds like one."""


def of_columns(names: Iterable[str]) -> list[str]:
    """Those of some columns that may hold a torque."""
    return [name for name in names if _sounds_like_torque(name)]


def of_topics(types: Mapping[str, str]) -> list[str]:
    """Those of some topics that may hold a torque, of which the message types are given."""
    return [
        topic
        for topic, kind in sorted(types.items())
        if kind in TYPES and (_sounds_like_torque(topic) or kind not in SCALARS) and not NOT_MEASURED.search(words(topic))
    ]


def note_of(candidates: Sequence[str], roles: Iterable[str]) -> list[str]:
    """Notes of a recording on candidates; empty if a torque was read."""
    if not candidates or any(base_role(role) == "torque" for role in roles):
        return []
    return [f"no torque channel is in use; candidates: {listed_names(candidates)}"]


def remedy_of(candidates: Sequence[str], of_topics: bool) -> str:
    """Remedy for a recording without a torque; `of_topics`: whether it is a bag."""
    if of_topics:
        line, more = "torque: {topic: NAME, type: TYPE, field: FIELD}", "{topic: ...}, {topic: ...}"
    else:
        line, more = "torque: {column: NAME, unit: Nm}", "{column: ...}, {column: ...}"
    several = f", or the sum of left and right: torque: {{sum: [{more}]}}" if len(candidates) > 1 else ""
    where = f"it may be in {listed_names(candidates)}: " if candidates else ""
    return f"{where}give it in a topics file: {line}{several}"


def _sounds_like_torque(name: str) -> bool:
    spoken = words(name)
    return bool(TORQUE_LIKE.search(spoken)) and not NOT_MEASURED.search(spoken)
