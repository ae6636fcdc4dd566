# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Repeats the paper's own test: laps of a circle on a site that is not level, torque computed from the engine's without losses.

The paper compares it with a model of a straight, level, lossless drive. Here the truth has all three, and the diagnosis
has to find them.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from proofs.sealed.cases import LOADS
from proofs.sealed.drives import STEP_S, SealedDrive, drive
from proofs.sealed.generate import FASTEST_MPS, record_all, weight_and_radius, write_vehicle
from proofs.sealed.sensors import Sensors
from proofs.sealed.truth import Build
from trackres_ros.diagnosis import Diagnosis, diagnose, load_base, read_recordings

RADIUS_M = 100.0
HIDDEN = {
    "turning_scrub": {"friction": 0.5},
    "grade_profile": {"rise": 0.01, "towards": 1.0},
    "drivetrain_efficiency": {"efficiency": 0.92},
}
LAP_SPEEDS_MPS = (10.0 / 3.6, 20.0 / 3.6, 30.0 / 3.6)
MINUTES, SEED = 15.0, 3


def diagnose_all(folder: Path) -> dict[str, Diagnosis]:
    """Diagnose the paper's circle, and drives that distinguish its causes; by the way to drive."""
    weight, _ = weight_and_radius()
    rng = np.random.default_rng(SEED)
    circles = [circle(MINUTES, speed, weight) for speed in LAP_SPEEDS_MPS]
    courses = [drive(MINUTES, share * weight, 15.0, FASTEST_MPS, rng) for share in LOADS]
    return {
        "laps of one circle at three speeds": _diagnosed(folder / "circle", circles, rng),
        "a course with bends and straights, three loads": _diagnosed(folder / "course", courses, rng),
    }


def circle(minutes: float, speed: float, weight: float) -> SealedDrive:
    """Laps of the paper's circle at one speed."""
    n = int(minutes * 60.0 / STEP_S)
    time = np.arange(n) * STEP_S
    speeds = speed * np.minimum(1.0, time / 30.0)
    turning = speeds / RADIUS_M
    return SealedDrive(
        STEP_S, speeds, np.gradient(speeds, STEP_S), turning, np.cumsum(turning) * STEP_S, np.full(n, weight), np.full(n, 15.0)
    )


def _diagnosed(folder: Path, drives: list[SealedDrive], rng: np.random.Generator) -> Diagnosis:
    folder.mkdir(parents=True, exist_ok=True)
    vehicle = write_vehicle(folder / "vehicle.yaml", lumped=False)
    _, paths = record_all(folder, "drive", Build(), HIDDEN, drives, Sensors(), rng)
    return diagnose(read_recordings(paths, None), load_base(vehicle))


def page(cases: Mapping[str, Diagnosis]) -> str:
    """Findings, and the truth."""
    lines = [
        f"True: turning scrub (friction {HIDDEN['turning_scrub']['friction']:g}), "
        f"a site tilted by {HIDDEN['grade_profile']['rise']:.0%}, "
        f"a drive train of efficiency {HIDDEN['drivetrain_efficiency']['efficiency']:g}.",
        "",
        "| Driven | Found | True ones in a class | Mean error on held-out laps: file, re-fitted, with effects [Nm] |",
        "|---|---|---|---|",
    ]
    for what, found in cases.items():
        classes = [t.members for t in found.found]
        named = "; ".join(" or ".join(m) for m in classes) or found.verdict.status
        hit = [name for name in HIDDEN if any(name in m for m in classes)]
        mae = found.held_out.mae
        errors = ", ".join(f"{mae[stage]:.0f}" for stage in ("nominal", "refitted", "with_effects"))
        lines.append(f"| {what} | {named} | {', '.join(hit) or '-'} | {errors} |")
    for what, found in cases.items():
        lines += ["", f"## {what[0].upper()}{what[1:]}", "", found.verdict.sentence, ""]
        fitted = ", ".join(f"{name} {value:.3g}" for name, value in found.final.base_values.items())
        lines += [f"Base, re-fitted along: {fitted}.", ""]
        hidden = [n for n in found.last.separability.not_visible if n.name in HIDDEN]
        lines += [f"- {n.name} cannot be seen: {n.why}" for n in hidden]
        for x in found.advice[:1]:
            lines.append(f"- To drive next, {x.minutes:.0f} min: {x.manoeuvre}. It tells {', '.join(x.separates)} apart.")
    return "\n".join(lines) + "\n"
