# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A picture of the page, and its width."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

WIDTH = 7.2  # width of a printed A4 page, so that type keeps its size
TITLE_LETTERS = 88  # characters of a title over the whole width
MOST_POINTS = 1500  # of a line: the resolution of paper


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture and its description."""

    path: Path
    title: str
    alternative: str
