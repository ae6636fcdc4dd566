# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Keeps the belt temperatures over a restart: loads at the start, saves in the background and at the end.

A state that this start cannot use, as it has other values, is copied to a file beside it before it is replaced. A later start
with the values of that copy goes on with it.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from trackres_ros.errors import InputError
from trackres_ros.estimator import columns as at
from trackres_ros.estimator.estimator import Estimator, Session
from trackres_ros.estimator.snapshot import (
    after_time_off,
    aside_of,
    content,
    is_other_kind,
    key,
    leftovers,
    place_aside,
    read_learning,
    set_aside,
)
from trackres_ros.files import own_files
from trackres_ros.files.own_files import FileLock
from trackres_ros.node.measured_torque import LiveLearning
from trackres_ros.node.notices import Notice
from trackres_ros.node.process import Background, steady_ns

AUTO, NONE = "auto", "none"
LONGEST_NAME = 100
SLOW_NS = 5_000_000_000  # of one saving
NO_HOME = "there is no home folder to save it in: set state_file or XDG_STATE_HOME"


def state_path(parameter: str, sim_time: bool, node: str, namespace: str, vehicle: str) -> tuple[Path | None, str]:
    """Folder for the state of a node, or None; and the reason, if a state file was requested."""
    if parameter == NONE or (parameter == AUTO and sim_time):
        return None, ""
    base = os.environ.get("XDG_STATE_HOME")
    try:
        if parameter != AUTO:
            return Path(parameter).expanduser(), ""
        folder = (Path(base) if base else Path.home() / ".local" / "state") / "trackres"
    except RuntimeError:  # no HOME, and a user unknown to the system
        return None, NO_HOME
    return folder / state_name(node, namespace, vehicle), ""


def state_name(node: str, namespace: str, vehicle: str) -> str:
    """Name of the state file of a node with a vehicle: a plain and unique one, whatever their names.

    The readable part may be the same for two of them; the digest of the whole is not.
    """
    identity = [*filter(None, namespace.split("/"))], node, vehicle
    readable_name = re.sub(r"[^A-Za-z0-9]+", "_", "_".join((*identity[0], node, vehicle))).strip("_")[:LONGEST_NAME]
    return f"{readable_name}-{hashlib.sha256(json.dumps(identity).encode()).hexdigest()[:12]}.json"


def lock_of(path: Path) -> Path:
    """The file that locks a state file, by whatever name it is reached."""
    target = Path(os.path.realpath(path))
    return target.with_name(f".{target.name}.lock")


