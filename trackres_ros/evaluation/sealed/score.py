# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Last process of a run: opens the seal and counts.

`python -m trackres_ros.evaluation.sealed.score FOLDER [FIRST]`
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.findings.locate import evenly_filled
from trackres_ros.errors import InputError
from trackres_ros.evaluation.sealed.answers import BASELINES, DESCRIBED, EARLIER, Answer, of_names, of_report
from trackres_ros.evaluation.sealed.baselines import by_trees
from trackres_ros.evaluation.sealed.cases import CATALOGUE, NOT_IN_CATALOGUE, RIGHT_FORMS, Case, first_by_name, sealed
from trackres_ros.evaluation.sealed.data_sheet import read_data_sheet
from trackres_ros.evaluation.sealed.follow import advised
from trackres_ros.evaluation.sealed.generate import VEHICLE
from trackres_ros.evaluation.sealed.masses import MassError, mass_errors
from trackres_ros.evaluation.sealed.oracle import OracleAnswer, fit_truth
from trackres_ros.evaluation.sealed.page import write_all
from trackres_ros.evaluation.sealed.programs import PROGRAM
from trackres_ros.evaluation.sealed.scored import OURS, Scored, true_values
from trackres_ros.evaluation.sealed.statements import is_true
from trackres_ros.evaluation.sealed.street import LOAD
from trackres_ros.evaluation.sealed.truth import G
from trackres_ros.files.resources import find_vehicle

Array = NDArray[np.float64]

ACTING_SHARE = 0.5  # of the 95th percentile: where the truth counts an effect as acting
BINS = 12


def main(arguments: Sequence[str]) -> None:
    """See above."""
    folder = Path(arguments[0])
    labels = json.loads((folder / "sealed" / "labels.json").read_text(encoding="utf-8"))
    drawn = [Case(**c) for c in labels["cases"]]
    cases = first_by_name(drawn, int(arguments[1])) if len(arguments) > 1 else drawn
    seal = sealed(labels["seed"], drawn)
    if seal != (folder / "seal.txt").read_text(encoding="utf-8").strip():
        given = "labels that are not those that were sealed"
        raise InputError(str(folder / "sealed"), given, "the labels of the cases as drawn", "begin anew with --fresh")
    simple = [json.loads((folder / "results" / f"{case.name}.json").read_text(encoding="utf-8"))["simple"] for case in cases]
    expected = [_expected(case) for case in cases]
    trees: Sequence[str | None] = by_trees([s["features"] for s in simple], expected, list(CATALOGUE)) or [None] * len(cases)
    scored = []
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        for done, one in enumerate(pool.map(_score, [(folder, c, t) for c, t in zip(cases, trees, strict=True)]), start=1):
            scored.append(one)
            print(f"\roracle fitted {done} of {len(cases)}", end="", flush=True)
    print(flush=True)
    print(write_all(folder, scored, seal, labels["seed"], len(drawn)))


def _expected(case: Case) -> str:
    """The right answer of a method that only gives names."""
    first = next(iter(case.hidden), "none")
    return first if first in (*CATALOGUE, "none") else "unexplained"


def _score(task: tuple[Path, Case, str | None]) -> Scored:
    folder, case, tree = task
    result = json.loads((folder / "results" / f"{case.name}.json").read_text(encoding="utf-8"))
    report, simple = result["report"], result["simple"]
    ours = of_report(report)
    rivals = sorted({name for c in ours.classes for name in c}) if case.level == "outside" else []
    kept = folder / "sealed" / f"{'_'.join([case.name, *rivals])}.oracle.json"
    if not kept.exists():
        known = fit_truth(
            folder / "cases" / case.name, [name for name in case.hidden if name in CATALOGUE], _outside(folder, case), rivals
        )
        kept.write_text(json.dumps(asdict(known)), encoding="utf-8")
    known = OracleAnswer(**json.loads(kept.read_text(encoding="utf-8")))
    answers = {name: of_names(simple[name]) for name in BASELINES if name in simple}
    if tree:
        answers["trees"] = Answer(tree, ()) if tree in ("none", "unexplained") else of_names([tree])
    before = folder / "results_earlier" / f"{case.name}.json"
    if before.exists():
        answers[EARLIER] = of_report(json.loads(before.read_text(encoding="utf-8")))
    overlap, jaccard = _where(folder, case, report)
    resolved = _resolved(folder, case, report)
    masses = _masses(folder, case, report)
    return Scored(
        case, report, known, {OURS: ours, **answers}, overlap, jaccard, resolved, result["learned"],
        _stated(folder, case, report), true_values(case), masses,
    )  # fmt: skip


