# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Drives and records a drawn fleet by the truth of the proofs, which shares nothing with the model."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from proofs.sealed.data_sheet import read_data_sheet
from proofs.sealed.drives import SealedDrive, drive
from proofs.sealed.sensors import drawn_sensors, record
from proofs.sealed.truth import Build, simulate_truth
from trackres_ros.files.own_files import PART
from trackres_ros.files.resources import find_vehicle
from trackres_ros.tools.fleet.sample import (
    BEARING,
    DAY_S,
    LOADS,
    MOVES_MPS,
    MOVES_S,
    START_S,
    VEHICLE,
    DrawnVehicle,
    air_at,
    change_at,
)

FASTEST_MPS = 16.7
WIND_MPS = 3.0  # most, from anywhere
RAIN_SHARE, RAIN = 0.12, (0.1, 0.8)  # of recordings; how much more a wet belt gives off
GAIN = "torque_gain.error"


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
    air = air_at(vehicle.days[number], rng)
    weight = float(rng.choice(LOADS)) * numbers["weight"]
    one = drive(minutes, weight, air, FASTEST_MPS, rng)
    while _moves_s(one) < MOVES_S:  # the driver stood nearly all the time
        one = drive(minutes, weight, air, FASTEST_MPS, rng)
    weather = {"headwind": {"wind": rng.uniform(0.0, WIND_MPS), "towards": rng.uniform(0.0, 2.0 * np.pi)}}
    if rng.random() < RAIN_SHARE:
        weather["rain"] = {"factor": 1.0 + rng.uniform(*RAIN)}
    build, sensors = Build(**vehicle.build), drawn_sensors(np.random.default_rng([vehicle.seed, *b"sensors"]))
    if vehicle.hidden is not None:
        share = 1.0 + change_at(vehicle, number)
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
