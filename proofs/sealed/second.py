# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The proofs on cases that another simulator made, and on the groomer's: labels, and cases/NAME/session*.csv.

The scores have the names and targets of the project's own cases. Scores that need more than the labels (where an effect acts)
are omitted.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from proofs.pipeline import Proof, each, read_json
from proofs.sealed.cases import CATALOGUE, Case
from proofs.sealed.groomer import Groomer, draw_groomers, label, record_groomer
from proofs.sealed.results import report_of
from proofs.sealed.scoring import (
    ABOUT,
    BASELINES,
    CONFIRMED,
    DESCRIBED,
    OURS,
    SURE,
    OracleAnswer,
    Scored,
    fit_truth,
    of_names,
    of_report,
    words,
)
from trackres_ros.arrays import Array
from trackres_ros.errors import InputError

CLEAR = 12.0  # d' from which physics outside the catalogue is detectable
TRUE = {
    "pump": (("spells",), ()), "brake": (("spells",), ("stop", "stand")), "resonance": ((), ("speed",)),
    "backlash": ((), ("driving torque",)), "cyclic_joint": (("wave",), ()), "zero_drift": (("drift",), ()),
    "gear_state": (("spells", "latch"), ("speed",)), "overload_rub": ((), ("load", "heavy")),
    "regen_misread": ((), ("driving torque", "slow", "brak")),
    "cold": ((), ("ambient",)), "cool": ((), ("ambient",)), "load": ((), ("load", "heavy", "light")),
    "late": ((), ("since start", "since the start")),
}  # fmt: skip
"""For physics outside that catalogue: its true forms, and words of which a true description has one."""
NOT_DRAWN = {"air_drag", "speed_scale"}  # effects of the catalogue that the project's own cases do not have
GROUND, SPEED = "soft_ground", "speed_scale"
BY_CHANCE = ("pump", "brake", "zero_drift")
THRESHOLD_K, SIZE_SHARE = 1.0, 0.1  # a described switch by air temperature is true within these
HINGE_K = 10.0  # a drag that grows in the cold has its size so far below its threshold
ENDS = 4  # parts of the points of a term: its first and its last are the ends of a switch


class Label(dict[str, Any]):
    """What is known of a case."""

    @property
    def name(self) -> str:
        """Uninformative."""
        return str(self["case"])


class SecondProof(Proof):
    """Cases of a folder, whose recordings and labels are not drawn here."""

    @property
    def case_folder(self) -> Path:
        """Folder of the recordings."""
        return Path(self.settings["source"]) / "cases"

    def draw(self) -> list[Groomer]:
        """None."""
        return []

    def labels(self, _cases: Sequence[Groomer]) -> str:
        """The labels of the folder, word for word."""
        return (Path(self.settings["source"]) / "labels.json").read_bytes().decode()

    def seal(self, labels: str) -> str:
        """SHA-256 of the file of the labels."""
        return hashlib.sha256(labels.encode()).hexdigest()

    def cases(self, labels: Mapping[str, Any]) -> list[Label]:
        """The labels of the cases, which have no parameters of hidden physics."""
        return sorted(map(Label, labels["cases"]), key=lambda label: label.name)

    def scores(self, cases: Sequence[Label]) -> list[Scored]:
        """See `Proof`."""
        return each(self._score, cases)

    def _score(self, label: Label) -> Scored:
        return scored(self.case_folder, label, self.result(label.name))

    def report(self, scores: list[Scored], labels: Mapping[str, Any], seal: str) -> tuple[dict[str, Any], str]:
        """See `Proof`."""
        return report_of(self.folder, scores, self.settings["proof"], labels, seal)


class GroomerProof(SecondProof):
    """Cases of `groomer`."""

    @property
    def case_folder(self) -> Path:
        """Folder of the recordings."""
        return self.folder / "cases"

    def draw(self) -> list[Groomer]:
        """See `Proof`."""
        return draw_groomers(self.settings["counts"], self.settings["seed"])

    def labels(self, cases: Sequence[Groomer]) -> str:
        """See `Proof`."""
        return json.dumps({"seed": self.settings["seed"], "cases": each(label, cases)}, indent=1)

    def record(self, case: Groomer) -> None:
        """See `Proof`."""
        record_groomer(self.case_folder / case.name, case)


def read_labels(source: Path) -> dict[str, Any]:
    """The labels of a folder, of which each case has recordings and a kind of physics that can be scored."""
    path, expectation = source / "labels.json", "a folder with labels.json and cases/NAME/session1.csv"
    try:
        labels: dict[str, Any] = read_json(path)
        given_valuess = [
            (case["case"], case["level"], [effect["name"] for effect in case["effects"]]) for case in labels["cases"]
        ]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(str(path), f"{type(error).__name__}: {error}", expectation) from None
    known = {"outside": set(TRUE)}
    for name, level, effects in given_valuess:
        if not list((source / "cases" / name).glob("*.csv")):
            raise InputError(str(source / "cases" / name), "no recording", expectation)
        if unknown := set(effects) - known.get(level, set(CATALOGUE) | NOT_DRAWN):
            raise InputError(
                f"{path}: {name}", ", ".join(unknown), f"at level {level} a kind that the scores know", "see second.py"
            )
    return labels


