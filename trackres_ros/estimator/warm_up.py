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
from trackres_ros.jit.compiled import code_folder, is_cached, keep_code_in
from trackres_ros.progress import tell
from trackres_ros.vehicle import AnyVehicle, load_any, with_surroundings

NICENESS = 10
LOCK = "compiling.lock"
START_NS = 1_700_000_000_000_000_000
MOST_IN_PYTHON = 50_000  # steps: about what plain Python makes while they are compiled
ANY_VEHICLE = "xgd24d"  # what is compiled is the same for all, but for their effects

LIVE, BLOCKS, SERIES = "live", "blocks", "series"


def exercise(estimator: Estimator) -> None:
    """Run once each function that the live node runs, so that it is loaded, or compiled and kept."""
    session = estimator.session()
    session.handle(session.channel("speed"), START_NS, START_NS, 1.0)
    estimator.rest(session.state, 0.0, 1.0)


def _replay_one(estimator: Estimator) -> None:
    session = estimator.session()
    stamps = np.array([START_NS])
    session.handle_block(np.array([session.channel("speed")], dtype=np.int16), stamps, stamps, np.ones(1))


def _run_one(estimator: Estimator) -> None:
    estimator.run(estimator.cold_start(estimator.inputs(1.0)), np.zeros(1), np.ones(1), 1.0, 0.0)


WORK: dict[str, tuple[Callable[[Estimator], None], tuple[Callable[..., object], ...]]] = {
    LIVE: (exercise, (COMPILED.feed_one, COMPILED.rest_vehicle)),
    BLOCKS: (_replay_one, (COMPILED.feed_many,)),
    SERIES: (_run_one, (COMPILED.run_series, COMPILED.start_belts)),
}
"""What a node, a replay and a simulation run, and which functions that needs."""


def is_warm(work: str) -> bool:
    """Whether what some work runs is compiled already, or cannot be."""
    return all(map(is_cached, WORK[work][1]))


def same_in_python(vehicle: AnyVehicle) -> bool:
    """Whether steps in plain Python give the same bits: our own effects are written so, which is not known of a user's."""
    ours = f"{__package__.split('.')[0]}."
    return all(type(active.effect).__module__.startswith(ours) for active in (*vehicle.effects, *vehicle.surroundings))


@contextmanager
def first_run(work: str, vehicle: AnyVehicle, steps: int = 0) -> Iterator[CompilerWarmUp]:
    """A warm-up for some work off line, which goes on for the next run where this one is through before.

    Parameters
    ----------
    work
        See `WORK`.
    vehicle
        What it is done with.
    steps
        How many there are of work that does not change over; with more than `MOST_IN_PYTHON` it waits for compiled ones.
    """
    warm_up = CompilerWarmUp(work, lasting=True, meanwhile=steps <= MOST_IN_PYTHON and same_in_python(vehicle))
    try:
        yield warm_up
    finally:
        warm_up.close()


class CompilerWarmUp:
    """Chooses the functions to begin with; `finished` gives the compiled ones once they are ready.

    Parameters
    ----------
    work
        Which are needed, see `WORK`.
    vehicle_file, surroundings_file
        Vehicle whose effects are compiled too.
    lasting
        Whether to go on compiling after `close`, for the next run.
    meanwhile
        Whether plain Python will do until then; else the work itself compiles, and waits.
    """

    def __init__(
        self,
        work: str,
        vehicle_file: str = ANY_VEHICLE,
        surroundings_file: str = "",
        lasting: bool = False,
        meanwhile: bool = True,
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
                [sys.executable, "-m", __name__, work, *self._files],
                env=self._environment(),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                start_new_session=self._lasting,
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

    def close(self) -> None:
        """End the compiling process if it still runs and is not to last; what it has left is loaded to the end, as that cannot
        be broken off.
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
    """Compile, as the other process, what some work runs, for a vehicle file and one of its surroundings; all work without."""
    os.nice(NICENESS)
    with one_at_a_time():
        for given in [sys.argv[1:]] if sys.argv[1:] else [[work, ANY_VEHICLE, ""] for work in WORK]:
            _exercise(*given)


if __name__ == "__main__":
    main()
