# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The proof of the estimated delay of the torque behind the speed, on vehicles with a concealed delay."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from proofs.learning import (
    AIRS_DEGC,
    LOADS,
    SENSORS,
    LearningCase,
    LearningProof,
    added_torque,
    draw_cases,
    misled,
    weight_shares,
)
from proofs.sealed.drives import SealedDrive, drive, trapezoids
from proofs.sealed.recordings import FASTEST_MPS, START_S, VEHICLE, weight_and_radius, write_vehicle
from proofs.sealed.truth import HEAVY_TAILS, Build, Sensors, drawn_sensors, lagging, road_slopes, simulate_truth
from proofs.tables import FOLDER, Rows, number, write_tables
from trackres_ros.arrays import Array
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.records import Steps
from trackres_ros.files.resources import find_vehicle
from trackres_ros.learning.columns import LEARNED
from trackres_ros.learning.learner import Learner
from trackres_ros.recording.opening import open_source
from trackres_ros.tasks.replay_run import replay
from trackres_ros.vehicle import load

LONGEST_S = 0.5
RATES_HZ = (1.0, 100.0)
APART = (0.5, 2.0)  # rate of the torque over that of the speed
JITTER_SHARE = 0.3  # at most, of the time between samples
STAMP_STD_S = 0.005  # at most, by which a stamp is off
TARGET_S, WITHIN_STD = 0.02, 3.0
RATES_OF = ((1.0, 3.0), (3.0, 10.0), (10.0, 30.0), (30.0, 100.0))


@dataclass(frozen=True)
class Delayed:
    """Concealed values of a vehicle."""

    case: LearningCase  # as for the proof of the learning
    delay_s: float
    filter_s: float  # a filter's share of the delay
    speed_hz: float
    torque_hz: float
    jitter: float
    stamp_std_s: float
    stop_and_go: bool

    @property
    def name(self) -> str:
        """Uninformative."""
        return self.case.name


def draw(seed: int, vehicles: int, hostile: int) -> list[Delayed]:
    """Draw vehicles with their delays and instruments, all from one seed."""
    rng = np.random.default_rng([seed, 17])
    results = []
    for case in draw_cases(seed, vehicles, hostile):
        delay = float(rng.uniform(0.0, LONGEST_S))
        speed_hz = float(np.exp(rng.uniform(*np.log(RATES_HZ))))
        torque_hz = min(max(speed_hz * float(np.exp(rng.uniform(*np.log(APART)))), RATES_HZ[0]), RATES_HZ[1])
        results.append(
            Delayed(case, delay, float(rng.uniform(0.0, min(0.1, delay))), speed_hz, torque_hz,
                    float(rng.uniform(0.0, JITTER_SHARE)), float(rng.uniform(0.0, STAMP_STD_S)), bool(rng.random() < 0.5))
        )  # fmt: skip
    return results


