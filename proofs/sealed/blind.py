# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Second process of a run: diagnoses each case, given its recordings and vehicle file and nothing else."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from proofs.processes import each, unfinished

if TYPE_CHECKING:
    from trackres_ros.diagnosis import Diagnosis
    from trackres_ros.diagnosis.base.loading import LoadedBase
    from trackres_ros.recording.recording import Recording

HELD_OUT = "held_out.json"
VEHICLE = "xgd24d"  # of a case without a vehicle file of its own
TOPICS = "topics.yaml"  # of a case whose columns are not the project's
SHOWN = 200  # points of a described term over its variable
DRIVING_MPS = 0.5


def main(cases: Path, results: Path, first: int | None = None) -> None:
    """Diagnose the unfinished cases."""
    each(partial(_diagnose, results), unfinished(cases, results, first), "diagnosed")


def opened(folder: Path) -> tuple[list[Path], list[Recording], LoadedBase]:
    """Paths and recordings in the folder of a case, and its vehicle."""
    from trackres_ros.diagnosis import load_base, read_recordings
    from trackres_ros.files.resources import find_vehicle
    from trackres_ros.recording.bindings import Topics

    own, paths = folder / "vehicle.yaml", sorted(folder.glob("*.csv"))
    base = load_base(own if own.exists() else find_vehicle(VEHICLE))
    if not (folder / TOPICS).exists():
        return paths, read_recordings(paths, None), base
    topics = Topics.load(folder / TOPICS)
    return paths, read_recordings(paths, topics), base.with_topics(topics)


def diagnosed(folder: Path) -> tuple[Diagnosis, list[Path]]:
    """Diagnosis of the folder of a case, and the recordings there."""
    from trackres_ros.diagnosis import DiagnosisOptions, diagnose

    paths, recordings, base = opened(folder)
    # A drive made to distinguish effects is added to the fit: the hold-out laps are the same as without it.
    kept = folder / HELD_OUT
    held_out = json.loads(kept.read_text(encoding="utf-8")) if kept.exists() else None
    return diagnose(recordings, base, DiagnosisOptions(holdout=held_out, quick=True)), paths


def _diagnose(results: Path, folder: Path) -> None:
    from proofs.sealed.baselines import simple_answers
    from proofs.sealed.discrepancy import learned_errors
    from trackres_ros.diagnosis.report.content import report

    found, paths = diagnosed(folder)
    simple = simple_answers(found.refitted, found.alone.separability.of_names)
    learned = learned_errors(found.refitted, found.split)
    partial = results / f"{folder.name}.part"
    result = {"report": report(found, paths), "simple": simple, "learned": learned, "over": _over(found)}
    partial.write_text(json.dumps(result), encoding="utf-8")
    partial.rename(results / f"{folder.name}.json")


def _over(found: Diagnosis) -> dict[str, list[list[float]]]:
    """Of each described term: values of its variable, rising, and its torque there [Nm]; without those that have none."""
    from trackres_ros.diagnosis.empirical.finders import variable_of

    shown = {}
    for term in found.described:
        course = variable_of(term, found.final)
        x, torque = (np.concatenate(list(of)) if of else np.empty(0) for of in (course, term.adds))
        speed = np.concatenate([s.speed for s in found.refitted.problem.sessions])
        if len(x) != len(speed):
            continue
        drives = np.flatnonzero((speed > DRIVING_MPS) & np.isfinite(x))
        rising = drives[np.argsort(x[drives])]
        kept = rising[np.linspace(0, len(rising) - 1, min(SHOWN, len(rising))).astype(int)]
        shown[term.name] = [x[kept].tolist(), torque[kept].tolist()]
    return shown
