# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the processes of all proofs share: labels sealed before the first recording is written, and all cores on the cases.

`python -m proofs.processes sealed.blind.main CASES RESULTS` calls a function of this room.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from importlib import import_module
from inspect import signature
from multiprocessing import active_children
from pathlib import Path
from typing import Any, TypeVar, get_args

from trackres_ros.errors import InputError
from trackres_ros.files.file_sets import file_set
from trackres_ros.files.interpreter import python
from trackres_ros.files.own_files import write

Task = TypeVar("Task")
Result = TypeVar("Result")


def digest(hidden: object) -> str:
    """SHA-256 of what is hidden, as JSON."""
    return hashlib.sha256(json.dumps(hidden, sort_keys=True).encode()).hexdigest()


def write_sealed(folder: Path, what: str, hidden: object, labels: Mapping[str, Any]) -> None:
    """Print the seal of what is hidden, and write it and the labels, which have that and more."""
    (folder / "sealed").mkdir(parents=True, exist_ok=True)
    seal = digest(hidden)
    print(f"sealed: {what}, SHA-256 {seal}", flush=True)
    (folder / "seal.txt").write_text(seal + "\n", encoding="utf-8")
    (folder / "sealed" / "labels.json").write_text(json.dumps(labels, indent=1), encoding="utf-8")


def read_labels(folder: Path) -> dict[str, Any]:
    """The labels of a run."""
    return dict(read_json(folder / "sealed" / "labels.json"))


def check_seal(folder: Path, hidden: object, remedy: str = "begin anew") -> str:
    """The seal of what is hidden, as the labels have it. Raises InputError if another one was written."""
    seal = digest(hidden)
    if seal != (folder / "seal.txt").read_text(encoding="utf-8").strip():
        raise InputError(str(folder / "sealed"), "labels that are not those that were sealed", "the labels as drawn", remedy)
    return seal


def write_scores(folder: Path, scores: Mapping[str, Any], page: str, text: str) -> None:
    """Write the scores and the page about them, and print the page."""
    with file_set():
        write(folder / "scores.json", json.dumps(scores, indent=1).encode())
        write(folder / page, text.encode())
    print(text)


def read_json(path: Path) -> Any:
    """Content of a JSON file."""
    return json.loads(path.read_text(encoding="utf-8"))


@contextmanager
def workers() -> Iterator[ProcessPoolExecutor]:
    """One process a core. An error or an interrupt ends them at once: a pool interrupted while it starts waits for ever."""
    pool = ProcessPoolExecutor(os.cpu_count())
    try:
        yield pool
    except BaseException:
        for process in active_children():
            process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def each(work: Callable[[Task], Result], tasks: Sequence[Task], done: str = "") -> list[Result]:
    """Results of independent tasks, in their order, by one process a core; `done` is printed with number and time left."""
    began = time.monotonic()
    with workers() as pool:
        results = [pool.submit(work, task) for task in tasks]
        for count, result in enumerate(as_completed(results), start=1):
            result.result()
            if done:
                left = (time.monotonic() - began) / count * (len(tasks) - count)
                show_count(done, count, len(tasks), f", {left / 60.0:.0f} min to go")
    return [result.result() for result in results]


def show_count(what: str, done: int, total: int, rest: str = "") -> None:
    """Print how many are done: on one line that changes in a terminal, else a line for each tenth of all."""
    line, last = f"{what} {done} of {total}{rest}", done >= total
    if sys.stdout.isatty():
        print(f"\r{line}   ", end="\n" if last else "", flush=True)
    elif last or done * 10 // total > (done - 1) * 10 // total:
        print(line, flush=True)


def run_command(*words: str | Path) -> None:
    """Run a command of `trackres`; RuntimeError with what it printed if it fails."""
    done = subprocess.run(**python("trackres_ros", *words), check=False, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"trackres {' '.join(map(str, words))} ended with {done.returncode}: {done.stderr}")


def unfinished(cases: Path, results: Path, first: int | None = None, suffix: str = ".json") -> list[Path]:
    """Folders of cases without a result yet; with `first` of so many, in the order of their random names."""
    results.mkdir(parents=True, exist_ok=True)
    return [case for case in sorted(cases.glob("*"))[:first] if not (results / f"{case.name}{suffix}").exists()]


def call(name: str, *words: str) -> None:
    """Call a function of this room, by module and name, with words as the types of its parameters."""
    module, _, function = name.rpartition(".")
    called = getattr(import_module(f"{__spec__.parent}.{module}"), function)
    kinds = [next(iter(get_args(p.annotation)), p.annotation) for p in signature(called, eval_str=True).parameters.values()]
    called(*(kinds[min(i, len(kinds) - 1)](word) for i, word in enumerate(words)))


if __name__ == "__main__":
    try:
        call(*sys.argv[1:])
    except InputError as refused:
        sys.exit(f"trackres: error: {refused}")
