# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the benchmarks share: targets, alternated timing, and child processes with their peak memory."""

from __future__ import annotations

import json
import os
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


@dataclass(frozen=True)
class Target:
    """A limit on a measured number, at most or at least."""

    limit: float
    at_most: bool = True

    def met(self, value: float) -> bool:
        """Whether a measured number keeps the limit."""
        return value <= self.limit if self.at_most else value >= self.limit

    def __str__(self) -> str:
        return f"{'at most' if self.at_most else 'at least'} {self.limit:,g}"


def at_most(limit: float) -> Target:
    """Target of a number that should be small."""
    return Target(limit)


def at_least(limit: float) -> Target:
    """Target of a number that should be large."""
    return Target(limit, at_most=False)


def uneven_loads(estimator: Estimator) -> NDArray[np.float64]:
    """Loads [N], shape (assemblies,), about the nominal ones: no assembly is like another, so each is computed."""
    return np.asarray(estimator.vehicle.nominal_loads() * np.resize(UNEVEN, len(estimator.assemblies)))


def seconds(run: Callable[[], object]) -> float:
    """Wall time of one call [s]."""
    begin = time.perf_counter()
    run()
    return time.perf_counter() - begin


def alternated(runs: Mapping[str, Callable[[], object]], repeats: int) -> dict[str, list[float]]:
    """Wall times [s] of several rivals, one after the other in each of `repeats` rounds, so that all meet the same machine."""
    times: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(repeats):
        for name, run in runs.items():
            times[name].append(seconds(run))
    return times


def median_ratio(over: Sequence[float], under: Sequence[float]) -> float:
    """Median of the ratios of times that belong to the same round."""
    return statistics.median(a / b for a, b in zip(over, under, strict=True))


RELAY = """
import os, sys, time
begin = time.perf_counter()
_, status, usage = os.wait4(os.posix_spawn(sys.argv[2], sys.argv[2:], os.environ), 0)
os.write(int(sys.argv[1]), f"{time.perf_counter() - begin} {usage.ru_maxrss} {usage.ru_utime + usage.ru_stime}".encode())
sys.exit(os.waitstatus_to_exitcode(status))
"""
"""Starts a program and waits for it. A program takes over the peak of memory of the process it was started from, so that one has
to be a small one."""


@dataclass(frozen=True)
class Ended:
    """What a child process left: its output, its wall time, its peak resident memory and its processor time."""

    output: str
    wall_s: float
    peak_bytes: int
    processor_s: float

    def json(self) -> Any:
        """Return the last line of the output, read as JSON."""
        return json.loads(self.output.strip().splitlines()[-1])


def child(arguments: Sequence[str], environment: Mapping[str, str] | None = None) -> Ended:
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
            command, env=variables, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, pass_fds=[sent], check=False
        )
        os.close(sent)
        wall_s, peak, processor_s = map(float, usage.read().split())
    if done.returncode:
        raise RuntimeError(f"{' '.join(arguments)}: exit code {done.returncode}\n{done.stdout}")
    return Ended(done.stdout, wall_s, int(peak) * (1 if sys.platform == "darwin" else 1024), processor_s)
