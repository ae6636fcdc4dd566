# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A picture of the page, and how wide it is."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

WIDTH = 7.2  # as wide as an A4 page prints, so that type keeps its size
TITLE_LETTERS = 88  # that a title over the whole width holds
MOST_POINTS = 1500  # of a line: all that paper shows


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture and what it shows, in words."""

    path: Path
    title: str
    alternative: str
