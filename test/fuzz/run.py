# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Fuzz the readers: `python test/fuzz/run.py --count 5000` prints a table, `--json` the counts.

The mutations are read in a process of their own, which is watched: one that hangs is ended and counted, one that takes too
much memory or dies is counted, and a new process goes on with the next mutation.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import selectors
import subprocess
import sys
import tempfile
import warnings
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

HANG_S = 60.0  # a reader ends by itself after 10 s of processor time
MOST_BYTES = 10**9
LIMIT_BYTES = 4 * 10**9
"""Of the address space; so much would be taken by what goes far beyond `MOST_BYTES`, and not by libraries that are loaded."""
START_S = 120.0  # to load what reads, and to write the files
OUTCOMES = ("refused", "remarks", "alike", "traceback", "hang", "memory", "lost")
HEADINGS = {
    "refused": "refused",
    "remarks": "read with remarks",
    "alike": "read alike",
    "traceback": "traceback",
    "hang": "hang over 60 s",
    "memory": "over 1 GB",
    "lost": "rows lost without a word",
}
FAULTS = ("traceback", "hang", "memory", "lost")


@dataclass
class Result:
    """Outcomes of the mutations of a format: counts by outcome, and the first of every fault."""

    outcomes: Counter[str] = field(default_factory=Counter)
    faults: list[dict[str, Any]] = field(default_factory=list)

    def add(self, number: int, outcome: str, text: str) -> None:
        """Count one."""
        self.outcomes[outcome] += 1
        if outcome in FAULTS:
            self.faults.append({"number": number, "outcome": outcome, "text": text})


def peak_bytes() -> int:
    """The most memory this process had; in `ru_maxrss` a program takes over the peak of the process it was started from."""
    status = Path("/proc/self/status").read_text()
    return 1024 * int(status.split("VmHWM:")[1].split()[0])


def work(name: str, count: int, seed: int, start: int) -> None:
    """Read the mutations of a format, one line of JSON before and after each; in the process that is watched."""
    warnings.simplefilter("error")
    resource.setrlimit(resource.RLIMIT_AS, (LIMIT_BYTES, LIMIT_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    from formats import FORMATS, damaged, outcome_of

    with tempfile.TemporaryDirectory() as folder:
        for number, one in enumerate(damaged(FORMATS[name], Path(folder), count, seed, start), start):
            print(json.dumps({"begin": number}), flush=True)
            report = outcome_of(one)
            if peak_bytes() > MOST_BYTES:
                report["outcome"] = "memory"
            print(json.dumps({"number": number, **report}), flush=True)
            if report["outcome"] == "memory":
                return  # the peak would be that of all later ones


def lines(process: subprocess.Popen[bytes]) -> Iterator[dict[str, Any] | None]:
    """Yield a worker's messages; None after a silence that is too long."""
    assert process.stdout is not None
    with selectors.DefaultSelector() as selector:
        selector.register(process.stdout, selectors.EVENT_READ)
        wait_s, rest = START_S, b""
        while selector.select(wait_s):
            data = os.read(process.stdout.fileno(), 2**16)
            if not data:
                return
            *whole, rest = (rest + data).split(b"\n")
            for line in whole:
                yield json.loads(line)
            wait_s = HANG_S
    yield None


def fuzzed(name: str, count: int, seed: int, script: Path = Path(__file__)) -> Result:
    """Read `count` mutations of a format, by processes of a script."""
    result = Result()
    next_number = 0
    while next_number < count:
        command = [sys.executable, str(script), "--worker", name, "--count", str(count), "--seed", str(seed)]
        begun, hung = next_number, False
        with subprocess.Popen([*command, "--start", str(next_number)], stdout=subprocess.PIPE) as process:
            try:
                for report in lines(process):
                    if report is None:
                        hung = True
                    elif "begin" in report:
                        begun = report["begin"]
                    else:
                        result.add(report["number"], report["outcome"], report["text"])
                        next_number = report["number"] + 1
            finally:
                process.kill()  # it has ended, or hangs
                status = process.wait()
        if next_number < count and (hung or next_number == begun):
            result.add(begun, "hang" if hung else "traceback", f"the process ended with status {status}")
            next_number = begun + 1
    return result


def table(results: dict[str, Result]) -> str:
    """The counts as a Markdown table."""
    rows = [["format", "mutations", *(HEADINGS[outcome] for outcome in OUTCOMES)]]
    rows.append(["---", *["--:"] * (len(rows[0]) - 1)])
    for name, result in results.items():
        counts = [result.outcomes.total(), *(result.outcomes[outcome] for outcome in OUTCOMES)]
        rows.append([name, *map(str, counts)])
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def main() -> int:
    """Run; exit code 1 if there is any fault."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=300, help="mutations a format")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--format", action="append", dest="formats", help="only this format; may be given several times")
    parser.add_argument("--json", action="store_true", dest="as_json", help="print the counts and all faults as JSON")
    parser.add_argument("--worker", help=argparse.SUPPRESS)
    parser.add_argument("--start", type=int, default=0, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.worker:
        work(given.worker, given.count, given.seed, given.start)
        return 0
    from formats import FORMATS

    results = {name: fuzzed(name, given.count, given.seed) for name in given.formats or FORMATS}
    if given.as_json:
        print(json.dumps({name: {**one.outcomes, "faults": one.faults} for name, one in results.items()}, indent=2))
    else:
        print(table(results))
    return int(any(one.faults for one in results.values()))


if __name__ == "__main__":
    sys.exit(main())
