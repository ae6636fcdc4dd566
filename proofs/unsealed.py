# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Two proofs without a seal, on the second simulator: a closed loop, and the paper's own test.

The loop replays a vehicle file that a diagnosis wrote, on a drive that the diagnosis never saw. The paper drives laps of a circle
on a site that is not level, with torque computed from the engine's without losses. It compares them with a model of a straight,
level, lossless drive. Here the truth has all three, and the diagnosis has to find them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from proofs.pipeline import run_command
from proofs.sealed.cases import LOADS, Case
from proofs.sealed.drives import STEP_S, SealedDrive, drive
from proofs.sealed.recordings import FASTEST_MPS, make_case, record_all, weight_and_radius, write_vehicle
from proofs.sealed.truth import Build, Sensors
from proofs.tables import Tables, number
from trackres_ros.arrays import Array
from trackres_ros.diagnosis import Diagnosis, diagnose, load_base, read_recordings
from trackres_ros.output.style import BLACK, BLUE, GREY, VERMILION, picture

MINUTES = 15.0
LOOP_SEED, PAPER_SEED = 5, 3
SMOOTHED_S = 10.0
TURNS_M = 0.005  # curvature [1/m]
LOOP_HIDDEN = {"warmup": {"torque": 600.0, "seconds": 400.0}, "turning_scrub": {"friction": 0.6}}


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """A hold-out drive: time [s], measured torque less inertia [Nm], and the feed-forward without and with the found physics."""

    sentence: str
    time: Array
    torque: Array
    before: Array
    after: Array
    turning: NDArray[np.bool_]

    def error(self, feedforward: Array, where: NDArray[np.bool_]) -> float:
        """Mean absolute error of the feed-forward [Nm]."""
        return float(np.abs(_smooth(self.torque - feedforward))[where & np.isfinite(self.torque)].mean())


def close_loop(folder: Path) -> ClosedLoop:
    """Drive three times with effects hidden; replay the last, with the vehicle file before and after the others' diagnosis."""
    make_case(folder, MINUTES, Case("loop", "single", LOOP_HIDDEN, {}, False, False, False, True, LOOP_SEED))
    result_before, result_after = folder / "cases" / "loop" / "vehicle.yaml", folder / "after.yaml"
    *paths, last = sorted(result_before.parent.glob("drive_*.csv"))
    loaded = load_base(result_before)
    result = diagnose(read_recordings(paths, None), loaded)
    loaded.base.write(result_after, result.kept, result.verdict.sentence)
    drive = np.genfromtxt(last, delimiter=",", names=True)
    rows = [
        _replayed(last, vehicle, folder / f"{name}.csv") for name, vehicle in (("before", result_before), ("after", result_after))
    ]
    time = drive["time_s"] - drive["time_s"][0]
    without, with_found = (np.interp(time, row["time_s"] - row["time_s"][0], row["feedforward_torque_nm"]) for row in rows)
    inertia = np.interp(time, rows[0]["time_s"] - rows[0]["time_s"][0], rows[0]["inertia_nm"])
    is_moving = drive["speed_mps"] > 0.5
    torque = np.where(is_moving, drive["torque_nm"] - inertia, np.nan)
    turning = np.abs(drive["yaw_rate_radps"]) > TURNS_M * np.maximum(drive["speed_mps"], 0.5)
    return ClosedLoop(result.verdict.sentence, time, torque, without, with_found, turning)


def _replayed(recording: Path, vehicle: Path, out: Path) -> NDArray[np.void]:
    run_command("replay", recording, "--vehicle", vehicle, "-o", out)
    return np.genfromtxt(out, delimiter=",", names=True)


def _smooth(series: Array) -> Array:
    """Mean over `SMOOTHED_S` of samples at 10 Hz: the acceleration's noise is no error of the feed-forward."""
    n = int(SMOOTHED_S * 10.0)
    known = np.isfinite(series)
    count = np.convolve(known.astype(float), np.ones(n), mode="same")
    return np.asarray(np.convolve(np.where(known, series, 0.0), np.ones(n), mode="same") / np.maximum(count, 1.0))


def draw_loop(loop: ClosedLoop, path: Path) -> None:
    """Measured torque and both feed-forwards over time."""
    with picture(path, 8.0, 3.4) as figure:
        axes = figure.subplots()
        minutes = loop.time / 60.0
        measured = np.where(np.isfinite(loop.torque), _smooth(loop.torque), np.nan)
        axes.plot(minutes, measured, color=GREY, label="measured, less inertia")
        axes.plot(minutes, loop.before, color=VERMILION, label="feed-forward with the vehicle file as it was")
        axes.plot(minutes, loop.after, color=BLUE, label="with the one that the diagnosis left")
        axes.set_xlabel("time [min]", color=BLACK)
        axes.set_ylabel("torque [Nm]")
        axes.set_ylim(0.0, 1.4 * float(np.nanpercentile(_smooth(loop.torque), 99.0)))
        axes.legend(loc="upper right")


def loop_tables(loop: ClosedLoop) -> Tables:
    """The mean error in parts of the drive, and the verdict."""
    everywhere, cold = np.isfinite(loop.torque), loop.time < 300.0
    parts = {"the whole drive": everywhere, "the first five minutes": cold, "bends": loop.turning, "straights": ~loop.turning}
    errors = [
        {
            "part": part,
            "before_nm": number(loop.error(loop.before, place), 0),
            "after_nm": number(loop.error(loop.after, place), 0),
        }
        for part, place in parts.items()
    ]
    return {"loop": errors, "loop_verdict": [{"verdict": loop.sentence}]}


RADIUS_M = 100.0
PAPER_HIDDEN = {
    "turning_scrub": {"friction": 0.5},
    "grade_profile": {"rise": 0.01, "towards": 1.0},
    "drivetrain_efficiency": {"efficiency": 0.92},
}
LAP_SPEEDS_MPS = (10.0 / 3.6, 20.0 / 3.6, 30.0 / 3.6)


def diagnose_all(folder: Path) -> dict[str, Diagnosis]:
    """Diagnose the paper's circle, and drives that distinguish its causes; by the way to drive."""
    weight, _ = weight_and_radius()
    rng = np.random.default_rng(PAPER_SEED)
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
    _, paths = record_all(folder, "drive", Build(), PAPER_HIDDEN, drives, Sensors(), rng)
    return diagnose(read_recordings(paths, None), load_base(vehicle))


def paper_tables(cases: Mapping[str, Diagnosis]) -> Tables:
    """Findings by the way to drive."""
    return {"paper": [paper_row(driven, result) for driven, result in cases.items()]}


def paper_row(driven: str, found: Diagnosis) -> dict[str, str]:
    """Findings, errors, and what to drive next."""
    classes = [t.members for t in found.found]
    hidden = [f"{n.name}: {n.why}" for n in found.last.separability.not_visible if n.name in PAPER_HIDDEN]
    advice = [f"{a.minutes:.0f} min: {a.manoeuvre}. It tells {', '.join(a.separates)} apart." for a in found.advice[:1]]
    return {
        "driven": driven,
        "found": "; ".join(" or ".join(members) for members in classes) or found.verdict.status,
        "true_in_a_class": ", ".join(name for name in PAPER_HIDDEN if any(name in members for members in classes)),
        **{f"{stage}_nm": number(found.held_out.mae[stage], 0) for stage in ("nominal", "refitted", "with_effects")},
        "verdict": found.verdict.sentence,
        "base": ", ".join(f"{name} {value:.3g}" for name, value in found.final.base_values.items()),
        "not_visible": "; ".join(hidden),
        "to_drive_next": "".join(advice),
    }
