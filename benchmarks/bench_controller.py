# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The exported step in a control loop of 1 kHz (xgd24d, in_process.hpp of the example): from the speed to the torque."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from bench_export import written
from measuring import HERE, ROOT, Target

from trackres_ros.estimator.estimator import Estimator
from trackres_ros.vehicle import load_any

STEPS = 20_000
INCLUDE = ROOT / "examples" / "ros2_feedforward" / "include"
TARGETS: dict[str, Target] = {}


def run(steps: int = STEPS) -> dict[str, float]:
    """Measure so many periods; empty where there is no compiler."""
    if not (shutil.which("cc") and shutil.which("c++")):
        return {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        written(Estimator(load_any("xgd24d")), folder)
        loop = ["c++", "-std=c++17", "-O2", "-I.", f"-I{INCLUDE}", str(HERE / "control_loop.cpp"), "step.o"]
        subprocess.run([*loop, "-o", "loop", "-lm"], cwd=folder, check=True)
        out = subprocess.run(["./loop", str(steps)], cwd=folder, check=True, capture_output=True, text=True).stdout
    took = np.array(out.split(), dtype=float)
    return {
        "controller: in process, median [us]": float(np.median(took)),
        "controller: in process, p99 [us]": float(np.quantile(took, 0.99)),
    }
