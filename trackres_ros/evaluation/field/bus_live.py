# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Closes the loop on the trolley bus by the commands: the first part of a mission is diagnosed, the rest is replayed with what
that leaves. The replay is what the live node gives.
"""

from __future__ import annotations

import csv
import gzip
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trackres_ros.evaluation.field.bus import TOPICS, VEHICLE
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.opening import open_source
from trackres_ros.recording.recording import Recording

Array = NDArray[np.float64]

DIAGNOSED = 0.7  # of a mission
MEAN_S = 4.0  # as the diagnosis compares a torque that comes once a second
SLOWEST_MPS = 0.5


@dataclass(frozen=True)
class LiveError:
    """What a replay of the rest leaves of the measured torque.

    Attributes
    ----------
    what
        The files it ran with.
    error_nm
        Mean size of what is left, in means over `MEAN_S` in which it drives and no brake is on.
    minutes
        How long all of these are together.
    """

    what: str
    error_nm: float
    minutes: float


def live_errors(mission: Path, folder: Path) -> list[LiveError]:
    """Diagnose the first part of a mission, and replay the rest with the shipped file, with the written one, and with that in the
    surroundings that were written.
    """
    first, rest = _parts(mission, folder)
    report = folder / "report"
    _run("diagnose", first, "--vehicle", VEHICLE, "--topics", TOPICS, "-o", report)
    written, around = report / "vehicle.yaml", report / "surroundings.yaml"
    runs: list[tuple[str, list[str | Path]]] = [("the shipped vehicle file", [VEHICLE]), ("vehicle.yaml", [written])]
    if around.is_file():
        runs.append(("vehicle.yaml and surroundings.yaml", [written, "--surroundings", around]))
    return [_error(what, rest, vehicle, folder / "rest_replay.csv") for what, vehicle in runs]


def _parts(mission: Path, folder: Path) -> tuple[Path, Path]:
    with gzip.open(mission, "rt", encoding="utf-8", newline="") as lines:
        head, *rows = csv.reader(lines)
    cut = int(DIAGNOSED * len(rows))
    files = folder / "first.csv", folder / "rest.csv"
    for file, part in zip(files, (rows[:cut], rows[cut:]), strict=True):
        with file.open("w", encoding="utf-8", newline="") as out:
            csv.writer(out).writerows([head, *part])
    return files


def _run(*words: str | Path) -> None:
    subprocess.run([sys.executable, "-m", "trackres_ros", *map(str, words)], check=True, capture_output=True)


def _error(what: str, recording: Path, vehicle: list[str | Path], out: Path) -> LiveError:
    _run("replay", recording, "--topics", TOPICS, "-o", out, "--vehicle", *vehicle)
    rows = np.genfromtxt(out, delimiter=",", names=True)
    read = Recording.from_source(open_source([recording], Topics.load(TOPICS)))
    brake = np.interp(rows["time_s"], read.time_s("brake"), read.series["brake"].value) > 0.0
    counts = (np.abs(rows["speed_mps"]) > SLOWEST_MPS) & ~brake & np.isfinite(rows["residual_nm"])
    block = (rows["time_s"] / MEAN_S).astype(int)
    number, used = np.bincount(block), np.bincount(block, counts)
    whole = (used == number) & (number > 0)
    left = np.bincount(block, np.where(counts, rows["residual_nm"], 0.0))[whole] / number[whole]
    return LiveError(what, float(np.abs(left).mean()), MEAN_S * int(whole.sum()) / 60.0)


def live_page(errors: list[LiveError]) -> list[str]:
    """Lines of the page."""
    around = "--vehicle report/vehicle.yaml --surroundings report/surroundings.yaml"
    return [
        "## The trolley bus, live",
        "",
        f"The first {DIAGNOSED:.0%} of the mission are diagnosed. `trackres replay` runs the rest, which the diagnosis "
        "never saw, with the files that this writes, step by step as the live node does. It has the speed of once a "
        "second alone: no speed that is smoothed from both sides, and no acceleration but that of its own filter. The "
        "commands:",
        "",
        "    trackres diagnose first.csv --vehicle ztbus_hess19 --topics ztbus -o report",
        f"    trackres replay rest.csv {around} --topics ztbus -o rest_replay.csv",
        "",
        f"| Files | Mean error of the rest, means over {MEAN_S:.0f} s, {errors[0].minutes:.0f} min without a brake [Nm] |",
        "|---|---|",
        *(f"| {e.what} | {e.error_nm:.0f} |" for e in errors),
        "",
    ]
