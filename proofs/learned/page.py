# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The page of the proof of the learning, and its pictures."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from proofs.learned.cases import DRIVES, KINDS, SENSORS
from proofs.processes import write_scores
from trackres_ros.estimator import columns as at
from trackres_ros.files.file_sets import file_set
from trackres_ros.output.style import BLACK, BLUE, GREY, VERMILION, picture

PICTURE = "learning.png"
LAST = DRIVES
WAYS = (
    (f"file_{LAST}", "the vehicle file"),
    (f"after_one_{LAST}", "learned, one drive before"),
    (f"refit_one_{LAST}", "re-fitted to that drive"),
    (f"learned_{LAST}", "learned, two drives before"),
    (f"refit_{LAST}", "re-fitted to those two"),
    (f"oracle_{LAST}", "oracle: re-fitted to all three"),
)
MOST_WORSE = 0.02
SHORT = {
    "a disturbance of": "a disturbance",
    "is being checked": "a step is being checked",
    "disagree with the others": "torques disagree with the others",
}


@file_set()
def write_page(folder: Path, scores: dict[str, Any]) -> None:
    """Write scores, page and picture."""
    plain = [case for case in scores["cases"] if not case["hostile"]]
    hostile = [case for case in scores["cases"] if case["hostile"]]
    draw(plain, folder / PICTURE)
    parts = _head(scores, plain, hostile), _of_vehicles(plain), _of_hostile(hostile), _of_age(scores["ageing"])
    write_scores(folder, scores, "proof-learning.md", "\n".join(line for part in parts for line in part) + "\n")


def _head(scores: dict[str, Any], plain: list[Any], hostile: list[Any]) -> list[str]:
    sealed, scored = scores["sealed"], len(scores["cases"])
    first = (
        f"Of {sealed} sealed vehicles the first {scored} by their drawn names" if scored < sealed else f"{sealed} sealed vehicles"
    )
    return [
        f"{first}: {len(plain)} whose files are off, {len(hostile)} on whose drives something misleads. {DRIVES} drives of "
        f"{scores['minutes']:g} minutes each, two weeks apart, with a state file between. Seed: {scores['seed']}, SHA-256 of "
        "the labels",
        f"`{scores['seal']}`.",
        "",
    ]


def _of_vehicles(plain: list[Any]) -> list[str]:
    if not plain:
        return []
    lines = [
        f"![Error of the feed-forward over the third drive, of each vehicle.]({PICTURE})",
        "",
        "| Feed-forward on the third drive | Mean error, median [% of torque] | 90 % of vehicles below | Better than the file |",
        "|---|---|---|---|",
    ]
    file = np.array([case["errors"][WAYS[0][0]] for case in plain])
    for key, name in WAYS:
        errors = np.array([case["errors"][key] for case in plain])
        better = f"{int((errors < file).sum())} of {len(plain)}" if key != WAYS[0][0] else ""
        lines.append(f"| {name} | {100.0 * np.median(errors):.2f} | {100.0 * np.quantile(errors, 0.9):.2f} | {better} |")
    one = _ratio(plain, f"after_one_{LAST}", f"refit_one_{LAST}")
    two = _ratio(plain, f"learned_{LAST}", f"refit_{LAST}")
    seconds = [float(case["inside"][LAST - 1]) for case in plain]
    means = [bool(case["mean_inside"][LAST - 1]) for case in plain]
    worse = [float(case["worse"][i]) for case in plain for i in range(DRIVES)]
    return [
        *lines,
        "",
        f"Learned over re-fitted, median of the vehicles: {one:.2f} after one drive, {two:.2f} after two (target: at most 1.3). "
        f"Intervals of 95 % cover the torque in {100.0 * np.mean(seconds):.1f} % of all seconds of the third drive. They "
        f"cover its mean in {sum(means)} of {len(means)} drives. The target is 90 to 98 %. At worst, learning changed the error "
        f"of a drive by {100.0 * max(worse):+.1f} % of the torque. {_of_mass(plain)}",
        "",
    ]


def _of_mass(plain: list[Any]) -> str:
    """Learned error of a mass that is right in the file."""
    off = [case["said"][str(LAST)]["applied"][at.OF_MASS] for case in plain if at.OF_MASS in case["said"][str(LAST)]["counts"]]
    if not off:
        return "No mass counts as learned."
    return (
        f"The rotating-mass factor is right in all files. It is learned on drives of {len(off)} vehicles and is then off by "
        f"{100.0 * float(np.median(off)):+.1f} % in the median, {100.0 * max(map(abs, off)):.1f} % at worst."
    )


