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
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from measuring import HERE, at_most, uneven_loads
from numpy.typing import NDArray

from trackres_ros.effects.effect import Active
from trackres_ros.effects.registry import catalogue
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.export.c_source import CSource, in_c
from trackres_ros.export.parts import Parts
from trackres_ros.vehicle import AnyVehicle, load_any

Array = NDArray[np.float64]

STEPS = 200_000
ROUNDS = 7
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


def measured(vehicle: AnyVehicle, folder: Path, single: bool, steps: int, rounds: int) -> dict[str, float]:
    """Time and size of one export, which stays in a folder."""
    estimator = Estimator(vehicle)
    source, translated = written(estimator, folder, single)
    loads = zip(estimator.assemblies, uneven_loads(estimator).tolist(), strict=False)
    set_loads = " ".join(f"inputs.{in_c(source.inputs[f'load/{a}'])} = (trackres_real){load!r};" for a, load in loads)
    build(folder, str(HERE / "export_step.c"), f"-DLOADS={set_loads}")
    command = ["./program", str(steps), str(rounds)]
    out = subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True).stdout
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


def written(estimator: Estimator, folder: Path, single: bool = False) -> tuple[CSource, float]:
    """Export into a folder and compile the step there; returns the source, and how long its translation took [s]."""
    begin = time.perf_counter()
    source = CSource(Parts(estimator, single=single), estimator.vehicle.title, ("benchmark",))
    files = source.files()
    translated = time.perf_counter() - begin
    folder.mkdir(exist_ok=True)
    for file, text in files.items():
        (folder / file).write_text(text)
    subprocess.run(["cc", *FLAGS, "-c", "trackres.c", "-o", "step.o"], cwd=folder, check=True)
    return source, translated


def build(folder: Path, program: str, *defined: str) -> None:
    """Build a program with the step that was compiled there."""
    command = ["cc", *FLAGS, "-DSPEED=10.0", *defined, program, "step.o", "-I.", "-o", "program", "-lm"]
    subprocess.run(command, cwd=folder, check=True)


def difference(double: Array, single: Array, names: Sequence[str]) -> dict[str, float]:
    """How far rows in float are off those in double: largest difference over the largest value [%], and of the belts [K]."""
    found = {}
    off = np.abs(single - double).max(axis=0)
    for name in ("resistance_torque_nm", "resistance_std_nm", "feedforward_torque_nm"):
        column = names.index(name)
        found[f"{name}, largest difference over the largest [%]"] = 100.0 * float(off[column] / np.abs(double[:, column]).max())
    belts = [i for i, name in enumerate(names) if name.startswith("belt_degc")]
    return found | {"belt temperature, largest difference [K]": float(off[belts].max())}


def of_float(exports: Sequence[Path], names: Sequence[str], hours: float) -> dict[str, float]:
    """The difference of double and float on a drive of changing speed at 20 Hz."""
    time_s = np.arange(0.0, 3600.0 * hours, 0.05)
    speed = np.clip(8.0 + 7.0 * np.sin(time_s / 211.0) + 2.0 * np.sin(time_s / 17.0), 0.0, None)
    columns = np.column_stack([time_s, speed, 10.0 + 5.0 * np.sin(time_s / 3000.0)])
    rows = []
    for folder in exports:
        np.savetxt(folder / "drive.csv", columns, delimiter=",", header="time_s,speed_mps,ambient_degc", comments="", fmt="%.5f")
        build(folder, "main.c")
        with (folder / "rows.csv").open("w") as out:
            subprocess.run(["./program", "drive.csv"], cwd=folder, check=True, stdout=out)
        rows.append(np.genfromtxt(folder / "rows.csv", delimiter=",", skip_header=1)[:, 2 : 2 + len(names)])
    return difference(*rows, names)


def of_steady(exports: Sequence[Path], names: Sequence[str], rate_hz: int, hours: float) -> dict[str, float]:
    """The same on a steady drive with a stop: at a high rate each step of a belt is small against its temperature."""
    rows = []
    for folder in exports:
        build(folder, str(HERE / "export_steady.c"))
        command = ["./program", str(rate_hz), str(hours)]
        out = subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True).stdout
        rows.append(np.genfromtxt(out.splitlines(), delimiter=",", ndmin=2))
    return difference(*rows, names)


def run(steps: int = STEPS, rounds: int = ROUNDS, hours: float = 2.0) -> dict[str, float]:
    """Measure the fastest of some rounds, and float against double on drives of hours; empty where there is no compiler."""
    if not (shutil.which("cc") and shutil.which("size")):
        return {}
    result: dict[str, float] = {}
    vehicle, single = load_any("xgd24d"), "xgd24d as float"
    vehicles = {"xgd24d": vehicle, "xgd24d with three effects": with_three_effects(vehicle), single: vehicle}
    with tempfile.TemporaryDirectory() as folder:
        for name, one in {**vehicles, "ztbus_hess19": load_any("ztbus_hess19")}.items():
            found = measured(one, Path(folder, name), name == single, steps, rounds)
            result |= {f"{name}: {what}": value for what, value in found.items()}
        exports = [Path(folder, name) for name in ("xgd24d", single)]
        names = [name for name in Estimator(vehicle).columns if name != "reasons"]
        off = {"": of_float(exports, names, hours)}
        off |= {f"steady at {rate} Hz, ": of_steady(exports, names, rate, 2.0 * hours) for rate in (50, 1000)}
    return result | {f"xgd24d as float: {drive}{what}": value for drive, of in off.items() for what, value in of.items()}
