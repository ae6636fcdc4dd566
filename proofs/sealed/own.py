# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The proof on the project's own cases: drawn effects and programs, sealed, diagnosed, and scored against the truth.

After the diagnosis the advised manoeuvres are driven, and a second diagnosis has them too. An earlier version may diagnose
the same cases.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from proofs.pipeline import Proof, answer_all, each, read_json, unseal
from proofs.sealed.cases import CATALOGUE, NOT_IN_CATALOGUE, RIGHT_FORMS, SOURCES, Case, draw_cases
from proofs.sealed.diagnosing import HELD_OUT, by_trees
from proofs.sealed.drives import STEP_S, SealedDrive, read_profiles
from proofs.sealed.phenomena import LOAD, LONG_STOP_S, PROGRAM
from proofs.sealed.recordings import PROFILES, drive_next, make_case, sized_case, weight_and_radius
from proofs.sealed.results import report_of
from proofs.sealed.scoring import (
    BASELINES,
    DESCRIBED,
    EARLIER,
    OURS,
    Answer,
    MassError,
    OracleAnswer,
    Scored,
    fit_truth,
    mass_errors,
    of_names,
    of_report,
    true_values,
    words,
)
from proofs.sealed.truth import G
from trackres_ros.arrays import Array
from trackres_ros.diagnosis import load_base, read_recordings
from trackres_ros.diagnosis.findings.next_drives import menu
from trackres_ros.diagnosis.prepare.gate import gate
from trackres_ros.diagnosis.selection.locate import evenly_filled
from trackres_ros.errors import InputError
from trackres_ros.files.interpreter import python

FOLLOWED = "drive_next"


class OwnProof(Proof):
    """Cases of `cases`, with a score for each level."""

    def draw(self) -> list[Case]:
        """The cases; the programs of some have the size of a drawn detectability."""
        data, minutes = self.settings["profiles"], self.settings["minutes"]
        if data:
            np.savez_compressed(self.folder / "sealed" / f"{PROFILES}.npz", *read_profiles(Path(data)))
        drawing = draw_cases(self.settings["counts"], self.settings["seed"], SOURCES if data else SOURCES[:-1])
        return each(partial(sized_case, self.folder, minutes), drawing)

    def record(self, case: Case) -> None:
        """See `Proof`."""
        make_case(self.folder, self.settings["minutes"], case)

    def cases(self, labels: Mapping[str, Any]) -> list[Case]:
        """See `Proof`."""
        return [Case(**label) for label in labels["cases"]]

    def scores(self, cases: Sequence[Case]) -> list[Scored]:
        """The answers to the cases, with those of trees that learn from the others."""
        simple = [self.result(case.name)["simple"] for case in cases]
        expectations = [_expected(case) for case in cases]
        trees = by_trees([s["features"] for s in simple], expectations, list(CATALOGUE)) or [""] * len(cases)
        return each(partial(_scored, self), list(zip(cases, trees, strict=True)), "oracle fitted")

    def report(self, scores: list[Scored], labels: Mapping[str, Any], seal: str) -> tuple[dict[str, Any], str]:
        """See `Proof`."""
        return report_of(self.folder, scores, "own", labels, seal)


def earlier(cases: Path, results: Path, checkout: Path, first: int | None = None) -> None:
    """Have an earlier version diagnose the unfinished cases: a checkout, run by its own commands with the libraries installed
    here.
    """
    checkout = checkout.resolve()
    if not (checkout / "trackres_ros" / "__init__.py").is_file():
        raise InputError("--earlier", str(checkout), "a checkout of an earlier version, with its folder trackres_ros")
    answer_all(partial(_by_earlier, checkout), cases.resolve(), results.resolve(), first)


def _by_earlier(checkout: Path, folder: Path) -> tuple[dict[str, Any], dict[str, Array]]:
    with tempfile.TemporaryDirectory() as report:
        drives = sorted(folder.glob("drive_*.csv"))
        words = ("diagnose", *drives, "--vehicle", folder / "vehicle.yaml", "--quick", "-o", report)
        command = python("trackres_ros", *words, PYTHONPATH=str(checkout))
        process = subprocess.run(**command, cwd=report, capture_output=True, text=True, check=False)
        if process.returncode:
            raise RuntimeError(
                f"{folder.name}: the earlier version ended with exit code {process.returncode}: {process.stderr[-500:]}"
            )
        return read_json(Path(report) / "report.json"), {}


