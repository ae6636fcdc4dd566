# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A new speed for four belts under four loads. The rival is a bare step in C, `bare_step.c`, with the same belt temperatures and
torque. It has no guards, uncertainty or other outputs. `handle` and its rival are called from Python, the exported step and
its rival from C. "Caches evicted" has a walk over 64 MB between two steps, as on a busy processor.
"""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
import sysconfig
import tempfile
import time
from collections import deque
from collections.abc import Callable, Sequence
from itertools import starmap
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from measuring import HERE, START_NS, Row, c_compiler, child, compared, uneven_loads

from trackres_ros.estimator import columns as at
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.kernels.compiler import FLAGS
from trackres_ros.tools.export.c_source import CSource, in_c
from trackres_ros.tools.export.parts import Parts
from trackres_ros.units import GRAVITY, STANDSTILL_MPS
from trackres_ros.vehicle import AnyVehicle, load

Call = Callable[..., Any]

STEPS, EVICTED, ROUNDS = 100_000, 300, 5
SMALL = {"steps": 100, "evicted": 2}
BALLAST, LINE = 64 << 20, 64  # bytes
STEP_NS = 10_000_000
TARGET = 2.0
AGREES = 1e-3  # of the torque: the two take the acceleration in other ways
FOR_EXPORT = ("-std=c99", "-O2", "-ffp-contract=off")


def measured(vehicle: AnyVehicle, folder: Path, steps: int, evicted: int) -> tuple[dict[str, float], np.ndarray]:
    """Export a vehicle into a folder and time it there: time of translation [s] and size of the code [kB]; the printed times."""
    estimator = Estimator(vehicle)
    begin = time.perf_counter()
    source = CSource(Parts(estimator), vehicle.title, ("benchmark",))
    files = source.files()
    facts = {"translated in [s]": time.perf_counter() - begin}
    folder.mkdir(exist_ok=True)
    for name, text in files.items():
        (folder / name).write_text(text)
    subprocess.run(["cc", *FOR_EXPORT, "-c", "trackres.c", "-o", "step.o"], cwd=folder, check=True)
    sizes = subprocess.run(["size", "step.o"], cwd=folder, check=True, capture_output=True, text=True).stdout
    text_bytes, data_bytes = (int(word) for word in sizes.splitlines()[1].split()[:2])
    tables = sum(8 * array.size for _, array in source.translator.tables.values() if hasattr(array, "size"))
    facts["code [kB]"] = (text_bytes + data_bytes - tables) / 1e3
    loads = zip(estimator.assemblies, uneven_loads(estimator).tolist(), strict=True)
    set_loads = " ".join(f"inputs.{in_c(source.inputs[f'load/{name}'])} = {newton!r};" for name, newton in loads)
    (folder / "bare_vehicle.h").write_text(bare_vehicle(estimator))
    command = ["cc", *FOR_EXPORT, f"-DSET_LOADS={set_loads}", str(HERE / "step_times.c"), "step.o", "-I.", "-o", "program", "-lm"]
    subprocess.run(command, cwd=folder, check=True)
    out = subprocess.run(["./program", str(steps), str(evicted)], cwd=folder, check=True, capture_output=True, text=True).stdout
    return facts, np.array([line.split() for line in out.splitlines()], float)


def bare_vehicle(estimator: Estimator) -> str:
    """Tables and constants of a vehicle with belts and the lumped thermal model, in C."""
    k, number, of = estimator.constants, estimator.constants.number, at.Assembly
    numbers = {
        "FIRST_X": number.first_x,
        "STEP_X": number.step_x,
        "GLASS_TRANSITION": number.glass_transition,
        "WLF_C1": number.wlf_c1,
        "WLF_C2": number.wlf_c2,
        "FRICTION": number.bearing_friction,
        "DRAG": 0.5 * number.air_density * number.drag_area,
        "INERTIA": number.rotating_mass_factor / GRAVITY,
        "STANDSTILL": STANDSTILL_MPS,
        "AMBIENT": estimator.vehicle.chassis.ambient,
    }
    columns = ("first_log_load", "step_log_load", "capacity", "area", "film_offset", "film_slope", "radius")
    arrays = {name.upper(): k.assembly[:, getattr(of, name)] for name in columns}
    arrays |= {"LOAD": uneven_loads(estimator), "LOSS": k.loss, "DRIVE": k.drive}
    lines = [f"enum {{ BELTS = {len(k.assembly)}, ROWS = {k.loss.shape[1]}, COLUMNS = {k.loss.shape[2]} }};"]
    lines += [f"#define {name} {float(value)!r}" for name, value in numbers.items()]
    lines.append(f"static const int TABLE[] = {_braces(k.assembly[:, of.table].astype(int))};")
    for name, array in arrays.items():
        shape = "".join(f"[{length}]" for length in array.shape)
        lines.append(f"static const double {name}{shape} = {_braces(array)};")
    return "\n".join(lines) + "\n"


def _braces(array: np.ndarray) -> str:
    return json.dumps(array.tolist()).replace("[", "{").replace("]", "}")


def bare_module(estimator: Estimator, folder: Path) -> ModuleType:
    """The bare step as a module of Python, compiled with the flags of our kernels."""
    (folder / "bare_vehicle.h").write_text(bare_vehicle(estimator))
    path = folder / "bare.abi3.so"
    include = sysconfig.get_paths()["include"]
    command = [
        "cc",
        *FLAGS,
        "-DFOR_PYTHON",
        str(HERE / "bare_step.c"),
        "-I.",
        f"-I{include}",
        "-shared",
        "-fPIC",
        "-o",
        path.name,
        "-lm",
    ]
    subprocess.run(command, cwd=folder, check=True)
    spec = importlib.util.spec_from_file_location("bare", path)
    if spec is None or spec.loader is None:
        raise ImportError(str(path))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def from_python(steps: int, evicted: int) -> dict[str, list[list[float]]]:
    """Times of `Session.handle` and of the bare step [s]: a step of each round of a tight loop, and of single evicted steps."""
    estimator = Estimator(load("xgd24d"))
    session = estimator.session()
    for name, newton in zip(estimator.assemblies, uneven_loads(estimator), strict=True):
        session.handle(session.channel(f"load/{name}"), START_NS, START_NS, float(newton))
    with tempfile.TemporaryDirectory() as folder:
        step = bare_module(estimator, Path(folder)).step
    messages, times = 0, {"warm": [], "evicted": []}

    def given(count: int) -> list[tuple[Call, Sequence[tuple[Any, ...]]]]:
        """Each function with its arguments for the next messages."""
        nonlocal messages
        numbers = range(messages + 1, messages + count + 1)
        messages += count
        stamps, speeds = [START_NS + n * STEP_NS for n in numbers], [10.0 + 0.01 * (n % 7) for n in numbers]
        ours = [(at.SPEED, stamp, stamp, speed) for stamp, speed in zip(stamps, speeds, strict=True)]
        return [(session.handle, ours), (step, [(speed, STEP_NS * 1e-9) for speed in speeds])]

    for _ in range(ROUNDS):
        times["warm"].append([_loop(*one) / steps for one in given(steps)])
    ballast = np.zeros(BALLAST, np.uint8)
    for _ in range(evicted):
        times["evicted"].append([_evicted(ballast, call, arguments[0]) for call, arguments in given(1)])
    (handle, ours), (_, bare) = given(1)
    _check(handle(*ours[0])["resistance_torque_nm"], step(*bare[0]))
    return times


def _loop(call: Call, arguments: Sequence[tuple[Any, ...]]) -> float:
    begin = time.perf_counter()
    deque(starmap(call, arguments), maxlen=0)
    return time.perf_counter() - begin


def _evicted(ballast: np.ndarray, call: Call, arguments: tuple[Any, ...]) -> float:
    ballast[::LINE] += 1
    begin = time.perf_counter()
    call(*arguments)
    return time.perf_counter() - begin


def _check(ours: float, bare: float) -> None:
    """Raises RuntimeError if the two did not compute the same."""
    if abs(ours / bare - 1.0) > AGREES:
        raise RuntimeError(f"the bare step computes another torque: {bare:g} instead of {ours:g} Nm")


def run(steps: int = STEPS, evicted: int = EVICTED) -> list[Row]:
    """Measure both pairs, so many steps in each of some rounds; empty without a C compiler."""
    if c_compiler() is None:
        return []
    with tempfile.TemporaryDirectory() as folder:
        _, table = measured(load("xgd24d"), Path(folder), 10 * steps, evicted)
    _check(*table[-1])
    of_c = {"warm": table[: len(table) - evicted - 1], "evicted": table[len(table) - evicted - 1 : -1]}
    of_python = child([__file__, str(steps), str(evicted)]).json()
    titles = {"warm": "in a loop", "evicted": "caches evicted"}
    return [
        compared(f"{what}, {titles[kind]} [us]", *np.transpose(rows[kind]).tolist(), TARGET, 1e6)
        for what, rows in (("`handle`", of_python), ("exported step", of_c))
        for kind in titles
    ]


if __name__ == "__main__":  # the process of Python that `run` starts
    print(json.dumps(from_python(int(sys.argv[1]), int(sys.argv[2]))))
