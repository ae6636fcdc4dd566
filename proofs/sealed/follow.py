# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Fourth process of a run: drives the advised manoeuvres if effects could not be distinguished.

It knows the vehicles, so it opens the seal; `blind` then diagnoses the recordings including the new one.
"""

from __future__ import annotations

import json
import shutil
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from proofs.processes import each, read_json, read_labels
from proofs.sealed.answers import of_report
from proofs.sealed.blind import HELD_OUT
from proofs.sealed.cases import Case, first_by_name
from proofs.sealed.drives import STEP_S, SealedDrive
from proofs.sealed.generate import drive_next

FOLLOWED = "drive_next"


def main(folder: Path, minutes: float, most: int, first: int | None = None) -> None:
    """Drive as advised in at most so many cases."""
    tasks = []
    for case in first_by_name([Case(**c) for c in read_labels(folder)["cases"]], first):
        report = read_json(folder / "results" / f"{case.name}.json")["report"]
        advice = advised(report, set(case.hidden))
        if advice is not None:
            held_out = [Path(lap).name for lap in report["heldout"]["laps"]]
            tasks.append((case, str(advice["manoeuvre"]), held_out))
    each(partial(_follow, folder, minutes), tasks[:most], "driven as advised")


def advised(report: dict[str, Any], true: set[str]) -> dict[str, Any] | None:
    """The first advice that separates a true effect from others of its class; None without one."""
    tied = [set(members) & true for members in of_report(report).classes if len(members) > 1]
    if not any(tied):
        return None
    for advice in report["advice"]:
        if any(members <= set(advice["separates"]) for members in tied if members):
            return dict(advice)
    return None


def _follow(folder: Path, minutes: float, task: tuple[Case, str, list[str]]) -> None:
    case, manoeuvre, held_out = task
    into = folder / "next" / case.name
    if (into / f"{FOLLOWED}.csv").exists():
        return
    before = folder / "cases" / case.name
    recorded = drive_next(folder, case, minutes, FOLLOWED, lambda last: planned(manoeuvre, before, last))
    into.mkdir(parents=True, exist_ok=True)
    for path in [*sorted(before.glob("drive_[0-9]*.csv")), before / "vehicle.yaml"]:
        shutil.copy(path, into / path.name)
    (into / HELD_OUT).write_text(json.dumps(held_out), encoding="utf-8")
    recorded.rename(into / recorded.name)


def planned(manoeuvre: str, before: Path, last: SealedDrive) -> SealedDrive:
    """A manoeuvre of the menu as a drive, on a day like that of the last drive."""
    from trackres_ros.diagnosis import load_base, read_recordings
    from trackres_ros.diagnosis.findings.next_drives import menu
    from trackres_ros.diagnosis.prepare.gate import gate

    loaded = load_base(before / "vehicle.yaml")
    (like,) = gate(read_recordings([before / "drive_1.csv"], None), loaded.known).sessions
    session = menu(loaded.base.facts.weight, loaded.known.max_speed)[manoeuvre](like)
    time = np.arange(0.0, session.time[-1], STEP_S)
    speed = np.interp(time, session.time, session.speed)
    yaw_rate = np.interp(time, session.time, session.yaw_rate)
    return SealedDrive(
        STEP_S,
        speed,
        np.gradient(speed, STEP_S),
        yaw_rate,
        np.cumsum(yaw_rate) * STEP_S,
        np.interp(time, session.time, session.weight),
        np.full(len(time), last.ambient[0]),
        np.interp(time, session.time, session.grade) if session.grade.any() else None,
    )
