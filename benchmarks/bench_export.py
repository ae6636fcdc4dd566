# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The step as C on this machine: time of a step with a new speed, all guards, and its size; bare and with three effects."""

from __future__ import annotations

import dataclasses
import shutil
import statistics
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
from measuring import HERE, at_most

from trackres_ros.effects.effect import Active
from trackres_ros.effects.registry import catalogue
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.export.c_source import CSource, in_c
from trackres_ros.export.parts import Parts
from trackres_ros.vehicle import AnyVehicle, load_any

STEPS = 200_000
ROUNDS = 7
UNEVEN = (0.97, 1.03, 0.99, 1.01)  # of the nominal loads: no assembly is like another, so each is computed
EFFECTS = ("warmup", "viscous_bearing", "tension_torque")
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off")
TARGETS = {
    "xgd24d: a step [us]": at_most(1.5),
    "xgd24d with three effects: a step [us]": at_most(3.0),
}


def with_three_effects(vehicle: AnyVehicle) -> AnyVehicle:
    """Three effects, with the ranges that a diagnosis writes."""
    known = catalogue()
    found = []
    for name in EFFECTS:
        effect = known[name]
        values = effect.values()
        ranges = {q.name: (0.9 * values[q.name], min(q.high, 1.1 * values[q.name])) for q in effect.parameters if q.fitted}
        found.append(Active(effect, values, ranges))
    return dataclasses.replace(vehicle, effects=tuple(found))


def measured(vehicle: AnyVehicle, single: bool, steps: int, rounds: int) -> dict[str, float]:
    """Time and size of one export."""
    estimator = Estimator(vehicle)
    begin = time.perf_counter()
    source = CSource(Parts(estimator, single=single), vehicle.title, ("benchmark",))
    files = source.files()
    translated = time.perf_counter() - begin
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file, text in files.items():
            (folder / file).write_text(text)
        loads = " ".join(
            f"inputs.{in_c(source.inputs[f'load/{a}'])} = (trackres_real){load * UNEVEN[i % 4]!r};"
            for i, (a, load) in enumerate(zip(estimator.assemblies, vehicle.nominal_loads().tolist(), strict=False))
        )
        defined = ["-DSPEED=10.0", f"-DLOADS={loads}"]
        run = ["cc", *FLAGS, *defined, "trackres.c", str(HERE / "export_step.c"), "-I.", "-o", "step", "-lm"]
        subprocess.run(run, cwd=folder, check=True)
        subprocess.run(["cc", *FLAGS, "-c", "trackres.c", "-o", "step.o"], cwd=folder, check=True)
        out = subprocess.run(["./step", str(steps), str(rounds)], cwd=folder, check=True, capture_output=True, text=True).stdout
        sizes = subprocess.run(["size", "step.o"], cwd=folder, check=True, capture_output=True, text=True).stdout
    each = [float(line.split()[0]) for line in out.splitlines()]
    most = [float(line.split()[1]) for line in out.splitlines()]
    width = 4 if single else 8
    tables = sum(array.size * width for _, array in source.translator.tables.values() if hasattr(array, "size"))
    text, data, _ = (int(word) for word in sizes.splitlines()[1].split()[:3])
    return {
        "a step [us]": 1e6 * min(each),
        "the slowest of a thousand steps [us]": 1e6 * statistics.median(most),
        "code [kB]": (text + data - tables) / 1e3,
        "tables [kB]": tables / 1e3,
        "state [kB]": int(source.state_bytes()) / 1e3,
        "translated in [s]": translated,
    }


def of_float(vehicle: AnyVehicle, hours: float) -> dict[str, float]:
    """How far a replay in float is off one in double: largest difference over the largest value [%], and of the belts [K]."""
    time_s = np.arange(0.0, 3600.0 * hours, 0.05)
    speed = np.clip(8.0 + 7.0 * np.sin(time_s / 211.0) + 2.0 * np.sin(time_s / 17.0), 0.0, None)
    rows = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        columns = np.column_stack([time_s, speed, 10.0 + 5.0 * np.sin(time_s / 3000.0)])
        np.savetxt(folder / "drive.csv", columns, delimiter=",", header="time_s,speed_mps,ambient_degc", comments="", fmt="%.5f")
        for single in (False, True):
            estimator = Estimator(vehicle)
            files = CSource(Parts(estimator, single=single), vehicle.title, ("benchmark",)).files()
            for file, text in files.items():
                (folder / file).write_text(text)
            subprocess.run(["cc", *FLAGS, "trackres.c", "main.c", "-o", "replay", "-lm"], cwd=folder, check=True)
            with (folder / "rows.csv").open("w") as out:
                subprocess.run(["./replay", "drive.csv"], cwd=folder, check=True, stdout=out)
            rows[single] = np.genfromtxt(folder / "rows.csv", delimiter=",", names=True)
    double, single_ = rows[False], rows[True]
    found = {}
    for column in ("resistance_torque_nm", "resistance_std_nm", "feedforward_torque_nm"):
        off = np.abs(single_[column] - double[column]).max() / np.abs(double[column]).max()
        found[f"{column}, largest difference over the largest [%]"] = 100.0 * float(off)
    belts = [column for column in double.dtype.names or () if column.startswith("belt_degc")]
    found["belt temperature, largest difference [K]"] = max(float(np.abs(single_[c] - double[c]).max()) for c in belts)
    return found


def run(steps: int = STEPS, rounds: int = ROUNDS, hours: float = 2.0) -> dict[str, float]:
    """Measure the fastest of some rounds, and float against double on a drive of hours; empty where there is no compiler."""
    if not (shutil.which("cc") and shutil.which("size")):
        return {}
    result: dict[str, float] = {}
    for name, vehicle, single in (
        ("xgd24d", load_any("xgd24d"), False),
        ("xgd24d with three effects", with_three_effects(load_any("xgd24d")), False),
        ("xgd24d as float", load_any("xgd24d"), True),
        ("ztbus_hess19", load_any("ztbus_hess19"), False),
    ):
        result |= {f"{name}: {what}": value for what, value in measured(vehicle, single, steps, rounds).items()}
    return result | {f"xgd24d as float: {what}": value for what, value in of_float(load_any("xgd24d"), hours).items()}
