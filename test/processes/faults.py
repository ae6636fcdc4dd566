# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Makes the n-th call of the system that changes a folder fail, or kill the process."""

import errno
import os
import signal
from contextlib import contextmanager
from pathlib import Path

import pytest

OF_PATHS = ("open", "link", "replace", "rename", "unlink", "mkdir", "rmdir")
OF_FILES = ("write", "fsync", "close")


class Faults:
    """Counts the calls on paths and open files in a folder; from `first` to `last` they fail, and from `again` on."""

    def __init__(self, folder, first, last, kill=False, again=1 << 30):
        self.folder, self.first, self.last, self.kill, self.again = Path(os.path.realpath(folder)), first, last, kill, again
        self.count, self.ours, self.calls = 0, set(), []

    def __enter__(self):
        self.patch = pytest.MonkeyPatch()
        for name in (*OF_PATHS, *OF_FILES):
            self.patch.setattr(os, name, self.counting(name, getattr(os, name)))
        return self

    def __exit__(self, *_):
        self.patch.undo()

    @property
    def hit(self):
        return self.count >= self.first

    def counting(self, name, real):
        def call(target, *args, **kwargs):
            if name in OF_PATHS and not (isinstance(target, str | Path) and self.is_inside(target)):
                return real(target, *args, **kwargs)
            if name in OF_FILES and target not in self.ours:
                return real(target, *args, **kwargs)
            self.count += 1
            self.calls.append(name)
            fails = self.first <= self.count <= self.last or self.count >= self.again
            if fails and self.kill:
                os.kill(os.getpid(), signal.SIGKILL)
            if name == "close":
                self.ours.discard(target)
                real(target)
            if fails:
                given = [str(target)] if name in OF_PATHS else []
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), *given)
            if name == "close":
                return None
            done = real(target, *args, **kwargs)
            if name == "open":
                self.ours.add(done)
            return done

        return call

    def is_inside(self, path):
        parent = os.path.realpath(Path(path).parent)
        return Path(parent).is_relative_to(self.folder) or Path(os.path.realpath(path)) == self.folder


def contents(folder):
    """All files of a folder with their bytes, hidden ones too."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(Path(folder).rglob("*")) if path.is_file()}


def shown(folder):
    """The same without hidden files."""
    return {name: content for name, content in contents(folder).items() if not Path(name).name.startswith(".")}


@contextmanager
def child():
    """A process that begins as a copy of this one; yields None there, and its number here, and waits for its end."""
    number = os.fork()
    if number == 0:
        try:
            yield None
        finally:
            os._exit(0)
    yield number
    os.waitpid(number, 0)
