# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Lists the shipped topics files with their content and path."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from trackres_ros.files.resources import shipped_topics
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.roles import base_role
from trackres_ros.text.table import table


def shipped() -> list[dict[str, Any]]:
    """Name, use, roles and path of each shipped topics file: ``topics`` serve bags and the live node, ``columns`` tables."""
    found = []
    for name, path in shipped_topics().items():
        topics = Topics.load(path)
        of_bags = any(binding.topic for binding in topics.bindings.values())
        found.append({"name": name, "names": "topics" if of_bags else "columns", "roles": list(topics), "file": str(path)})
    return found


def shipped_text(found: Iterable[Mapping[str, Any]]) -> str:
    """The same for people."""
    rows = [
        (one["name"], one["names"], ", ".join(dict.fromkeys(base_role(role) for role in one["roles"])), one["file"])
        for one in found
    ]
    return table(rows, ("name", "names", "roles", "file"), numbers=False)