class DelayProof(LearningProof):
    """Vehicles of the proof of the learning, with a delay each."""

    key, page = "drawn", "delay.md"

    def draw(self) -> list[Delayed]:
        """See `Proof`."""
        return draw(self.settings["seed"], self.settings["vehicles"], self.settings["hostile"])

    def record(self, delayed: Delayed) -> None:
        """Write the vehicle file and the recording of one vehicle: a line for each sample of a sensor, by its stamp."""
        case, into = delayed.case, self.folder / "cases" / delayed.name
        into.mkdir(parents=True, exist_ok=True)
        write_vehicle(into / "vehicle.yaml", case.lumped)
        weight, radius = weight_and_radius()
        rng = np.random.default_rng([case.seed, 2])
        make = trapezoids if delayed.stop_and_go else drive
        planned = make(
            self.settings["minutes"], float(rng.choice(LOADS)) * weight, float(rng.choice(AIRS_DEGC)), FASTEST_MPS, rng
        )
        driven = replace(planned, weight=planned.weight * weight_shares(case, planned.speed))
        (run,) = simulate_truth(find_vehicle(VEHICLE), Build(**case.build), {}, [driven])
        sensors = drawn_sensors(rng)
        torque = run.shown + road_slopes(driven, sensors, rng) * driven.weight * radius
        torque = torque + added_torque(case, driven, weight, radius)
        rows = [*_speeds(delayed, driven, sensors, rng), *_torques(delayed, driven, torque, sensors, rng)]
        lines = [
            f"{stamp:.6f},{speed},{measured},{planned.weight[0]:.1f},{planned.ambient[0]:.1f}"
            for stamp, speed, measured in sorted(rows)
        ]
        head = "time_s,speed_mps,torque_nm,weight_n,ambient_degc"
        (into / "drive.csv").write_text("\n".join([head, *lines]) + "\n", encoding="utf-8")

    def cases(self, labels: Mapping[str, Any]) -> list[Delayed]:
        """See `Proof`."""
        return [Delayed(**{**label, "case": LearningCase(**label["case"])}) for label in labels["drawn"]]

    def scores(self, cases: Sequence[Delayed]) -> list[dict[str, Any]]:
        """See `Proof`."""
        return [_score(case, np.load(self.folder / "results" / f"{case.name}.npz")["rows"]) for case in cases]

    def report(self, scores: list[dict[str, Any]], labels: Mapping[str, Any], seal: str) -> tuple[dict[str, Any], str]:
        """See `Proof`."""
        content = {"seed": labels["seed"], "minutes": labels["minutes"], "seal": seal, "each": scores}
        write_tables(self.folder / FOLDER, {"delay": rows_of(scores)})
        return content, page(content)


def _speeds(one: Delayed, driven: SealedDrive, sensors: Sensors, rng: np.random.Generator) -> list[tuple[float, str, str]]:
    times, stamps = _sampled(one, driven, one.speed_hz, rng)
    speed = np.interp(times, np.arange(len(driven)) * driven.step, driven.speed)
    shown = np.round((speed + rng.normal(0.0, sensors.speed_mps, len(speed))) / sensors.speed_step_mps) * sensors.speed_step_mps
    shown = np.where(speed < 1e-3, 0.0, shown)
    return [(stamp, f"{value:.5f}", "") for stamp, value in zip(stamps.tolist(), shown.tolist(), strict=True)]


def _torques(
    one: Delayed, driven: SealedDrive, torque: Array, sensors: Sensors, rng: np.random.Generator
) -> list[tuple[float, str, str]]:
    times, stamps = _sampled(one, driven, one.torque_hz, rng)
    grid = np.arange(len(driven)) * driven.step
    filtered = sensors.torque_gain * lagging(torque, one.filter_s, driven.step) + sensors.torque_offset_nm
    seen = times - (one.delay_s - one.filter_s)
    shown = np.interp(seen, grid, filtered)
    white = rng.standard_t(HEAVY_TAILS, len(seen)) * np.sqrt((HEAVY_TAILS - 2.0) / HEAVY_TAILS)
    size = sensors.torque_nm + sensors.torque_share * np.abs(shown) + 20.0 * np.abs(np.interp(seen, grid, driven.accel))
    shown = np.round((shown + white * size) / sensors.torque_step_nm) * sensors.torque_step_nm
    if one.case.hostile in SENSORS:
        shown = misled(one.case, shown, 1.0 / one.torque_hz, rng)
    there = np.isfinite(shown) & (rng.random(len(shown)) > sensors.dropouts)
    return [(stamp, "", f"{value:.2f}") for stamp, value in zip(stamps[there].tolist(), shown[there].tolist(), strict=True)]


