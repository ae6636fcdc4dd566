"""Last process of a run: opens the seal and counts.

`python -m trackres_ros.proof.score FOLDER`
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from trackres_ros.proof.answers import BASELINES, Answer, of_names, of_report
from trackres_ros.proof.baselines import by_trees
from trackres_ros.proof.cases import CATALOGUE, Case, sealed
from trackres_ros.proof.follow import advised
from trackres_ros.proof.oracle import Known, ask

Array = NDArray[np.float64]

OURS = "diagnosis"
WORTH_REMOVING = 0.01  # of the error
NO_WORSE = 1.01  # than the re-fitted base: a percent is chance
ACTING_SHARE = 0.5  # of the 95th percentile: where the truth counts an effect as acting
BINS = 12
COMPARABLE = {
    "grade": ("grade", "grade"), "torque_offset": ("offset", "offset"), "torque_gain": ("error", "error"),
    "delay": ("time", "time"),
    "drivetrain_drag": ("drag", "drag"), "drivetrain_efficiency": ("efficiency", "efficiency"), "solar": ("flux", "flux"),
    "rain": ("factor", "factor"), "still_air": ("share", "share"), "cornering": ("compliance", "compliance"),
    "soft_ground": ("torque", "torque"), "warmup": ("torque", "torque"), "vibration": ("speed", "speed"),
    "rotating_inertia": ("more", "factor"),
}  # fmt: skip
"""Effects of which one parameter means nearly the same in both forms: its name here, and in the catalogue."""


@dataclass(frozen=True, eq=False)
class Scored:
    """One case, what was said of it, and what an oracle knows.

    Attributes
    ----------
    answers
        By method.
    overlap, jaccard
        Of the first true effect that was named: in time, and over the range of what it follows; nan where none was.
    resolved
        Whether the advised manoeuvre left the true effect and took from its class all that was to be told from it; None where
        none was advised, or driven.
    """

    case: Case
    report: dict[str, Any]
    known: Known
    answers: Mapping[str, Answer]
    overlap: float
    jaccard: float
    resolved: bool | None

    @property
    def true(self) -> set[str]:
        """Names of what is hidden."""
        return set(self.case.hidden)

    @property
    def answer(self) -> Answer:
        """Of the diagnosis."""
        return self.answers[OURS]

    @property
    def wrong(self) -> str:
        """What kind of mistake the diagnosis made; empty where none."""
        a = self.answer
        if self.case.level == "none":
            return "false alarm" if a.classes else ""
        if self.case.level == "outside":
            return (
                "a name for what is not in the catalogue"
                if a.classes
                else ""
                if a.status == "unexplained"
                else "unknown not noticed"
            )
        if not a.classes:
            return "not named though identifiable" if self.known.identifiable else ""
        if not a.holds(self.true):
            return "wrong name"
        if a.holds(self.true) < len(a.classes):
            return "right, and a wrong one beside"
        return "one of two missed" if self.case.level == "two" and a.holds(self.true) < 2 else ""


def main(arguments: Sequence[str]) -> None:
    """See above."""
    from trackres_ros.proof.page import write_all

    folder = Path(arguments[0])
    labels = json.loads((folder / "sealed" / "labels.json").read_text(encoding="utf-8"))
    cases = [Case(**c) for c in labels["cases"]]
    seal = sealed(labels["seed"], cases)
    assert seal == (folder / "seal.txt").read_text(encoding="utf-8").strip(), "the labels are not those that were sealed"
    simple = [json.loads((folder / "results" / f"{case.name}.json").read_text(encoding="utf-8"))["simple"] for case in cases]
    said = [next(iter(case.hidden), "none") if case.level != "outside" else "unexplained" for case in cases]
    trees: Sequence[str | None] = by_trees([s["features"] for s in simple], said, list(CATALOGUE)) or [None] * len(cases)
    scored = []
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        for done, one in enumerate(pool.map(_score, [(folder, c, t) for c, t in zip(cases, trees, strict=True)]), start=1):
            scored.append(one)
            print(f"\roracle asked {done} of {len(cases)}", end="", flush=True)
    print(flush=True)
    print(write_all(folder, scored, seal, labels["seed"]))


def _score(task: tuple[Path, Case, str | None]) -> Scored:
    folder, case, tree = task
    result = json.loads((folder / "results" / f"{case.name}.json").read_text(encoding="utf-8"))
    report, simple = result["report"], result["simple"]
    kept = folder / "sealed" / f"{case.name}.oracle.json"
    if not kept.exists():
        known = ask(folder / "cases" / case.name, [name for name in case.hidden if name in CATALOGUE])
        kept.write_text(json.dumps(asdict(known)), encoding="utf-8")
    known = Known(**json.loads(kept.read_text(encoding="utf-8")))
    answers = {name: of_names(simple[name]) for name in BASELINES if name in simple}
    if tree:
        answers["trees"] = Answer(tree, ()) if tree in ("none", "unexplained") else of_names([tree])
    overlap, jaccard = _where(folder, case, report)
    return Scored(case, report, known, {OURS: of_report(report), **answers}, overlap, jaccard, _resolved(folder, case, report))


def _where(folder: Path, case: Case, report: dict[str, Any]) -> tuple[float, float]:
    """Common part over both together, of where a true effect acts and where it is said to: in time, and over its regime."""
    of = [e for e in report["effects"] if e["name"] in case.hidden]
    if not of:
        return float("nan"), float("nan")
    truth = np.load(folder / "sealed" / f"{case.name}.npz")
    added, lengths = np.abs(truth[f"added/{of[0]['name']}"]), truth["lengths"]
    if not added.max() > 0.0:
        return float("nan"), float("nan")
    said, first = np.zeros(len(added), dtype=bool), np.concatenate(([0], np.cumsum(lengths)[:-1]))
    for recording, begin, end in of[0]["where"]["time"]:
        at = int(first[int(Path(recording).stem.removeprefix("drive_")) - 1])
        said[at + int(begin) : at + int(end)] = True
    overlap = _common(added >= ACTING_SHARE * np.percentile(added, 95.0), said)
    regime = of[0]["where"]["regime"]
    if not regime:
        return overlap, float("nan")
    variable = regime[0]["variable"]
    over = truth[f"over/{variable}"]
    inside = (over >= regime[0]["lo"]) & (over <= regime[0]["hi"])
    edges = np.unique(np.quantile(over, np.linspace(0.0, 1.0, BINS + 1)))
    place = np.clip(np.searchsorted(edges, over, side="right") - 1, 0, max(len(edges) - 2, 0))
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


def wilson(hits: int, of: int) -> tuple[float, float]:
    """95 % interval of a share."""
    if not of:
        return 0.0, 1.0
    z, share = float(norm.ppf(0.975)), hits / of
    middle = (share + z * z / (2 * of)) / (1 + z * z / of)
    half = z * np.sqrt(share * (1 - share) / of + z * z / (4 * of * of)) / (1 + z * z / of)
    return float(middle - half), float(middle + half)


def shares(scored: Sequence[Scored], method: str = OURS) -> dict[str, tuple[int, int]]:
    """Hits and tries of each score, of what a method answered."""
    by = {level: [s for s in scored if s.case.level == level] for level in {s.case.level for s in scored}}

    def share(of: Sequence[Scored], hit: Callable[[Scored, Answer], bool]) -> tuple[int, int]:
        return sum(hit(s, s.answers[method]) for s in of), len(of)

    def right(s: Scored, a: Answer) -> bool:
        return bool(a.classes) and a.first in s.true

    def in_class(s: Scored, a: Answer) -> bool:
        return a.holds(s.true) > 0

    def plain(of: Sequence[Scored]) -> list[Scored]:
        return [s for s in of if s.known.identifiable]

    single, masked, compensated = (by.get(level, []) for level in ("single", "masked", "compensated"))
    two, outside, none = (by.get(level, []) for level in ("two", "outside", "none"))
    unclear = [s for s in [*single, *masked, *compensated, *by.get("confounded", [])] if not s.known.identifiable]
    return {
        "none: false alarm": share(none, lambda _, a: bool(a.classes)),
        "none: unexplained": share(none, lambda _, a: a.status == "unexplained"),
        "single, identifiable: right name": share(plain(single), right),
        "single, all: right name": share(single, right),
        "single: truth in the reported class": share([s for s in single if s.answers[method].classes], in_class),
        "compensated, identifiable: right name": share(plain(compensated), right),
        "compensated, all: right name": share(compensated, right),
        "masked, identifiable: right name": share(plain(masked), right),
        "masked, all: right name": share(masked, right),
        "two, each identifiable: both": share([s for s in two if s.known.plain_both], lambda s, a: a.holds(s.true) >= 2),
        "two: both": share(two, lambda s, a: a.holds(s.true) >= 2),
        "two: at least one": share(two, in_class),
        "two: no false third": share(two, lambda s, a: a.holds(s.true) == len(a.classes)),
        "not identifiable: class or abstain": share(unclear, lambda s, a: not a.classes or in_class(s, a)),
        "outside: unexplained": share(outside, lambda _, a: a.status == "unexplained"),
        "outside: confident wrong name": share(outside, lambda _, a: a.status == "named"),
    }


def own_shares(scored: Sequence[Scored]) -> dict[str, tuple[int, int]]:
    """Hits and tries of what only the diagnosis answers."""
    covers, _ = comparable(scored)
    errors = [s.report["heldout"]["mae"] for s in scored]
    driven = [s.resolved for s in scored if s.resolved is not None]
    return {
        "held-out laps: never worse than the base": (
            sum(e["with_effects"] <= NO_WORSE * e["refitted"] for e in errors),
            len(errors),
        ),
        "95 % intervals cover": (sum(covers), len(covers)),
        "recommended manoeuvre resolves the tie": (sum(driven), len(driven)),
    }


def sizes(scored: Sequence[Scored]) -> dict[str, list[float]]:
    """Scores that are no shares, case by case; of the first the median is told, of the last the mean."""

    def removed(s: Scored) -> float:
        mae = s.report["heldout"]["mae"]
        return float((mae["refitted"] - mae["with_effects"]) / (s.known.mae_base - s.known.mae))

    return {
        "held-out error removed, of what the oracle removes (median)": [
            removed(s) for s in scored if s.known.mae_base - s.known.mae > WORTH_REMOVING * s.known.mae_base
        ],
        "relative error of parameters (median)": comparable(scored)[1],
        "where, in time: overlap (median)": [s.overlap for s in scored if np.isfinite(s.overlap)],
        "where, in its regime: Jaccard (median)": [s.jaccard for s in scored if np.isfinite(s.jaccard)],
        "single: size of the class (mean)": [float(len(m)) for s in scored if s.case.level == "single" for m in s.answer.classes],
    }


def comparable(scored: Sequence[Scored]) -> tuple[list[bool], list[float]]:
    """Of effects rightly named: whether the interval covers the truth, and the relative error."""
    covers, errors = [], []
    for s in scored:
        for e in s.report["effects"] if s.answer.classes else []:
            if e["name"] in s.true & set(COMPARABLE):
                here, there = COMPARABLE[e["name"]]
                true, q = s.case.hidden[e["name"]][here], e["parameters"][there]
                errors.append(abs(q["value"] / true - 1.0))
                if q["ci95"]:
                    covers.append(q["ci95"][0] <= true <= q["ci95"][1])
    return covers, errors


if __name__ == "__main__":
    main(sys.argv[1:])
