# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The first start on a machine: steps run in plain Python while another process compiles them, and then change over."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from trackres_ros.estimator.entry_points import COMPILED, Entries, interpreted_entries
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.jit.compiled import code_folder, is_cached, keep_code_in
from trackres_ros.node.remarks import Remark
from trackres_ros.vehicle import load, with_surroundings

NICENESS = 10
LOCK = "compiling.lock"
START_NS = 1_700_000_000_000_000_000


def is_warm() -> bool:
    """Whether what the live node runs is compiled already, or cannot be."""
    return is_cached(COMPILED.feed_one) and is_cached(COMPILED.rest_vehicle)


def exercise(estimator: Estimator) -> None:
    """Run once each function that the live node runs, so that it is loaded, or compiled and kept."""
    session = estimator.session()
    session.handle(session.channel("speed"), START_NS, START_NS, 1.0)
    estimator.rest(session.state, 0.0, 1.0)


def exercise_of(vehicle_file: str, surroundings_file: str = "") -> None:
    """The same for a vehicle, whose effects are compiled too."""
    exercise(Estimator(with_surroundings(load(vehicle_file), surroundings_file)))


class WarmUp:
    """Chooses the functions to begin with; `finished` gives the compiled ones once they are ready."""

    def __init__(self, vehicle_file: str, surroundings_file: str = "") -> None:
        self._files = vehicle_file, surroundings_file
        self._ready = threading.Event()
        self._process: subprocess.Popen[bytes] | None = None
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self.first: Entries = COMPILED
        if not is_warm():
            self.first = interpreted_entries()
            self._process = subprocess.Popen(
                [sys.executable, "-m", "trackres_ros.node.warm_up", *self._files],
                env=self._environment(),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
            self._thread = threading.Thread(target=self._wait, name="warm-up", daemon=True)
            self._thread.start()

    def _environment(self) -> dict[str, str]:
        """That of the compiling process: without a cache that can be used both meet in a folder of this run."""
        if code_folder() is not None:
            return dict(os.environ)
        try:
            self._folder = tempfile.TemporaryDirectory(prefix="trackres")
        except OSError:  # nowhere at all: then this process compiles once more by itself
            return dict(os.environ)
        keep_code_in(Path(self._folder.name))
        return {**os.environ, "NUMBA_CACHE_DIR": self._folder.name}

    @property
    def running(self) -> bool:
        """Whether it is still being compiled."""
        return self._process is not None and self._process.poll() is None

    def finished(self) -> Entries | None:
        """The compiled functions, once, when they are ready."""
        if not self._ready.is_set():
            return None
        self._ready.clear()
        return COMPILED

    def remarks(self, entries: Entries) -> list[Remark]:
        """That steps run in plain Python, if these entry points do and others are being compiled."""
        if entries is self.first and not entries.compiled and self.running:
            return [Remark("COMPILING", "steps run in plain Python until they are compiled")]
        return []

    def close(self) -> None:
        """End the compiling process if it still runs; what it has left is loaded to the end, as that cannot be broken off."""
        if self._process is None:
            return
        if self._process.poll() is None:
            self._process.terminate()
        self._thread.join()
        if self._folder is not None:
            self._folder.cleanup()

    def _wait(self) -> None:
        if self._process is not None and self._process.wait() == 0:
            exercise_of(*self._files)
            self._ready.set()


@contextmanager
def one_at_a_time() -> Iterator[None]:
    """Hold off other processes that would compile the same meanwhile, and find it done after; where no lock can be had, go on."""
    folder = code_folder()
    try:
        lock = (folder / LOCK).open("a") if folder else None
    except OSError:
        lock = None
    if lock is None:  # no cache to share
        yield
        return
    with lock:
        with suppress(OSError):  # of a file system that has none
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def main() -> None:
    """Compile for a vehicle file, and for one of its surroundings if given, as the other process."""
    os.nice(NICENESS)
    with one_at_a_time():
        exercise_of(*sys.argv[1:])


if __name__ == "__main__":
    main()
