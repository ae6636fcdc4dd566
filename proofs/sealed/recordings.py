# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Records cases: their drives as sensors show them, and vehicle files that say nothing of the hidden physics."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from proofs.sealed.belt import read_data_sheet
from proofs.sealed.cases import LOADS, RECORDED, Case, draws, sensors_of, sized, streets_of
from proofs.sealed.drives import SealedDrive, draw_town, drive, recorded, street_drive, trapezoids
from proofs.sealed.phenomena import loaded
from proofs.sealed.truth import Build, Hidden, Sensors, TruthRun, record, simulate_truth
from trackres_ros.arrays import Array
from trackres_ros.files.documents import read_yaml
from trackres_ros.files.resources import find_vehicle

VEHICLE = "xgd24d"
PROFILES = "profiles"
DULL_LOADS = (1.0, 1.0, 1.0)
AIRS_DEGC = (5.0, 15.0, 25.0)
FASTEST_MPS = 16.7
DULL_MPS = (6.0, 8.0)
STREET_TIMES = 2.0  # as long drives in towns: they stand at crossings, and streets are to come again
START_S, APART_S = 1_750_000_000.0, 1_300_000.0  # two weeks: each begins soaked
EVERY = 10  # samples: kept part of the truth for the score


def make_case(folder: Path, minutes: float, case: Case) -> None:
    """Write one case with drives of so many minutes."""
    into = folder / "cases" / case.name
    into.mkdir(parents=True, exist_ok=True)
    (folder / "sealed").mkdir(exist_ok=True)
    vehicle = write_vehicle(into / "vehicle.yaml", case.lumped)
    profiles, build = _profiles(folder), Build(**case.build)
    if case.compensated:
        result_before = _drives(case, minutes, "before", profiles)
        _, paths = record_all(into, "before", build, case.hidden, result_before, sensors_of(case), draws(case, "before"))
        refit(paths, vehicle, vehicle, "fitted to earlier drives")  # as users do, whatever is hidden in them
        for path in paths:
            path.unlink()
    driven = _drives(case, minutes, "drive", profiles)
    runs, _ = record_all(into, "drive", build, case.hidden, driven, sensors_of(case), draws(case, "drive"))
    np.savez_compressed(folder / "sealed" / f"{case.name}.npz", **_kept(case, driven, runs))


def _kept(case: Case, driven: Sequence[SealedDrive], runs: Sequence[TruthRun]) -> dict[str, Any]:
    """Part of the truth for the score: contributions of each effect, and variables for them."""

    def joined(series: Sequence[Array]) -> Array:
        return np.concatenate([item[::EVERY] for item in series])

    way = [np.cumsum(np.abs(d.speed)) * d.step for d in driven]
    earlier = np.cumsum([0.0, *(item[-1] for item in way)])[:-1]
    results = {f"added/{name}": np.concatenate([means(item.added[name]) for item in runs]) for name in case.hidden}
    over = {
        "speed": [d.speed for d in driven],
        "acceleration": [d.accel for d in driven],
        "load": [item.weight for item in runs],
        "belt temperature": [item.belt for item in runs],
        "ambient temperature": [d.ambient for d in driven],
        "yaw rate": [np.abs(d.yaw_rate) for d in driven],
        "yaw rate to the left": [d.yaw_rate for d in driven],
        "driving torque": [item.torque for item in runs],
        "heading": [np.angle(np.exp(1j * d.heading)) for d in driven],
        "time since start": [np.arange(len(d)) * d.step for d in driven],
        "distance": way,
        "distance run": [result_before + item for result_before, item in zip(earlier, way, strict=True)],
        "curvature": [np.abs(d.yaw_rate) / np.maximum(np.abs(d.speed), 0.3) for d in driven],
    }
    lengths = np.array([len(item.torque[::EVERY]) for item in runs])
    return {"lengths": lengths, **results, **{f"over/{name}": joined(series) for name, series in over.items()}}


def means(series: Array, every: int = EVERY) -> Array:
    """Means over each so many samples, the last of as many as there are."""
    begins = np.arange(0, len(series), every)
    return np.asarray(np.add.reduceat(series, begins) / np.diff(np.append(begins, len(series))))


def drive_next(folder: Path, case: Case, minutes: float, name: str, planned: Callable[[SealedDrive], SealedDrive]) -> Path:
    """Let the vehicle of a case drive once more, after all its drives, and record it; `planned` gets its last drive."""
    driven = _drives(case, minutes, "drive", _profiles(folder))
    more = planned(driven[-1])
    run = simulate_truth(find_vehicle(VEHICLE), Build(**case.build), case.hidden, [*driven, more])[-1]
    path = folder / "cases" / case.name / f"{name}.csv"
    _, radius = weight_and_radius()
    record(path, more, run, sensors_of(case), radius, START_S + len(driven) * APART_S, draws(case, name))
    return path


