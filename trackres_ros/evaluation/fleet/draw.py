# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Draws a fleet: vehicles that differ from their data sheet, months of drives, and changes in some of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from trackres_ros.errors import InputError
from trackres_ros.evaluation.sealed.data_sheet import read_data_sheet
from trackres_ros.evaluation.sealed.drives import SealedDrive, drive
from trackres_ros.evaluation.sealed.sensors import drawn_sensors, record
from trackres_ros.evaluation.sealed.truth import Build, simulate_truth
from trackres_ros.files.own_files import PART
from trackres_ros.files.resources import find_vehicle

VEHICLE = "xgd24d"
START_S, DAY_S = 1_750_000_000.0, 86_400.0
FASTEST_MPS = 16.7
LOADS = (1.0, 0.8, 1.25)  # over the nominal weight
VEHICLES_DIFFER = 0.05  # standard deviation of each of a vehicle's factors
AIR_DEGC, SEASON_K, WEATHER_K = 14.0, 10.0, 4.0  # mean, amplitude over a year, and scatter of a day
WIND_MPS = 3.0  # most, from anywhere
RAIN_SHARE, RAIN = 0.12, (0.1, 0.8)  # of recordings; how much more a wet belt gives off
MOVES_S, MOVES_MPS = 90.0, 1.0  # at least: a recording with less than 60 s of driving is not compared
EARLIEST, LATEST = 0.1, 0.9  # when a recording begins, as a share of the time between two
BEARING, LOSS, GAIN = "bearing_friction", "loss_modulus_scale", "torque_gain.error"
NONE, STEP, RAMP = "none", "step", "ramp"


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
    vehicles: int, days: int, every: float, minutes: float, changes: Sequence[tuple[str, str, float]], seed: int
) -> list[DrawnVehicle]:
    """Vehicles, the first drawn of which have the changes: parameter, kind and size of each; in random order.

    A vehicle with one recording has no change: nothing could show it. InputError if a recording is longer than the time between
    two.
    """
    rng = np.random.default_rng([seed, *b"fleet"])
    found = []
    every = min(every, float(days))
    room = 1.0 - minutes * 60.0 / (every * DAY_S)
    if room <= 0.0:
        raise InputError("--every", f"{every:g} days between recordings of {minutes:g} minutes", "longer than a recording")
    share = min(1.0, room / (LATEST - EARLIEST))
    count = max(1, int(days / every))
    for i in range(vehicles):
        build = np.clip(rng.normal(1.0, VEHICLES_DIFFER, 5), 0.8, 1.2)
        begins = (np.arange(count) + share * rng.uniform(EARLIEST, LATEST, count)) * every
        hidden = None
        if i < len(changes) and count > 1:
            parameter, kind, size = changes[i]
            hidden = Hidden(parameter, kind, int(rng.integers(max(1, count // 4), max(2, count // 2 + 1))), size)
        factors = dict(zip(("loss", "bearing", "drag", "film", "capacity"), map(float, build), strict=True))
        found.append(DrawnVehicle("", factors, int(rng.integers(2**31)), tuple(map(float, begins)), hidden))
    return [replace(found[j], name=f"truck-{i + 1:02d}") for i, j in enumerate(rng.permutation(vehicles))]


def come(hidden: Hidden, number: int, count: int) -> float:
    """Share of a change at a recording: 0 before, 1 at the last."""
    if number < hidden.first:
        return 0.0
    return 1.0 if hidden.kind == STEP else (number - hidden.first + 1) / (count - hidden.first)


def write_recording(folder: Path, vehicle: DrawnVehicle, number: int, minutes: float) -> Path:
    """Drive and record once; an existing file is kept."""
    begin = START_S + vehicle.days[number] * DAY_S
    path = folder / vehicle.name / f"drive_{number + 1:04d}.csv"
    if path.exists():
        return path
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet = find_vehicle(VEHICLE)
    numbers = read_data_sheet(sheet)
    rng = np.random.default_rng([vehicle.seed, number])
    season = SEASON_K * np.sin(2.0 * np.pi * vehicle.days[number] / 365.25)
    air = AIR_DEGC + season + WEATHER_K * rng.standard_normal()
    weight = float(rng.choice(LOADS)) * numbers["weight"]
    one = drive(minutes, weight, air, FASTEST_MPS, rng)
    while _moves_s(one) < MOVES_S:  # the driver stood nearly all the time
        one = drive(minutes, weight, air, FASTEST_MPS, rng)
    weather = {"headwind": {"wind": rng.uniform(0.0, WIND_MPS), "towards": rng.uniform(0.0, 2.0 * np.pi)}}
    if rng.random() < RAIN_SHARE:
        weather["rain"] = {"factor": 1.0 + rng.uniform(*RAIN)}
    build, sensors = Build(**vehicle.build), drawn_sensors(np.random.default_rng([vehicle.seed, *b"sensors"]))
    if vehicle.hidden is not None:
        share = 1.0 + vehicle.hidden.size * come(vehicle.hidden, number, len(vehicle.days))
        if vehicle.hidden.parameter == GAIN:
            sensors = replace(sensors, torque_gain=sensors.torque_gain * share)
        else:
            name = "bearing" if vehicle.hidden.parameter == BEARING else "loss"
            build = replace(build, **{name: getattr(build, name) * share})
    (run,) = simulate_truth(sheet, build, weather, [one])
    part = path.with_name(path.name + PART)
    record(part, one, run, sensors, numbers["track.sprocket_radius"], begin, rng)
    return part.rename(path)


def _moves_s(one: SealedDrive) -> float:
    return float((one.speed > MOVES_MPS).sum()) * one.step
