# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Closes the loop on real vehicles by the commands: some drives are diagnosed, others are replayed with the resulting files.

The replay gives the same results as the live node.
"""

from __future__ import annotations

import gzip
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackres_ros.evaluation.field import bus
from trackres_ros.evaluation.field.data import car, robot, trips
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.opening import open_source
from trackres_ros.recording.recording import Recording
from trackres_ros.text.numbers import figures
from trackres_ros.vehicle import RoadVehicle, load_any

Array = NDArray[np.float64]

DIAGNOSED = 0.7  # of the only recording
MEAN_S = 4.0  # as the diagnosis compares a torque that comes once a second
SLOWEST_MPS = 0.5


@dataclass(frozen=True)
class Drives:
    """Drives of one vehicle: those for diagnosis, and those for replay.

    Attributes
    ----------
    what
        Description.
    vehicle, topics
        Names of the shipped files.
    """

    what: str
    vehicle: str
    topics: str
    first: tuple[Path, ...]
    rest: tuple[Path, ...]


@dataclass(frozen=True)
class LiveError:
    """Residual torque in a replay of the other drives.

    Attributes
    ----------
    what
        The files in use.
    error_nm
        Mean absolute residual, in means over `MEAN_S` while driving without a friction brake.
    minutes
        Duration of all of these.
    """

    what: str
    error_nm: float
    minutes: float


def all_drives(data: Path, folder: Path) -> Iterator[Drives]:
    """Of the bus, the car and a robot, as far as their recordings are there; tables go to `folder`."""
    for mission in bus.missions(data):
        with gzip.open(mission, "rt", encoding="utf-8") as lines:
            first, rest = parted(lines.read(), folder, "mission")
        yield Drives("the trolley bus, one mission", bus.VEHICLE, bus.TOPICS, (first,), (rest,))
    if (data / "bmw_i3" / "trips.csv").is_file():
        winter = [car(data, name, folder) for name in trips(data) if name.startswith("TripB")]
        yield Drives("the car, winter trips in turn", "bmw_i3", "default", tuple(winter[::2]), tuple(winter[1::2]))
    if (data / "husky_warthog" / "husky_wetgrass.csv.gz").is_file():
        drive = robot(data, "husky_wetgrass", folder)
        first, rest = parted(drive.read_text(encoding="utf-8"), folder, "robot")
        yield Drives("the robot on wet grass, one drive", "husky", "default", (first,), (rest,))


def parted(table: str, folder: Path, name: str) -> tuple[Path, Path]:
    """The first part of a table and the rest, as separate files."""
    head, *rows = table.splitlines()
    cut = int(DIAGNOSED * len(rows))
    files = folder / f"{name}_first.csv", folder / f"{name}_rest.csv"
    for file, part in zip(files, (rows[:cut], rows[cut:]), strict=True):
        file.write_text("\n".join([head, *part]) + "\n", encoding="utf-8")
    return files


def live_errors(drives: Drives, folder: Path) -> list[LiveError]:
    """Diagnose, and replay the rest with the shipped file, with the written one, and with that in the surroundings that were
    written.
    """
    report = folder / "report"
    run_command("diagnose", *drives.first, "--vehicle", drives.vehicle, "--topics", drives.topics, "-o", report)
    written, around = report / "vehicle.yaml", report / "surroundings.yaml"
    runs: list[tuple[str, list[str | Path]]] = [("the shipped vehicle file", [drives.vehicle]), ("vehicle.yaml", [written])]
    if around.is_file():
        runs.append(("vehicle.yaml and surroundings.yaml", [written, "--surroundings", around]))
    found = []
    for what, files in runs:
        left = np.concatenate([_left(drives, rest, files, folder / "replay.csv") for rest in drives.rest])
        found.append(LiveError(what, float(np.abs(left).mean()), MEAN_S * len(left) / 60.0))
    return found


def run_command(*words: str | Path) -> None:
    """Run a command of `trackres`."""
    subprocess.run([sys.executable, "-m", "trackres_ros", *map(str, words)], check=True, capture_output=True)


def _left(drives: Drives, recording: Path, vehicle: Sequence[str | Path], out: Path) -> Array:
    """Residual torque of a replay, in means over `MEAN_S` [Nm]."""
    run_command("replay", recording, "--topics", drives.topics, "-o", out, "--vehicle", *vehicle)
    rows = np.genfromtxt(out, delimiter=",", names=True)
    return means(rows["time_s"], rows["speed_mps"], rows["residual_nm"], _braked(drives, recording, rows))


def means(time_s: Array, speed: Array, residual: Array, braked: NDArray[np.bool_]) -> Array:
    """Residual torque, in means over `MEAN_S` while driving without a friction brake [Nm]."""
    counts = (np.abs(speed) > SLOWEST_MPS) & ~braked & np.isfinite(residual)
    block = (time_s / MEAN_S).astype(int)
    number, used = np.bincount(block), np.bincount(block, counts)
    whole = (used == number) & (number > 0)
    return np.asarray(np.bincount(block, np.where(counts, residual, 0.0))[whole] / number[whole])


def _braked(drives: Drives, recording: Path, rows: Any) -> NDArray[np.bool_]:
    """Where a friction brake is on; if the vehicle has unrecorded ones, where the torque brakes."""
    read = Recording.from_source(open_source([recording], Topics.load(drives.topics)))
    if "brake" in read.series:
        return np.asarray(np.interp(rows["time_s"], read.time_s("brake"), read.series["brake"].value) > 0.0)
    vehicle = load_any(drives.vehicle)
    has_brakes = isinstance(vehicle, RoadVehicle) and vehicle.friction_brakes
    return np.asarray(has_brakes & (rows["measured_torque_nm"] < 0.0))


def live_page(data: Path) -> list[str]:
    """Lines of the page."""
    lines = [
        "## What was found, live",
        "",
        "The diagnosis uses some drives. `trackres replay` then runs other drives with the files that it wrote, step by step as "
        "the live node does. A replay has no speed smoothed from both sides, and no acceleration except that of its own "
        "filter. The commands for the bus:",
        "",
        "    trackres diagnose mission_first.csv --vehicle ztbus_hess19 --topics ztbus -o report",
        "    trackres replay mission_rest.csv --vehicle report/vehicle.yaml --surroundings report/surroundings.yaml "
        "--topics ztbus -o replay.csv",
        "",
        f"The error is of means over {MEAN_S:.0f} s while the vehicle drives without friction brakes. The diagnosis uses the "
        f"first {DIAGNOSED:.0%} of a single recording, and every other one of the car's winter trips.",
        "",
        "| Drives | Replayed [min] | Files | Mean error [Nm] |",
        "|---|---|---|---|",
    ]
    with tempfile.TemporaryDirectory() as folder:
        for drives in all_drives(data, Path(folder)):
            errors = live_errors(drives, Path(folder))
            lines += [f"| {drives.what} | {figures(e.minutes, 2)} | {e.what} | {figures(e.error_nm)} |" for e in errors]
    return [*lines, ""]
