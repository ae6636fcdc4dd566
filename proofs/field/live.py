# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Closes the loop on real vehicles: some drives are diagnosed, or the vehicle is learned in them; others are replayed with that.

The replay gives the same results as the live node. Learned values are carried from drive to drive by a state file, and are used
only if the learner itself finds them better. Learning continues during the hold-out drives, as in a vehicle.
"""

from __future__ import annotations

import gzip
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from proofs.field.trials import BUS, BUS_TOPICS, car, missions, robot, trips
from proofs.pipeline import run_command
from proofs.tables import Rows
from trackres_ros.arrays import Array
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.records import Steps
from trackres_ros.estimator.settings import settings_for
from trackres_ros.learning.learner import Learner
from trackres_ros.node.parameters import make_parameters
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.opening import open_source
from trackres_ros.recording.recording import Recording
from trackres_ros.tasks.replay_run import replay
from trackres_ros.text import figures
from trackres_ros.units import NANOSECOND
from trackres_ros.vehicle import AnyVehicle, RoadVehicle, load_any
from trackres_ros.vehicle.surroundings import with_surroundings

DIAGNOSED = 0.7  # of the only recording
MEAN_S = 4.0  # as the diagnosis compares a torque that comes once a second
SLOWEST_MPS = 0.5
GROUND = {"": "no altitude", "altitude_m": "with the altitude", "grade": "with a slope made of it afterwards"}


@dataclass(frozen=True)
class Drives:
    """Drives of one vehicle: the first for diagnosis, the rest for replay; vehicle and topics name the shipped files."""

    what: str
    vehicle: str
    topics: str
    first: tuple[Path, ...]
    rest: tuple[Path, ...]


@dataclass(frozen=True)
class LiveError:
    """Residual torque in a replay of the other drives."""

    what: str  # the files in use
    error_nm: float  # mean absolute residual, in means over `MEAN_S` while driving without a friction brake
    minutes: float  # duration of all of these


def all_drives(data: Path, folder: Path) -> Iterator[Drives]:
    """Of the bus, the car and a robot, as far as their recordings are there; tables go to `folder`."""
    for mission in missions(data):
        first, rest = parted(gzip.decompress(mission.read_bytes()).decode(), folder, "mission")
        yield Drives("the trolley bus, one mission", BUS, BUS_TOPICS, (first,), (rest,))
    if (data / "bmw_i3" / "trips.csv").is_file():
        winter = [car(data, name, folder) for name in trips(data) if name.startswith("TripB")]
        yield Drives("the car, winter trips in turn", "bmw_i3", "default", tuple(winter[::2]), tuple(winter[1::2]))
    if (data / "husky_warthog" / "husky_wetgrass.csv.gz").is_file():
        drive = robot(data, "husky_wetgrass", folder)
        first, rest = parted(drive.read_text(encoding="utf-8"), folder, "robot")
        yield Drives("the robot on wet grass, one drive", "husky", "default", (first,), (rest,))


def parted(table: str, folder: Path, name: str, share: float = DIAGNOSED) -> tuple[Path, Path]:
    """The first share of a table and the rest, as separate files."""
    head, *rows = table.splitlines()
    cut = int(share * len(rows))
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
    written, around, settings = (report / name for name in ("vehicle.yaml", "surroundings.yaml", "estimator.yaml"))
    runs: list[tuple[str, list[str | Path]]] = [("the shipped vehicle file", [drives.vehicle]), ("vehicle.yaml", [written])]
    if around.is_file():
        runs.append(("vehicle.yaml and surroundings.yaml", [written, "--surroundings", around]))
    if settings.is_file():
        what, files = runs[-1]
        runs += [
            (f"{what}, with estimator.yaml", [*files, "--params", settings]),
            (f"{what}, with `--both-sides` (offline)", [*files, "--both-sides"]),
        ]
    results = []
    for what, files in runs:
        remainder = np.concatenate([_left(drives, rest, files, folder / "replay.csv") for rest in drives.rest])
        results.append(LiveError(what, float(np.abs(remainder).mean()), MEAN_S * len(remainder) / 60.0))
    return results


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
    total = (used == number) & (number > 0)
    return np.asarray(np.bincount(block, np.where(counts, residual, 0.0))[total] / number[total])


def _braked(drives: Drives, recording: Path, rows: Any) -> NDArray[np.bool_]:
    """Where a friction brake is on; if the vehicle has unrecorded ones, where the torque brakes."""
    read = Recording.from_source(open_source([recording], Topics.load(drives.topics)))
    if "brake" in read.series:
        return np.asarray(np.interp(rows["time_s"], read.time_s("brake"), read.series["brake"].value) > 0.0)
    vehicle = load_any(drives.vehicle)
    has_brakes = isinstance(vehicle, RoadVehicle) and vehicle.friction_brakes
    return np.asarray(has_brakes & (rows["measured_torque_nm"] < 0.0))


def live_rows(data: Path) -> Rows:
    """The residual in replays of unused drives, by the files in use."""
    with tempfile.TemporaryDirectory() as folder:
        into = Path(folder)
        return [replay_row(drives.what, error) for drives in all_drives(data, into) for error in live_errors(drives, into)]


def replay_row(drives: str, error: LiveError) -> dict[str, str]:
    """A row of `live_rows`."""
    numbers = {"replayed_min": figures(error.minutes, 2), "files": error.what, "error_nm": figures(error.error_nm)}
    return {"drives": drives, **numbers}


class Taught(NamedTuple):
    """Mean error on hold-out drives [Nm], with the file and with values learned from the others."""

    what: str
    file_nm: float
    learned_nm: float


def of_car(data: Path, folder: Path) -> Iterator[Taught]:
    """Either half of the winter trips teaches, the other is looked at."""
    for ground, words in GROUND.items():
        winter = [car(data, name, folder / ground, False, ground) for name in trips(data) if name.startswith("TripB")]
        halves = {"every other trip, from the first": winter[::2], "every other trip, from the second": winter[1::2]}
        for (name, first), other in zip(halves.items(), reversed(halves.values()), strict=True):
            yield taught(f"the car, winter, {words}: {name}", load_any("bmw_i3"), "default", first, other)


def of_bus(data: Path, folder: Path) -> Iterator[Taught]:
    """Either half of a mission teaches, the other is looked at."""
    for mission in missions(data):
        files = parted(gzip.decompress(mission.read_bytes()).decode(), folder, "half", 0.5)
        for name, first, other in (("first", files[0], files[1]), ("second", files[1], files[0])):
            what = f"the trolley bus, one mission: the {name} half"
            yield taught(what, load_any(BUS), BUS_TOPICS, [first], [other])
            report = folder / name
            run_command("diagnose", first, "--vehicle", BUS, "--topics", BUS_TOPICS, "-o", report)
            vehicle = with_surroundings(load_any(report / "vehicle.yaml"), report / "surroundings.yaml")
            yield taught(f"{what}, on the road that its diagnosis found", vehicle, BUS_TOPICS, [first], [other])


def taught(what: str, vehicle: AnyVehicle, topics_name: str, first: Sequence[Path], other: Sequence[Path]) -> Taught:
    """Values learned from drives of a vehicle, for the others."""
    topics = Topics.load(topics_name)
    estimator = Estimator(vehicle, settings_for(make_parameters({}).settings(), topics))
    learner = Learner(estimator, "on")
    for path in first:
        _left_learning(path, topics, estimator, learner)
    without, with_it = (
        np.concatenate([_left_learning(path, topics, estimator, item) for path in other]) for item in (None, learner)
    )
    return Taught(what, float(np.abs(without).mean()), float(np.abs(with_it).mean()))


def _left_learning(path: Path, topics: Topics, estimator: Estimator, learner: Learner | None) -> Array:
    """Residual of a replay; without braking torques, where friction brakes may assist."""
    kept: list[Steps] = []
    if learner is not None:
        learner.restart()
    replay(open_source([path], topics), estimator, kept.append, learner=learner)
    rows, stamps = np.concatenate([steps.rows for steps in kept]), np.concatenate([steps.stamp_ns for steps in kept])
    speed, residual, measured = (
        rows[:, estimator.column_index[name]] for name in ("speed_mps", "residual_nm", "measured_torque_nm")
    )
    return means((stamps - stamps[0]) * NANOSECOND, speed, residual, measured < 0.0)


def learned_rows(data: Path) -> Rows:
    """The residual in other drives, with the vehicle file and with values learned while driving."""
    with tempfile.TemporaryDirectory() as folder:
        return [learned_row(item) for item in (*of_car(data, Path(folder)), *of_bus(data, Path(folder)))]


def learned_row(one: Taught) -> dict[str, str]:
    """A row of `learned_rows`."""
    return {"teacher": one.what, "file_nm": figures(one.file_nm), "learned_nm": figures(one.learned_nm)}
