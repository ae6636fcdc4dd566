# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""First process: draws the cases, seals them, and writes recordings and vehicle files that say nothing of them."""

from __future__ import annotations

from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from proofs.learned.cases import (
    AIR_OFF_K,
    AIRS_DEGC,
    LOADS,
    REAL,
    SENSORS,
    LearningCase,
    added_torque,
    draw_cases,
    misled,
    weight_shares,
)
from proofs.processes import each, write_sealed
from proofs.sealed.data_sheet import read_data_sheet
from proofs.sealed.drives import drive
from proofs.sealed.generate import APART_S, FASTEST_MPS, START_S, VEHICLE, write_vehicle
from proofs.sealed.sensors import drawn_sensors, record
from proofs.sealed.truth import Build, G, simulate_truth
from trackres_ros.files.resources import find_vehicle

REFIT = "refit"  # marks a vehicle that is re-fitted too, the slowest part


def main(folder: Path, seed: int, minutes: float, vehicles: int, hostile: int, first: int | None = None) -> None:
    """Seal all vehicles and record them, or the first."""
    cases = draw_cases(seed, vehicles, hostile)
    labels = {"seed": seed, "minutes": minutes, "cases": [asdict(case) for case in cases]}
    write_sealed(folder, f"{len(cases)} vehicles", [seed, labels["cases"]], labels)
    missing = [case for case in cases[:first] if not (folder / "sealed" / f"{case.name}.npz").exists()]
    each(partial(make_case, folder, minutes), missing, "recorded")


def make_case(folder: Path, minutes: float, case: LearningCase) -> None:
    """Write one vehicle with drives of so many minutes."""
    into, sheet = folder / "cases" / case.name, find_vehicle(VEHICLE)
    into.mkdir(parents=True, exist_ok=True)
    write_vehicle(into / "vehicle.yaml", case.lumped)
    if not case.hostile:
        (into / REFIT).touch()
    numbers = read_data_sheet(sheet)
    weight, radius = numbers["weight"], numbers["track.sprocket_radius"]
    rng = np.random.default_rng([case.seed, 1])
    airs = rng.permutation(AIRS_DEGC)
    planned = [drive(minutes, share * weight, air, FASTEST_MPS, rng) for share, air in zip(LOADS, airs, strict=True)]
    driven = [replace(one, weight=one.weight * weight_shares(case, one.speed)) for one in planned]
    runs = simulate_truth(sheet, Build(**case.build), {}, driven)
    sensors = drawn_sensors(rng)
    kept: dict[str, Any] = {}
    for i, (plan, one, run) in enumerate(zip(planned, driven, runs, strict=True)):
        added = added_torque(case, one, weight, radius)
        path, off = into / f"drive_{i + 1}.csv", float(rng.normal(0.0, AIR_OFF_K))
        with_added = replace(run, torque=run.torque + added, shown=run.shown + added)
        record(path, plan, with_added, replace(sensors, ambient_off_k=off), radius, START_S + i * APART_S, rng)
        if case.hostile in SENSORS:
            _mislead(path, case, one.step, rng)
        inertia = radius * numbers["chassis.rotating_mass_factor"] * one.weight / G * one.accel
        kept[f"torque_{i + 1}"], kept[f"speed_{i + 1}"] = run.torque + added - inertia, one.speed
        # Disturbances are outside of any model: on a hill without a recorded slope they cannot be known.
        kept[f"known_{i + 1}"] = run.torque - inertia + (added if case.hostile in REAL and case.hostile != "hill" else 0.0)
    np.savez_compressed(folder / "sealed" / f"{case.name}.npz", **kept)


def _mislead(path: Path, case: LearningCase, step: float, rng: np.random.Generator) -> None:
    names = path.read_text(encoding="utf-8").partition("\n")[0].split(",")
    rows = np.loadtxt(path, delimiter=",", skiprows=1)
    rows[:, names.index("torque_nm")] = misled(case, rows[:, names.index("torque_nm")], step, rng)
    with path.open("w", encoding="utf-8") as file:
        file.write(",".join(names) + "\n")
        np.savetxt(file, rows, delimiter=",", fmt="%.5f")
