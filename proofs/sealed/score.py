# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Last process of a run: opens the seal and counts."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from proofs.processes import check_seal, each, read_json, read_labels
from proofs.sealed.answers import BASELINES, DESCRIBED, EARLIER, Answer, of_names, of_report
from proofs.sealed.baselines import by_trees
from proofs.sealed.cases import CATALOGUE, NOT_IN_CATALOGUE, RIGHT_FORMS, Case, first_by_name
from proofs.sealed.drives import Array
from proofs.sealed.follow import advised
from proofs.sealed.generate import weight_and_radius
from proofs.sealed.oracle import OracleAnswer, fit_truth
from proofs.sealed.page import write_all
from proofs.sealed.programs import PROGRAM
from proofs.sealed.scored import OURS, MassError, Scored, mass_errors, true_values
from proofs.sealed.statements import is_true
from proofs.sealed.street import LOAD
from proofs.sealed.truth import G
from trackres_ros.diagnosis.selection.locate import evenly_filled

Truth = Mapping[str, Any]
"""The kept part of the truth of a case, see `generate`."""

ACTING_SHARE = 0.5  # of the 95th percentile: where the truth counts an effect as acting
BINS = 12


def main(folder: Path, first: int | None = None) -> None:
    """Score all cases, or the first."""
    labels = read_labels(folder)
    drawn = [Case(**c) for c in labels["cases"]]
    cases = drawn if first is None else first_by_name(drawn, first)
    seal = check_seal(folder, labels, "begin anew with --fresh")
    simple = [read_json(folder / "results" / f"{case.name}.json")["simple"] for case in cases]
    expected = [_expected(case) for case in cases]
    trees: Sequence[str | None] = by_trees([s["features"] for s in simple], expected, list(CATALOGUE)) or [None] * len(cases)
    scored = each(partial(_score, folder), list(zip(cases, trees, strict=True)), "oracle fitted")
    write_all(folder, scored, seal, labels["seed"], len(drawn))


def _expected(case: Case) -> str:
    """The right answer of a method that only gives names."""
    first = next(iter(case.hidden), "none")
    return first if first in (*CATALOGUE, "none") else "unexplained"


def _score(folder: Path, task: tuple[Case, str | None]) -> Scored:
    case, tree = task
    result = read_json(folder / "results" / f"{case.name}.json")
    report, simple = result["report"], result["simple"]
    ours = of_report(report)
    with np.load(folder / "sealed" / f"{case.name}.npz") as file:
        truth = dict(file)
    rivals = sorted({name for c in ours.classes for name in c}) if case.level == "outside" else []
    kept = folder / "sealed" / f"{'_'.join([case.name, *rivals])}.oracle.json"
    if not kept.exists():
        names = [name for name in case.hidden if name in CATALOGUE]
        known = fit_truth(folder / "cases" / case.name, names, _outside(case, truth), rivals)
        kept.write_text(json.dumps(asdict(known)), encoding="utf-8")
    known = OracleAnswer(**read_json(kept))
    answers = {name: of_names(simple[name]) for name in BASELINES if name in simple}
    if tree:
        answers["trees"] = Answer(tree, ()) if tree in ("none", "unexplained") else of_names([tree])
    before = folder / "results_earlier" / f"{case.name}.json"
    if before.exists():
        answers[EARLIER] = of_report(read_json(before))
    overlap, jaccard = _where(case, truth, report)
    return Scored(
        case, report, known, {OURS: ours, **answers}, overlap, jaccard, _resolved(folder, case, report), result["learned"],
        _stated(case, truth, report, ours), true_values(case), _masses(case, truth, report),
    )  # fmt: skip


def _outside(case: Case, truth: Truth) -> list[Array]:
    """Torque of physics outside the catalogue in each drive, in means over seconds [Nm]; empty without."""
    added = [truth[f"added/{name}"] for name in case.hidden if name not in CATALOGUE]
    return np.split(added[0], np.cumsum(truth["lengths"])[:-1]) if added else []


def _stated(case: Case, truth: Truth, report: dict[str, Any], answer: Answer) -> bool | None:
    """Whether the first description is true; None without a description, or without hidden physics of a known form."""
    if answer.status != DESCRIBED or not answer.described or case.level not in NOT_IN_CATALOGUE or not case.hidden:
        return None
    if PROGRAM not in case.hidden:
        return all(answer.described[0].form == RIGHT_FORMS[name] for name in case.hidden)
    over = {key.removeprefix("over/"): truth[key] for key in truth if key.startswith("over/")}
    return is_true(report["described"][0], over, truth[f"added/{PROGRAM}"], truth["lengths"])


def _masses(case: Case, truth: Truth, report: dict[str, Any]) -> list[MassError]:
    """Errors of the masses of a described payload; none without a payload, or without a description."""
    described = [term["stretches"] for term in report.get("described", ()) if term["form"] == "payload"]
    if LOAD not in case.hidden or not described:
        return []
    speed, weight = (np.split(truth[f"over/{name}"], np.cumsum(truth["lengths"])[:-1]) for name in ("speed", "load"))
    nominal, _ = weight_and_radius()
    greatest = case.hidden[LOAD]["share"] * nominal / G
    found = []
    for i, (v, w) in enumerate(zip(speed, weight, strict=True), start=1):
        stretches = [one for one in described[0] if Path(one["recording"]).stem == f"drive_{i}"]
        found += mass_errors(v, (w - nominal) / G, stretches, greatest)
    return found


def _where(case: Case, truth: Truth, report: dict[str, Any]) -> tuple[float, float]:
    """Intersection over union of the true and the reported action of an effect: in time, and over its regime."""
    of = [e for e in report["effects"] if e["name"] in case.hidden]
    if not of:
        return np.nan, np.nan
    added, lengths = np.abs(truth[f"added/{of[0]['name']}"]), truth["lengths"]
    if not added.max() > 0.0:
        return np.nan, np.nan
    indicated, first = np.zeros(len(added), dtype=bool), np.concatenate(([0], np.cumsum(lengths)[:-1]))
    for recording, begin, end in of[0]["where"]["time"]:
        at = int(first[int(Path(recording).stem.removeprefix("drive_")) - 1])
        indicated[at + int(begin) : at + int(end)] = True
    overlap = _common(added >= ACTING_SHARE * np.percentile(added, 95.0), indicated)
    regime = of[0]["where"]["regime"]
    over = truth.get(f"over/{regime[0]['variable']}") if regime else None
    if over is None:
        return overlap, np.nan
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
    after = of_report(read_json(path)["report"])
    stays = {name for group in advice["groups"] if set(group) & true for name in group}
    gone = set(advice["separates"]) - stays
    return any(set(members) & true & stays and not set(members) & gone for members in after.classes)
