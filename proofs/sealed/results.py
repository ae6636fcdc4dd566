# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The results of a run: scores with their targets, general learners, cases, and verdicts on physics outside the catalogue."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from proofs.sealed.cases import NOT_IN_CATALOGUE
from proofs.sealed.diagnosing import BASE
from proofs.sealed.scoring import (
    BASELINES,
    DESCRIBED,
    NO_WORSE,
    OURS,
    Answer,
    Scored,
    error_left,
    own_shares,
    shares,
    sizes,
    wilson,
)
from proofs.tables import FOLDER, TRUTH, Tables, number, write_tables
from trackres_ros.text import table

TARGETS = {
    "none: false alarm": ("at most", 0.03), "single, identifiable: right name": ("at least", 0.90),
    "single: truth in the reported class": ("at least", 0.95), "single: size of the class (mean)": ("at most", 1.5),
    "compensated, identifiable: right name": ("at least", 0.85), "masked, identifiable: right name": ("at least", 0.70),
    "two, each identifiable: both": ("at least", 0.70), "two: at least one": ("at least", 0.95),
    "two: no false third": ("at least", 0.90),
    "not identifiable: class or abstain": ("at least", 0.90),
    "outside: confirmed wrong name": ("at most", 0.03), "outside: described or unexplained": ("at least", 0.85),
    "outside, seen by the oracle: described, and the statement is true": ("at least", 0.75),
    "outside, predictable: held-out error removed, of what the oracle removes (median)": ("at least", 0.8),
    "none: false description": ("at most", 0.02),
    "street, nothing hidden: a name or a description": ("at most", 0.05), "street: confirmed wrong name": ("at most", 0.03),
    "street, load described: masses within 8% of the load, over 300 s of driving": ("at least", 0.8),
    "street: held-out laps never worse than the base": ("at least", 0.97),
    "held-out error removed, of what the oracle removes (median)": ("at least", 0.9),
    "held-out laps: never worse than the base": ("at least", 1.0), "95 % intervals cover": ("at least", 0.90),
    "street, load described: 95 % intervals of masses cover": ("at least", 0.90),
    "relative error of parameters (median)": ("at most", 0.15), "where, in time: overlap (median)": ("at least", 0.7),
    "where, in its regime: Jaccard (median)": ("at least", 0.6), "recommended manoeuvre resolves the tie": ("at least", 0.80),
}  # fmt: skip


def content(scored: Sequence[Scored], seed: int, seal: str) -> dict[str, Any]:
    """Content of scores.json."""

    def counted(rows: Mapping[str, tuple[int, int]]) -> dict[str, Any]:
        return {name: {"hits": hits, "of": of, "interval": wilson(hits, of)} for name, (hits, of) in rows.items()}

    return {
        "seed": seed,
        "seal": seal,
        "scores": {method: counted(rows) for method, rows in _by_method(scored).items()},
        "own": counted(own_shares(scored)),
        "sizes": sizes(scored),
        "cases": [
            {
                "case": asdict(s.case), "known": asdict(s.known), "learned": dict(s.learned),
                "overlap": s.overlap, "jaccard": s.jaccard, "wrong": s.wrong,
                "answers": {method: asdict(answer) for method, answer in s.answers.items()},
            }
            for s in scored
        ],
    }  # fmt: skip


def _by_method(scored: Sequence[Scored]) -> dict[str, dict[str, tuple[int, int]]]:
    return {method: shares(scored, method) for method in (OURS, *BASELINES) if all(method in s.answers for s in scored)}


def report_of(
    folder: Path, scored: Sequence[Scored], truth: str, labels: Mapping[str, Any], seal: str
) -> tuple[dict[str, Any], str]:
    """Content of scores.json, and the scores with a target as text; writes the tables."""
    tables = tables_of(scored, truth, labels["seed"], seal)
    write_tables(folder / FOLDER, tables)
    drawn = len(labels["cases"])
    part = "" if len(scored) == drawn else f" of the {drawn} that were sealed, the first in the order of their drawn names"
    text = f"{len(scored)} cases{part}, seed {labels['seed']}, SHA-256 {seal}\n\n{overview(tables['scores'])}\n"
    return content(scored, labels["seed"], seal), text


def tables_of(scored: Sequence[Scored], truth: str, seed: int, seal: str) -> Tables:
    """The tables of a run, whose first column is the name of the truth."""
    tables = {
        "runs": [{"cases": str(len(scored)), "seed": str(seed), "seal": seal}],
        "scores": _score_rows(scored),
        "learners": _learner_rows(scored),
        "outside": _outside_rows(scored),
        "cases": _case_rows(scored),
    }
    return {name: [{TRUTH: truth, **row} for row in rows] for name, rows in tables.items()}


