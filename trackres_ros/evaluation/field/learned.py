# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Learns real vehicles while some of their drives are replayed, and computes the error on the others.

Learned values are carried from drive to drive by a state file, and are used only if the learner itself finds them better.
Learning continues during the hold-out drives, as in a vehicle.
"""

from __future__ import annotations

import gzip
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackres_ros.estimator.estimate import Steps
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.topic_settings import settings_for
from trackres_ros.evaluation.field import bus
from trackres_ros.evaluation.field.data import car, trips
from trackres_ros.evaluation.field.live import means, run_command
from trackres_ros.learning.learner import Learner
from trackres_ros.node.parameters import make_parameters
from trackres_ros.offline.replay import replay
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.opening import open_source
from trackres_ros.text.numbers import figures
from trackres_ros.units import NANOSECOND
from trackres_ros.vehicle import AnyVehicle, load_any
from trackres_ros.vehicle.surroundings import with_surroundings

Array = NDArray[np.float64]
GROUND = {"": "no altitude", "altitude_m": "with the altitude", "grade": "with a slope made of it afterwards"}


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
    for mission in bus.missions(data):
        head, *rows = gzip.decompress(mission.read_bytes()).decode().splitlines()
        files = folder / "first_half.csv", folder / "second_half.csv"
        for file, part in zip(files, (rows[: len(rows) // 2], rows[len(rows) // 2 :]), strict=True):
            file.write_text("\n".join([head, *part]) + "\n", encoding="utf-8")
        for name, first, other in (("first", files[0], files[1]), ("second", files[1], files[0])):
            what = f"the trolley bus, one mission: the {name} half"
            yield taught(what, load_any(bus.VEHICLE), bus.TOPICS, [first], [other])
            report = folder / name
            run_command("diagnose", first, "--vehicle", bus.VEHICLE, "--topics", bus.TOPICS, "-o", report)
            vehicle = with_surroundings(load_any(report / "vehicle.yaml"), report / "surroundings.yaml")
            yield taught(f"{what}, on the road that its diagnosis found", vehicle, bus.TOPICS, [first], [other])


def taught(what: str, vehicle: AnyVehicle, topics_name: str, first: Sequence[Path], other: Sequence[Path]) -> Taught:
    """Values learned from drives of a vehicle, for the others."""
    topics = Topics.load(topics_name)
    estimator = Estimator(vehicle, settings_for(make_parameters({}).settings(), topics, ()))
    learner = Learner(estimator, "on")
    for path in first:
        _left(path, topics, estimator, learner)
    without, with_it = (np.concatenate([_left(path, topics, estimator, one) for path in other]) for one in (None, learner))
    return Taught(what, float(np.abs(without).mean()), float(np.abs(with_it).mean()))


def _left(path: Path, topics: Topics, estimator: Estimator, learner: Learner | None) -> Array:
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


def learned_page(data: Path) -> list[str]:
    """Lines of the page."""
    lines = [
        "## What one drive teaches the other",
        "",
        "The vehicles are learned while they drive (`learning: on`) on some drives. The error is that on the other drives, where "
        "learning goes on. In the last two lines of the car a slope is an input, which the estimate uses too.",
        "",
        "| What teaches | The vehicle file [Nm] | With what was learned [Nm] | |",
        "|---|---|---|---|",
    ]
    with tempfile.TemporaryDirectory() as folder:
        for one in (*of_car(data, Path(folder)), *of_bus(data, Path(folder))):
            change = f"{one.learned_nm / one.file_nm - 1.0:+.0%}"
            lines.append(f"| {one.what} | {figures(one.file_nm)} | {figures(one.learned_nm)} | {change} |")
    return [*lines, ""]