def follow(folder: Path, first: int | None = None) -> None:
    """Drive as advised where effects could not be distinguished, in at most so many cases as the settings say.

    It knows the vehicles, so it opens the seal. The diagnosis then gets a copy of the recordings with the new one.
    """
    proof, labels, _ = unseal(folder)
    tasks = []
    for case in sorted(proof.cases(labels), key=lambda case: str(case.name))[:first]:
        result = proof.result(case.name)["report"]
        advice = advised(result, set(case.hidden))
        if advice is not None:
            held_out = [Path(lap).name for lap in result["heldout"]["laps"]]
            tasks.append((case, str(advice["manoeuvre"]), held_out))
    each(partial(_follow, folder, proof.settings["minutes"]), tasks[: proof.settings["followed"]], "driven as advised")


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
    result_before = folder / "cases" / case.name
    recorded = drive_next(folder, case, minutes, FOLLOWED, lambda last: planned(manoeuvre, result_before, last))
    into.mkdir(parents=True, exist_ok=True)
    for path in [*sorted(result_before.glob("drive_[0-9]*.csv")), result_before / "vehicle.yaml"]:
        shutil.copy(path, into / path.name)
    (into / HELD_OUT).write_text(json.dumps(held_out), encoding="utf-8")
    recorded.rename(into / recorded.name)


def planned(manoeuvre: str, before: Path, last: SealedDrive) -> SealedDrive:
    """A manoeuvre of the menu as a drive, on a day like that of the last drive."""
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


BOUND = 0.4
ALL, TWO_LEVELS = 0.7, 0.92  # correlations: with the main part of a torque; with its levels (a sine has 0.90)
BLOCK_S, BINS, SIDES = 37, 10, 3  # length of a block; bins of a variable; bins of a gate
STANDING_MPS, BRAKING_MPS2 = 0.1, -0.3
MEANT = {
    "yaw rate to the left": ("left", "right"), "yaw rate": ("turn",), "load": ("heavy", "light", "load"),
    "acceleration": ("slow", "brak", "speeds up", "accelerat"), "driving torque": ("torque",),
    "time since start": ("time of day", "since start"), "speed": ("pulls away", "to a stop", "m/s"),
}  # fmt: skip
"""Words that mean a variable without its own name."""
ALSO = {
    "distance": "distance run", "distance since a stop": "distance since a long stop",
    "time since a stop": "time since a long stop",
}  # fmt: skip
"""Second meaning of a variable: since the vehicle's first drive, and since a stop of at least `LONG_STOP_S`."""
CLOCKS = ("distance", "distance run", "time since start")


def is_true(term: Mapping[str, Any], over: Mapping[str, Array], added: Array, lengths: Array) -> bool:
    """Whether a described term of report.json is true of the hidden torque.

    It names variables, a gate, or a temporal pattern. It is true if a function of just that explains the hidden torque with a
    partial correlation of at least `BOUND`, in blocks of time to which the function was not fitted. The part that a re-fit of the
    vehicle file can absorb is removed first.

    Variables and torque of the hidden physics [Nm] are by seconds, one drive after the other; `lengths` are those of the drives.
    """
    form = str(term["form"])
    series = {**over, **_since_stops(over, lengths)}
    if form == "spells":
        return _two_levels(np.split(added, np.cumsum(lengths)[:-1]))
    if form == "recordings":
        return partial_correlation([np.repeat(np.arange(len(lengths)), lengths.astype(int))], over, added) >= BOUND
    if form == "drift":  # slow, and no single variable explains it
        rivals = [x for name, x in over.items() if name not in CLOCKS]
        return (
            _correlation(_smooth(added, 60), added)
            >= ALL
            > max(partial_correlation([_bins(x, BINS)], over, added) for x in rivals)
        )
    if form in ("wave", "place"):
        period = term.get("period_m")
        return (
            period is not None
            and partial_correlation([_bins(series["distance"] % float(period), 2 * BINS)], over, added) >= BOUND
        )
    named = [*_named(words(term.get("variable")), series)[:1], *_named(words(term.get("gate")), series)[:1]]
    meant = [[series[x] for x in (name, ALSO.get(name)) if x in series] for name in named]
    return any(
        partial_correlation([_bins(x, count) for x, count in zip(xs, (BINS, SIDES), strict=False)], over, added) >= BOUND
        for xs in product(*meant) if xs
    )  # fmt: skip


