# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs a sealed proof: draws cases, seals their labels, records them, has them answered blind, opens the seal and scores.

Each stage is a process: `python -m proofs.pipeline pipeline.answer sealed.diagnosing.answer CASES RESULTS` calls a function of
`proofs`. The one that answers gets the recordings and no path to the labels. The folder of a run has:

- settings.json: what is drawn; a run with the same settings continues where it stopped.
- sealed/labels.json and seal.txt: the labels and their SHA-256; sealed/ also has the truth that only the score needs.
- cases/NAME: recordings, and the vehicle file.
- results/NAME.json: the answer, with arrays in NAME.npz.
- scores.json, and tables (CSV) or a page.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager, suppress
from dataclasses import asdict
from functools import partial
from importlib import import_module
from inspect import signature
from multiprocessing import active_children
from pathlib import Path
from typing import Any, TypeVar, get_args

import click
import numpy as np

from trackres_ros.arrays import Array
from trackres_ros.errors import InputError
from trackres_ros.files.file_sets import file_set
from trackres_ros.files.interpreter import python
from trackres_ros.files.own_files import write
from trackres_ros.tasks.terminal import output_folder

Task = TypeVar("Task")
Result = TypeVar("Result")
Answer = tuple[Mapping[str, Any], Mapping[str, Array]]
"""An answer to a case: JSON, and arrays."""
Step = tuple[object, ...]
"""A function of `proofs`, and its arguments."""

PROOFS = {
    "own": "sealed.own.OwnProof",
    "second": "sealed.second.SecondProof",
    "groomer": "sealed.second.GroomerProof",
    "learning": "learning.LearningProof",
    "delay": "delay.DelayProof",
    "fleet": "fleet.FleetProof",
}
FOLDERS = ("cases", "results", "results_earlier", "next", "results_next", "sealed")
SETTINGS = "settings.json"


class Proof(ABC):
    """What differs from proof to proof; `folder` and `settings` are those of a run."""

    noun = "cases"
    key = "cases"  # of the labels in labels.json
    label_settings: tuple[str, ...] = ("seed",)  # that labels.json has too
    page = ""  # file of the page; empty if the results are tables

    def __init__(self, folder: Path, settings: Mapping[str, Any]) -> None:
        self.folder, self.settings = folder, settings

    @abstractmethod
    def draw(self) -> Sequence[Any]:
        """All cases of the seed. Each has a `name` that says nothing."""

    def labels(self, cases: Sequence[Any]) -> str:
        """Content of labels.json."""
        settings = {name: self.settings[name] for name in self.label_settings}
        return json.dumps({**settings, self.key: [asdict(case) for case in cases]}, indent=1)

    def seal(self, labels: str) -> str:
        """SHA-256 of the content of labels.json."""
        return digest(json.loads(labels))

    def record(self, case: Any) -> None:
        """Write into cases/NAME what the answer may use, and into sealed/ what the score needs."""
        raise NotImplementedError

    def record_all(self, cases: Sequence[Any]) -> None:
        """Record all cases that are not yet recorded."""
        each(self._record, [case for case in cases if not self._mark(case).exists()], "recorded")

    def _record(self, case: Any) -> None:
        self.record(case)
        self._mark(case).touch()

    def _mark(self, case: Any) -> Path:
        return self.folder / "sealed" / f"{case.name}.recorded"

    @abstractmethod
    def cases(self, labels: Mapping[str, Any]) -> Sequence[Any]:
        """The cases, from their labels."""

    def choice(self, cases: Sequence[Any], first: int | None) -> Sequence[Any]:
        """So many cases in the order of their names; without a number all as drawn."""
        return cases if first is None else sorted(cases, key=lambda case: case.name)[:first]

    @abstractmethod
    def scores(self, cases: Sequence[Any]) -> list[Any]:
        """Scores of the answers to the cases."""

    @abstractmethod
    def report(self, scores: list[Any], labels: Mapping[str, Any], seal: str) -> tuple[Mapping[str, Any], str]:
        """Content of scores.json, and the page, or a text for the terminal; writes pictures and tables."""

    def result(self, name: str, results: str = "results") -> Any:
        """JSON of the answer to a case."""
        return read_json(self.folder / results / f"{name}.json")


def prove(
    name: str, folder: Path, settings: Mapping[str, Any], *steps: Step, first: int | None = None, fresh: bool = False,
    as_json: bool = False,
) -> None:  # fmt: skip
    """Draw, run the steps in between, and score, each in a process of its own; print the scores if `as_json`.

    `first`: number of cases. `fresh`: remove the results of the folder. InputError if it has those of other settings.
    """
    begin(name, folder, settings, fresh)
    for step in (("pipeline.draw", folder, first), *steps, ("pipeline.score", folder, first)):
        run_step(step, as_json)
    if as_json:
        click.echo((folder / "scores.json").read_text(encoding="utf-8"))


def begin(name: str, folder: Path, settings: Mapping[str, Any], fresh: bool = False) -> None:
    """Make the folder of a run, and note its settings; InputError if it holds another run."""
    file, text = output_folder(folder) / SETTINGS, json.dumps({"proof": name, **settings}, indent=1)
    if fresh and file.exists():
        for part in FOLDERS:
            shutil.rmtree(folder / part, ignore_errors=True)
    same = file.exists() and file.read_text(encoding="utf-8") == text
    if not same and any((folder / part).exists() for part in FOLDERS):
        raise InputError("-o", str(folder), "an empty folder, or one of a run with the same options")
    file.write_text(text, encoding="utf-8")