def _sampled(one: Delayed, driven: SealedDrive, rate_hz: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """When a sensor samples [s], and its stamps [s since 1970]."""
    n = int(len(driven) * driven.step * rate_hz)
    times = (np.arange(n) + rng.random() + one.jitter * rng.uniform(-0.5, 0.5, n)) / rate_hz
    return times, np.maximum.accumulate(START_S + times + rng.normal(0.0, one.stamp_std_s, n))


def learn(folder: Path) -> tuple[dict[str, Any], dict[str, Array]]:
    """Answer of the folder of a vehicle, learned as by the live node.

    The rows have time [s], delay [s], standard deviation [s] and state, once a second.
    """
    estimator = Estimator(load(folder / "vehicle.yaml"))
    kept: list[Steps] = []
    replay(open_source([folder / "drive.csv"], None), estimator, kept.append, learner=Learner(estimator, "watch"))
    stamps = np.concatenate([steps.stamp_ns for steps in kept])
    rows = np.concatenate([steps.rows[:, -3:] for steps in kept])
    seconds = np.flatnonzero(np.diff(stamps // 10**9, append=0))
    return {}, {"rows": np.column_stack([(stamps[seconds] - stamps[0]) * 1e-9, rows[seconds]])}


def _score(one: Delayed, rows: Array) -> dict[str, Any]:
    """Error at the end, and at how many seconds it was sure of a wrong delay."""
    deviation, known = rows[:, 1] - one.delay_s, rows[:, 3] == LEARNED
    wrong = known & (np.abs(deviation) > WITHIN_STD * rows[:, 2])
    return {
        "name": one.case.name, "hostile": one.case.hostile, "delay_s": one.delay_s, "speed_hz": one.speed_hz,
        "torque_hz": one.torque_hz, "error_s": float(deviation[-1]), "std_s": float(rows[-1, 2]), "known": bool(known[-1]),
        "known_after_s": float(rows[np.argmax(known), 0]) if known.any() else None, "wrong_s": int(wrong.sum()),
    }  # fmt: skip


def page(scores: Mapping[str, Any]) -> str:
    """The scores as Markdown."""
    plain = [item for item in scores["each"] if not item["hostile"]]
    minutes = f"{scores['minutes']:g} minutes"
    good, known = sum(abs(item["error_s"]) < TARGET_S for item in plain), [item for item in plain if item["known"]]
    wrong = sum(item["wrong_s"] > 0 for item in scores["each"])
    lines = [
        f"{len(scores['each'])} sealed vehicles, {minutes} of driving each: nothing misleads on {len(plain)}, something does on "
        f"{len(scores['each']) - len(plain)}. Seed {scores['seed']}, SHA-256 of what is concealed",
        f"`{scores['seal']}`.",
        "",
        f"An error below 20 ms after {minutes}: {good} of {len(plain)} (target: all); of those whose state is `learned` "
        f"{sum(abs(item['error_s']) < TARGET_S for item in known)} of {len(known)}. Sure of a wrong delay in any second, off by "
        f"more than {WITHIN_STD:g} standard deviations while `learned`: {wrong} of {len(scores['each'])} vehicles "
        "(target: none).",
    ]
    return "\n".join(lines) + "\n"


def rows_of(each: Sequence[dict[str, Any]]) -> Rows:
    """Errors of the delay by the rate of the slower sensor [Hz], and by what misleads."""
    plain = [item for item in each if not item["hostile"]]
    kinds = sorted({item["hostile"] for item in each if item["hostile"]})
    return [
        _row("all that nothing misleads", plain),
        *(
            _row(f"slower sensor at {low:g} to {high:g} Hz", [item for item in plain if low <= _slower(item) < high])
            for low, high in RATES_OF
        ),
        *(_row(f"misled: {kind}", [item for item in each if item["hostile"] == kind]) for kind in kinds),
    ]


def _slower(item: dict[str, Any]) -> float:
    return float(min(item["speed_hz"], item["torque_hz"]))


def _row(name: str, some: Sequence[dict[str, Any]]) -> dict[str, str]:
    errors = 1e3 * np.abs([item["error_s"] for item in some])
    after = [item["known_after_s"] for item in some if item["known_after_s"] is not None]
    return {
        "group": name,
        "vehicles": str(len(some)),
        "error_below_20_ms": str(int((errors < 1e3 * TARGET_S).sum())),
        "known_at_the_end": str(sum(item["known"] for item in some)),
        "mean_error_ms": number(errors.mean(), 1) if some else "",
        "error_95_percent_below_ms": number(np.quantile(errors, 0.95), 1) if some else "",
        "known_after_median_s": number(np.median(after), 0) if after else "",
        "sure_of_a_wrong_delay": str(sum(item["wrong_s"] > 0 for item in some)),
    }
