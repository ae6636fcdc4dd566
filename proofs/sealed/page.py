# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes the results of a run: tables, the confusion matrix as a picture, and one page of each kind of mistake."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from proofs.sealed.cases import NOT_IN_CATALOGUE
from proofs.sealed.diagnosing import BASE, diagnosed
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
from trackres_ros.diagnosis.report.content import report
from trackres_ros.diagnosis.report.page import glance, write_page
from trackres_ros.diagnosis.report.pictures import draw_all
from trackres_ros.files.own_files import write
from trackres_ros.output.style import picture

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
ALONE = ("single", "masked", "compensated", "confounded")  # levels with one effect, or none
CONFUSION = "confusion.png"
UNITLESS = "(median)", "(mean)"  # how the names of scores end that are no shares


def scores_and_page(
    folder: Path, scored: Sequence[Scored], seal: str, seed: int, drawn: int, cases: Path | None = None
) -> tuple[dict[str, Any], str]:
    """Content of scores.json and of proof.md; writes cases.csv, confusion.png and a page of one mistake of each kind."""
    kinds = mistakes(scored)
    for kind, value in kinds.items():
        write_case(folder, cases or folder / "cases", value[0], folder / f"{file_name(kind)}.html")
    _write_cases(folder / "cases.csv", scored)
    alone = [s for s in scored if s.case.level in (*ALONE, "none", *NOT_IN_CATALOGUE)]
    if alone:
        _draw_confusion(folder / CONFUSION, alone)
    results = {method: shares(scored, method) for method in (OURS, *BASELINES) if all(method in s.answers for s in scored)}

    def counted(rows: Mapping[str, tuple[int, int]]) -> dict[str, Any]:
        return {name: {"hits": hits, "of": value, "interval": wilson(hits, value)} for name, (hits, value) in rows.items()}

    kept = {
        "seed": seed,
        "seal": seal,
        "scores": {method: counted(rows) for method, rows in results.items()},
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
    counts = Counter(s.case.level for s in scored)
    text = "\n\n".join(
        (
            f"{len(scored)} cases{_of(len(scored), drawn)} ({', '.join(f'{n} {level}' for level, n in counts.items())}). "
            f"Seed: {seed}. SHA-256 of seed and labels, printed before the first recording was written: `{seal}`.",
            table(results, own_shares(scored), sizes(scored)),
            learned_table(scored),
            *([outside_table(scored)] if any(counts[level] for level in NOT_IN_CATALOGUE) else []),
            *([f"![What was named over what was true, of cases with one effect.]({CONFUSION})"] if alone else []),
            mistake_table(kinds),
        )
    )
    return kept, text + "\n"


def _of(count: int, drawn: int) -> str:
    return "" if count == drawn else f" of the {drawn} that were sealed, the first in the order of their drawn names"


def mistakes(scored: Sequence[Scored]) -> dict[str, list[Scored]]:
    """Cases by kind of mistake, the most frequent kind first."""
    kinds: dict[str, list[Scored]] = {}
    for s in sorted(scored, key=lambda s: s.case.name):
        if s.wrong:
            kinds.setdefault(s.wrong, []).append(s)
    return dict(sorted(kinds.items(), key=lambda pair: -len(pair[1])))


def file_name(kind: str) -> str:
    """File name of the page of a kind of mistake."""
    return "wrong_" + "_".join(word.strip(",") for word in kind.split())


def write_case(folder: Path, cases: Path, s: Scored, path: Path) -> None:
    """The page that the diagnosis makes of a case."""
    result, paths = diagnosed(cases / s.case.name)
    into = folder / "pictures" / s.case.name
    title = f"Case {s.case.name}; hidden: {s.case.title}"
    content = report(result, [Path(p.name) for p in paths])
    write_page(path, content, glance(result, content["topics_lines"]), draw_all(result, into), title)


def table(
    found: Mapping[str, Mapping[str, tuple[int, int]]], own: Mapping[str, tuple[int, int]], other: Mapping[str, Sequence[float]]
) -> str:
    """All scores with their targets and the baselines."""
    methods = [method for method in BASELINES if method in found]
    heads = ["Score", "Measured", "95 %", "Target", "Met", *(BASELINES[method] for method in methods)]
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for name, (hits, content) in {**found[OURS], **own}.items():
        low, high = wilson(hits, content)
        shown = f"{hits / content:.0%} ({hits} of {content})" if content else "no case"
        by_others = [_share(*found[method][name]) if name in found[method] else "" for method in methods]
        target, met = _target(name, hits / content if content else float("nan"), lambda x: f"{x:.0%}")
        lines.append(
            f"| {name} | {shown} | {f'{low:.0%} to {high:.0%}' if content else ''} | {target} | {met} | {' | '.join(by_others)} |"
        )
    for name, values in other.items():
        if not values:
            continue
        value = float(np.mean(values) if name.endswith("(mean)") else np.median(values))
        target, met = _target(name, value, lambda x: f"{x:g}")
        lines.append(f"| {name} | {value:.2f} (of {len(values)}) | | {target} | {met} |{' |' * len(methods)}")
    return "\n".join(lines)


def side_by_side(runs: Mapping[str, Mapping[str, Any]]) -> str:
    """The targets, and their measured values in several runs: the contents of their scores.json, by the name of the truth."""
    lines = [f"| Score | Target | {' | '.join(runs)} |", "|---" * (2 + len(runs)) + "|"]
    for name, (side, bound) in TARGETS.items():
        cells = [_measured(name, run) for run in runs.values()]
        target = f"{bound:g}" if name.endswith(UNITLESS) else f"{bound:.0%}"
        lines.append(f"| {name} | {side} {target} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _measured(name: str, run: Mapping[str, Any]) -> str:
    share, values = {**run["scores"][OURS], **run["own"]}.get(name), run["sizes"].get(name)
    if share is not None and share["of"]:
        low, high = share["interval"]
        value = share["hits"] / share["of"]
        text = f"{value:.0%} ({share['hits']} of {share['of']}; {low:.0%} to {high:.0%})"
    elif values:
        value = float(np.mean(values) if name.endswith("(mean)") else np.median(values))
        text = f"{value:.2f} (of {len(values)})"
    else:
        return "not measured"
    return text + (", met" if _target(name, value, str)[1] == "yes" else ", **missed**")


def learned_table(scored: Sequence[Scored]) -> str:
    """Reduction of the error on hold-out laps by the diagnosis and by general learners."""
    outside = [s for s in scored if s.case.level == "outside" and s.reducible]
    groups = {
        "outside, predictable: removed, of what the oracle removes (median)": [s for s in outside if s.predictable],
        "outside, all: removed, of what the oracle removes (median)": outside,
    }
    errors = {"diagnosis": [(s.report["heldout"]["mae"]["refitted"], error_left(s.report)) for s in scored]} | {
        name: [(s.learned[BASE], s.learned[name]) for s in scored] for name in scored[0].learned if name != BASE
    }
    lines = [f"| Error on held-out laps | Cases | {' | '.join(errors)} |", "|---" * (len(errors) + 2) + "|"]
    for what, value in groups.items():
        medians = [
            np.median([s.share_removed(*e) for s, e in zip(scored, pairs, strict=True) if s in value]) if value else float("nan")
            for pairs in errors.values()
        ]
        lines.append(f"| {what} | {len(value)} | {' | '.join(f'{x:.2f}' if np.isfinite(x) else '' for x in medians)} |")
    for level in ("none", *NOT_IN_CATALOGUE):
        places = [i for i, s in enumerate(scored) if s.case.level == level]
        worse = [sum(pairs[i][1] > NO_WORSE * pairs[i][0] for i in places) for pairs in errors.values()]
        lines.append(f"| {level}: worse than the base | {len(places)} | {' | '.join(map(str, worse))} |")
    return "\n".join(lines)


def outside_table(scored: Sequence[Scored]) -> str:
    """The verdict on each case with physics that is not in the catalogue, and on each drive in a town."""
    lines = ["| Hidden | Drives | Seen by the oracle | Right | Error removed | Verdict |", "|---" * 6 + "|"]
    for s in sorted(scored, key=lambda s: (s.case.level, s.case.title)):
        if s.case.level in NOT_IN_CATALOGUE:
            location = "town" if s.case.level == "street" else s.case.source
            seen, right = ("yes" if hit else "no" for hit in (s.known.identifiable, not s.wrong))
            removed = f"{s.removed:.0%}" if s.reducible else ""
            lines.append(f"| {s.case.title} | {location} | {seen} | {right} | {removed} | {_verdict_of(s.answer)} |")
    return "\n".join(lines)


def mistake_table(kinds: Mapping[str, Sequence[Scored]]) -> str:
    """A list of mistakes by kind, with the page of the first of each and what the others were."""
    lines = ["Mistakes by kind. Each case: what was hidden, then what was named instead.", ""]
    for kind, value in kinds.items():
        lines.append(f"- {kind} ([the first]({file_name(kind)}.html)), {len(value)} {'case' if len(value) == 1 else 'cases'}:")
        lines += [f"    - {s.case.title}: {_verdict_of(s.answer)}" for s in value]
    return "\n".join(lines)


def _verdict_of(answer: Answer) -> str:
    if answer.status == DESCRIBED:
        return " + ".join(f"{term.form} ({term.about})" if term.about else term.form for term in answer.described)
    return " + ".join("/".join(members) for members in answer.classes) or answer.status


def _share(hits: int, of: int) -> str:
    return f"{hits / of:.0%}" if of else ""


def _target(name: str, value: float, shown: Callable[[float], str]) -> tuple[str, str]:
    """The target in words, and whether it is met."""
    if name not in TARGETS:
        return "", ""
    side, target = TARGETS[name]
    if not np.isfinite(value):
        return f"{side} {shown(target)}", ""
    met = value <= target if side == "at most" else value >= target
    return f"{side} {shown(target)}", "yes" if met else "**no**"


def _write_cases(path: Path, scored: Sequence[Scored]) -> None:
    rows = io.StringIO()
    writer = csv.writer(rows)
    methods = [method for method in BASELINES if all(method in s.answers for s in scored)]
    writer.writerow(["case", "level", "hidden", "said", "status", "identifiable", "oracle_gain", "mistake", *methods])
    for s in sorted(scored, key=lambda s: (s.case.level, sorted(s.true))):
        by_others = [_verdict_of(s.answers[method]) for method in methods]
        plain = "yes" if s.known.identifiable else "no"
        writer.writerow(
            [s.case.name, s.case.level, "+".join(s.case.hidden), _verdict_of(s.answer), s.answer.status, plain,
             f"{s.known.gain:.1f}", s.wrong, *by_others]
        )  # fmt: skip
    write(path, rows.getvalue().encode())


def _draw_confusion(path: Path, scored: Sequence[Scored]) -> None:
    """First names against true ones, of cases with one effect or none."""
    pairs = Counter(
        (next(iter(s.case.hidden), "nothing") if s.case.level != "outside" else "not in the catalogue", _first(s)) for s in scored
    )
    true = sorted({t for t, _ in pairs}, key=_last_of_all)
    named = sorted({a for _, a in pairs}, key=_last_of_all)
    counts = np.array([[pairs[t, a] for a in named] for t in true])
    with picture(path, 2.5 + 0.27 * len(named), 1.8 + 0.24 * len(true)) as figure:
        axes = figure.subplots()
        axes.grid(visible=False)
        share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
        axes.imshow(share, cmap="Blues", vmin=0.0, vmax=1.2, aspect="auto")
        for i, j in zip(*np.nonzero(counts), strict=True):
            axes.text(
                j, i, str(counts[i, j]), ha="center", va="center", fontsize=8, color="white" if share[i, j] > 0.7 else "black"
            )
        axes.set_xticks(range(len(named)), named, rotation=60, ha="right", rotation_mode="anchor")
        axes.set_yticks(range(len(true)), true)
        axes.set_xlabel("named first")
        axes.set_ylabel("hidden")


def _first(s: Scored) -> str:
    return {"none": "nothing"}.get(s.answer.first, s.answer.first)


def _last_of_all(name: str) -> tuple[bool, str]:
    return name in ("nothing", DESCRIBED, "unexplained", "not in the catalogue"), name
