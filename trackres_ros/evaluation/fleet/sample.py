# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes a simulated fleet: recordings in a folder for each vehicle, and fleet.yaml."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
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
from trackres_ros.evaluation.processes import workers
from trackres_ros.files.jsons import parse_json
from trackres_ros.files.own_files import read, write

SAMPLE_CHANGES = ((BEARING, RAMP, 0.4), (BEARING, STEP, 0.2), (LOSS, STEP, 0.15))
ANSWERS, FLEET, RECORDINGS = "answers.json", "fleet.yaml", "recordings"
MOST_BYTES = 1 << 20  # of answers.json
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
    """A simulated fleet for trials, in which up to three vehicles change; answers.json lists them, and the options.

    InputError if a recording is longer than the time between two, or the folder has other content or a sample with others.
    """
    options = {"vehicles": vehicles, "days": days, "every": every, "minutes": minutes, "seed": seed}
    fleet = draw_fleet(vehicles, days, every, minutes, SAMPLE_CHANGES, seed)
    _check_same(folder, options)
    changes = [
        {"vehicle": v.name, **asdict(v.hidden), "since_s": START_S + v.days[v.hidden.first] * DAY_S} for v in fleet if v.hidden
    ]
    folder.mkdir(parents=True, exist_ok=True)
    write(folder / ANSWERS, (json.dumps({"options": options, "changes": changes}, indent=1) + "\n").encode())
    tasks = begin_recordings(folder, fleet, minutes)
    advance = on_begin(len(tasks))
    with workers() as pool:
        for _ in pool.map(record_one, tasks, chunksize=4):
            advance(1)
    return fleet


def _check_same(folder: Path, options: Mapping[str, float]) -> None:
    """Raise InputError if a folder has other content than a sample with these options, perhaps an interrupted one."""
    if not folder.exists() or not any(folder.iterdir()):
        return
    allowed = "a folder that is empty, or that holds an earlier sample with the same options"
    try:
        kept = parse_json(read(folder / ANSWERS, MOST_BYTES))["options"]
        given = " ".join(f"--{name} {kept[name]}" for name in options)
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError("-o", f"{folder}, which has other content", allowed, "give another folder") from None
    if kept != options:
        raise InputError("-o", f"{folder}, a sample with {given}", allowed, "give these options or another folder")


def begin_recordings(folder: Path, fleet: Sequence[DrawnVehicle], minutes: float) -> list[tuple[Path, DrawnVehicle, int, float]]:
    """Write fleet.yaml; the tasks of `record_one`."""
    folder.mkdir(parents=True, exist_ok=True)
    described = {v.name: {"file": VEHICLE, "limits": {BEARING: BEARING_LIMIT}} for v in fleet}
    (folder / FLEET).write_text(yaml.safe_dump({"vehicles": described}, sort_keys=False), encoding="utf-8")
    return [(folder / RECORDINGS, v, number, minutes) for v in fleet for number in range(len(v.days))]


def record_one(task: tuple[Path, DrawnVehicle, int, float]) -> None:
    """Drive and record once, unless the file is there."""
    write_recording(*task)
