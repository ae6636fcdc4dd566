# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Second process of a run: diagnoses each case, given its recordings and vehicle file and nothing else."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from trackres_ros.evaluation.processes import each, unfinished

if TYPE_CHECKING:
    from trackres_ros.diagnosis import Diagnosis
    from trackres_ros.diagnosis.base.loading import LoadedBase

HELD_OUT = "held_out.json"
VEHICLE = "xgd24d"  # of a case without a vehicle file of its own


def main(cases: Path, results: Path, first: int | None = None) -> None:
    """Diagnose the unfinished cases."""
    each(partial(_diagnose, results), unfinished(cases, results, first), "diagnosed")


def opened(folder: Path) -> tuple[list[Path], LoadedBase]:
    """Recordings in the folder of a case, and its vehicle."""
    from trackres_ros.diagnosis import load_base
    from trackres_ros.files.resources import find_vehicle

    own = folder / "vehicle.yaml"
    return sorted(folder.glob("*.csv")), load_base(own if own.exists() else find_vehicle(VEHICLE))


def diagnosed(folder: Path) -> tuple[Diagnosis, list[Path]]:
    """Diagnosis of the folder of a case, and the recordings there."""
    from trackres_ros.diagnosis import DiagnosisOptions, diagnose, read_recordings

    paths, base = opened(folder)
    # A drive made to distinguish effects is added to the fit: the hold-out laps are the same as without it.
    kept = folder / HELD_OUT
    held_out = json.loads(kept.read_text(encoding="utf-8")) if kept.exists() else None
    return diagnose(read_recordings(paths, None), base, DiagnosisOptions(holdout=held_out, quick=True)), paths


def _diagnose(results: Path, folder: Path) -> None:
    from trackres_ros.diagnosis.report.content import report
    from trackres_ros.evaluation.sealed.baselines import simple_answers
    from trackres_ros.evaluation.sealed.discrepancy import learned_errors

    found, paths = diagnosed(folder)
    simple = simple_answers(found.refitted, found.alone.separability.of_names)
    learned = learned_errors(found.refitted, found.split)
    partial = results / f"{folder.name}.part"
    result = {"report": report(found, paths), "simple": simple, "learned": learned}
    partial.write_text(json.dumps(result), encoding="utf-8")
    partial.rename(results / f"{folder.name}.json")