def _ratio(plain: list[Any], key: str, over: str) -> float:
    return float(np.median([case["errors"][key] / case["errors"][over] for case in plain]))


def _of_hostile(hostile: list[Any]) -> list[str]:
    if not hostile:
        return []
    lines = [
        "| What misleads | Vehicles | Worst over the file [% of torque] | Drives worse by more than 2 % | Outside the ranges "
        "| Status [s a drive] |",
        "|---|---|---|---|---|---|",
    ]
    for kind in KINDS:
        of = [case for case in hostile if case["hostile"] == kind]
        if not of:
            continue
        worse = [float(x) for case in of for x in case["worse"]]
        bad = sum(x > MOST_WORSE for x in worse)
        outside = sum(case["outside"] for case in of)
        where = "sensor" if kind in SENSORS else "vehicle or ground"
        shares = f"{100.0 * max(worse):+.1f} | {bad} of {len(worse)}"
        lines.append(f"| {kind} ({where}) | {len(of)} | {shares} | {outside} | {_said(of)} |")
    drives = [float(x) for case in hostile for x in case["worse"]]
    bad = sum(x > MOST_WORSE for x in drives)
    silent = [case["hostile"] for case in hostile for i in range(DRIVES) if not case["said"][str(i + 1)]["said_s"]]
    which = ", ".join(f"{kind} {count}" for kind, count in sorted(Counter(silent).items()))
    return [
        *lines,
        "",
        f"Worse than the file by more than 2 % of the torque: {bad} of {len(drives)} drives (target: none). Without a remark "
        f"in the status: {len(silent)} of {len(drives)} drives (target: none){': ' if which else ''}{which}.",
        "",
    ]


def _said(cases: list[Any]) -> str:
    """The most frequent statuses, with their mean time in a drive [s]."""
    seconds: dict[str, float] = {}
    for case in cases:
        for i in range(DRIVES):
            for text, s in case["said"][str(i + 1)]["said_s"].items():
                short = next((said for words, said in SHORT.items() if words in text), text)
                seconds[short] = seconds.get(short, 0.0) + s
    found = sorted(((s, text) for text, s in seconds.items()), reverse=True)
    drives = len(cases) * DRIVES
    return "; ".join(f"{text}: {s / len(cases) / DRIVES:.0f}" for s, text in found[:3] if s >= 0.5 * drives) or "nothing"


def _of_age(aged: list[dict[str, float]] | None) -> list[str]:
    if not aged:
        return []
    late = aged[len(aged) // 10 :]
    errors = [hour["error"] for hour in late]
    first, last = np.mean(errors[: len(errors) // 2]), np.mean(errors[len(errors) // 2 :])
    return [
        f"An age of {len(aged)} hours of driving: the error of the torque is {100.0 * first:.2f} % over the first half and "
        f"{100.0 * last:.2f} % over the second. In the worst hour it is {100.0 * max(errors):.2f} %. The state file has "
        f"{aged[0]['bytes']:.0f} bytes after the first hour and {aged[-1]['bytes']:.0f} after the last.",
        "",
    ]


def draw(plain: list[Any], path: Path) -> None:
    """Error of each method, of each vehicle, in the order of the file's error."""
    if not plain:
        return
    with picture(path, 8.0, 3.4) as figure:
        axes = figure.subplots()
        order = np.argsort([case["errors"][WAYS[0][0]] for case in plain])
        for (key, name), colour, mark in zip(WAYS, (GREY, BLUE, VERMILION, BLUE, VERMILION, BLACK), "osodD+", strict=True):
            if key in (f"after_one_{LAST}", f"refit_one_{LAST}"):
                continue
            errors = [100.0 * plain[i]["errors"][key] for i in order]
            axes.plot(errors, mark, color=colour, markersize=4, label=name, linestyle="none")
        axes.set_xlabel("vehicles, by what their file is off", color=BLACK)
        axes.set_ylabel("error of the feed-forward [% of torque]")
        axes.set_ylim(bottom=0.0)
        axes.legend(loc="upper left")
