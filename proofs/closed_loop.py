# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Closes the loop: a vehicle file that a diagnosis wrote is replayed on a drive that the diagnosis never saw."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from proofs.processes import run_command
from proofs.sealed.cases import Case
from proofs.sealed.generate import make_case
from trackres_ros.arrays import Array
from trackres_ros.diagnosis import diagnose, load_base, read_recordings
from trackres_ros.output.style import BLACK, BLUE, GREY, VERMILION, picture

MINUTES, SEED = 15.0, 5
SMOOTHED_S = 10.0
TURNS_M = 0.005  # curvature [1/m]
HIDDEN = {"warmup": {"torque": 600.0, "seconds": 400.0}, "turning_scrub": {"friction": 0.6}}


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
    make_case(folder, MINUTES, Case("loop", "single", HIDDEN, {}, False, False, False, True, SEED))
    before, after = folder / "cases" / "loop" / "vehicle.yaml", folder / "after.yaml"
    *paths, last = sorted(before.parent.glob("drive_*.csv"))
    loaded = load_base(before)
    found = diagnose(read_recordings(paths, None), loaded)
    loaded.base.write(after, found.kept, found.verdict.sentence)
    drive = np.genfromtxt(last, delimiter=",", names=True)
    rows = [_replayed(last, vehicle, folder / f"{name}.csv") for name, vehicle in (("before", before), ("after", after))]
    time = drive["time_s"] - drive["time_s"][0]
    without, with_found = (np.interp(time, row["time_s"] - row["time_s"][0], row["feedforward_torque_nm"]) for row in rows)
    inertia = np.interp(time, rows[0]["time_s"] - rows[0]["time_s"][0], rows[0]["inertia_nm"])
    moving = drive["speed_mps"] > 0.5
    torque = np.where(moving, drive["torque_nm"] - inertia, np.nan)
    turning = np.abs(drive["yaw_rate_radps"]) > TURNS_M * np.maximum(drive["speed_mps"], 0.5)
    return ClosedLoop(found.verdict.sentence, time, torque, without, with_found, turning)


def _replayed(recording: Path, vehicle: Path, out: Path) -> NDArray[np.void]:
    run_command("replay", recording, "--vehicle", vehicle, "-o", out)
    return np.genfromtxt(out, delimiter=",", names=True)


def _smooth(series: Array) -> Array:
    """Mean over `SMOOTHED_S` of samples at 10 Hz: the acceleration's noise is no error of the feed-forward."""
    n = int(SMOOTHED_S * 10.0)
    known = np.isfinite(series)
    count = np.convolve(known.astype(float), np.ones(n), mode="same")
    return np.asarray(np.convolve(np.where(known, series, 0.0), np.ones(n), mode="same") / np.maximum(count, 1.0))


def draw(loop: ClosedLoop, path: Path) -> None:
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


def page(loop: ClosedLoop, name: str) -> str:
    """The numbers, with the picture of a name."""
    everywhere, cold = np.isfinite(loop.torque), loop.time < 300.0
    parts = {"the whole drive": everywhere, "the first five minutes": cold, "bends": loop.turning, "straights": ~loop.turning}
    lines = [f"The diagnosis of two drives: {loop.sentence}", "", f"![A third drive, which it never saw.]({name})", ""]
    lines += ["| Of a third drive | Mean error before [Nm] | After [Nm] |", "|---|---|---|"]
    lines += [f"| {what} | {loop.error(loop.before, at):.0f} | {loop.error(loop.after, at):.0f} |" for what, at in parts.items()]
    return "\n".join(lines) + "\n"
