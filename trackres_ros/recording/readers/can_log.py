# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads logs of CAN frames: BLF, ASC and candump."""

import io
import logging
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from trackres_ros.errors import InputError
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.can_signals import CanSignals, Frame
from trackres_ros.recording.channel_file import MOST_TIME_S
from trackres_ros.recording.opening import FileKind

NO_FRAME = re.compile(r"(date|base|//|(no )?internal events|Begin|End|\d+\.\d+\s+Start of measurement)\b|//|$", re.IGNORECASE)
"""Lines of an ASC file other than frames."""
RELATIVE = re.compile(r"base\s+\w+\s+timestamps\s+relative\b", re.IGNORECASE)
"""Header of an ASC file whose times are those since the line before."""
SINCE_LAST = re.compile(r"^\s*(\d{1,10})\.(\d{1,9})(?=\s)")
"""Such a time [s]: of a frame, or of another event, which python-can skips."""
MICROSECOND_NS = 1000
"""Resolution of stamps: seconds since 1970 in double precision have a quarter of it."""


class CanLog(CanSignals):
    """A log that python-can reads. Stamps are those of the log, an ASC file's from its beginning."""

    def __init__(self, path: Path, name: str, topics: Topics | None) -> None:
        self._path = path
        super().__init__(name, self._read, topics)

    def _read(self, event_counts: Counter[str]) -> Iterator[Frame]:
        import can

        logging.getLogger("can").setLevel(logging.ERROR)  # what it skips is counted
        readers: dict[str, Any] = {".asc": can.ASCReader, ".log": can.CanutilsLogReader}
        suffix = self._path.suffix.lower()
        frames = 0
        with self._path.open("rb") as file:
            lines = None if suffix == ".blf" else _Lines(file)
            reader = can.BLFReader(file) if lines is None else readers[suffix](lines)
            first_bus = 0 if suffix == ".log" else 1  # buses of Vector's tools count from 1, python-can from 0
            for message in reader if lines is None else _resuming(reader):
                if not abs(message.timestamp) < MOST_TIME_S:
                    continue
                frames += 1
                if not (message.is_error_frame or message.is_remote_frame):
                    stamp_ns = round(message.timestamp * 1e6) * MICROSECOND_NS
                    bus = _bus(message.channel, first_bus)
                    yield Frame(stamp_ns, message.arbitration_id, message.is_extended_id, bus, bytes(message.data))
        if lines and lines.entries and not frames:
            remedy = "record it with: candump -L" if suffix == ".log" else ""
            raise InputError(self.name, "no readable frame", "a log with one frame per line", remedy)
        event_counts["lost"] = max(0, (lines.entries if lines else reader.object_count) - frames)
        event_counts["cut"] = int(lines is not None and not lines.has_line_end)


def _bus(channel: Any, first_bus: int) -> int | None:
    """The number of a bus, also of an interface such as can0."""
    if isinstance(channel, int):
        return channel + first_bus
    digits = re.search(r"\d+$", str(channel or ""))
    return int(digits.group()) if digits else None


def _resuming(reader: Iterable[Any]) -> Iterator[Any]:
    """The frames of a log in text. A reader ends at a line that it does not understand; then it goes on behind that line."""
    while True:
        try:
            yield from reader
            return
        except (ValueError, IndexError):
            continue


class _Lines:
    """The lines of a log in text; `entries` are those that should be frames.

    Times since the line before become times since the beginning. A last line without an end is left out.
    """

    def __init__(self, file: io.BufferedReader) -> None:
        self._file, self.entries, self.has_line_end = file, 0, True
        self._is_relative, self._since_ns = False, 0
        self.close = file.close  # required by python-can

    def __iter__(self) -> Iterator[str]:
        if self.entries:
            yield "\n"  # ends the header for a reader that resumes
        for line in self._file:
            text, self.has_line_end = line.decode("latin-1"), line.endswith(b"\n")
            if not self.has_line_end:
                return
            self.entries += not NO_FRAME.match(text.strip())
            self._is_relative |= RELATIVE.match(text.strip()) is not None
            yield SINCE_LAST.sub(self._from_beginning, text) if self._is_relative else text

    def _from_beginning(self, since_last: re.Match[str]) -> str:
        whole_seconds, part = since_last.groups()
        self._since_ns += int(whole_seconds) * 10**9 + int(part.ljust(9, "0"))
        return f"{self._since_ns // 10**9}.{self._since_ns % 10**9:09d}"


KINDS = (
    FileKind(
        "a CAN log",
        (".blf", ".asc", ".log"),
        lambda path, name, topics: [CanLog(path, name, topics)],
        (("can", "can"), ("cantools", "can")),
        checked=True,
    ),
)