def run_step(step: Step, as_json: bool = False) -> None:
    """Run a step in a process of its own; an argument that is None is left out."""
    # Every core works on a case of its own: threads within a case would only compete for cores.
    alone = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    words = [str(word) for word in step if word is not None]
    run_process(words[0].rpartition(".")[2], **python("proofs.pipeline", *words, **alone), stdout=sys.stderr if as_json else None)


def run_process(name: str, **how: Any) -> None:
    """Run a process that ends with this one, and all that it starts too.

    `name`: for messages; `how`: for `subprocess.Popen`.
    """
    running = subprocess.Popen(**how, process_group=0)
    result_before = signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    try:
        code = running.wait()
    except BaseException:
        with suppress(ProcessLookupError):
            os.killpg(running.pid, signal.SIGTERM)
        running.wait()
        raise
    finally:
        signal.signal(signal.SIGTERM, result_before)
    if code:
        raise click.ClickException(f"{name} ended with exit code {code}; finished results are kept")


def proof_of(folder: Path) -> Proof:
    """The proof whose run is in a folder."""
    settings = read_json(folder / SETTINGS)
    proof: Proof = _member(PROOFS[settings["proof"]])(folder, settings)
    return proof


def draw(folder: Path, first: int | None = None) -> None:
    """Draw the cases, print and write their seal, and record all, or the first."""
    proof = proof_of(folder)
    (folder / "sealed").mkdir(exist_ok=True)
    cases = proof.draw()
    labels = proof.labels(cases)
    seal = proof.seal(labels)
    print(f"sealed: {len(json.loads(labels)[proof.key])} {proof.noun}, SHA-256 {seal}", flush=True)
    (folder / "seal.txt").write_text(seal + "\n", encoding="utf-8")
    (folder / "sealed" / "labels.json").write_text(labels, encoding="utf-8", newline="")
    proof.record_all(proof.choice(cases, first))


def answer(function: str, cases: Path, results: Path, first: int | None = None) -> None:
    """Answer all cases without a result yet, or those of the first; the function of `proofs` gets the folder of a case only."""
    answer_all(_member(function), cases, results, first)


def answer_all(function: Callable[[Path], Answer], cases: Path, results: Path, first: int | None = None) -> None:
    """See `answer`."""
    results.mkdir(parents=True, exist_ok=True)
    folders = sorted(cases.glob("*"))[:first]
    missing = [folder for folder in folders if not (results / f"{folder.name}.json").exists()]
    each(partial(_answer, function, results), missing, "answered")


def _answer(function: Callable[[Path], Answer], results: Path, folder: Path) -> None:
    content, arrays = function(folder)
    if arrays:
        np.savez_compressed(results / f"{folder.name}.npz", **dict[str, Any](arrays))
    write(results / f"{folder.name}.json", json.dumps(content).encode())


def unseal(folder: Path) -> tuple[Proof, dict[str, Any], str]:
    """The proof of a run, its labels, and their seal. InputError if other labels were sealed."""
    proof, text = proof_of(folder), (folder / "sealed" / "labels.json").read_bytes().decode()
    seal = proof.seal(text)
    if seal != (folder / "seal.txt").read_text(encoding="utf-8").strip():
        place = str(folder / "sealed")
        raise InputError(place, "labels that are not those that were sealed", "the labels as drawn", "begin anew")
    return proof, json.loads(text), seal


def score(folder: Path, first: int | None = None) -> None:
    """Open the seal, score all answers, or the first, and write scores, and tables or a page."""
    proof, labels, seal = unseal(folder)
    scores = proof.scores(proof.choice(proof.cases(labels), first))
    with file_set():
        content, text = proof.report(scores, labels, seal)
        write(folder / "scores.json", json.dumps(content, indent=1).encode())
        if proof.page:
            write(folder / proof.page, text.encode())
    print(text)


def digest(labels: object) -> str:
    """SHA-256 of labels, as JSON with sorted keys."""
    return hashlib.sha256(json.dumps(labels, sort_keys=True).encode()).hexdigest()


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
                remainder = (time.monotonic() - began) / count * (len(tasks) - count)
                show_count(done, count, len(tasks), f", {remainder / 60.0:.0f} min to go")
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
    process = subprocess.run(**python("trackres_ros", *words), check=False, capture_output=True, text=True)
    if process.returncode:
        raise RuntimeError(f"trackres {' '.join(map(str, words))} ended with {process.returncode}: {process.stderr}")


def _member(name: str) -> Any:
    """A function or class of `proofs`, by module and name."""
    module, _, member = name.rpartition(".")
    return getattr(import_module(f"proofs.{module}"), member)


def call(name: str, *words: str) -> None:
    """Call a function of `proofs` with words as the types of its parameters."""
    function = _member(name)
    kinds = [next(iter(get_args(p.annotation)), p.annotation) for p in signature(function, eval_str=True).parameters.values()]
    function(*(kind(word) for kind, word in zip(kinds, words, strict=False)))


if __name__ == "__main__":
    try:
        call(*sys.argv[1:])
    except InputError as refused:
        sys.exit(f"trackres: error: {refused}")
