# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes a simulated fleet: recordings in a folder for each vehicle, and fleet.yaml."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from pathlib import Path

import yaml

from trackres_ros.errors import InputError
from trackres_ros.evaluation.fleet.draw import (
    BEARING,
    DAY_S,
    LOSS,
    RAMP,
    START_S,
    STEP,
    VEHICLE,
    DrawnVehicle,
    draw_fleet,
    write_recording,
)

SAMPLE_CHANGES = ((BEARING, RAMP, 0.4), (BEARING, STEP, 0.2), (LOSS, STEP, 0.15))
ANSWERS, FLEET, RECORDINGS = "answers.json", "fleet.yaml", "recordings"
BEARING_LIMIT = 0.012  # upper limit of a bearing in the vehicle file


def write_sample(
    folder: Path,
    vehicles: int,
    days: int,
    every: float,
    minutes: float,
    seed: int,
    on_begin: Callable[[int], Callable[[float], None]],
) -> list[DrawnVehicle]:
    """A simulated fleet for trials, in which up to three vehicles change; answers.json lists them.

    InputError if a recording is longer than the time between two, or the folder has other content.
    """
    fleet = draw_fleet(vehicles, days, every, minutes, SAMPLE_CHANGES, seed)
    if folder.exists() and any(folder.iterdir()) and not (folder / FLEET).exists():
        raise InputError("-o", str(folder), "a folder that is empty, or that holds an earlier sample")
    write_recordings(folder, fleet, minutes, on_begin)
    answers = [
        {"vehicle": v.name, **asdict(v.hidden), "since_s": START_S + v.days[v.hidden.first] * DAY_S} for v in fleet if v.hidden
    ]
    (folder / ANSWERS).write_text(json.dumps(answers, indent=1) + "\n", encoding="utf-8")
    return fleet


def write_recordings(
    folder: Path, fleet: Sequence[DrawnVehicle], minutes: float, on_begin: Callable[[int], Callable[[float], None]]
) -> None:
    """Write fleet.yaml and all recordings that are not there yet."""
    folder.mkdir(parents=True, exist_ok=True)
    described = {v.name: {"file": VEHICLE, "limits": {BEARING: BEARING_LIMIT}} for v in fleet}
    (folder / FLEET).write_text(yaml.safe_dump({"vehicles": described}, sort_keys=False), encoding="utf-8")
    work = [(folder / RECORDINGS, v, number, minutes) for v in fleet for number in range(len(v.days))]
    advance = on_begin(len(work))
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        for _ in pool.map(_write, work, chunksize=4):
            advance(1)


def _write(task: tuple[Path, DrawnVehicle, int, float]) -> None:
    write_recording(*task)
