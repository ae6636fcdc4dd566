# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reproduces Figures 17 to 22, the paper's three driving tests as its text describes them: laps at 10 and 30 km/h and a straight
at 50 km/h.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from proofs.reproduce.bench import (
    COMBINATIONS,
    HOLDS,
    IN_PART,
    OPEN,
    Bench,
    Claim,
    Figure,
    Runs,
    Section,
    Series,
    Table,
    at_times,
    percent,
    percents,
    write_csv,
)
from trackres_ros.arrays import Array
from trackres_ros.estimator.drives import SimulatedDrive, laps, simulate, through_points
from trackres_ros.output.style import BLACK, BLUE, GREY, ORANGE, SKY, VERMILION, legend_beside, picture, thin_out
from trackres_ros.recording.slopes import runs_of
from trackres_ros.units import KMH_PER_MPS

LAP_M = 2.0 * math.pi * 100.0  # section 3.2.2: turning radius about 100 m
STRAIGHT_M, STRAIGHT_S = 2000.0, 155.0  # the straight, and how long the record of Figure 22 is
STRAIGHT_KMH = 50.0
# Constant acceleration from rest and then 50 km/h cover 2000 m in 155 s if the ramp lasts 2 (155 s - 2000 m / v) = 22 s.
ACCELERATION = STRAIGHT_KMH / KMH_PER_MPS / (2.0 * (STRAIGHT_S - STRAIGHT_M * KMH_PER_MPS / STRAIGHT_KMH))
STOP_S = 20.0  # assumed: to stop and save the data; the paper gives no duration
OTHER_STOPS_S = (5.0, 60.0)
LONG_RUN = 10  # times a lap test's duration, to find its steady state
LEAST_HELD = 4  # samples of a stretch at full speed that counts
LINES = ((BLUE, "-"), (SKY, "--"), (VERMILION, "-"), (ORANGE, "--"))  # of `COMBINATIONS`


@dataclass(frozen=True)
class Trial:
    """One test of section 3.2.2, with the error that section 4.1 states between its simulation and its measurement."""

    speed_kmh: float
    duration_s: float
    figures: str
    name: str
    laps: bool
    mae_nm: float
    r_square: float
    csv_step_s: float

    @property
    def where(self) -> str:
        """Where the paper speaks of it."""
        return f"section 4.1, Figures {self.figures}"

    def drive(self, dt: float, stop_s: float = STOP_S, times: int = 1) -> SimulatedDrive:
        """Speed over time; `times` as long as the record."""
        speed = self.speed_kmh / KMH_PER_MPS
        ramp, end = speed / ACCELERATION, times * self.duration_s
        if not self.laps:
            return through_points(np.array([0.0, ramp, end]), np.array([0.0, speed, speed]), dt)
        count = math.ceil(end / (LAP_M / speed + ramp + stop_s))
        total = laps(speed, LAP_M, count, ramp, stop_s, dt)
        kept = total.time_s <= end + 1e-9
        return SimulatedDrive(total.time_s[kept], total.speed[kept], total.acceleration[kept])


TRIALS = (
    Trial(10.0, 2500.0, "17 and 18", "fig18_laps_10kmh", True, 409.0, 0.85, 5.0),
    Trial(30.0, 600.0, "19 and 20", "fig20_laps_30kmh", True, 707.0, 0.88, 2.0),
    Trial(STRAIGHT_KMH, STRAIGHT_S, "21 and 22", "fig22_straight_50kmh", False, 1061.0, 0.91, 1.0),
)


def held(series: Series) -> Iterator[slice]:
    """The stretches at full speed, without their first two samples: the belt strain by the drive lags one step."""
    for start, end in runs_of(series["speed_mps"] >= series["speed_mps"].max() - 1e-9):
        if end - start >= LEAST_HELD:
            yield slice(start + 2, end)


def held_means(series: Series) -> Array:
    """Mean resistance torque of each stretch at full speed [Nm], shape (stretches,)."""
    return np.array([series["resistance_torque_nm"][part].mean() for part in held(series)])


def trials(bench: Bench, out: Path) -> Iterator[Section]:
    """A section for each of the three tests."""
    for trial in TRIALS:
        runs = bench.run(f"test at {trial.speed_kmh:g} km/h", trial.drive(bench.dt))
        figure = _draw(bench, out, trial, runs)
        claims = [_lap_falls(trial, runs), _lap_settles(bench, trial, runs)] if trial.laps else [_straight_falls(trial, runs)]
        claims.append(_stated_error(bench, trial, runs))
        tables = [_table(runs)] + ([_stop_table(bench, trial)] if trial.laps else [])
        title = f"Figures {trial.figures}: {'laps' if trial.laps else 'straight'} at {trial.speed_kmh:g} km/h"
        numbers = {"acceleration_mps2": ACCELERATION, "stop_s": STOP_S if trial.laps else None}
        yield Section(title, [_profile_text(bench, trial)], [figure], claims, tables, numbers)


