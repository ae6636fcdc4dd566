# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes the guesses about a recording as a topics file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.guess import topics_line
from trackres_ros.recording.opening import open_source

ALSO = "also possible: "


def guessed_topics(recording: Sequence[Path], topics: Topics | None) -> list[str]:
    """Lines of a topics file, with alternatives.

    `recording`: bags, or one other file; `topics`: which names the databases of a bus, if needed. Raises InputError for a file
    that cannot be read, or without a speed that can be guessed.
    """
    source = open_source(recording, topics)
    lines = [f"# Guessed from {source.name}: check each line."]
    if topics and topics.dbc:
        lines.append(f"dbc: [{', '.join(str(file) for _, file in topics.dbc)}]")
    for role, binding in source.bindings.items():
        others = [note.partition(ALSO)[2] for note in source.notes if note.startswith(f"{role}: ") and ALSO in note]
        lines.append(topics_line(role, binding) + (f"  # or {others[0]}" if others else ""))
    return lines
