# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Replaces files that belong together as one: whatever fails, all of them are the new ones or all are the old ones.

All new files are written beside the old ones, which get a second name. Then a journal comes in place in one step: from there on
the set is replaced, by renames that need no space. A process that is killed between two renames leaves its journal. The next one
that reads or writes there completes the renames, and says so. Files beside have the token of their set in their names: a journal
moves only those, so one from a stranger harms nobody else's files.
"""

from __future__ import annotations

import errno
import fcntl
import hashlib
import json
import os
import re
import secrets
import shutil
import stat
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

FORWARD, BACK = ".trackres-set.json", ".trackres-set-undone.json"
"""A journal by its direction: its set is to be put in place, or to be taken back."""
FORMAT = "trackres-set"
MOST_BYTES = 1 << 24  # of a journal: that of a fleet of ten thousand vehicles has 2 MB
TOKEN = re.compile(r"[0-9a-f]{16}")
Seal = list[int]
"""Size and time of the last change [ns] of a file: a rename keeps them, a later change does not."""


class RepairWarning(UserWarning):
    """Files that a killed process had replaced in part are whole again."""


@dataclass(slots=True)
class Member:
    """A file of a set: bytes to write, a finished file beside its place, or None for a file to remove."""

    place: Path  # without symbolic links
    content: bytes | Path | None
    mode: int = 0o666
    is_exact: bool = False  # whether the umask does not narrow the mode

    def neighbour(self, token: str, kind: Literal["new", "old"]) -> Path:
        """Name of its new or its old file until all are in place."""
        return _neighbour(self.place, token, kind)


class FileSet:
    """The files of an open set, see `file_set`."""

    def __init__(self) -> None:
        self._members: dict[Path, Member] = {}
        self.process = os.getpid()

    def add(self, member: Member) -> None:
        """Replace, create or remove a file when the set is complete."""
        self._members[member.place] = member

    def get(self, path: Path) -> Member | None:
        """The member for a path, if the set has one."""
        return self._members.get(_real_path(path)) or self._members.get(_place(path))

    def drop(self) -> None:
        """Remove the finished files that will not be used."""
        for member in self._members.values():
            if isinstance(member.content, Path):
                member.content.unlink(missing_ok=True)

    def commit(self) -> None:
        """Replace all files. Raises OSError if that is impossible; all are then the old ones."""
        members = [m for m in self._members.values() if m.content is not None or m.place.exists()]
        if not members:
            return None
        folders = {m.place.parent for m in members}
        new_folders = {place for folder in folders for place in (folder, *folder.parents) if not place.exists()}
        roots = _roots(folders)
        try:
            for folder in folders:
                folder.mkdir(parents=True, exist_ok=True)
            while True:
                for root in roots:
                    settle(root)
                with _lock_folders(roots) as is_locked:
                    if any(_journal_in(root) for root in roots):
                        continue  # of one that was killed meanwhile
                    if is_locked:
                        for root in roots:
                            _remove_leftovers(root)
                    return _Replacement(members, roots).run()
        except BaseException as error:
            self.drop()
            for folder in sorted(new_folders, reverse=True):  # the deepest first
                with suppress(OSError):
                    folder.rmdir()
            if isinstance(error, OSError) and Path(error.filename or ".trackres").name.startswith("."):
                error.filename = str(roots[0])  # nobody knows the journal
            raise


_open_file_set: ContextVar[FileSet | None] = ContextVar("open set", default=None)


@contextmanager
def file_set() -> Iterator[FileSet]:
    """Hold all files that `own_files` writes or removes in the block, and replace them together at its end.

    After an exception none is replaced. A set within another one belongs to it. Raises OSError if the files cannot be replaced;
    none is then.
    """
    outer_set = open_set()
    if outer_set is not None:
        yield outer_set
        return
    files = FileSet()
    token = _open_file_set.set(files)
    try:
        yield files
    except BaseException:
        files.drop()
        raise
    finally:
        _open_file_set.reset(token)
    files.commit()


@contextmanager
def trial_folder() -> Iterator[Path]:
    """A folder whose files are written at once, to be read again, and go at the end of the block: they belong to no set."""
    token = _open_file_set.set(None)
    try:
        with TemporaryDirectory() as folder:
            yield Path(folder)
    finally:
        _open_file_set.reset(token)


def open_set() -> FileSet | None:
    """The set that is open now; a process that was forked meanwhile has none, as nobody would replace its files."""
    files = _open_file_set.get()
    return files if files is not None and files.process == os.getpid() else None


def present_content(path: Path) -> bytes | None:
    """Bytes of a file, as the open set will leave it; None if there is no file."""
    member = None if (files := open_set()) is None else files.get(path)
    content = path if member is None else member.content
    if isinstance(content, Path):
        return content.read_bytes() if content.is_file() else None
    return content


def is_free(path: Path) -> bool:
    """Whether the open set leaves nothing at a path."""
    member = None if (files := open_set()) is None else files.get(path)
    return not path.exists() if member is None else member.content is None


def write_new(path: Path, data: bytes, mode: int = 0o666, is_exact: bool = False) -> None:
    """Write a file that must be new, to the disk; `is_exact`: no umask narrows its mode. Raises OSError."""
    fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, mode)
    try:
        if is_exact:
            os.fchmod(fd, mode)
        rest = memoryview(data)
        while rest:
            rest = rest[os.write(fd, rest) :]
        os.fsync(fd)
    except BaseException:
        with suppress(OSError):
            os.close(fd)
        raise
    os.close(fd)  # some file systems say only here that a disk is full


def settle(folder: Path) -> None:
    """Make a set in a folder whole that a killed process had replaced in part; wait for a living one. Warns of a repair.

    Raises OSError if that is impossible; its text says why, and what to do.
    """
    while (path := _journal_in(folder)) is not None:
        try:
            journal = _Journal.read(path)
            with _lock_folders(journal.roots):
                if _journal_in(folder) == path and _Journal.read(path).token == journal.token:
                    journal.complete()
        except OSError as error:
            if not os.path.lexists(path):  # a living process was faster
                continue
            text = f"a run ended while it replaced the files in {folder}, and they cannot be made whole: "
            remedy = f"see that this user may write there, and run it again, or delete {path}"
            raise OSError(error.errno, f"{text}{error.strerror or error}; {remedy}", str(folder)) from error


class _Replacement:
    """One replacement of a set, with the locks of its folders held."""

    def __init__(self, members: list[Member], roots: list[Path]) -> None:
        self._members, self._roots, self._home = members, roots, roots[0]
        self._token = secrets.token_hex(8)

    def run(self) -> None:
        """Replace all files. Raises OSError if that is impossible; all are then the old ones."""
        plan, draft = (self._home / f".trackres-set.{self._token}.{kind}" for kind in ("plan", "full"))
        names = [_name(m.place, self._home) for m in self._members]
        journal = _Journal(self._home / FORWARD, self._token, self._roots, [])
        journal.entries = [_Entry(m.place, None, None) for m in self._members]
        try:
            write_new(plan, json.dumps(names).encode())
            journal.entries = [self._prepare_entry(m) for m in self._members]
            write_new(draft, journal.text())
            folders = {m.place.parent for m in self._members}
            for root in self._roots[1:]:
                new_file = _neighbour(root / FORWARD, self._token, "new")
                write_new(new_file, journal.text(root))
                new_file.replace(root / FORWARD)
            for folder in {*folders, *self._roots}:
                _sync(folder)
            draft.replace(journal.path)  # from here on the set is replaced
        except BaseException:
            journal.clean()
            raise
        try:
            _sync(self._home)
            journal.go_forward()
        except BaseException:
            journal.go_back()
            raise
        journal.clean()

    def _prepare_entry(self, member: Member) -> _Entry:
        try:
            return self._write_beside(member)
        except OSError as error:  # a full disk names none, and nobody knows the file beside
            raise OSError(error.errno, error.strerror, str(member.place)) from error

    def _write_beside(self, member: Member) -> _Entry:
        """Write the new file beside the old one, and give that one a second name."""
        new_seal = None
        new_file, old_file = member.neighbour(self._token, "new"), member.neighbour(self._token, "old")
        if isinstance(member.content, bytes):
            write_new(new_file, member.content, member.mode, member.is_exact)
            new_seal = _seal(new_file)
        elif member.content is not None:
            _sync(member.content)
            member.content.replace(new_file)
            new_seal = _seal(new_file)
        old_seal = _seal(member.place)
        if old_seal is not None:
            try:
                os.link(member.place, old_file)
            except OSError as error:
                if error.errno not in (errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK, errno.EINVAL):
                    raise
                shutil.copy2(member.place, old_file)  # a file system without second names, such as that of a USB stick
                _sync(old_file)
        return _Entry(member.place, new_seal, old_seal)


@dataclass(slots=True)
class _Entry:
    """A file of a journal: the seals of the new one and of the old one, None where there is none."""

    place: Path
    new_seal: Seal | None
    old_seal: Seal | None

    def go_forward(self, token: str) -> bool:
        """Put the new file in place, or remove the old one; return whether that was still to do."""
        new_file, old_file = (_neighbour(self.place, token, kind) for kind in ("new", "old"))
        if self.new_seal is not None and os.path.lexists(new_file):
            new_file.replace(self.place)
            return True
        if self.new_seal is None and os.path.lexists(old_file) and _seal(self.place) == self.old_seal:
            self.place.unlink()
            return True
        return False

    def go_back(self, token: str) -> None:
        """Put the old file back, or remove the new one where there was none."""
        old_file = _neighbour(self.place, token, "old")
        if self.old_seal is not None and os.path.lexists(old_file):
            old_file.replace(self.place)
        elif self.old_seal is None and self.new_seal is not None and _seal(self.place) == self.new_seal:
            self.place.unlink()


@dataclass(slots=True)
class _Journal:
    """The files of a set that is being replaced; it is in the first of its folders, the others lead there."""

    path: Path
    token: str
    roots: list[Path]
    entries: list[_Entry]

    @classmethod
    def read(cls, path: Path) -> _Journal:
        """The journal in a file, or where that leads. Raises OSError if it is not one of ours, or leads nowhere any more."""
        content = _content(path)
        home, token = path.parent, str(content["token"])
        if content["home"]:
            home = _real_path(path.parent / str(content["home"]))
            journal = next((home / name for name in (FORWARD, BACK) if os.path.lexists(home / name)), None)
            if journal is None or _content(journal)["token"] != token:  # not begun, or completed: nothing is left to do
                return cls(path, token, [path.parent], [])
            path, content = journal, _content(journal)
        entries = [_Entry(_place(home / name), new_seal, old_seal) for name, new_seal, old_seal in content["files"]]
        roots = [_real_path(home / name) for name in content["roots"]]
        return cls(path, token, [home, *(root for root in roots if root.is_dir())], entries)

    def text(self, seen_from: Path | None = None) -> bytes:
        """The content of the journal; from another folder, that of a file that leads to it."""
        home = self.path.parent
        content: dict[str, Any] = {"format": FORMAT, "token": self.token, "home": "", "roots": [], "files": []}
        if seen_from is not None:
            content["home"] = _name(home, seen_from)
        else:
            content["roots"] = [_name(root, home) for root in self.roots[1:]]
            content["files"] = [[_name(e.place, home), e.new_seal, e.old_seal] for e in self.entries]
        return json.dumps(content).encode()

    def complete(self) -> None:
        """Bring a set to its end that its process did not; warn where that changes a file."""
        if self.path.name == BACK:
            for entry in self.entries:
                entry.go_back(self.token)
            outcome = "the earlier files are back"
        else:
            outcome = "the rest is replaced now" if self.go_forward() else ""
        self.clean()
        if _journal_in(self.path.parent) is not None:
            raise OSError(errno.EROFS, "its journal cannot be removed", str(self.path))
        if outcome:
            names = ", ".join(sorted(e.place.name for e in self.entries)[:8])
            text = f"{self.path.parent}: a run ended while it replaced files that belong together ({names}); {outcome}"
            warnings.warn(text, RepairWarning, stacklevel=3)

    def go_forward(self) -> bool:
        """Put all new files in place; return whether any was still to do."""
        moves_made = [entry.go_forward(self.token) for entry in self.entries]
        for folder in {entry.place.parent for entry in self.entries}:
            if folder.is_dir():  # nobody has removed it since
                _sync(folder)
        return any(moves_made)

    def go_back(self) -> None:
        """Take everything back. Where that is impossible too, the journal stays for the next run."""
        with suppress(OSError):
            back = self.path.with_name(BACK)
            self.path.replace(back)
            self.path = back
            for entry in self.entries:
                entry.go_back(self.token)
            self.clean()

    def clean(self) -> None:
        """Remove what is beside the files, then the journal. What cannot be removed stays, with the journal, for a next run."""
        home = self.path.parent
        with suppress(OSError):
            for entry in self.entries:
                for kind in ("new", "old"):
                    _neighbour(entry.place, self.token, kind).unlink(missing_ok=True)
            for root in self.roots[1:]:
                _neighbour(root / FORWARD, self.token, "new").unlink(missing_ok=True)
                _unlink_leftovers(root / FORWARD, self.token)
            (home / f".trackres-set.{self.token}.full").unlink(missing_ok=True)
            _unlink_leftovers(self.path, self.token)
            (home / f".trackres-set.{self.token}.plan").unlink(missing_ok=True)


def _remove_leftovers(home: Path) -> None:
    """Remove the files of a set whose process was killed before it replaced any; the lock shows that it lives no more."""
    for plan in home.glob(".trackres-set.*.plan"):
        token = plan.name.split(".")[2]
        if not TOKEN.fullmatch(token):
            continue
        try:
            names = json.loads(_bytes(plan))
        except (OSError, ValueError):  # cut short: nothing was written after it
            names = []
        entries = [_Entry(_place(home / str(name)), None, None) for name in names if isinstance(names, list)]
        roots = _roots({home, *(entry.place.parent for entry in entries)})
        _Journal(home / f".trackres-set.{token}.full", token, [home, *(r for r in roots if r != home)], entries).clean()


def _content(path: Path) -> Mapping[str, Any]:
    """What a journal says. Raises OSError if it is not one of ours."""
    try:
        content = json.loads(_bytes(path))
        is_sound = content["format"] == FORMAT and TOKEN.fullmatch(content["token"]) and isinstance(content["home"], str)
        is_sound = is_sound and all(isinstance(root, str) for root in content["roots"])
        is_sound = is_sound and all(isinstance(name, str) and len(seals) == 2 for name, *seals in content["files"])
    except (ValueError, KeyError, TypeError):
        is_sound = False
    if not is_sound:
        raise OSError(errno.EINVAL, f"{path} is damaged", str(path))
    return content  # type: ignore[no-any-return]


def _bytes(path: Path) -> bytes:
    """Bytes of a regular file of bounded size; never blocks."""
    with os.fdopen(os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK | os.O_NOFOLLOW), "rb") as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise OSError(errno.EINVAL, "not a regular file", str(path))
        return file.read(MOST_BYTES)


def _unlink_leftovers(journal: Path, token: str) -> None:
    """Remove the journal of a set, but no other one."""
    if os.path.lexists(journal) and _content(journal)["token"] == token:
        journal.unlink()


def _journal_in(folder: Path) -> Path | None:
    return next((folder / name for name in (FORWARD, BACK) if os.path.lexists(folder / name)), None)


def _seal(path: Path) -> Seal | None:
    try:
        status = os.lstat(path)
    except FileNotFoundError:
        return None
    return [status.st_size, status.st_mtime_ns]


def _neighbour(place: Path, token: str, kind: str) -> Path:
    """Name of the new or old file beside its place; that of any file fits into the length of a name."""
    digest = hashlib.sha256(os.fsencode(place.name)).hexdigest()[:16]
    return place.with_name(f".trackres-set.{token}.{digest}.{kind}")


def _real_path(path: Path) -> Path:
    return Path(os.path.realpath(path))


def _place(path: Path) -> Path:
    """A path without symbolic links but for itself: what is beside it decides, not what it leads to."""
    return _real_path(path.parent) / path.name


def _name(path: Path, home: Path) -> str:
    return os.path.relpath(path, home)


def _roots(folders: Iterable[Path]) -> list[Path]:
    """Folders that are in none of the others, sorted."""
    roots: list[Path] = []
    for folder in sorted(folders):
        if not any(folder.is_relative_to(root) for root in roots):
            roots.append(folder)
    return roots


def _sync(path: Path) -> None:
    """Bring a file or the names in a folder to the disk."""
    fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(fd)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.EBADF):  # a file system that cannot do this for folders
            error.filename = str(path)
            raise
    finally:
        _close(fd)


def _close(fd: int) -> None:
    """Close what was opened for reading alone: nothing is lost where that fails."""
    with suppress(OSError):
        os.close(fd)


@contextmanager
def _lock_folders(folders: Iterable[Path]) -> Iterator[bool]:
    """Hold the locks of folders, which the system frees when a process ends; whether the file system has any."""
    with ExitStack() as stack:
        is_locked = True
        for folder in sorted(set(folders)):  # in one order, so that no two wait for each other
            fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
            stack.callback(_close, fd)
            try:
                fcntl.flock(fd, fcntl.LOCK_EX)
            except OSError:
                is_locked = False
        yield is_locked