def scored(cases: Path, label: Mapping[str, Any], result: Mapping[str, Any]) -> Scored:
    """Score the answer to a case by its label."""
    report, effects = result["report"], label["effects"]
    level = {"parameters_off": "none"}.get(label["level"], label["level"])
    names = [e["name"] for e in effects]
    program = {"predictable": not set(names) & set(BY_CHANCE)} if level == "outside" else {}
    case = Case(
        label["case"], level, {name: {} for name in names}, {}, False, level == "compensated", level == "confounded",
        "belt_degc" in label["given"], 0, label["driving"], program,
    )  # fmt: skip
    seen = all(e["d_prime"] >= CLEAR for e in effects) if level == "outside" else bool(label["identifiable"])
    alike = tuple(sorted({name for e in effects for name in e["acceptable"]}))
    ignored = set(label["tolerated"]) - set(names)
    named = [_accepted(e, effects) for e in report["effects"] if e["name"] not in ignored]
    report = {**report, "effects": [*named, *_by_place(names, report)]}
    report["verdict"] = _verdict_on_rest(result["report"], report)
    if level == "outside":  # hidden physics is known by its name alone: the residual is at least the noise
        result_before = float(report["heldout"]["mae"]["refitted"])
        known = OracleAnswer(0.5 * effects[0]["d_prime"] ** 2, (), seen, False, result_before, label["noise_mae"][-1]["one_s"])
    else:
        known = fit_truth(cases / case.name, names)
    known = replace(known, alike=alike, identifiable=seen, plain_both=seen and level == "two")
    answers = {name: of_names(result["simple"][name]) for name in BASELINES if name in result["simple"]}
    return Scored(
        case, report, known, {OURS: of_report(report), **answers}, np.nan, np.nan, None, result["learned"],
        _stated(effects, report, result.get("over", {})) if level == "outside" else None, _comparable(effects, report),
    )  # fmt: skip


def _accepted(found: Mapping[str, Any], effects: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """A found effect, with the hidden ones in its class for which the labels accept its name."""
    also = [e["name"] for e in effects if found["name"] in e["acceptable"] and e["name"] in CATALOGUE]
    return {**found, "class": list(dict.fromkeys([*found["class"], *also]))}


def _by_place(names: Sequence[str], report: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Soft ground is at a place of the lap there. A confirmed place is equivalent to its name."""
    placed = any(d["form"] == "place" and d["grade"] == "confirmed" for d in report.get("described", []))
    named = {e["name"] for e in report["effects"]}
    results = [name for name in names if name == GROUND and placed and name not in named]
    return [{"name": name, "class": [name], "grade": "confirmed", "parameters": {}} for name in results]


def _verdict_on_rest(given: Mapping[str, Any], rest: Mapping[str, Any]) -> dict[str, Any]:
    """The verdict where all names that were given are tolerated ones: on what else is confirmed."""
    if given["verdict"]["status"] not in SURE or rest["effects"]:
        return dict(given["verdict"])
    confirmed = any(term["grade"] == CONFIRMED for term in given.get("described", ()))
    return {**given["verdict"], "status": DESCRIBED if confirmed else "none"}


def _stated(effects: Sequence[Mapping[str, Any]], report: Mapping[str, Any], over: Mapping[str, Any]) -> bool | None:
    if report["verdict"]["status"] != DESCRIBED or not report.get("described"):
        return None
    first = report["described"][0]
    about = " ".join(words(first.get(key)) for key in ABOUT)
    return any(
        (first["form"] in TRUE[e["name"]][0] or any(word in about for word in TRUE[e["name"]][1]))
        and ("threshold" not in e or _close(e, over.get(first["name"])))
        for e in effects
    )


def _close(effect: Mapping[str, Any], points: Sequence[Sequence[float]] | None) -> bool:
    """Whether a described term has the threshold [degC] and the size [Nm] of a label, see `threshold_and_size`."""
    if not points:
        return False
    place, size = threshold_and_size(np.array(points[0]), np.array(points[1]), grows=effect["name"] == "cool")
    return bool(abs(place - effect["threshold"]) <= THRESHOLD_K and abs(size / effect["size_nm"] - 1.0) <= SIZE_SHARE)


def threshold_and_size(x: Array, torque: Array, grows: bool) -> tuple[float, float]:
    """Threshold [degC] of a torque over the air temperature, and its additional size in the cold [Nm].

    That of a torque that `grows` below the threshold is where a line bends best, and `HINGE_K` below it. That of a switch is
    halfway between the levels at both ends. Temperatures rise.
    """
    if grows:
        bends = [np.column_stack((np.ones(len(x)), np.maximum(item - x, 0.0))) for item in x[1:]]
        results = [np.linalg.lstsq(columns, torque, rcond=None)[0] for columns in bends]
        errors = [((torque - columns @ q) ** 2).sum() for columns, q in zip(bends, results, strict=True)]
        best = int(np.argmin(errors))
        return float(x[1:][best]), float(HINGE_K * results[best][1])
    part = max(len(x) // ENDS, 1)
    cold, warm = float(np.median(torque[:part])), float(np.median(torque[-part:]))
    beyond = (torque - 0.5 * (cold + warm)) * (cold - warm) <= 0.0
    return float(x[int(np.argmax(beyond))]), cold - warm


def _comparable(effects: Sequence[Mapping[str, Any]], report: Mapping[str, Any]) -> dict[str, tuple[str, float]]:
    """Of rightly named effects: the parameter equivalent to the label's, and the label's value."""
    results = {}
    for e in effects:
        for item in report["effects"] if e.get("comparable") else ():
            named = [q for q in item["parameters"] if re.search(e["comparable"]["pattern"], q)]
            if item["name"] == e["name"] and named:
                sign = np.sign(item["parameters"][named[0]]["value"]) if e["comparable"]["magnitude"] else 1.0
                true = e["comparable"]["value"]
                if e["name"] == SPEED:  # measured over true speed there, true over measured here
                    true = 1.0 / (1.0 + true) - 1.0
                results[e["name"]] = (named[0], float(abs(true) * sign if e["comparable"]["magnitude"] else true))
    return results
