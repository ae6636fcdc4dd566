# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Finds the files that a command has written so far, for the message when it is interrupted."""

import os
import time
from collections.abc import Iterator
from pathlib import Path

from trackres_ros.text.numbers import some_of

SHOWN = 8
CLOCK_TICK_NS = 20_000_000  # a file's time may be that of the kernel's last tick

_places: list[Path] = []
_began_ns = 0


def begin() -> None:
    """Mark the start of a command, before any output."""
    global _began_ns
    _places.clear()
    _began_ns = time.time_ns()


def watch(*places: Path | None) -> None:
    """Register the files or folders that a command writes."""
    _places.extend(place for place in places if place)


def places() -> str:
    """The output places of the command, for error messages."""
    return ", ".join(str(place) for place in _places[:SHOWN])


def so_far() -> str:
    """The files written since the command started, in words."""
    found = sorted({str(path) for place in _places for path in _files(place) if _is_new(path)})
    if not found:
        return "nothing was written"
    return f"written so far: {some_of(found, SHOWN)}"


def _files(place: Path) -> Iterator[Path]:
    if not place.is_dir():
        yield place
    for folder, _, names in os.walk(place):
        yield from (Path(folder) / name for name in names)


def _is_new(path: Path) -> bool:
    try:
        return path.stat().st_mtime_ns >= _began_ns - CLOCK_TICK_NS
    except OSError:
        return False
