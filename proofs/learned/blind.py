# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Second process: learns and re-fits, given recordings and vehicle files and nothing else."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from proofs.learned.generate import REFIT
from proofs.processes import each, unfinished
from proofs.sealed.drives import Array
from proofs.sealed.generate import APART_S, refit
from trackres_ros.errors import InputError
from trackres_ros.estimator import columns as at
from trackres_ros.estimator.estimate import Steps
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.snapshot import read_learning, save
from trackres_ros.learning.learner import Learner
from trackres_ros.learning.parameters import VEHICLES_OWN
from trackres_ros.learning.store import stored, take
from trackres_ros.recording.opening import open_source
from trackres_ros.tasks.replay_run import replay
from trackres_ros.vehicle import load

KEY = re.compile(r"\(?[+-]?\d+ (%|Nm|s)|( of the|of)(?= *$)| (since|for) *$|, of the kind.*")  # varies from run to run
BESIDE = "a torque that no parameter explains"
SHOWN = [at.Results.speed_mps, at.Results.feedforward_torque_nm, at.Results.resistance_torque_nm, at.Results.resistance_std_nm]


class Listening(Learner):
    """A learner that records its status, its seconds, and whether it left its ranges."""

    def __init__(self, estimator: Estimator, mode: str) -> None:
        super().__init__(estimator, mode)
        self.said: dict[str, int] = {}
        self.outside = False

    def _close(self, session: Any, passed: int) -> None:
        super()._close(session, passed)
        for text in (self.frozen, self.disturbance and BESIDE, self.left_out.partition(" in ")[0]):
            if text:
                key = KEY.sub("", text.split(":")[0]).strip()
                self.said[key] = self.said.get(key, 0) + 1
        own, applied = list(VEHICLES_OWN), self.learned.applied
        self.outside |= bool((applied[own] < self.prior.low[own]).any() or (applied[own] > self.prior.high[own]).any())


def main(folder: Path, first: int | None = None) -> None:
    """Learn all vehicles, or the first."""
    results = folder / "results"
    each(partial(learn_and_fit, results), unfinished(folder / "cases", results, first), "learned")


def learn_and_fit(results: Path, case: Path) -> None:
    """One vehicle: with its file, with learning on, and with files of a re-fit."""
    drives = sorted(case.glob("drive_*.csv"))
    vehicle = case / "vehicle.yaml"
    rows: dict[str, Any] = {}
    for i, path in enumerate(drives):
        rows[f"file_{i + 1}"] = _plain(path, vehicle)
    said = _learned(case, drives, vehicle, rows, "learned")
    _learned(case, [drives[0], drives[-1]], vehicle, rows, "after_one")
    ways = (("refit_one", drives[:1]), ("refit", drives[:-1]), ("oracle", drives)) if (case / REFIT).exists() else ()
    for name, which in ways:
        try:
            rows[f"{name}_{len(drives)}"] = _plain(drives[-1], refit(which, vehicle, case / f"{name}.yaml", "re-fitted"))
        except InputError as error:  # of a recording that a re-fit refuses nothing is learned
            rows[f"{name}_{len(drives)}"] = rows[f"file_{len(drives)}"]
            said[f"{name} refused"] = str(error)[:200]
    np.savez_compressed(results / f"{case.name}.npz", **rows)
    (results / f"{case.name}.json").write_text(json.dumps(said, indent=1), encoding="utf-8")


def _plain(path: Path, vehicle: Path) -> Array:
    kept: list[Steps] = []
    replay(open_source([path], None), Estimator(load(vehicle)), kept.append)
    return _shown(kept)


def _shown(kept: Sequence[Steps]) -> Array:
    """Time [s] and scored values of each step."""
    rows = np.concatenate([steps.rows[:, SHOWN] for steps in kept])
    stamps = np.concatenate([steps.stamp_ns for steps in kept])
    return np.column_stack([stamps * 1e-9, rows])


def _learned(case: Path, drives: Sequence[Path], vehicle: Path, rows: dict[str, Array], name: str) -> dict[str, Any]:
    """With learning on: learned values come from the state file of the drive before, two weeks later."""
    estimator, state = Estimator(load(vehicle)), case / f"{name}.state"
    said: dict[str, Any] = {}
    for path in drives:
        learner = Listening(estimator, "on")
        if path is not drives[0]:  # belts begin soaked at the measured air's temperature, as with every other file
            take(learner, read_learning(estimator, state))
            learner.age(APART_S)
        kept: list[Steps] = []
        done = replay(open_source([path], None), estimator, kept.append, learner=learner)
        save(done.session, state, 0.0, stored(learner))
        number = path.stem.rpartition("_")[2]
        rows[f"{name}_{number}"] = _shown(kept)
        said[number] = {
            "text": learner.text,
            "said_s": learner.said,
            "outside": learner.outside,
            "seconds": learner.learned.seconds,
            "applied": learner.learned.applied.tolist(),
            "std": np.sqrt(np.diag(learner.learned.covariance)).tolist(),
            "counts": [state for state in VEHICLES_OWN if learner.counted[state]],
        }
    return said