def _outside(folder: Path, case: Case) -> list[Array]:
    """Torque of physics outside the catalogue in each drive, in means over seconds [Nm]; empty without."""
    truth = np.load(folder / "sealed" / f"{case.name}.npz")
    added = [truth[f"added/{name}"] for name in case.hidden if name not in CATALOGUE]
    return np.split(added[0], np.cumsum(truth["lengths"])[:-1]) if added else []


def _stated(folder: Path, case: Case, report: dict[str, Any]) -> bool | None:
    """Whether the first description is true; None without a description, or without hidden physics of a known form."""
    answer = of_report(report)
    if answer.status != DESCRIBED or not answer.described or case.level not in NOT_IN_CATALOGUE or not case.hidden:
        return None
    if PROGRAM not in case.hidden:
        return all(answer.described[0].form == RIGHT_FORMS[name] for name in case.hidden)
    truth = np.load(folder / "sealed" / f"{case.name}.npz")
    over = {key.removeprefix("over/"): truth[key] for key in truth if key.startswith("over/")}
    return is_true(report["described"][0], over, truth[f"added/{PROGRAM}"], truth["lengths"])


def _masses(folder: Path, case: Case, report: dict[str, Any]) -> list[MassError]:
    """Errors of the masses of a described payload; none without a payload, or without a description."""
    described = [term["stretches"] for term in report.get("described", ()) if term["form"] == "payload"]
    if LOAD not in case.hidden or not described:
        return []
    truth = np.load(folder / "sealed" / f"{case.name}.npz")
    speed, weight = (np.split(truth[f"over/{name}"], np.cumsum(truth["lengths"])[:-1]) for name in ("speed", "load"))
    nominal = read_data_sheet(find_vehicle(VEHICLE))["weight"]
    greatest = case.hidden[LOAD]["share"] * nominal / G
    return [
        error
        for i, (v, w) in enumerate(zip(speed, weight, strict=True), start=1)
        for error in mass_errors(v, (w - nominal) / G, _named(described[0], f"drive_{i}"), greatest)
    ]


def _named(stretches: Sequence[dict[str, Any]], recording: str) -> list[dict[str, Any]]:
    return [one for one in stretches if Path(one["recording"]).stem == recording]


def _where(folder: Path, case: Case, report: dict[str, Any]) -> tuple[float, float]:
    """Intersection over union of the true and the reported action of an effect: in time, and over its regime."""
    of = [e for e in report["effects"] if e["name"] in case.hidden]
    if not of:
        return float("nan"), float("nan")
    truth = np.load(folder / "sealed" / f"{case.name}.npz")
    added, lengths = np.abs(truth[f"added/{of[0]['name']}"]), truth["lengths"]
    if not added.max() > 0.0:
        return float("nan"), float("nan")
    indicated, first = np.zeros(len(added), dtype=bool), np.concatenate(([0], np.cumsum(lengths)[:-1]))
    for recording, begin, end in of[0]["where"]["time"]:
        at = int(first[int(Path(recording).stem.removeprefix("drive_")) - 1])
        indicated[at + int(begin) : at + int(end)] = True
    overlap = _common(added >= ACTING_SHARE * np.percentile(added, 95.0), indicated)
    regime = of[0]["where"]["regime"]
    if not regime:
        return overlap, float("nan")
    kept = f"over/{regime[0]['variable']}"
    if kept not in truth:
        return overlap, float("nan")
    over = truth[kept]
    inside = (over >= regime[0]["lo"]) & (over <= regime[0]["hi"])
    _, place = evenly_filled(over, BINS)
    means = np.bincount(place, weights=added) / np.maximum(np.bincount(place), 1)
    return overlap, _common((means >= ACTING_SHARE * means.max())[place], inside)


def _common(one: NDArray[np.bool_], other: NDArray[np.bool_]) -> float:
    return float((one & other).sum() / max((one | other).sum(), 1))


def _resolved(folder: Path, case: Case, report: dict[str, Any]) -> bool | None:
    path = folder / "results_next" / f"{case.name}.json"
    if not path.exists():
        return None
    advice, true = advised(report, set(case.hidden)), set(case.hidden)
    assert advice is not None
    after = of_report(json.loads(path.read_text(encoding="utf-8"))["report"])
    stays = {name for group in advice["groups"] if set(group) & true for name in group}
    gone = set(advice["separates"]) - stays
    return any(set(members) & true & stays and not set(members) & gone for members in after.classes)


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except InputError as refused:
        sys.exit(f"trackres: error: {refused}")