def _profile_text(bench: Bench, trial: Trial) -> str:
    way = f"in laps of {LAP_M:.0f} m with a stop of {STOP_S:g} s after each" if trial.laps else f"on a {STRAIGHT_M:g} m straight"
    return (
        f"{trial.duration_s:g} s {way}, {bench.vehicle.weight / 1e3:g} kN, {bench.vehicle.chassis.ambient:g} °C. Weight, air"
        f"{', stops' if trial.laps else ''} and the acceleration of {ACCELERATION:.2f} m/s² are assumed: the recorded speed is "
        f"not public.{' The model does not know the turn.' if trial.laps else ''}"
    )


def _draw(bench: Bench, out: Path, trial: Trial, runs: Runs) -> Figure:
    figure = Figure(
        f"{trial.name}.png",
        (f"{trial.name}.csv",),
        f"Speed, torque and belt temperature of the test at {trial.speed_kmh:g} km/h (the paper's Figures {trial.figures}).",
    )
    times = np.arange(0.0, trial.duration_s + 1e-9, trial.csv_step_s)
    columns = {"time_s": times, "speed_mps": at_times(runs[bench.shipped], "speed_mps", times)}
    for combination in COMBINATIONS:
        for column in ("resistance_torque_nm", "drive_torque_nm", "belt_degc"):
            columns[f"{column}_{combination.replace('/', '_')}"] = at_times(runs[combination], column, times)
    write_csv(out / figure.data[0], columns)
    main = runs[bench.shipped]
    with picture(out / figure.png, 9.0, 8.0) as drawing:
        speed, torque, zoom, belt = drawing.subplots(4, 1, sharex=True, height_ratios=(0.8, 1.3, 1.3, 1.2))
        speed.plot(*thin_out(main["time_s"], main["speed_mps"] * KMH_PER_MPS), color=BLACK)
        speed.set_ylim(0.0, 1.1 * trial.speed_kmh)
        speed.set_ylabel("speed [km/h]")
        driving = thin_out(main["time_s"], main["drive_torque_nm"] / 1e3)
        torque.plot(*driving, color=GREY, linewidth=0.9, label="drive torque,\nwith inertia")
        torque.plot(*thin_out(main["time_s"], main["resistance_torque_nm"] / 1e3), color=BLUE, label="resistance")
        torque.set_title(bench.shipped.replace("/", ", "))
        torque.set_ylabel("torque [kNm]")
        zoom.set_title("resistance at full speed")
        for combination, (colour, style) in zip(COMBINATIONS, LINES, strict=True):
            series, label = runs[combination], combination.replace("/", ", ")
            at_speed = np.full(len(series["time_s"]), np.nan)
            for part in held(series):
                at_speed[part] = series["resistance_torque_nm"][part]
            zoom.plot(*thin_out(series["time_s"], at_speed), color=colour, linestyle=style, label=label)
            belt.plot(*thin_out(series["time_s"], series["belt_degc"]), color=colour, linestyle=style, label=label)
        zoom.set_ylabel("torque [Nm]")
        belt.set_ylabel("belt [°C]")
        belt.axhline(bench.vehicle.chassis.ambient, color=GREY, linestyle=":", linewidth=1.0, label="ambient")
        belt.set_xlabel("time [s]")
        belt.margins(x=0.01)
        for axes in (torque, zoom, belt):
            legend_beside(axes)
        drawing.align_ylabels()
    return figure


def _lap_falls(trial: Trial, runs: Runs) -> Claim:
    means = {c: held_means(runs[c]) for c in COMBINATIONS}
    return Claim(
        f"laps_{trial.speed_kmh:g}_fall",
        trial.where,
        "The simulated torque gradually decreases.",
        {c: bool((np.diff(m) < 0).all()) for c, m in means.items()},
        f"The mean torque at full speed changes from the first of {len(means[COMBINATIONS[0]])} laps to the last by "
        f"{percents(m[-1] / m[0] - 1.0 for m in means.values())}.",
        {HOLDS: "The belt warms more in a lap than it cools in a stop."},
        {"lap_mean_nm": {c: m.tolist() for c, m in means.items()}},
        {
            "first lap": {c: f"{m[0]:.0f} Nm" for c, m in means.items()},
            "last lap": {c: f"{m[-1]:.0f} Nm" for c, m in means.items()},
        },
    )


