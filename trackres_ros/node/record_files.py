# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Names the files of a recording, decides when the next one begins, and deletes the oldest to stay within the limit."""

from __future__ import annotations

import re
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from trackres_ros.errors import InputError
from trackres_ros.output.mcap import BEGINNING
from trackres_ros.recording.mcap import SUFFIX
from trackres_ros.units import SECOND_NS

MB = 1_000_000
FILES_IN_LIMIT = 10  # where only the total limit is given
STILL_WRITTEN_S = 60.0  # an unfinished file with a more recent change may belong to another process


@dataclass(frozen=True, slots=True)
class RecordLimits:
    """Size at which the next file of a recording begins, and limit of all of them; 0 is no limit.

    Raises InputError if the limit is too small for two files.
    """

    split_mb: float = 0.0
    split_minutes: float = 0.0
    limit_mb: float = 0.0

    def __post_init__(self) -> None:
        if self.limit_mb and self.split_mb > 0.5 * self.limit_mb:
            given = f"{self.limit_mb:g} MB, with files of {self.split_mb:g} MB"
            raise InputError("--record-limit-mb", given, "at least twice --record-split-mb", "the oldest whole files are deleted")

    @property
    def splits(self) -> bool:
        """Whether there is more than one file."""
        return bool(self.split_mb or self.split_minutes or self.limit_mb)

    @property
    def largest_mb(self) -> float:
        """Size of a file at which the next one begins; 0 is none."""
        return self.split_mb or self.limit_mb / FILES_IN_LIMIT

    def due(self, size: int, span_ns: int) -> bool:
        """Whether the next file begins, behind one of so many bytes that covers so much time."""
        by_size = self.largest_mb and size >= self.largest_mb * MB
        return bool(by_size or (self.split_minutes and span_ns >= self.split_minutes * 60 * SECOND_NS))


class RecordingFiles:
    """The files of one recording: `drive.mcap`, or `drive_0000.mcap`, `drive_0001.mcap`... if it is split. One that is not split
    goes on with `drive_0001.mcap` where a simulated clock goes back.

    Numbers continue from earlier runs, which belong to the same recording. An unfinished file ends in `.part`;
    one from an earlier run is never overwritten.
    """

    def __init__(self, path: Path, limits: RecordLimits) -> None:
        self._path, self._limits = path, limits
        self._name = re.compile(rf"{re.escape(path.stem)}_(\d{{4,}}){re.escape(path.suffix)}({re.escape(SUFFIX)})?")
        self.deleted = 0
        self._begun = False  # the file without a number

    def next(self) -> tuple[Path, Path]:
        """The next file, and its name until it is finished."""
        if self._limits.splits or self._begun:
            number = 1 + max((number for number, _ in self._numbered()), default=0 if self._begun else -1)
            path = self._path.with_name(f"{self._path.stem}_{number:04d}{self._path.suffix}")
            return path, path.with_name(path.name + SUFFIX)
        self._begun = True
        part, number = self._path.with_name(self._path.name + SUFFIX), 0
        while part.exists():
            number += 1
            part = self._path.with_name(f"{self._path.name}.{number}{SUFFIX}")
        return self._path, part

    def left_unfinished(self) -> list[Path]:
        """Unfinished files of earlier runs."""
        beginning = self._path.stem if self._limits.splits else self._path.name
        found = self._path.parent.glob(f"*{SUFFIX}")
        return sorted(path for path in found if path.name.startswith(beginning) and _is_ours(path))

    def make_room(self) -> None:
        """Delete the oldest files of this recording, by number, until the next one fits into the limit too."""
        limits = self._limits
        if not limits.limit_mb:
            return
        sizes = {path: path.stat().st_size for _, path in sorted(self._numbered()) if _is_ours(path)}
        too_much = sum(sizes.values()) + (limits.largest_mb - limits.limit_mb) * MB
        for path, size in sizes.items():
            if too_much <= 0:
                return
            if path.suffix != SUFFIX or abs(time.time() - path.stat().st_mtime) > STILL_WRITTEN_S:
                path.unlink(missing_ok=True)
                self.deleted += 1
                too_much -= size

    def _numbered(self) -> list[tuple[int, Path]]:
        found = [(self._name.fullmatch(path.name), path) for path in self._path.parent.iterdir()]
        return [(int(match[1]), path) for match, path in found if match]


def _is_ours(path: Path) -> bool:
    with suppress(OSError), path.open("rb") as file:
        return file.read(len(BEGINNING)) == BEGINNING
    return False
