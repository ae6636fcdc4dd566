# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Compilers take the C without a warning, on three processors it gives the same numbers, and it needs nothing but math.h."""

import csv
import dataclasses
import re
import shutil
import subprocess

import numpy as np
import pytest
from built import EQUAL, STRICT, difference, drive, have, write

import trackres_ros as tr
from trackres_ros.effects.effect import Active
from trackres_ros.effects.registry import catalogue

THREE = ("warmup", "roadwheel_tyres", "tension_torque")
CROSS = {
    "aarch64": ("aarch64-linux-gnu-gcc", "qemu-aarch64", "/usr/aarch64-linux-gnu"),
    "armhf": ("arm-linux-gnueabihf-gcc", "qemu-arm", "/usr/arm-linux-gnueabihf"),
}
SANITIZED = ("-g", "-O0", "-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all")


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """Files of a vehicle with three effects, a drive, and the live step's results on it."""
    folder = tmp_path_factory.mktemp("exported")
    known = catalogue()
    vehicle = tr.load_vehicle("agri3t")
    sized = [known[name].for_size(vehicle.size, False) for name in THREE]
    vehicle = dataclasses.replace(vehicle, effects=tuple(Active(effect, effect.values()) for effect in sized))
    estimator = write(vehicle, folder)
    channel, stamp, _, value = drive(estimator, 0.04, 7, faults=False)
    speeds = channel == 0
    stamp = stamp[speeds] - stamp[speeds][0]
    lines = (
        f"{ns * 1e-9:.9f},{v!r},{12.5 if i % 3 == 0 else ''}"
        for i, (ns, v) in enumerate(zip(stamp, value[speeds].tolist(), strict=True))
    )
    (folder / "drive.csv").write_text("time_s,speed_mps,ambient_degc\n" + "\n".join(lines) + "\n")
    expectation = tr.replay(folder / "drive.csv", vehicle)
    return folder, estimator, np.stack([expectation[name] for name in estimator.columns], axis=1)


def build(folder, compiler, *flags):
    """The program that replays."""
    command = [compiler, *STRICT, *flags, "trackres.c", "main.c", "-o", f"replay_{compiler}", "-lm"]
    process = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert process.returncode == 0, process.stderr
    assert not process.stderr
    return f"./replay_{compiler}"


def held(exported, *words, environment=None):
    """Run it, and hold its rows against those of a replay."""
    folder, estimator, expectation = exported
    process = subprocess.run([*words, "drive.csv"], cwd=folder, capture_output=True, text=True, env=environment)
    assert process.returncode == 0, process.stderr
    rows = list(csv.DictReader(process.stdout.splitlines()))
    result = np.array([[float(row[name] or "nan") for name in estimator.columns] for row in rows])
    assert difference(result, expectation).max() <= EQUAL


@pytest.mark.parametrize("compiler", ["gcc", "clang"])
@pytest.mark.parametrize("flags", [("-O2",), SANITIZED], ids=["strict", "sanitized"])
def test_compilers_take_it_and_sanitizers_find_nothing(compiler, flags, exported):
    if not have(compiler):
        pytest.skip(f"{compiler} is not installed")
    held(exported, build(exported[0], compiler, *flags))


@pytest.mark.parametrize("processor", CROSS)
def test_other_processors_give_the_same(processor, exported):
    compiler, emulator, root = CROSS[processor]
    if not have(compiler, emulator):
        pytest.skip(f"{compiler} or {emulator} is not installed")
    held(exported, emulator, "-L", root, build(exported[0], compiler, "-O2"))


def test_no_library_but_that_of_mathematics_is_called(exported):
    if not have("gcc", "nm"):
        pytest.skip("gcc or nm is not installed")
    folder, *_ = exported
    subprocess.run(["gcc", *STRICT, "-O1", "-c", "trackres.c", "-o", "step.o"], cwd=folder, check=True)
    lines = subprocess.run(["nm", "step.o"], cwd=folder, check=True, capture_output=True, text=True).stdout.splitlines()
    kinds = [line.split()[-2:] for line in lines]
    asked = {name for kind, name in kinds if kind == "U"}
    of_mathematics = "sqrt exp expm1 log log10 pow tanh cos sin floor ceil fabs copysign fmod"
    assert asked <= set(of_mathematics.split())
    assert not [name for kind, name in kinds if kind in "bBdDC"]  # no globals that change
    assert set(re.findall(r"#include <(.+)>", (folder / "trackres.c").read_text())) == {"math.h", "stddef.h"}


def test_cppcheck_finds_nothing(exported):
    if not shutil.which("cppcheck"):
        pytest.skip("cppcheck is not installed")
    folder, *_ = exported
    text = (folder / "trackres.c").read_text()
    (folder / "checked.c").write_text(re.sub(r"(TR_LOSS\[\d+\] = \{ /\* .*? \*/).*?\};", r"\1 1.0};", text, flags=re.DOTALL))
    looked_for = "--enable=warning,style,performance,portability"
    command = ["cppcheck", "--std=c99", looked_for, "--error-exitcode=1", "--quiet", "checked.c", "main.c"]
    process = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert process.returncode == 0, process.stderr


def test_the_same_file_gives_the_same_c(exported, tmp_path):
    folder, estimator, _ = exported
    write(estimator.vehicle, tmp_path)
    assert (tmp_path / "trackres.c").read_bytes() == (folder / "trackres.c").read_bytes()
