"""Third process of a run: opens the seal and counts.

`python -m trackres_ros.proof.score FOLDER`
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from trackres_ros.proof.cases import CATALOGUE, Case, sealed
from trackres_ros.proof.oracle import Known, ask

Array = NDArray[np.float64]

WORTH_REMOVING = 0.01  # of the error
ACTING_SHARE = 0.5  # of the 95th percentile: where the truth counts an effect as acting
COMPARABLE = {
    "grade": ("grade", "grade"), "torque_offset": ("offset", "offset"), "torque_gain": ("error", "error"),
    "delay": ("time", "time"),
    "drivetrain_drag": ("drag", "drag"), "drivetrain_efficiency": ("efficiency", "efficiency"), "solar": ("flux", "flux"),
    "rain": ("factor", "factor"), "still_air": ("share", "share"), "cornering": ("compliance", "compliance"),
    "soft_ground": ("torque", "torque"), "warmup": ("torque", "torque"), "vibration": ("speed", "speed"),
    "rotating_inertia": ("more", "factor"),
}  # fmt: skip
"""Effects of which one parameter means nearly the same in both forms: its name here, and in the catalogue."""
TARGETS = {
    "false alarm on none": ("at most", 0.05), "right name, identifiable single": ("at least", 0.90),
    "truth in the reported class, single": ("at least", 0.95), "right name, compensated": ("at least", 0.85),
    "right name, masked": ("at least", 0.70), "two: both": ("at least", 0.70), "two: at least one": ("at least", 0.95),
    "two: no false third": ("at least", 0.90), "not identifiable: class or abstain": ("at least", 0.90),
    "outside: unexplained": ("at least", 0.80), "outside: confident wrong name": ("at most", 0.10),
    "held-out: never worse than the base": ("at least", 0.97), "95 % intervals cover": ("at least", 0.90),
    "median relative error of parameters": ("at most", 0.15),
    "median share of the oracle's gain on held-out laps": ("at least", 0.9),
    "median overlap in time of where it acts": ("at least", 0.7), "mean size of the class, single": ("at most", 1.5),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Scored:
    """One case, what was said of it, and what an oracle knows."""

    case: Case
    report: dict[str, Any]
    known: Known
    overlap: float  # in time, of the first true effect; nan where it was not named

    @property
    def true(self) -> set[str]:
        """Names of what is hidden."""
        return set(self.case.hidden)

    @property
    def named(self) -> list[str]:
        """Names that were given, one for each class."""
        return [e["name"] for e in self.report["effects"]] if self.spoke else []

    @property
    def classes(self) -> list[list[str]]:
        """Classes that were given."""
        return [e["class"] for e in self.report["effects"]] if self.spoke else []

    @property
    def status(self) -> str:
        """Of the verdict."""
        return str(self.report["verdict"]["status"])

    @property
    def spoke(self) -> bool:
        """Whether it stands by its names."""
        return self.status in ("named", "one_of")


def main(arguments: Sequence[str]) -> None:
    """See above."""
    folder = Path(arguments[0])
    labels = json.loads((folder / "sealed" / "labels.json").read_text(encoding="utf-8"))
    cases = [Case(**c) for c in labels["cases"]]
    seal = sealed(labels["seed"], cases)
    assert seal == (folder / "seal.txt").read_text(encoding="utf-8").strip(), "the labels are not those that were sealed"
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        scored = list(pool.map(_score, [(folder, case) for case in cases]))
    (folder / "scores.json").write_text(json.dumps(_plain(scored, seal), indent=1), encoding="utf-8")
    text = page(scored, seal, labels["seed"])
    (folder / "proof.md").write_text(text, encoding="utf-8")
    print(text)


def _score(task: tuple[Path, Case]) -> Scored:
    folder, case = task
    report = json.loads((folder / "results" / f"{case.name}.json").read_text(encoding="utf-8"))
    kept = folder / "sealed" / f"{case.name}.oracle.json"
    if not kept.exists():
        known = ask(folder / "cases" / case.name, [name for name in case.hidden if name in CATALOGUE])
        kept.write_text(json.dumps(asdict(known)), encoding="utf-8")
    known = Known(**json.loads(kept.read_text(encoding="utf-8")))
    return Scored(case, report, known, _overlap(folder, case, report))


def _overlap(folder: Path, case: Case, report: dict[str, Any]) -> float:
    """Of the times where the first true effect acts and where it is said to act: common part over both together."""
    of = [e for e in report["effects"] if case.hidden and e["name"] == next(iter(case.hidden))]
    if not of:
        return float("nan")
    truth = np.load(folder / "sealed" / f"{case.name}.npz")
    added, lengths = np.abs(truth[f"added/{of[0]['name']}"]), truth["lengths"]
    if not added.max() > 0.0:
        return float("nan")
    acts = added >= ACTING_SHARE * np.percentile(added, 95.0)
    said = np.zeros(len(added), dtype=bool)
    begins = dict(
        zip((f"drive_{i + 1}" for i in range(len(lengths))), np.concatenate(([0], np.cumsum(lengths)[:-1])), strict=True)
    )
    for recording, begin, end in of[0]["where"]["time"]:
        first = int(begins[Path(recording).stem])
        said[first + int(begin) : first + int(end)] = True
    return float((acts & said).sum() / max((acts | said).sum(), 1))


def wilson(hits: int, of: int) -> tuple[float, float]:
    """95 % interval of a share."""
    if not of:
        return 0.0, 1.0
    z, share = float(norm.ppf(0.975)), hits / of
    middle = (share + z * z / (2 * of)) / (1 + z * z / of)
    half = z * np.sqrt(share * (1 - share) / of + z * z / (4 * of * of)) / (1 + z * z / of)
    return float(middle - half), float(middle + half)


def rows(scored: Sequence[Scored]) -> dict[str, tuple[int, int]]:
    """Hits and tries of each score."""
    by = {level: [s for s in scored if s.case.level == level] for level in {s.case.level for s in scored}}

    def share(of: Sequence[Scored], hit: Callable[[Scored], bool]) -> tuple[int, int]:
        return sum(hit(s) for s in of), len(of)

    def right(s: Scored) -> bool:
        return bool(s.named) and s.named[0] in s.true

    def in_class(s: Scored) -> bool:
        return any(s.true & set(members) for members in s.classes)

    single, masked, compensated = (by.get(level, []) for level in ("single", "masked", "compensated"))
    two, outside, none = (by.get(level, []) for level in ("two", "outside", "none"))
    unclear = [s for s in [*single, *masked, *compensated, *by.get("confounded", [])] if not s.known.identifiable]
    found: dict[str, tuple[int, int]] = {
        "false alarm on none": share(none, lambda s: s.spoke),
        "none: unexplained": share(none, lambda s: s.status == "unexplained"),
        "right name, identifiable single": share([s for s in single if s.known.identifiable], right),
        "right name, any single": share(single, right),
        "truth in the reported class, single": share([s for s in single if s.classes], in_class),
        "right name, compensated": share([s for s in compensated if s.known.identifiable], right),
        "right name, any compensated": share(compensated, right),
        "right name, masked": share([s for s in masked if s.known.identifiable], right),
        "right name, any masked": share(masked, right),
        "two: both": share(two, lambda s: sum(bool(s.true & set(m)) for m in s.classes) >= 2),
        "two: at least one": share(two, in_class),
        "two: no false third": share(two, lambda s: all(s.true & set(m) for m in s.classes)),
        "not identifiable: class or abstain": share(unclear, lambda s: not s.spoke or in_class(s)),
        "outside: unexplained": share(outside, lambda s: s.status == "unexplained"),
        "outside: confident wrong name": share(outside, lambda s: s.status == "named"),
        "held-out: never worse than the base": share(
            scored, lambda s: s.report["heldout"]["mae"]["with_effects"] <= 1.01 * s.report["heldout"]["mae"]["refitted"]
        ),
    }
    covers, _ = comparable(scored)
    found["95 % intervals cover"] = (sum(covers), len(covers))
    return found


def comparable(scored: Sequence[Scored]) -> tuple[list[bool], list[float]]:
    """Of effects rightly named: whether the interval covers the truth, and the relative error."""
    covers, errors = [], []
    for s in scored:
        for e in s.report["effects"] if s.spoke else []:
            if e["name"] in s.true & set(COMPARABLE):
                here, there = COMPARABLE[e["name"]]
                true, q = s.case.hidden[e["name"]][here], e["parameters"][there]
                errors.append(abs(q["value"] / true - 1.0))
                if q["ci95"]:
                    covers.append(q["ci95"][0] <= true <= q["ci95"][1])
    return covers, errors


def page(scored: Sequence[Scored], seal: str, seed: int) -> str:
    """The scores as a page."""
    lines = ["| Score | Measured | 95 % interval | Target | Met |", "|---|---|---|---|---|"]
    for name, (hits, of) in rows(scored).items():
        low, high = wilson(hits, of)
        shown = f"{hits / of:.0%} ({hits} of {of})" if of else "no case"
        target, met = _target(name, hits / of if of else float("nan"), lambda x: f"{x:.0%}")
        lines.append(f"| {name} | {shown} | {low:.0%} to {high:.0%} | {target} | {met} |")
    for name, values in _sizes(scored).items():
        if values:
            value = float(np.mean(values) if name.startswith("mean") else np.median(values))
            target, met = _target(name, value, lambda x: f"{x:g}")
            lines.append(f"| {name} | {value:.2g} ({len(values)}) | | {target} | {met} |")
    lines += ["", f"{len(scored)} cases, seed {seed}, sealed as SHA-256 `{seal}`.", ""]
    lines += ["| Level | Hidden | Said | Identifiable | Oracle's gain |", "|---|---|---|---|---|"]
    for s in sorted(scored, key=lambda s: (s.case.level, sorted(s.true))):
        said = "; ".join(" or ".join(m) for m in s.classes) or s.status
        if not all(s.true & set(m) for m in s.classes):
            said += " (wrong)"
        plain = "yes" if s.known.identifiable else "no"
        lines.append(f"| {s.case.level} | {', '.join(sorted(s.true)) or '-'} | {said} | {plain} | {s.known.gain:.0f} |")
    return "\n".join(lines) + "\n"


def _target(name: str, value: float, shown: Callable[[float], str]) -> tuple[str, str]:
    """The target in words, and whether it is met."""
    if name not in TARGETS:
        return "", ""
    side, target = TARGETS[name]
    met = value <= target if side == "at most" else value >= target
    return f"{side} {shown(target)}", "yes" if met else "**no**"


def _sizes(scored: Sequence[Scored]) -> dict[str, list[float]]:
    """Scores that are no shares, case by case."""

    def removed(s: Scored) -> float:
        mae = s.report["heldout"]["mae"]
        return float((mae["refitted"] - mae["with_effects"]) / (s.known.mae_base - s.known.mae))

    return {
        "median relative error of parameters": comparable(scored)[1],
        "median share of the oracle's gain on held-out laps": [
            removed(s) for s in scored if s.known.mae_base - s.known.mae > WORTH_REMOVING * s.known.mae_base
        ],
        "median overlap in time of where it acts": [s.overlap for s in scored if np.isfinite(s.overlap)],
        "mean size of the class, single": [float(len(m)) for s in scored if s.case.level == "single" for m in s.classes],
    }


def _plain(scored: Sequence[Scored], seal: str) -> dict[str, Any]:
    return {
        "seal": seal,
        "scores": {name: {"hits": hits, "of": of, "interval": wilson(hits, of)} for name, (hits, of) in rows(scored).items()},
        "cases": [
            {"name": s.case.name, "level": s.case.level, "true": sorted(s.true), "status": s.status, "classes": s.classes}
            for s in scored
        ],
    }


if __name__ == "__main__":
    main(sys.argv[1:])
