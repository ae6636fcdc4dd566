# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Lists the shipped topics files, and writes the guesses about a recording as one."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from trackres_ros.files.resources import shipped_topics
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.guess import NOT_GUESSED, in_a_line, topics_line
from trackres_ros.recording.opening import open_source
from trackres_ros.recording.roles import base_role
from trackres_ros.text import table

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
    for role, binding in source.bindings.items():
        others = [note.partition(ALSO)[2] for note in source.notes if note.startswith(f"{role}: ") and ALSO in note]
        lines.append(topics_line(role, binding) + (f"  # or {others[0]}" if others else ""))
    return [*lines, *(f"# {note}" for note in source.notes if f": {NOT_GUESSED} " in note)]


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
