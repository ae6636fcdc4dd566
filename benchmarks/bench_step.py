# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""One step of four assemblies against one message to another process and back, and growth of memory."""

from __future__ import annotations

import json
import os
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from measuring import START_NS, at_most, child, uneven_loads

from trackres_ros.estimator import columns as at
from trackres_ros.estimator.entry_points import COMPILED
from trackres_ros.estimator.estimator import Estimator, Session
from trackres_ros.vehicle import load

STEPS = 5_000
STEPS_A_ROUND = 50  # between as many messages
LONG_RUN = 1_000_000
WARM_UP = 1_000
STEP_NS = 10_000_000

KINDS = ("handle", "step")
TARGETS = {
    **{f"compiled: {kind}, median over median round trip": at_most(1 / 10) for kind in KINDS},
    **{f"compiled: {kind}, p99 over median round trip": at_most(1 / 3) for kind in KINDS},
    **{f"compiled: {kind}, p99 over p99 round trip": at_most(1 / 3) for kind in KINDS},
    **{f"interpreted: {kind}, median over median round trip": at_most(1 / 10) for kind in KINDS},
    "a million messages: resident memory, growth [kB]": at_most(1024),
}


def _speed(n: int) -> float:
    return 10.0 + 0.01 * (n % 7)


def _session(estimator: Estimator) -> Session:
    session = estimator.session()
    for name, newton in zip(estimator.assemblies, uneven_loads(estimator), strict=True):
        session.handle(session.channel(f"load/{name}"), START_NS, START_NS, float(newton))
    return session


def steppers() -> dict[str, Callable[[int], None]]:
    """Takes the n-th speed: through `Session.handle`, with its guards, and by `Estimator.step`."""
    estimator = Estimator(load("xgd24d"))
    session = _session(estimator)
    loads = uneven_loads(estimator)
    state = estimator.cold_start(estimator.inputs(_speed(0), load=loads, ambient=15.0))
    inputs = [estimator.inputs(_speed(n), load=loads, ambient=15.0) for n in range(7)]

    def handle(n: int) -> None:
        stamp = START_NS + n * STEP_NS
        if session.handle(at.SPEED, stamp, stamp, _speed(n)) is None:
            raise RuntimeError("a speed was not accepted")

    def step(n: int) -> None:
        nonlocal state
        state, _ = estimator.step(state, inputs[n % 7], 0.01)

    return {"handle": handle, "step": step}


def measure(steps: int) -> dict[str, float]:
    """Ratios of steps to round trips in this process; empty where the middleware is missing."""
    try:
        from dds_echo import Echo
    except ImportError:
        return {}
    rivals = steppers()
    times: dict[str, list[float]] = {kind: [] for kind in (*rivals, "round trip")}
    with Echo() as echo:
        for n in range(1, min(WARM_UP, steps) + 1):
            for rival in rivals.values():
                rival(n)
            echo.round_trip(float(n))
        for begin in range(0, steps, STEPS_A_ROUND):
            rounds = range(WARM_UP + begin + 1, WARM_UP + begin + min(STEPS_A_ROUND, steps - begin) + 1)
            for kind, rival in rivals.items():
                for n in rounds:
                    before = time.perf_counter()
                    rival(n)
                    times[kind].append(time.perf_counter() - before)
            times["round trip"].extend(echo.round_trip(float(n)) for n in rounds)
    quantiles = {kind: np.percentile(values, [50.0, 99.0]) * 1e6 for kind, values in times.items()}
    trip, slow_trip = quantiles.pop("round trip")
    result = {"round trip, median [us]": trip, "round trip, p99 [us]": slow_trip}
    for kind, (median, slow) in quantiles.items():
        result[f"{kind}, median [us]"] = median
        result[f"{kind}, p99 [us]"] = slow
        result[f"{kind}, median over median round trip"] = median / trip
        result[f"{kind}, p99 over median round trip"] = slow / trip
        result[f"{kind}, p99 over p99 round trip"] = slow / slow_trip
    return {name: float(value) for name, value in result.items()}


def growth(messages: int) -> dict[str, float]:
    """Growth of this process's resident memory over many messages [kB], after a tenth of them."""
    estimator = Estimator(load("xgd24d"))
    session = _session(estimator)

    def feed(first: int, count: int) -> None:
        for n in range(first, first + count):
            stamp = START_NS + n * STEP_NS
            session.handle(at.SPEED, stamp, stamp, _speed(n))

    feed(1, max(messages // 10, WARM_UP))
    before = resident_kb()
    feed(1 + max(messages // 10, WARM_UP), messages)
    return {"resident": resident_kb() - before}


def resident_kb() -> float:
    """Resident memory of this process now [kB]; the kernel's file for it is Linux's own."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1024.0


def run(steps: int = STEPS, messages: int = LONG_RUN) -> dict[str, float]:
    """Measure steps against as many messages there and back, and growth over `messages`, each in a process of its own.

    Without `cyclonedds` there are no rows that compare.
    """
    result: dict[str, float] = {}
    kinds = {"compiled": {}, "interpreted": {"TRACKRES_INTERPRETED": "1"}} if COMPILED.compiled else {"interpreted": {}}
    for kind, environment in kinds.items():
        measured = child([__file__, "measure", str(steps)], environment).json()
        if not measured:
            print("cyclonedds is not installed: no round trip to compare a step with (pip install cyclonedds)", file=sys.stderr)
            break
        result |= {f"{kind}: {name}": value for name, value in measured.items()}
    grown = child([__file__, "growth", str(messages)]).json()
    result["a million messages: resident memory, growth [kB]"] = grown["resident"]
    return result


if __name__ == "__main__":  # one of the processes that `run` starts
    print(json.dumps({"measure": measure, "growth": growth}[sys.argv[1]](int(sys.argv[2]))), flush=True)
    os._exit(0)  # the middleware's threads need no goodbye
