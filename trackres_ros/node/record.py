# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes every message that the running node receives, and every estimate, into a bag, in one file or several.

A separate thread writes, so that a full, slow or missing disk does not affect the estimate. Messages that cannot be written are
counted and reported, and recording continues once the disk works again.
"""

from __future__ import annotations

import re
import shlex
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from trackres_ros.arrays import Array
from trackres_ros.errors import InputError
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.records import Steps
from trackres_ros.estimator.snapshot import is_other_kind, state_file
from trackres_ros.files import own_files
from trackres_ros.learning.columns import column_names
from trackres_ros.learning.learner import Learner
from trackres_ros.node.notices import Notice
from trackres_ros.node.transport import LAST_NS, InputTopic, Reasons, input_name
from trackres_ros.output.bag import OutputBag
from trackres_ros.output.mcap import BEGINNING
from trackres_ros.output.preview import ResultPreview, picture_columns
from trackres_ros.recording.mcap import SUFFIX
from trackres_ros.units import SECOND_NS

if TYPE_CHECKING:
    from trackres_ros.node.application import Application

WRITE_EVERY_S = 0.5  # so that a killed process loses less than a second
PREVIEW_ROWS = 256
MOST_WAITING_BYTES = 64 * 2**20
MOST_EARLY = 10000  # messages that wait for a simulated clock
BYTES_PER_NUMBER, BYTES_BESIDES = 32, 200  # memory of the queue
SHOWN_NS = 5_000_000_000  # since something was lost, or since the disk answered last
END_PATIENCE_S = 10.0
MB = 1_000_000
FILES_IN_LIMIT = 10  # where only the total limit is given
STILL_WRITTEN_S = 60.0  # an unfinished file with a more recent change may belong to another process


class Origin(NamedTuple):
    """What is recorded of one application."""

    estimator: Estimator
    learner: Learner | None
    topics: list[tuple[InputTopic, str]]  # topics, and the texts that define their types
    jump_ns: int  # back in time, from which on the next file begins

    @property
    def columns(self) -> tuple[str, ...]:
        """Of a row; with learning, the learned columns follow those of the estimate."""
        return (*self.estimator.columns, *(() if self.learner is None else column_names(self.learner.learnables)))


Published = tuple[list[float], Reasons]
"""Numbers and reasons of a message of `~/estimate`."""
Item = tuple[int, bytes | list[float] | Published, int, int, Origin]
"""Topic (or `ESTIMATE`, `RESTORED`, `PUBLISHED`), message, row or file, stamp and arrival [ns], and what they belong to."""
ESTIMATE, RESTORED, PUBLISHED = -1, -2, -3


class Recorder:
    """Takes messages and estimates one by one, and writes them twice a second. It keeps a preview of the estimates for a picture.

    Messages have their names in the topics file, whatever the namespace: with it the bag is a recording like any other. A
    message from before the simulated clock gets the clock's first time. Times on a topic are unique. Where the clock goes back
    the next file begins, as the estimate does; so it does with the next application, after a lifecycle's cleanup.

    Parameters
    ----------
    path
        The file, replaced if it exists; with several files, numbers follow its name.
    limits
        Size of a file and of all together.
    """

    def __init__(self, path: Path, limits: RecordLimits | None = None) -> None:
        self.path, self._limits = path, limits or RecordLimits()
        self._files = RecordingFiles(path, self._limits)
        self._bag: OutputBag | None = None
        self._queue: deque[Item] = deque()
        self._put_bytes = self._taken_bytes = 0  # bytes; one thread counts each
        self._overflow, self._dropped_ns = [0, 0], -SHOWN_NS  # messages and estimates
        self._given_out, self._finished_counts, self._missing_counts = [0, 0], [0, 0], [0, 0]
        self._counts: dict[str, int] = {}  # messages of each topic
        self._error, self._failed_ns, self._answered_ns = "", -SHOWN_NS, 0
        self._is_finished = False
        self._finished_files: list[str] = []
        self._starts: list[Path] = []  # files of restored states
        self._began_ns = self._latest_ns = 0
        self._before_clock: list[Item] = []
        self._preview: ResultPreview | None = None
        self._preview_steps: list[Steps] = []  # of the preview
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="recording", daemon=True)

    def begin(self, application: Application) -> list[str]:
        """Begin the bag, and record all inputs and results of the application from now on; return a text about earlier runs.

        For a later application the next file begins, with its first message. Raises InputError if the first cannot be created.
        """
        learner, estimator = application.learning.learner, application.estimator
        jump_ns = LAST_NS  # a real clock never goes back, though a message may be recorded late
        if application.parameters.sim_time:
            jump_ns = int(estimator.settings.clock_jump_s * SECOND_NS)
        self._current = Origin(estimator, learner, application.record(self._keep), jump_ns)
        self._names = [input_name(topic.name, "/") for topic, _ in self._current.topics]
        self._counts = dict.fromkeys(self._names, 0) | self._counts
        unfinished_files: list[Path] = []
        if self._thread.ident is None:
            unfinished_files = self._files.left_unfinished()
            self._origin, self._last = self._current, [0] * len(self._current.topics)
            self._preview = ResultPreview(len(self._current.columns))
            try:
                self._open()
            except OSError as error:
                raise InputError("--record", f"{self.path}: {error.strerror}", "a file that can be written") from error
            self._answered_ns = time.monotonic_ns()
            self._thread.start()
        application.on_estimate, application.on_restored = self._record_row, self._start_from
        application.on_published = self._take_published
        application.recording_notices = self.notices
        return [
            f"{path} is unfinished but readable; repair it with: trackres recover {shlex.quote(str(path))} -o FILE"
            for path in unfinished_files
        ]

    def end(self) -> list[str]:
        """Finish the bag; return texts for the log. It never raises."""
        if not self._thread.is_alive():
            return []
        self._stop.set()
        self._thread.join(END_PATIENCE_S)
        if self._thread.is_alive():
            return [f"{self._part}: the disk does not respond, the file is unfinished; see trackres recover"]
        inputs = ", ".join(f"{number} of {name}" for name, number in self._counts.items())
        estimate_count = self._written_counts()[1]
        estimates = f"{estimate_count} estimates as topics" if estimate_count else "no estimate was made"
        lines = [f"{self._file_range()}: {estimates}; messages: {inputs}"]
        if any(self._lost_counts()):
            lines.append(f"not recorded: {_counts_text(self._lost_counts())}")
        if self._files.deleted:
            lines.append(f"{self._files.deleted} of the oldest files were deleted to stay within --record-limit-mb")
        if not self._is_finished:
            lines.append(f"{self._part} is unfinished: {self._error}; it is readable, repair it with: trackres recover")
        return lines + [
            f"{path}: the state restored before it; for the same numbers: trackres replay --resume {shlex.quote(str(path))}"
            for path in self._starts
        ]

    @property
    def series(self) -> dict[str, Array]:
        """Time [s] and columns of the estimates for a picture, once the bag is finished; empty if there were none."""
        if self._preview is None or self._thread.is_alive() or not self._preview.steps:
            return {}
        return {"time_s": self._preview.samples[:, 0], **picture_columns(self._origin.columns, self._preview.samples)}

    @property
    def title(self) -> str:
        """Title of the picture."""
        return f"Live: {self._origin.estimator.vehicle.title}"

    def _file_range(self) -> str:
        first_file = self._finished_files[0] if self._finished_files else str(self._part)
        return first_file if len(self._finished_files) < 2 else f"{first_file} to {self._finished_files[-1]}"

    def notices(self) -> list[Notice]:
        """Text that data are not recorded, with the file and the amount."""
        now_ns = time.monotonic_ns()
        silent_s = (now_ns - self._answered_ns) * 1e-9
        if silent_s * 1e9 > SHOWN_NS:
            cause = f"the disk has not responded for {silent_s:.0f} s"
        elif now_ns - self._failed_ns < SHOWN_NS:
            cause = self._error
        elif now_ns - self._dropped_ns < SHOWN_NS:
            cause = "the disk is too slow for the data"
        else:
            return []
        return [Notice("NOT_RECORDED", f"recording to {self._part}: {cause}; lost so far: {_counts_text(self._lost_counts())}")]

    # Called by the application, at almost no cost

    def _keep(self, index: int, raw: bytes, arrival_ns: int) -> None:
        self._counts[self._names[index]] += 1
        self._wait((index, raw, 0, arrival_ns, self._current))

    def _record_row(self, row: list[float], stamp_ns: int, arrival_ns: int) -> None:
        self._wait((ESTIMATE, row, stamp_ns, arrival_ns, self._current))

    def _take_published(self, stamp_ns: int, numbers: list[float], reasons: Reasons, at_ns: int) -> None:
        self._wait((PUBLISHED, (numbers, reasons), stamp_ns, at_ns, self._current))

    def _start_from(self, state: bytes, arrival_ns: int) -> None:
        self._wait((RESTORED, state, 0, arrival_ns, self._current))

    def _wait(self, item: Item) -> None:
        if self._put_bytes - self._taken_bytes > MOST_WAITING_BYTES:
            self._overflow[item[0] in (ESTIMATE, PUBLISHED)] += 1
            self._dropped_ns = time.monotonic_ns()
            return
        self._put_bytes += _size(item)
        self._queue.append(item)

    # Work of the thread

    def _run(self) -> None:
        while not self._stop.wait(WRITE_EVERY_S):
            self._attempt(self._write)
        self._attempt(self._write)
        self._attempt(self._feed_preview)
        self._is_finished = self._attempt(self._close)

    def _attempt(self, do: Callable[[], None]) -> bool:
        success = False
        try:
            do()
        except BaseException as error:  # whatever it is, it is reported, and tried again
            self._error = getattr(error, "strerror", None) or f"{type(error).__name__}: {error}"
            self._failed_ns = time.monotonic_ns()
        else:
            success = True
        counts = self._written_counts()
        self._missing_counts = [given_count - in_file for given_count, in_file in zip(self._given_out, counts, strict=True)]
        self._answered_ns = time.monotonic_ns()
        return success

    def _drain(self) -> list[Item]:
        """Take the queue; messages from before the simulated clock keep waiting for it."""
        items, self._before_clock = self._before_clock, []
        while self._queue:
            items.append(self._queue.popleft())
            self._taken_bytes += _size(items[-1])
        if not any(item[3] > 0 for item in items) and not self._stop.is_set():
            self._before_clock = items[-MOST_EARLY:]
            items = items[:-MOST_EARLY]
        return items

    def _write(self) -> None:
        rounds: list[list[Item]] = [[]]
        origin = self._origin
        for item in self._drain():
            if item[0] not in (RESTORED, PUBLISHED):
                self._given_out[item[0] == ESTIMATE] += 1
            if item[4] is not origin or 0 < item[3] < self._latest_ns - origin.jump_ns:  # a simulated clock went back
                rounds.append([])
                self._latest_ns, origin = 0, item[4]
            self._latest_ns = max(self._latest_ns, item[3])
            rounds[-1].append(item)
        for number, items in enumerate(rounds):
            if number:
                self._close()
                self._turn_to(items[0][4])
            if items or len(rounds) == 1:
                self._write_round(items)

    def _turn_to(self, origin: Origin) -> None:
        """Go on with the next file, perhaps of another application; where its columns differ the picture begins anew."""
        self._feed_preview()
        if origin.columns != self._origin.columns:
            self._preview = ResultPreview(len(origin.columns))
        self._origin, self._last = origin, [0] * len(origin.topics)

    def _write_round(self, items: Sequence[Item]) -> None:
        if self._bag is None:
            self._open()
        assert self._bag
        first_ns = next((item[3] for item in items if item[3] > 0), 0)
        rows, states, outputs = [], list[bytes](), []
        for index, content, stamp_ns, arrival_ns, _ in items:
            if isinstance(content, tuple):
                outputs.append((*content, stamp_ns, arrival_ns if arrival_ns > 0 else first_ns))
            elif not isinstance(content, bytes):
                rows.append((content, stamp_ns, arrival_ns))
            elif index == RESTORED:
                states.append(content)
            else:
                # A simulated clock stands still between its ticks; two samples without a stamp would have the same time.
                self._last[index] = max(arrival_ns if arrival_ns > 0 else first_ns, self._last[index] + 1)
                self._bag.writer.write_raw(self._topics[index], content, self._last[index])
        if rows:
            values, stamps, arrivals = zip(*rows, strict=True)
            steps = Steps(np.array(stamps, dtype=np.int64), np.array(arrivals, dtype=np.int64), np.array(values))
            self._preview_steps.append(steps)
            self._bag.write(steps)
        if outputs:
            self._bag.write_published(outputs)
        self._bag.writer.flush()
        for state in states:
            start = start_of(self._bag.writer.part)
            own_files.write(state_file(start, "--record"), state)
            self._starts.append(start)
        if sum(len(steps.rows) for steps in self._preview_steps) >= PREVIEW_ROWS:
            self._feed_preview()
        if items:
            self._began_ns = self._began_ns or first_ns
            if self._limits.is_full(self._bag.writer.size, items[-1][3] - self._began_ns):
                self._close()
                self._open()

    def _feed_preview(self) -> None:
        """Keep a preview for the picture; of many rows at a time, as each time it is copied."""
        if self._preview_steps and self._preview:
            parts, self._preview_steps = self._preview_steps, []
            fields = (np.concatenate([getattr(steps, name) for steps in parts]) for name in ("stamp_ns", "arrival_ns", "rows"))
            self._preview.take(Steps(*fields), None)

    def _open(self) -> None:
        self._files.make_room()
        path, self._part = self._files.next()
        _remove_start(self._part)  # of one that was removed or repaired
        bag = OutputBag(path, self._origin.estimator, self._origin.learner, self._part, live=True)
        bag.__enter__()
        self._topics = [
            bag.writer.raw_topic(input_name(topic.name, "/"), topic.type, text) for topic, text in self._origin.topics
        ]
        self._bag, self._began_ns = bag, 0

    def _close(self) -> None:
        """Finish a file; if that fails, it stays unfinished."""
        bag, self._finished_counts, self._bag = self._bag, self._written_counts(), None
        if bag is not None:
            bag.__exit__(None, None, None)
            self._finished_files.append(str(bag.path))
            part_start, start = start_of(bag.writer.part), start_of(bag.path)
            if _remove_start(bag.path) and part_start in self._starts:  # that of a bag that was replaced
                part_start.replace(start)
                self._starts[self._starts.index(part_start)] = start

    def _written_counts(self) -> list[int]:
        """Messages and estimates that are in a file."""
        messages, estimates = self._finished_counts
        if self._bag is None:
            return [messages, estimates]
        return [messages + sum(topic.count for topic in self._topics), estimates + self._bag.estimates]

    def _lost_counts(self) -> list[int]:
        """Messages and estimates that are in no file, and will not be."""
        return [missing_count + overflow for missing_count, overflow in zip(self._missing_counts, self._overflow, strict=True)]


def start_of(bag: Path) -> Path:
    """File beside a bag, finished or not, with the restored state that its estimates begin with."""
    return bag.with_suffix(".start.json")


def _remove_start(bag: Path) -> bool:
    """Remove the restored state beside a bag; return whether its place is free, which it is not with another kind of file."""
    start = start_of(bag)
    if start.exists() and not is_other_kind(start):
        start.unlink()
    return not start.exists()


def _size(item: Item) -> int:
    content = item[1]
    if isinstance(content, tuple):
        content = content[0]
    return BYTES_BESIDES + (len(content) if isinstance(content, bytes) else BYTES_PER_NUMBER * len(content))


def _counts_text(counts: list[int]) -> str:
    return f"{counts[0]} messages and {counts[1]} estimates"


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
            limits = f"{self.limit_mb:g} MB, with files of {self.split_mb:g} MB"
            raise InputError(
                "--record-limit-mb", limits, "at least twice --record-split-mb", "the oldest whole files are deleted"
            )

    @property
    def splits(self) -> bool:
        """Whether there is more than one file."""
        return bool(self.split_mb or self.split_minutes or self.limit_mb)

    @property
    def largest_mb(self) -> float:
        """Size of a file at which the next one begins; 0 is none."""
        return self.split_mb or self.limit_mb / FILES_IN_LIMIT

    def is_full(self, size: int, span_ns: int) -> bool:
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
        self._has_begun = False  # the file without a number

    def next(self) -> tuple[Path, Path]:
        """The next file, and its name until it is finished."""
        if self._limits.splits or self._has_begun:
            number = 1 + max((number for number, _ in self._numbered_files()), default=0 if self._has_begun else -1)
            path = self._path.with_name(f"{self._path.stem}_{number:04d}{self._path.suffix}")
            return path, path.with_name(path.name + SUFFIX)
        self._has_begun = True
        part, number = self._path.with_name(self._path.name + SUFFIX), 0
        while part.exists():
            number += 1
            part = self._path.with_name(f"{self._path.name}.{number}{SUFFIX}")
        return self._path, part

    def left_unfinished(self) -> list[Path]:
        """Unfinished files of earlier runs."""
        beginning = self._path.stem if self._limits.splits else self._path.name
        parts = self._path.parent.glob(f"*{SUFFIX}")
        return sorted(path for path in parts if path.name.startswith(beginning) and _is_ours(path))

    def make_room(self) -> None:
        """Delete the oldest files of this recording, by number, until the next one fits into the limit too."""
        limits = self._limits
        if not limits.limit_mb:
            return
        sizes = {path: path.stat().st_size for _, path in sorted(self._numbered_files()) if _is_ours(path)}
        too_much = sum(sizes.values()) + (limits.largest_mb - limits.limit_mb) * MB
        for path, size in sizes.items():
            if too_much <= 0:
                return
            if path.suffix != SUFFIX or abs(time.time() - path.stat().st_mtime) > STILL_WRITTEN_S:
                path.unlink(missing_ok=True)
                self.deleted += 1
                too_much -= size

    def _numbered_files(self) -> list[tuple[int, Path]]:
        matches = [(self._name.fullmatch(path.name), path) for path in self._path.parent.iterdir()]
        return [(int(match[1]), path) for match, path in matches if match]


def _is_ours(path: Path) -> bool:
    with suppress(OSError), path.open("rb") as file:
        return file.read(len(BEGINNING)) == BEGINNING
    return False