class StateKeeper:
    """One state file. Times are the machine's: the belt cools while the machine is off, whatever time is simulated."""

    def __init__(self, path: Path | None, why_none: str = "", steady_ns: Callable[[], int] = steady_ns) -> None:
        self.path, self._steady_ns = path, steady_ns
        self.holds_at = time.time()  # when the loaded state holds: that of the file may be later than a clock not yet set
        self.saved_ns: int | None = None  # by the steady clock
        self.error = why_none
        self.unused_reason = ""  # why the state file that was there could not be used
        self._copy_path: Path | None = None  # where that file is copied before it is replaced; None if there is nothing to keep
        self._used_copy: Path | None = None  # copy that this start went on with; it goes once a later state is saved
        self._lock = FileLock(lock_of(path)) if path else None
        self.shared_with = ""  # another process that keeps its state in this file
        self._writer = Background("state")
        self._began_ns = 0

    def load(self, estimator: Estimator, learning: LiveLearning) -> tuple[Session, str]:
        """A session with the stored belts, cooled since, or cold; and the outcome as text.

        The learning continues with the stored values, less certain by the time off; a file without them leaves it unchanged.
        """
        if self.path is None:
            return estimator.session(), f"no state is saved{self.error and f' ({self.error})'}: cold start"
        try:
            if self.path.parent.exists() and self._has_lock():
                for part in leftovers(self.path):
                    part.unlink(missing_ok=True)
            if not self.path.exists():
                return estimator.session(), f"no state file {self.path} yet: cold start"
        except (OSError, ValueError) as error:
            self.unused_reason = f"cold start: the state file {self.path} cannot be reached: {error}"
            return estimator.session(), self.unused_reason
        file = self.path
        try:
            session, since_s = after_time_off(estimator, file, self.holds_at)
        except InputError as error:
            error = InputError(error.where, error.given, error.allowed)  # there is nothing to do: a copy is kept
            self.unused_reason = f"cold start: the state file cannot be used: {error}"
            with suppress(OSError):
                if file.is_file() and is_other_kind(file):
                    self.error, self.path = f"{file} is another kind of file, which is not replaced", None
                    return estimator.session(), self.unused_reason
            self._keep_unused("; a start with its values uses it again")
            file = place_aside(file, key(estimator))  # that of an earlier start with these values
            if self._copy_path in (None, file):  # then the state file itself may be the later one
                return estimator.session(), self.unused_reason
            try:
                session, since_s = after_time_off(estimator, file, self.holds_at)
            except InputError:
                return estimator.session(), self.unused_reason
            self.unused_reason, self._used_copy = "", file
        off_s = max(0.0, since_s)
        self.holds_at += off_s - since_s
        subject = "belts" if estimator.assemblies else "temperatures of the effects"
        text = f"{subject} restored from {file} and cooled for {off_s / 60.0:.1f} min"
        if not session.started:
            text = f"no {subject} in {file}: cold start{' in the last known air' if session.has_past else ''}"
        try:
            learning_note = learning.go_on(session, read_learning(estimator, file), self.holds_at)
        except ValueError as error:
            self.unused_reason = f"learning starts from the vehicle file: {error}"
            self._keep_unused("")
            self._used_copy = None
            return session, f"{text}; {self.unused_reason}"
        return session, f"{text}; {learning_note}" if learning_note else text

    def _keep_unused(self, use: str) -> None:
        """Have the state file copied before it is replaced, and say where; `how` says how it is used again."""
        assert self.path is not None
        self._copy_path = aside_of(self.path)
        if self._copy_path is not None:
            self.unused_reason += f"; before it is replaced it is copied to {self._copy_path}{use}"

    def _may_replace(self, session: Session) -> bool:
        """Whether there is anything to save in place of what is there: after a speed, and before it what was restored."""
        return (self._copy_path is None and session.has_past) or session.memory.counters[at.SPEED, at.Count.ACCEPTED] > 0

    def notices(self) -> list[Notice]:
        """Text that the state file cannot be written, or that the existing one could not be used."""
        notices = []
        waited_ns = time.monotonic_ns() - self._began_ns
        if self._writer.busy and waited_ns > SLOW_NS:
            text = f"the disk has not accepted the state file {self.path} for {waited_ns * 1e-9:.0f} s"
            notices.append(Notice("STATE_NOT_SAVED", text))
        elif self.error:
            place = f" in {self.path}" if self.path else ""
            notices.append(Notice("STATE_NOT_SAVED", f"the state cannot be saved{place}: {self.error}"))
        if self.shared_with:
            text = f"{self.shared_with} keeps its state in {self.path} too: it is not written until that one has ended"
            notices.append(Notice("STATE_SHARED", f"{text}; give each node a name or a state_file of its own"))
        if self.unused_reason:
            notices.append(Notice("STATE_NOT_USED", self.unused_reason))
        return notices

    def _has_lock(self) -> bool:
        """Whether no other node has the file; where no lock can be made, saving will tell why."""
        assert self._lock is not None
        try:
            self.shared_with = self._lock.take()
        except OSError:
            self.shared_with = ""
        return not self.shared_with

    def close(self) -> None:
        """Leave the file to others, once it is written."""
        if self._lock is not None and not self._writer.busy:
            self._lock.release()

    def save_soon(self, session: Session, state_at: float, learning: LiveLearning) -> None:
        """Save in the background, without holding up the outputs; not while the last one is still being written.

        `state_at` is the time [s since 1970] of the state: the belts cool from then on.
        """
        if self.path is not None and not self._writer.busy and self._may_replace(session):
            self._begin(self.path, session, state_at, learning)

    def save(self, session: Session, state_at: float, learning: LiveLearning, patience_s: float = 1.0) -> str:
        """Save now; return a text for the log. See `save_soon`.

        Raises InputError if no state is kept, the file cannot be written, or the disk takes longer than `patience_s`;
        or if there is nothing to save, as nothing was restored and there is no speed yet.
        """
        if self.path is None:
            raise InputError("state file", "none", "the node's parameter state_file set to a path or to auto")
        if not self._may_replace(session):
            raise InputError(f"state file {self.path}", "no speed yet", "an accepted speed before it is written")
        end = time.monotonic() + patience_s
        if not self._writer.wait(patience_s):
            raise InputError(f"state file {self.path}", "an earlier save that is still running", "a disk that responds")
        self._begin(self.path, session, state_at, learning)
        if not self._writer.wait(max(0.0, end - time.monotonic())):
            problem = f"a disk that does not respond within {patience_s:g} s"
            remedy = "the save continues; the status reports if it fails"
            raise InputError(f"state file {self.path}", problem, "a faster disk", remedy)
        if self.error:
            raise InputError(f"state file {self.path}", self.error, "a file that can be written")
        return f"state saved in {self.path}"

    def _begin(self, path: Path, session: Session, state_at: float, learning: LiveLearning) -> None:
        data = content(session, state_at, learning.stored())
        self._began_ns = time.monotonic_ns()
        self._writer.start(lambda: self._write(data, path))

    def _write(self, data: bytes, path: Path) -> None:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            if not self._has_lock():
                self.error = f"it is in use by {self.shared_with}"
                return
            if self._copy_path is not None:
                with suppress(FileNotFoundError):
                    set_aside(path, self._copy_path)
                self._copy_path = None
            own_files.write(path, data)
            if self._used_copy is not None:
                with suppress(OSError):
                    self._used_copy.unlink()
                self._used_copy = None
        except Exception as error:  # of the disk, mostly
            self.error = getattr(error, "strerror", None) or str(error)
        else:
            self.error, self.saved_ns = "", self._steady_ns()