def partial_correlation(groups: list[NDArray[np.int64]], over: Mapping[str, Array], target: Array) -> float:
    """Partial correlation of a torque with a free function of binned variables, given the part that the base can absorb."""
    base = np.column_stack([np.ones(len(target)), over["load"], over["load"] * over["belt temperature"], over["speed"] ** 2])
    base = base / np.abs(base).max(axis=0)
    cells = np.stack([np.all([g == k for g, k in zip(groups, key, strict=True)], axis=0)
                      for key in product(*(range(int(g.max()) + 1) for g in groups))], axis=1)  # fmt: skip
    half = np.arange(len(target)) // BLOCK_S % 2
    errors = np.zeros(2)
    for fit_result in (half == 0, half == 1):
        for i, columns in enumerate((base, np.hstack((base, cells)))):
            ridge = 1e-3 * np.sqrt(fit_result.sum()) * np.eye(columns.shape[1])
            wanted = np.append(target[fit_result], np.zeros(columns.shape[1]))
            result = np.linalg.lstsq(np.vstack((columns[fit_result], ridge)), wanted, rcond=None)[0]
            errors[i] += float(((target - columns @ result)[~fit_result] ** 2).sum())
    return float(np.sqrt(max(0.0, 1.0 - errors[1] / max(errors[0], 1e-12))))


def _named(text: str, series: Mapping[str, Array]) -> list[str]:
    """Variables that a text names, the longest name first; else those that it implies."""
    given_values = sorted((name for name in series if name in text), key=len, reverse=True)
    return given_values or [name for name, meant in MEANT.items() if any(word in text for word in meant)]