def write_vehicle(path: Path, lumped: bool) -> Path:
    """Write the data sheet as a vehicle file, without or with a core temperature of the belt."""
    sheet = find_vehicle(VEHICLE)
    content = read_yaml(sheet)
    content["rubber"]["file"] = str((sheet.parent / content["rubber"]["file"]).resolve())
    content["model"]["thermal"] = "lumped" if lumped else "core_surface"
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    return path


def sized_case(folder: Path, minutes: float, case: Case) -> Case:
    """A case whose hidden program, if it has one, is as large as drawn."""
    if case.level != "outside":
        return case
    return sized(case, find_vehicle(VEHICLE), _drives(case, minutes, "drive", _profiles(folder)))


def _profiles(folder: Path) -> list[Array]:
    path = folder / "sealed" / f"{PROFILES}.npz"
    return list(np.load(path).values()) if path.exists() else []


def _drives(case: Case, minutes: float, name: str, profiles: Sequence[Array] = ()) -> list[SealedDrive]:
    rng = draws(case, f"route of {name}")
    weight, _ = weight_and_radius()
    if case.level == "street":
        return _in_town(case, STREET_TIMES * minutes, weight, rng)
    town = draw_town(draws(case, "town")) if case.source == "town" and not case.dull else None

    def one(share: float, air: float) -> SealedDrive:
        if case.dull:
            return _dull(minutes, weight, rng)
        if town is not None:  # level, and only the channels of every recording
            return replace(street_drive(minutes, share * weight, air, town, 0.0, rng), street=None)
        if case.source == RECORDED:
            return recorded(minutes, share * weight, air, FASTEST_MPS, profiles, rng)
        return {"course": drive, "trapezoids": trapezoids}[case.source](minutes, share * weight, air, FASTEST_MPS, rng)

    loads = DULL_LOADS if case.dull else LOADS
    return [one(share, air) for share, air in zip(loads, rng.permutation(AIRS_DEGC), strict=True)]


def _in_town(case: Case, minutes: float, weight: float, rng: np.random.Generator) -> list[SealedDrive]:
    """Drives through the town of a case. The slope of a town that is not level is in the recording or hidden."""
    town, streets = draw_town(draws(case, "town")), streets_of(case)
    steepest = case.hidden.get("street_slope", {}).get("steepest", streets.steepest)
    drives, driven = list[SealedDrive](), 0.0
    for share, air in zip(streets.shares, rng.permutation(AIRS_DEGC), strict=True):
        item = street_drive(minutes, share * weight, air, town, steepest, rng)
        if streets.load:
            item = loaded(item, streets.load, driven)
        if streets.steepest and item.street is not None:
            item = replace(item, slope=item.street.slope)
        drives.append(item)
        driven += float(np.abs(item.speed).sum() * item.step)
    return drives


def record_all(
    into: Path, name: str, build: Build, hidden: Hidden, drives: Sequence[SealedDrive], sensors: Sensors, rng: np.random.Generator
) -> tuple[list[TruthRun], list[Path]]:
    """Make drives of a vehicle, two weeks apart, and record them: true values and paths."""
    _, radius = weight_and_radius()
    runs = simulate_truth(find_vehicle(VEHICLE), build, hidden, drives)
    paths = [into / f"{name}_{i + 1}.csv" for i in range(len(drives))]
    for i, (path, value, true) in enumerate(zip(paths, drives, runs, strict=True)):
        record(path, value, true, sensors, radius, START_S + i * APART_S, rng)
    return runs, paths


def _dull(minutes: float, weight: float, rng: np.random.Generator) -> SealedDrive:
    """A drive that shows little: straight on, at nearly one speed."""
    made = drive(minutes, weight, 15.0, FASTEST_MPS, rng)
    n = len(made)
    time = np.arange(n) * made.step
    speed = rng.uniform(*DULL_MPS) * np.minimum(1.0, time / 30.0) * (1.0 + 0.02 * np.sin(time / 40.0))
    still = np.zeros(n)
    return SealedDrive(made.step, speed, np.gradient(speed, made.step), still, still, made.weight, made.ambient)


def weight_and_radius() -> tuple[float, float]:
    """Nominal weight of the vehicle [N], and radius of its sprockets [m]."""
    numbers = read_data_sheet(find_vehicle(VEHICLE))
    return numbers["weight"], numbers["track.sprocket_radius"]


def refit(paths: Sequence[Path], vehicle: Path, into: Path, remark: str) -> Path:
    """Write the vehicle file with the parameters that a diagnosis begins with re-fitted to recordings."""
    from trackres_ros.diagnosis import load_base, read_recordings
    from trackres_ros.diagnosis.inference.fitting import Problem, fit, with_levels
    from trackres_ros.diagnosis.prepare.gate import gate
    from trackres_ros.vehicle.writing.changes import FileChanges

    loaded = load_base(vehicle)
    sessions = gate(read_recordings(paths, None), loaded.known).sessions
    result = with_levels(fit(Problem(loaded.base, sessions, tuple(s.used for s in sessions))))
    loaded.base.write(into, FileChanges(result.base_values, (), {}), remark)
    return into
