# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The exported step under the rules of the example controller in C++: its added torque, without ROS."""

import itertools
import shutil
import subprocess

import numpy as np
import pytest
from built import EQUAL, have, write

import trackres_ros as tr

COMPILER = shutil.which("g++") or shutil.which("clang++")
if not COMPILER or not have("cc"):
    pytest.skip("no C and C++ compiler", allow_module_level=True)

# Reads lines of: speed, elapsed, enabled. Prints the torque to add, what the step gave, and its level.
PROGRAM = """
#include <cstdio>
#include "trackres_feedforward/in_process.hpp"

int main()
{
  trackres_feedforward::InProcess step;
  double speed_mps, elapsed_s;
  int enabled;
  while (std::scanf("%lf %lf %d", &speed_mps, &elapsed_s, &enabled) == 3) {
    const double torque = step.torque(speed_mps, elapsed_s, enabled != 0);
    std::printf("%.17g %.17g %d\\n", torque, static_cast<double>(step.outputs().feedforward_torque_nm), step.outputs().level);
  }
}
"""
STRICT = ("-Wall", "-Wextra", "-Wpedantic", "-Werror")
PERIOD_S, RAMP_NM_PER_S = 0.01, 5000.0
STALE = 3


class Vehicle:
    """A vehicle exported and compiled with the header of the example."""

    def __init__(self, folder, repository):
        self.folder, self.estimator = folder, write(tr.load_vehicle("xgd24d"), folder)
        (folder / "step.cpp").write_text(PROGRAM)
        include = repository / "examples" / "ros2_feedforward" / "include"
        c = ["cc", "-std=c99", "-O1", "-ffp-contract=off", "-c", "trackres.c"]
        cpp = [COMPILER, "-std=c++17", "-O1", *STRICT, "-I.", f"-I{include}", "step.cpp", "trackres.o", "-o", "step", "-lm"]
        for command in (c, ["cc", "-std=c99", "-O1", "-ffp-contract=off", "trackres.c", "main.c", "-o", "replay", "-lm"], cpp):
            process = subprocess.run(command, cwd=folder, capture_output=True, text=True)
            assert process.returncode == 0, process.stderr

    def added(self, speeds, enabled=None):
        """Torque to add, result of the step, and its level: a column each."""
        lines = "".join(f"{v!r} {PERIOD_S} {int(on)}\n" for v, on in zip(speeds, enabled or itertools.repeat(True), strict=False))
        process = subprocess.run([self.folder / "step"], input=lines, capture_output=True, text=True, check=True)
        return np.array([line.split() for line in process.stdout.splitlines()], dtype=float).T

    def replayed(self, speeds):
        """Feed-forward of the replay program that comes with the export, at the same times."""
        rows = "".join(f"{PERIOD_S * (i + 1):.2f},{v!r}\n" for i, v in enumerate(speeds))
        (self.folder / "drive.csv").write_text("time_s,speed_mps\n" + rows)
        command = [self.folder / "replay", "drive.csv"]
        process = subprocess.run(command, cwd=self.folder, capture_output=True, text=True, check=True)
        result = np.genfromtxt(process.stdout.splitlines(), delimiter=",", names=True)
        return result["feedforward_torque_nm"]


@pytest.fixture(scope="module")
def vehicle(tmp_path_factory, repository):
    return Vehicle(tmp_path_factory.mktemp("in_process"), repository)


def drive(seconds=20.0):
    """A start, some changes of the speed and a stop at the end [m/s]."""
    t = PERIOD_S * np.arange(round(seconds / PERIOD_S))
    return np.clip(np.minimum(1.5 * t, 8.0 + np.sin(t)), 0.0, np.maximum(0.0, 2.0 * (seconds - 3.0 - t))).tolist()


def ramped(wanted):
    """What follows a torque no faster than the ramp of the controller."""
    used = [0.0]
    for torque in wanted:
        used.append(used[-1] + float(np.clip(torque - used[-1], -RAMP_NM_PER_S * PERIOD_S, RAMP_NM_PER_S * PERIOD_S)))
    return np.array(used[1:])


def test_it_adds_what_the_export_replays(vehicle):
    speeds = drive()
    torque, given_values, _ = vehicle.added(speeds)
    replay_result = vehicle.replayed(speeds)
    assert np.abs(torque).max() > 1000.0
    assert np.abs(given_values - replay_result).max() <= EQUAL * np.abs(replay_result).max()
    assert np.abs(torque - ramped(replay_result)).max() <= EQUAL * np.abs(replay_result).max()
    assert (torque == replay_result).mean() > 0.5


def test_nothing_pushes_at_standstill(vehicle):
    torque, _, level = vehicle.added([0.0] * 500)
    assert not torque.any()
    assert level[-1] != STALE
    torque, _, _ = vehicle.added(drive() + [0.0] * 300)
    assert torque[-1] == 0.0


def test_disabled_it_ramps_to_zero_and_comes_back(vehicle):
    speeds = [5.0] * 900
    torque, _, _ = vehicle.added(speeds, [True] * 300 + [False] * 300 + [True] * 300)
    assert torque[299] > 1000.0
    assert torque[599] == 0.0
    assert torque[-1] == pytest.approx(torque[299], rel=0.05)
    assert np.abs(np.diff(torque)).max() <= RAMP_NM_PER_S * PERIOD_S + 1e-6


def test_without_a_speed_nothing_is_added_for_long(vehicle):
    torque, _, level = vehicle.added([float("nan")] * 100 + [5.0] * 300 + [float("nan")] * 300)
    assert not torque[:100].any()
    assert (level[:100] == STALE).all()
    assert torque[399] > 1000.0
    assert torque[-1] == 0.0
    assert level[-1] == STALE


@pytest.mark.parametrize("elapsed", [float("nan"), float("inf"), -5.0, -0.01])
def test_while_the_step_refuses_its_time_the_torque_ends(vehicle, elapsed):
    lines = "".join([*["5.0 0.01 1\n"] * 300, *[f"5.0 {elapsed} 1\n"] * 200, *["5.0 0.01 1\n"] * 100])
    process = subprocess.run([vehicle.folder / "step"], input=lines, capture_output=True, text=True, check=True)
    torque = np.array([float(line.split()[0]) for line in process.stdout.splitlines()])
    assert torque[299] > 1000.0
    assert torque[301] == torque[299]
    assert torque[499] == 0.0
    assert torque[-1] == pytest.approx(torque[299], rel=0.05)
    assert np.abs(np.diff(torque)).max() <= RAMP_NM_PER_S * PERIOD_S + 1e-6