def overview(rows: Sequence[Mapping[str, str]]) -> str:
    """The scores with a target as text."""
    of_targets = [row for row in rows if row["target"] and row["value"]]
    cells = [[row["score"], row["value"], row["hits"], row["of"], row["target"], row["met"]] for row in of_targets]
    return table(cells, ("score", "value", "hits", "of", "target", "met"), numbers=False)


def _score_rows(scored: Sequence[Scored]) -> list[dict[str, str]]:
    """All scores with their 95 % intervals and targets, and the shares of the baselines."""
    by_method = _by_method(scored)
    rows = []
    for name, (hits, of) in {**by_method[OURS], **own_shares(scored)}.items():
        low, high = wilson(hits, of) if of else (np.nan, np.nan)
        others = {method: by_method[method][name] for method in BASELINES if name in by_method.get(method, {})}
        baselines = {method: number(hit / tried, 2) if tried else "" for method, (hit, tried) in others.items()}
        counts = {"hits": str(hits), "of": str(of)}
        rows.append(_score_row(name, hits / of if of else np.nan, baselines, low, high, **counts))
    for name, values in sizes(scored).items():
        value = np.nan
        if values:
            value = float(np.mean(values) if name.endswith("(mean)") else np.median(values))
        rows.append(_score_row(name, value, {}, of=str(len(values))))
    return rows


def _score_row(
    name: str, value: float, baselines: Mapping[str, str], low: float = np.nan, high: float = np.nan, hits: str = "", of: str = ""
) -> dict[str, str]:
    side, bound = TARGETS.get(name, ("", np.nan))
    met = "" if not np.isfinite(value * bound) else "yes" if (value <= bound if side == "at most" else value >= bound) else "no"
    return {
        "score": name, "hits": hits, "of": of, "value": number(value, 2), "low": number(low, 2), "high": number(high, 2),
        "target": f"{side} {bound:g}" if side else "", "met": met,
        **{method: baselines.get(method, "") for method in BASELINES},
    }  # fmt: skip


def _learner_rows(scored: Sequence[Scored]) -> list[dict[str, str]]:
    """Reduction of the error on hold-out laps by the diagnosis and by general learners."""
    outside = [s for s in scored if s.case.level == "outside" and s.reducible]
    groups = {
        "outside, predictable: removed, of what the oracle removes (median)": [s for s in outside if s.predictable],
        "outside, all: removed, of what the oracle removes (median)": outside,
    }
    errors = {"diagnosis": [(s.report["heldout"]["mae"]["refitted"], error_left(s.report)) for s in scored]} | {
        name: [(s.learned[BASE], s.learned[name]) for s in scored] for name in scored[0].learned if name != BASE
    }
    rows = []
    for method, pairs in errors.items():
        for what, of in groups.items():
            removed = [s.share_removed(*pair) for s, pair in zip(scored, pairs, strict=True) if s in of]
            value = number(float(np.median(removed)) if removed else np.nan, 2)
            rows.append({"method": method, "score": what, "cases": str(len(of)), "value": value})
        for level in ("none", *NOT_IN_CATALOGUE):
            of_level = [pair for s, pair in zip(scored, pairs, strict=True) if s.case.level == level]
            worse = sum(after > NO_WORSE * before for before, after in of_level)
            score = f"{level}: worse than the base"
            rows.append({"method": method, "score": score, "cases": str(len(of_level)), "value": str(worse)})
    return rows


def _outside_rows(scored: Sequence[Scored]) -> list[dict[str, str]]:
    """The verdict on each case with physics that is not in the catalogue, and on each drive in a town."""
    return [
        {
            "level": s.case.level, "hidden": s.case.title, "drives": "town" if s.case.level == "street" else s.case.source,
            "seen": "yes" if s.known.identifiable else "no", "right": "no" if s.wrong else "yes",
            "error_removed": number(s.removed, 2) if s.reducible else "", "verdict": _verdict_of(s.answer),
        }
        for s in sorted(scored, key=lambda s: (s.case.level, s.case.title))
        if s.case.level in NOT_IN_CATALOGUE
    ]  # fmt: skip


def _case_rows(scored: Sequence[Scored]) -> list[dict[str, str]]:
    """Each case with the answer of every method and the kind of mistake of the diagnosis."""
    return [
        {
            "case": s.case.name, "level": s.case.level, "hidden": "+".join(s.case.hidden), "said": _verdict_of(s.answer),
            "status": s.answer.status, "identifiable": "yes" if s.known.identifiable else "no",
            "oracle_gain": f"{s.known.gain:.1f}", "mistake": s.wrong,
            **{method: _verdict_of(s.answers[method]) if method in s.answers else "" for method in BASELINES},
        }
        for s in sorted(scored, key=lambda s: (s.case.level, sorted(s.true)))
    ]  # fmt: skip


def _verdict_of(answer: Answer) -> str:
    if answer.status == DESCRIBED:
        return " + ".join(f"{term.form} ({term.about})" if term.about else term.form for term in answer.described)
    return " + ".join("/".join(members) for members in answer.classes) or answer.status
