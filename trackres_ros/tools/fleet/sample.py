# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes a simulated fleet: recordings in a folder for each vehicle, and fleet.yaml.

The drives come from the model itself, so the sample shows what a fleet's results look like, not how good they are.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import yaml

from trackres_ros.diagnosis.base.loading import LoadedBase, load_base
from trackres_ros.diagnosis.synthetic import drives, write_recording
from trackres_ros.errors import InputError
from trackres_ros.files.documents import parse_json
from trackres_ros.files.own_files import PART, read, write

VEHICLE = "xgd24d"
START_S, DAY_S = 1_750_000_000.0, 86_400.0
LOADS = (1.0, 0.8, 1.25)  # over the nominal weight
VEHICLES_DIFFER = 0.05  # standard deviation of each of a vehicle's factors
AIR_DEGC, SEASON_K, WEATHER_K = 14.0, 10.0, 4.0  # mean, amplitude over a year, and scatter of a day
MOVES_S, MOVES_MPS = 90.0, 1.0  # at least: a recording with less than 60 s of driving is not compared
EARLIEST, LATEST = 0.1, 0.9  # when a recording begins, as a share of the time between two
BEARING, LOSS = "bearing_friction", "loss_modulus_scale"
PARAMETERS = {
    "loss": LOSS, "bearing": BEARING, "drag": "drag_coefficient", "film": "film_scale", "capacity": "capacity_scale",
}  # fmt: skip
NONE, STEP, RAMP = "none", "step", "ramp"
SAMPLE_CHANGES = ((BEARING, RAMP, 0.4), (BEARING, STEP, 0.2), (LOSS, STEP, 0.15))
ANSWERS, FLEET, RECORDINGS = "answers.json", "fleet.yaml", "recordings"
MOST_BYTES = 1 << 20  # of answers.json
BEARING_LIMIT = 0.012  # upper limit of a bearing in the vehicle file


@dataclass(frozen=True, slots=True)
class Hidden:
    """A change in a vehicle: parameter, kind, first recording, and relative size at the last one."""

    parameter: str
    kind: str
    first: int
    size: float


@dataclass(frozen=True, slots=True)
class DrawnVehicle:
    """A vehicle: its build, the seed of its other draws, days of its recordings, and its changes."""

    name: str
    build: dict[str, float]
    seed: int
    days: tuple[float, ...]
    hidden: Hidden | None


def draw_fleet(
    vehicles: int, days: int, interval: float, minutes: float, changes: Sequence[tuple[str, str, float]], seed: int
) -> list[DrawnVehicle]:
    """Vehicles, the first drawn of which have the changes: parameter, kind and size of each; in random order.

    A vehicle with one recording has no change: nothing could show it. InputError if a recording is longer than the time between
    two.
    """
    rng = np.random.default_rng([seed, *b"fleet"])
    drawn_vehicles = []
    interval = min(interval, float(days))
    room = 1.0 - minutes * 60.0 / (interval * DAY_S)
    if room <= 0.0:
        raise InputError("--every", f"{interval:g} days between recordings of {minutes:g} minutes", "longer than a recording")
    share = min(1.0, room / (LATEST - EARLIEST))
    count = max(1, int(days / interval))
    for i in range(vehicles):
        build = np.clip(rng.normal(1.0, VEHICLES_DIFFER, 5), 0.8, 1.2)
        begins = (np.arange(count) + share * rng.uniform(EARLIEST, LATEST, count)) * interval
        change = None
        if i < len(changes) and count > 1:
            parameter, kind, size = changes[i]
            change = Hidden(parameter, kind, int(rng.integers(max(1, count // 4), max(2, count // 2 + 1))), size)
        factors = dict(zip(PARAMETERS, map(float, build), strict=True))
        drawn_vehicles.append(DrawnVehicle("", factors, int(rng.integers(2**31)), tuple(map(float, begins)), change))
    return [replace(drawn_vehicles[j], name=f"truck-{i + 1:02d}") for i, j in enumerate(rng.permutation(vehicles))]


def change_at(vehicle: DrawnVehicle, number: int) -> float:
    """Relative change of a vehicle's parameter at a recording: 0 before it begins, its whole size at the last."""
    change, count = vehicle.hidden, len(vehicle.days)
    if change is None or number < change.first:
        return 0.0
    return change.size * (1.0 if change.kind == STEP else (number - change.first + 1) / (count - change.first))


def air_at(day: float, rng: np.random.Generator) -> float:
    """Air temperature of a day [degC]: its season and its weather."""
    return float(AIR_DEGC + SEASON_K * np.sin(2.0 * np.pi * day / 365.25) + WEATHER_K * rng.standard_normal())


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
    for task in tasks:
        record_drive(task)
        advance(1)
    return fleet


def _check_same(folder: Path, options: Mapping[str, float]) -> None:
    """Raise InputError if a folder has other content than a sample with these options, perhaps an interrupted one."""
    if not folder.exists() or not any(folder.iterdir()):
        return
    allowed = "a folder that is empty, or that holds an earlier sample with the same options"
    try:
        content = parse_json(read(folder / ANSWERS, MOST_BYTES))["options"]
        text = " ".join(f"--{name} {content[name]}" for name in options)
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError("-o", f"{folder}, which has other content", allowed, "give another folder") from None
    if content != options:
        raise InputError("-o", f"{folder}, a sample with {text}", allowed, "give these options or another folder")


def begin_recordings(folder: Path, fleet: Sequence[DrawnVehicle], minutes: float) -> list[tuple[Path, DrawnVehicle, int, float]]:
    """Write fleet.yaml; of each recording its folder, vehicle, number and length [min]."""
    folder.mkdir(parents=True, exist_ok=True)
    entries = {v.name: {"file": VEHICLE, "limits": {BEARING: BEARING_LIMIT}} for v in fleet}
    write(folder / FLEET, yaml.safe_dump({"vehicles": entries}, sort_keys=False).encode())
    return [(folder / RECORDINGS, v, number, minutes) for v in fleet for number in range(len(v.days))]


@cache
def _base() -> LoadedBase:
    return load_base(VEHICLE)


def record_drive(task: tuple[Path, DrawnVehicle, int, float]) -> None:
    """Drive and record once; an existing file is kept."""
    folder, vehicle, number, minutes = task
    path = folder / vehicle.name / f"drive_{number + 1:04d}.csv"
    if path.exists():
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    base, rng = _base().base, np.random.default_rng([vehicle.seed, number])
    air, load = air_at(vehicle.days[number], rng), float(rng.choice(LOADS))
    moving_s = 0.0
    while moving_s < MOVES_S:  # else the driver stood nearly all the time
        (session,) = drives(base, _base().known.max_speed, 1, minutes, rng)
        moving_s = float((session.speed > MOVES_MPS).sum()) * session.step
    steps = len(session)
    session = replace(session, weight=np.full(steps, load * base.facts.weight), ambient=np.full(steps, air))
    values = {name: base.nominal[name] * vehicle.build[factor] for factor, name in PARAMETERS.items()}
    if vehicle.hidden is not None:
        values[vehicle.hidden.parameter] *= 1.0 + change_at(vehicle, number)
    (predicted,) = base.predict([session], base.nominal | values, ())
    part = path.with_name(path.name + PART)
    write_recording(part, session, predicted, base.torque_scale, START_S + vehicle.days[number] * DAY_S, rng)
    part.rename(path)
