# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the benchmarks share: rows of the page, alternated timing, and child processes with their peak memory."""

from __future__ import annotations

import json
import math
import os
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from trackres_ros.estimator.estimator import Estimator

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
START_NS = 1_700_000_000_000_000_000
UNEVEN = (0.97, 1.03, 0.99, 1.01)  # of the nominal loads
INSTALLED = Path(sys.executable).with_name("trackres")
COMMAND = [str(INSTALLED)] if INSTALLED.exists() else ["-m", "trackres_ros"]  # as a user types it


@dataclass(frozen=True)
class Row:
    """A line of the page: what was measured, and its rival's number in the same unit. The target is the most that the ratio may
    be, or without a rival the measured number.
    """

    name: str
    measured: float
    rival: float | None = None
    target: float | None = None
    ratio: float | None = None

    @property
    def missed(self) -> bool:
        """Whether the target is exceeded."""
        judged = self.measured if self.rival is None else self.ratio
        return self.target is not None and judged is not None and judged > self.target


def alone(name: str, measured: float, target: float | None = None) -> Row:
    """A number without a rival."""
    return Row(name, measured, None, target)


def compared(name: str, ours: Sequence[float], theirs: Sequence[float], target: float | None = None, unit: float = 1.0) -> Row:
    """Medians of ours and of a rival's, times a unit, and the median of their ratios, one a round."""
    return Row(name, unit * statistics.median(ours), unit * statistics.median(theirs), target, median_ratio(ours, theirs))


def uneven_loads(estimator: Estimator) -> NDArray[np.float64]:
    """Loads [N], shape (assemblies,), about the nominal ones: no assembly is like another, so each is computed."""
    return np.asarray(estimator.vehicle.nominal_loads() * np.resize(UNEVEN, len(estimator.assemblies)))


def seconds(run: Callable[..., object], *given: object) -> float:
    """Wall time of one call [s]."""
    begin = time.perf_counter()
    run(*given)
    return time.perf_counter() - begin


def alternated(runs: Mapping[str, Callable[[], object]], repeats: int) -> dict[str, list[float]]:
    """Wall times [s] of several rivals, one after the other in each of `repeats` rounds, so that all meet the same machine."""
    times: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(repeats):
        for name, run in runs.items():
            times[name].append(seconds(run))
    return times


def median_ratio(over: Sequence[float], under: Sequence[float]) -> float:
    """Median of the ratios of numbers that belong to the same round."""
    return statistics.median(a / b if b else math.inf for a, b in zip(over, under, strict=True))


RELAY = """
import os, sys, time
begin = time.perf_counter()
_, status, usage = os.wait4(os.posix_spawn(sys.argv[2], sys.argv[2:], os.environ), 0)
os.write(int(sys.argv[1]), f"{time.perf_counter() - begin} {usage.ru_maxrss}".encode())
sys.exit(os.waitstatus_to_exitcode(status))
"""
"""Starts a program and waits for it. A program takes over the peak of memory of the process it was started from, so that one has
to be a small one."""


@dataclass(frozen=True)
class Ended:
    """What a child process left: its output, its wall time and its peak resident memory."""

    output: str
    wall_s: float
    peak_bytes: int

    def json(self) -> Any:
        """Return the last line of the output, read as JSON."""
        return json.loads(self.output.strip().splitlines()[-1])


def child(arguments: Sequence[str], environment: Mapping[str, str] | None = None, cwd: Path | None = None) -> Ended:
    """Run this Python with arguments and wait for it.

    Raises
    ------
    RuntimeError
        If it fails; with what it said.
    """
    paths = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    variables = {**os.environ, "PYTHONPATH": paths, **(environment or {})}
    received, sent = os.pipe()
    with os.fdopen(received) as usage:
        command = [sys.executable, "-S", "-c", RELAY, str(sent), sys.executable, *arguments]
        done = subprocess.run(
            command, env=variables, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, pass_fds=[sent], check=False,
            cwd=cwd,
        )  # fmt: skip
        os.close(sent)
        wall_s, peak = map(float, usage.read().split())
    if done.returncode:
        raise RuntimeError(f"{' '.join(arguments)}: exit code {done.returncode}\n{done.stdout}")
    return Ended(done.stdout, wall_s, int(peak) * (1 if sys.platform == "darwin" else 1024))


def trackres(*words: object, home: Path | None = None, cwd: Path | None = None, **environment: str) -> Ended:
    """Run the command as a user types it, where asked with a home of its own."""
    return child([*COMMAND, *map(str, words)], {**of_home(home), **environment}, cwd)


def of_home(home: Path | None) -> dict[str, str]:
    """The environment of a user with this home."""
    if home is None:
        return {}
    home.mkdir(exist_ok=True)
    return {"HOME": str(home), **{f"XDG_{kind}_HOME": str(home / kind.lower()) for kind in ("CACHE", "CONFIG", "DATA", "STATE")}}


def c_compiler() -> str | None:
    """The C compiler of this machine."""
    return shutil.which("cc")