def _lap_settles(bench: Bench, trial: Trial, runs: Runs) -> Claim:
    means = {c: held_means(runs[c]) for c in COMBINATIONS}
    long_run = trial.drive(bench.dt, times=LONG_RUN)
    ends = {c: float(held_means(simulate(bench.estimator(c), long_run))[-2]) for c in COMBINATIONS}  # the last may be cut short
    shrinking = {c: bool((np.diff(m[:-1], 2) > 0).all()) for c, m in means.items()}
    outcomes = {c: float((m[0] - m[-1]) / (m[0] - ends[c])) for c, m in means.items()}
    return Claim(
        f"laps_{trial.speed_kmh:g}_settle",
        trial.where,
        "The torque gradually tends to a stable value.",
        shrinking,
        f"Of the fall in {LONG_RUN * trial.duration_s:g} s of laps, the {trial.duration_s:g} s of the record have "
        f"{percents(outcomes.values(), 0)}.",
        {
            HOLDS: "The fall from lap to lap shrinks: the belt comes to a balance of heat.",
            IN_PART: "The fall does not shrink from each lap to the next.",
        },
        {"tends_to_nm": ends, "share_done": outcomes},
        {
            "tends to": {c: f"{m:.0f} Nm" for c, m in ends.items()},
            "share of the fall in the record": {c: percent(share, 0) for c, share in outcomes.items()},
        },
    )


def _straight_falls(trial: Trial, runs: Runs) -> Claim:
    torque = {c: runs[c]["resistance_torque_nm"][next(held(runs[c]))] for c in COMBINATIONS}
    change = {c: float(m[-1] / m[0] - 1.0) for c, m in torque.items()}
    return Claim(
        f"straight_{trial.speed_kmh:g}_falls",
        trial.where,
        "The simulated torque gradually decreases.",
        {c: bool((np.diff(m) < 0).all()) for c, m in torque.items()},
        f"From when full speed is reached to {trial.duration_s:g} s the torque changes by {percents(change.values())}.",
        {HOLDS: "The belt warms all the way; the record ends long before its balance of heat."},
        {"change": change},
        {
            "at full speed": {c: f"{m[0]:.0f} Nm" for c, m in torque.items()},
            "at the end": {c: f"{m[-1]:.0f} Nm" for c, m in torque.items()},
        },
    )


def _stated_error(bench: Bench, trial: Trial, runs: Runs) -> Claim:
    # R² is 1 - mean square error / variance, and a root mean square error is at least the mean absolute one.
    least = trial.mae_nm / math.sqrt(1.0 - trial.r_square)
    series = runs[bench.shipped]
    drive, resistance = float(np.std(series["drive_torque_nm"])), float(np.std(series["resistance_torque_nm"]))
    if least <= resistance:
        reading = "Resistance alone varies as much"
    elif least <= drive:
        reading = "Only with the inertia of driving off and stopping does it vary so much"
    else:
        reading = "The paper's vehicle accelerated harder, or has more resistance, than this profile and vehicle file"
    return Claim(
        f"stated_error_{trial.speed_kmh:g}",
        trial.where,
        f"Simulation and measurement agree to a mean absolute error of {trial.mae_nm:g} Nm and an R² of {trial.r_square:g} over "
        f"0-{trial.duration_s:g} s.",
        {},
        "The measurement is not public. Both numbers give its least standard deviation: "
        f"{trial.mae_nm:g} / √(1 - {trial.r_square:g}) = {least:.0f} Nm. The program's resistance torque has {resistance:.0f} Nm "
        f"({bench.shipped.replace('/', ', ')}), its drive torque with inertia {drive:.0f} Nm. {reading}.",
        {OPEN: ""},
        {"least_std_nm": least, "drive_std_nm": drive, "resistance_std_nm": resistance},
    )


def _table(runs: Runs) -> Table:
    rows = []
    for c in COMBINATIONS:
        parts, torque = list(held(runs[c])), runs[c]["resistance_torque_nm"]
        torques = torque[parts[0].start], torque[parts[-1].stop - 1], runs[c]["drive_torque_nm"].max()
        first, last, largest = (f"{nm:.0f}" for nm in torques)
        rows.append([c.replace("/", ", "), first, last, f"{runs[c]['belt_degc'][-1]:.1f}", largest])
    header = [
        "methods",
        "resistance when full speed is reached [Nm]",
        "resistance at the end of full speed [Nm]",
        "belt at the end [°C]",
        "largest drive torque, with inertia [Nm]",
    ]
    return Table("Whole vehicle, over the record.", header, rows)


def _stop_table(bench: Bench, trial: Trial) -> Table:
    rows = []
    for stop_s in sorted((STOP_S, *OTHER_STOPS_S)):
        series = simulate(bench.estimator(bench.shipped), trial.drive(bench.dt, stop_s))
        means = held_means(series)
        rows.append([f"{stop_s:g}", f"{means[0]:.0f}", f"{means[-1]:.0f}", f"{series['belt_degc'][-1]:.1f}"])
    return Table(
        f"What the assumed stop changes ({bench.shipped.replace('/', ', ')}).",
        ["stop [s]", "mean of the first lap [Nm]", "mean of the last lap [Nm]", "belt at the end [°C]"],
        rows,
    )
