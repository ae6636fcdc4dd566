# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The first run on a machine: steps run in plain Python while another process compiles them, and then change over."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from trackres_ros.estimator.entry_points import COMPILED, Entries, interpreted_entries
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.files.interpreter import python
from trackres_ros.jit.compiled import code_folder, is_cached, keep_code_in
from trackres_ros.progress import tell
from trackres_ros.vehicle import AnyVehicle, load_any, with_surroundings

NICENESS = 10
LOCK = "compiling.lock"
START_NS = 1_700_000_000_000_000_000
MOST_IN_PYTHON = 50_000  # steps: about as many as plain Python makes during compilation
ANY_VEHICLE = "xgd24d"  # compiled code is shared by all, except for effects

MESSAGES, SERIES = "messages", "series"


def exercise(estimator: Estimator) -> None:
    """Run every function for messages once, so that it is loaded, or compiled and cached."""
    session = estimator.session()
    session.handle(session.channel("speed"), START_NS, START_NS, 1.0)
    estimator.rest(session.state, 0.0, 1.0)


def _run_one(estimator: Estimator) -> None:
    estimator.run(estimator.cold_start(estimator.inputs(1.0)), np.zeros(1), np.ones(1), 1.0, 0.0)


WORK: dict[str, tuple[Callable[[Estimator], None], tuple[Callable[..., object], ...]]] = {
    MESSAGES: (exercise, (COMPILED.feed, COMPILED.rest_vehicle)),
    SERIES: (_run_one, (COMPILED.run_series, COMPILED.start_belts)),
}
"""Functions that messages need, live and from a recording, and those of a simulation."""


def is_warm(work: str) -> bool:
    """Whether the functions for some work are compiled already, or cannot be."""
    return all(map(is_cached, WORK[work][1]))


def same_in_python(vehicle: AnyVehicle) -> bool:
    """Whether steps in plain Python give the same bits: true of our own effects, unknown for a user's."""
    ours = f"{__package__.split('.')[0]}."
    return all(type(active.effect).__module__.startswith(ours) for active in (*vehicle.effects, *vehicle.surroundings))


@contextmanager
def first_run(work: str, vehicle: AnyVehicle, steps: int = 0) -> Iterator[CompilerWarmUp]:
    """Warm-up for some `WORK` offline; it goes on for the next run if this one ends earlier.

    Work that does not change over gives its number of steps: above `MOST_IN_PYTHON` it waits for compiled functions.
    """
    warm_up = CompilerWarmUp(work, lasting=True, meanwhile=steps <= MOST_IN_PYTHON and same_in_python(vehicle))
    try:
        yield warm_up
    finally:
        warm_up.close()


class CompilerWarmUp:
    """Chooses the initial functions for some `WORK`; `finished` gives the compiled ones once they are ready."""

    def __init__(
        self,
        work: str,
        vehicle_file: str = ANY_VEHICLE,  # whose effects are compiled too
        surroundings_file: str = "",
        lasting: bool = False,  # whether to continue compiling after `close`, for the next run
        meanwhile: bool = True,  # whether to use plain Python until then; else the work itself compiles, and waits
    ) -> None:
        self._work, self._files = work, (vehicle_file, surroundings_file)
        self._ready = threading.Event()
        self._process: subprocess.Popen[bytes] | None = None
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._lasting = lasting and code_folder() is not None
        self.first: Entries = COMPILED
        if meanwhile and not is_warm(work):
            self.first = interpreted_entries()
            tell("in plain Python, while it is compiled, once")
            self._process = subprocess.Popen(
                **python(__name__, work, *self._files, **self._cache()),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                start_new_session=self._lasting,
            )
            self._thread = threading.Thread(target=self._wait, name="warm-up", daemon=True)
            self._thread.start()

    def _cache(self) -> dict[str, str]:
        """Variable with the cache of the compiling process: if none is usable, both processes share a folder of this run."""
        if code_folder() is not None:
            return {}
        try:
            self._folder = tempfile.TemporaryDirectory(prefix="trackres")
        except OSError:  # nowhere at all: then this process compiles again
            return {}
        keep_code_in(Path(self._folder.name))
        return {"NUMBA_CACHE_DIR": self._folder.name}

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

    def close(self) -> None:
        """End the compiling process if it still runs and may not outlast this one; finish loading its results, as loading
        cannot be interrupted.
        """
        if self._process is None:
            return
        if self._process.poll() is None:
            if self._lasting:
                return
            self._process.terminate()
        self._thread.join()
        if self._folder is not None:
            self._folder.cleanup()

    def _wait(self) -> None:
        if self._process is not None and self._process.wait() == 0:
            _exercise(self._work, *self._files)
            self._ready.set()


def _exercise(work: str, vehicle_file: str, surroundings_file: str) -> None:
    WORK[work][0](Estimator(with_surroundings(load_any(vehicle_file), surroundings_file)))


@contextmanager
def one_at_a_time() -> Iterator[None]:
    """Keep other processes from compiling the same functions meanwhile; go on if no lock is available."""
    folder = code_folder()
    try:
        lock = (folder / LOCK).open("a") if folder else None
    except OSError:
        lock = None
    if lock is None:  # no cache to share
        yield
        return
    with lock:
        with suppress(OSError):  # of a file system without locks
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def main() -> None:
    """Compile, in a separate process, the functions for some work, for a vehicle file with its surroundings, or for all work."""
    os.nice(NICENESS)
    with one_at_a_time():
        for given in [sys.argv[1:]] if sys.argv[1:] else [[work, ANY_VEHICLE, ""] for work in WORK]:
            _exercise(*given)


if __name__ == "__main__":
    main()