def _bins(x: Array, count: int) -> NDArray[np.int64]:
    """Numbers of bins: half of the edges divide the time evenly, half the range."""
    low, high = np.quantile(x, (0.002, 0.998))
    share = np.linspace(0.0, 1.0, count // 2 + 2)[1:-1]
    edges = np.unique(np.concatenate((np.quantile(x, share), low + share * (high - low))))
    return np.searchsorted(edges, x, side="right")


def _since_stops(over: Mapping[str, Array], lengths: Array) -> dict[str, Array]:
    """Distance [m] and time [s] since a stop and since a long one, and time since a deceleration; they restart in each drive.
    Before its first long stop a drive has the largest values.
    """
    second, way = np.arange(len(over["speed"]), dtype=float), np.cumsum(np.abs(over["speed"]))
    begins = np.isin(second, np.cumsum(lengths) - lengths)

    def since(series: Array, event: NDArray[np.bool_]) -> Array:
        return np.asarray(series - np.maximum.accumulate(np.where(event | begins, series, 0.0)))

    stops, slows = np.abs(over["speed"]) < STANDING_MPS, over["acceleration"] < BRAKING_MPS2
    long = stops & (since(second, ~stops) >= LONG_STOP_S)
    none_yet = np.concatenate([np.cumsum(item) == 0 for item in np.split(long, np.cumsum(lengths)[:-1].astype(int))])
    return {
        "distance since a stop": since(way, stops),
        "time since a stop": since(second, stops),
        "distance since a long stop": np.where(none_yet, way[-1], since(way, long)),
        "time since a long stop": np.where(none_yet, second[-1], since(second, long)),
        "braking": since(second, slows),
    }


def _two_levels(added: list[Array]) -> bool:
    """Whether a torque has two levels in each drive, and stays at each for a while."""
    fit_result, lasts = [], list[Array]()
    for item in added:
        slow = _smooth(item, 5)
        high = slow > 0.5 * np.sum(np.quantile(slow, (0.05, 0.95)))
        fit_result.append(np.where(high, item[high].mean() if high.any() else 0.0, item[~high].mean() if not high.all() else 0.0))
        lasts.append(np.diff(np.flatnonzero(np.diff(high.astype(int)))))
    held = np.concatenate(lasts)
    return (
        len(held) > 0
        and float(np.median(held)) >= 5.0
        and _correlation(np.concatenate(fit_result), np.concatenate(added)) >= TWO_LEVELS
    )


def _smooth(x: Array, seconds: int) -> Array:
    window = np.full(seconds, 1.0 / seconds)
    return np.convolve(np.pad(x, seconds // 2, mode="edge"), window, mode="valid")[: len(x)]


def _correlation(one: Array, other: Array) -> float:
    if one.std() < 1e-12 or other.std() < 1e-12:
        return 0.0
    return float(np.corrcoef(one, other)[0, 1])


Truth = Mapping[str, Any]
"""The kept part of the truth of a case, see `recordings`."""

ACTING_SHARE = 0.5  # of the 95th percentile: where the truth counts an effect as acting
REGIME_BINS = 12


def _expected(case: Case) -> str:
    """The right answer of a method that only gives names."""
    first = next(iter(case.hidden), "none")
    return first if first in (*CATALOGUE, "none") else "unexplained"


def _scored(proof: OwnProof, task: tuple[Case, str]) -> Scored:
    (case, tree), folder = task, proof.folder
    result = proof.result(case.name)
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
    if (folder / "results_earlier" / f"{case.name}.json").exists():
        answers[EARLIER] = of_report(proof.result(case.name, "results_earlier"))
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
    descriptions = [term["stretches"] for term in report.get("described", ()) if term["form"] == "payload"]
    if LOAD not in case.hidden or not descriptions:
        return []
    speed, weight = (np.split(truth[f"over/{name}"], np.cumsum(truth["lengths"])[:-1]) for name in ("speed", "load"))
    nominal, _ = weight_and_radius()
    greatest = case.hidden[LOAD]["share"] * nominal / G
    results = []
    for i, (v, w) in enumerate(zip(speed, weight, strict=True), start=1):
        stretches = [item for item in descriptions[0] if Path(item["recording"]).stem == f"drive_{i}"]
        results += mass_errors(v, (w - nominal) / G, stretches, greatest)
    return results


def _where(case: Case, truth: Truth, report: dict[str, Any]) -> tuple[float, float]:
    """Intersection over union of the true and the reported action of an effect: in time, and over its regime."""
    item = [e for e in report["effects"] if e["name"] in case.hidden]
    if not item:
        return np.nan, np.nan
    added, lengths = np.abs(truth[f"added/{item[0]['name']}"]), truth["lengths"]
    if not added.max() > 0.0:
        return np.nan, np.nan
    indicated, first = np.zeros(len(added), dtype=bool), np.concatenate(([0], np.cumsum(lengths)[:-1]))
    for recording, begin, end in item[0]["where"]["time"]:
        place_here = int(first[int(Path(recording).stem.removeprefix("drive_")) - 1])
        indicated[place_here + int(begin) : place_here + int(end)] = True
    overlap = _common(added >= ACTING_SHARE * np.percentile(added, 95.0), indicated)
    regime = item[0]["where"]["regime"]
    over = truth.get(f"over/{regime[0]['variable']}") if regime else None
    if over is None:
        return overlap, np.nan
    is_inside = (over >= regime[0]["lo"]) & (over <= regime[0]["hi"])
    _, place = evenly_filled(over, REGIME_BINS)
    means = np.bincount(place, weights=added) / np.maximum(np.bincount(place), 1)
    return overlap, _common((means >= ACTING_SHARE * means.max())[place], is_inside)


def _common(one: NDArray[np.bool_], other: NDArray[np.bool_]) -> float:
    return float((one & other).sum() / max((one | other).sum(), 1))


def _resolved(folder: Path, case: Case, report: dict[str, Any]) -> bool | None:
    path = folder / "results_next" / f"{case.name}.json"
    if not path.exists():
        return None
    advice, true = advised(report, set(case.hidden)), set(case.hidden)
    assert advice is not None
    result_after = of_report(read_json(path)["report"])
    stays = {name for group in advice["groups"] if set(group) & true for name in group}
    gone = set(advice["separates"]) - stays
    return any(set(members) & true & stays and not set(members) & gone for members in result_after.classes)
