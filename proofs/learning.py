# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The proof of the learning: vehicles with wrong files, drives that are made to mislead, and an age of driving."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from proofs.pipeline import Proof, digest, proof_of, read_json
from proofs.sealed.belt import read_data_sheet
from proofs.sealed.drives import SealedDrive, drive
from proofs.sealed.recordings import APART_S, FASTEST_MPS, START_S, VEHICLE, refit, write_vehicle
from proofs.sealed.truth import Build, G, drawn_sensors, record, simulate_truth
from proofs.tables import FOLDER, Rows, write_tables
from trackres_ros.arrays import Array
from trackres_ros.errors import InputError
from trackres_ros.estimator import columns as at
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.records import Steps
from trackres_ros.estimator.snapshot import read_learning, save
from trackres_ros.files.resources import find_vehicle
from trackres_ros.learning.learner import Learner
from trackres_ros.learning.parameters import VEHICLES_OWN
from trackres_ros.learning.store import learner_content, take_content
from trackres_ros.output.style import BLACK, BLUE, GREY, VERMILION, picture
from trackres_ros.recording.opening import open_source
from trackres_ros.tasks.replay_run import replay
from trackres_ros.vehicle import load

LOSS_ERRORS = (0.05, 0.20)  # relative, of a vehicle file
OTHERS_OFF = 0.10  # at most, of bearings, drag, cooling and heat capacity
DRIVES = 3
LOADS, AIRS_DEGC = (1.0, 0.85, 1.15), (5.0, 15.0, 25.0)
AIR_OFF_K = 1.5  # standard deviation, from drive to drive: a thermometer on a vehicle sees sun and exhaust
NONE = ""
ROLLING_SHARE = 0.01  # of weight times radius: about the rolling resistance
# Sensor faults leave the drive unchanged. Faults of the vehicle or the ground change the true torque.
SENSORS = ("gain_step", "stuck", "half_missing", "outliers", "sign_flips")
REAL = ("payload", "mud", "pump", "brake", "hill")
KINDS = (*SENSORS, *REAL)


@dataclass(frozen=True)
class LearningCase:
    """One vehicle."""

    name: str  # uninformative
    build: dict[str, float]  # differences from its file, see `sealed.truth.Build`
    lumped: bool  # the vehicle file has no core temperature of the belt
    hostile: str  # disturbance, one of `KINDS`; empty without one
    size: float  # of the disturbance, relative to its largest: 0 to 1
    seed: int


def draw_cases(seed: int, vehicles: int, hostile: int) -> list[LearningCase]:
    """Draw vehicles, and as many others with a disturbance: every kind equally often."""
    rng = np.random.default_rng([seed, 16])
    names = rng.permutation(10 * (vehicles + hostile))[: vehicles + hostile]
    kinds = [NONE] * vehicles + [KINDS[i % len(KINDS)] for i in range(hostile)]
    results = []
    for number, kind in zip(names, kinds, strict=True):
        build = {part: float(1.0 + rng.uniform(-OTHERS_OFF, OTHERS_OFF)) for part in ("bearing", "drag", "film", "capacity")}
        build["loss"] = float(1.0 / (1.0 + rng.choice((-1.0, 1.0)) * rng.uniform(*LOSS_ERRORS)))
        case = LearningCase(
            f"v{number:05d}", build, bool(rng.random() < 0.5), kind, float(rng.random()), int(rng.integers(1 << 31))
        )
        results.append(case)
    return sorted(results, key=lambda case: case.name)


def added_torque(case: LearningCase, one: SealedDrive, nominal: float, radius: float) -> Array:
    """Torque of the ground or the vehicle on a drive [Nm], shape of the speed; the nominal weight is in newtons."""
    speed, distance, rolling = one.speed, np.cumsum(one.speed) * one.step, ROLLING_SHARE * nominal * radius
    time, forecast = np.arange(len(speed)) * one.step, np.tanh(speed / 0.05)
    if case.hostile == "mud":  # stretches of a kilometre that come again
        return np.asarray((0.15 + 0.25 * case.size) * rolling * (np.sin(2.0 * np.pi * distance / 2500.0) > 0.5) * forecast)
    if case.hostile == "pump":
        runs = np.sin(2.0 * np.pi * time / (300.0 + 200.0 * case.size)) > 0.3
        return np.asarray((0.07 + 0.05 * case.size) * rolling * runs * forecast)
    if case.hostile == "brake":  # drags from the middle on, and lets go three quarters of the way
        drags = (time > 0.5 * time[-1]) & (time < 0.75 * time[-1])
        return np.asarray((0.08 + 0.12 * case.size) * rolling * drags * forecast)
    if case.hostile == "hill":
        slope = (0.006 + 0.01 * case.size) * np.sin(2.0 * np.pi * distance / (600.0 + 1500.0 * case.size))
        return np.asarray(one.weight * radius * slope)
    return np.zeros(len(speed))


def weight_shares(case: LearningCase, speed: Array) -> Array:
    """Weight over recorded weight, shape of the speed: another load from the first stop after a third of it on."""
    result = np.ones(len(speed))
    if case.hostile == "payload":
        result_after = np.flatnonzero((np.arange(len(speed)) > len(speed) // 3) & (speed < 0.05))
        begin = int(result_after[0]) if len(result_after) else len(speed) // 2
        result[begin:] = 1.0 + (0.06 + 0.12 * case.size) * (1.0 if round(case.size * 100) % 2 else -1.0)
    return result


def misled(case: LearningCase, torque: Array, step: float, rng: np.random.Generator) -> Array:
    """Torque shown by the sensor [Nm], from a third of the drive on."""
    n = len(torque)
    late = np.arange(n) > n // 3
    if case.hostile == "gain_step":
        return np.where(late, (1.05 if case.size < 0.5 else 0.95) * torque, torque)
    if case.hostile == "stuck":
        held = late & (np.arange(n) * step % 240.0 < 120.0)
        return np.where(held, torque[np.maximum.accumulate(np.where(held, 0, np.arange(n)))], torque)
    if case.hostile == "half_missing":
        return np.where(rng.random(n) < 0.5, np.nan, torque)
    if case.hostile == "outliers":
        return torque + np.where(rng.random(n) < 0.3, rng.normal(1500.0 * (case.size - 0.5), 3000.0, n), 0.0)
    if case.hostile == "sign_flips":
        return np.where(late & (np.arange(n) * step % 120.0 < 40.0), -torque, torque)
    return torque


REFIT = "refit"  # marks a vehicle that is re-fitted too, the slowest part


def _mislead(path: Path, case: LearningCase, step: float, rng: np.random.Generator) -> None:
    names = path.read_text(encoding="utf-8").partition("\n")[0].split(",")
    rows = np.loadtxt(path, delimiter=",", skiprows=1)
    rows[:, names.index("torque_nm")] = misled(case, rows[:, names.index("torque_nm")], step, rng)
    with path.open("w", encoding="utf-8") as file:
        file.write(",".join(names) + "\n")
        np.savetxt(file, rows, delimiter=",", fmt="%.5f")


KEY = re.compile(r"\(?[+-]?\d+ (%|Nm|s)|( of the|of)(?= *$)| (since|for) *$|, of the kind.*")  # varies from run to run
UNEXPLAINED_TORQUE = "a torque that no parameter explains"
SHOWN = [at.Results.speed_mps, at.Results.feedforward_torque_nm, at.Results.resistance_torque_nm, at.Results.resistance_std_nm]


class Listening(Learner):
    """A learner that records its status, its seconds, and whether it left its ranges."""

    def __init__(self, estimator: Estimator, mode: str) -> None:
        super().__init__(estimator, mode)
        self.said: dict[str, int] = {}
        self.outside = False

    def _close(self, session: Any, passed: int) -> None:
        super()._close(session, passed)
        for text in (self.freeze_reason, self.disturbance and UNEXPLAINED_TORQUE, self.left_out.partition(" in ")[0]):
            if text:
                key = KEY.sub("", text.split(":")[0]).strip()
                self.said[key] = self.said.get(key, 0) + 1
        own, applied = list(VEHICLES_OWN), self.learned.applied
        self.outside |= bool((applied[own] < self.prior.low[own]).any() or (applied[own] > self.prior.high[own]).any())


def learn_and_fit(case: Path) -> tuple[dict[str, Any], dict[str, Array]]:
    """Answer of the folder of a vehicle: with its file, with learning on, and with files of a re-fit."""
    drives = sorted(case.glob("drive_*.csv"))
    vehicle = case / "vehicle.yaml"
    rows: dict[str, Array] = {}
    for i, path in enumerate(drives):
        rows[f"file_{i + 1}"] = _plain(path, vehicle)
    text = _learned(case, drives, vehicle, rows, "learned")
    _learned(case, [drives[0], drives[-1]], vehicle, rows, "after_one")
    ways = (("refit_one", drives[:1]), ("refit", drives[:-1]), ("oracle", drives)) if (case / REFIT).exists() else ()
    for name, which in ways:
        try:
            rows[f"{name}_{len(drives)}"] = _plain(drives[-1], refit(which, vehicle, case / f"{name}.yaml", "re-fitted"))
        except InputError as error:  # of a recording that a re-fit refuses nothing is learned
            rows[f"{name}_{len(drives)}"] = rows[f"file_{len(drives)}"]
            text[f"{name} refused"] = str(error)[:200]
    return text, rows


def _plain(path: Path, vehicle: Path) -> Array:
    kept: list[Steps] = []
    replay(open_source([path], None), Estimator(load(vehicle)), kept.append)
    return _shown(kept)


def _shown(kept: Sequence[Steps]) -> Array:
    """Time [s] and scored values of each step."""
    rows = np.concatenate([steps.rows[:, SHOWN] for steps in kept])
    stamps = np.concatenate([steps.stamp_ns for steps in kept])
    return np.column_stack([stamps * 1e-9, rows])


def _learned(case: Path, drives: Sequence[Path], vehicle: Path, rows: dict[str, Array], name: str) -> dict[str, Any]:
    """With learning on: learned values come from the state file of the drive before, two weeks later."""
    estimator, state = Estimator(load(vehicle)), case / f"{name}.state"
    texts: dict[str, Any] = {}
    for path in drives:
        learner = Listening(estimator, "on")
        if path is not drives[0]:  # belts begin soaked at the measured air's temperature, as with every other file
            take_content(learner, read_learning(estimator, state))
            learner.age_values(APART_S)
        kept: list[Steps] = []
        outcome = replay(open_source([path], None), estimator, kept.append, learner=learner)
        save(outcome.session, state, 0.0, learner_content(learner))
        number = path.stem.rpartition("_")[2]
        rows[f"{name}_{number}"] = _shown(kept)
        texts[number] = {
            "text": learner.text,
            "said_s": learner.said,
            "outside": learner.outside,
            "seconds": learner.learned.seconds,
            "applied": learner.learned.applied.tolist(),
            "std": np.sqrt(np.diag(learner.learned.covariance)).tolist(),
            "counts": [state for state in VEHICLES_OWN if learner.has_evidence[state]],
        }
    return texts


ROLLS_MPS = 1.0
WITHIN_STD = 1.96
SETTLED_S = 60.0  # of a drive, after which speeds and feed-forward have settled
AGEING = "ageing.json"
# Of the ageing run.
STEP_NS = 500_000_000
TRUE_LOSS = 0.12
NOISE_NM, WANDERS_NM, WANDERS_S = 60.0, 60.0, 300.0
START_NS = 1_700_000_000_000_000_000


class LearningProof(Proof):
    """Vehicles of `draw_cases`, with the ageing run of `grow_old`."""

    noun, label_settings, page = "vehicles", ("seed", "minutes"), "proof-learning.md"

    def draw(self) -> Sequence[Any]:
        """See `Proof`."""
        return draw_cases(self.settings["seed"], self.settings["vehicles"], self.settings["hostile"])

    def seal(self, labels: str) -> str:
        """SHA-256 of the seed and the cases."""
        content = json.loads(labels)
        return digest([content["seed"], content[self.key]])

    def record(self, case: Any) -> None:
        """See `Proof`."""
        into, sheet, minutes = self.folder / "cases" / case.name, find_vehicle(VEHICLE), self.settings["minutes"]
        into.mkdir(parents=True, exist_ok=True)
        write_vehicle(into / "vehicle.yaml", case.lumped)
        if not case.hostile:
            (into / REFIT).touch()
        numbers = read_data_sheet(sheet)
        weight, radius = numbers["weight"], numbers["track.sprocket_radius"]
        rng = np.random.default_rng([case.seed, 1])
        airs = rng.permutation(AIRS_DEGC)
        planned = [drive(minutes, share * weight, air, FASTEST_MPS, rng) for share, air in zip(LOADS, airs, strict=True)]
        driven = [replace(value, weight=value.weight * weight_shares(case, value.speed)) for value in planned]
        runs = simulate_truth(sheet, Build(**case.build), {}, driven)
        sensors = drawn_sensors(rng)
        kept: dict[str, Any] = {}
        for i, (plan, value, run) in enumerate(zip(planned, driven, runs, strict=True)):
            added = added_torque(case, value, weight, radius)
            path, deviation = into / f"drive_{i + 1}.csv", float(rng.normal(0.0, AIR_OFF_K))
            with_added = replace(run, torque=run.torque + added, shown=run.shown + added)
            record(path, plan, with_added, replace(sensors, ambient_off_k=deviation), radius, START_S + i * APART_S, rng)
            if case.hostile in SENSORS:
                _mislead(path, case, value.step, rng)
            inertia = radius * numbers["chassis.rotating_mass_factor"] * value.weight / G * value.accel
            kept[f"torque_{i + 1}"], kept[f"speed_{i + 1}"] = run.torque + added - inertia, value.speed
            # Disturbances are outside of any model: on a hill without a recorded slope they cannot be known.
            kept[f"known_{i + 1}"] = run.torque - inertia + (added if case.hostile in REAL and case.hostile != "hill" else 0.0)
        np.savez_compressed(self.folder / "sealed" / f"{case.name}.npz", **kept)

    def cases(self, labels: Mapping[str, Any]) -> Sequence[Any]:
        """See `Proof`."""
        return [LearningCase(**label) for label in labels["cases"]]

    def scores(self, cases: Sequence[Any]) -> list[dict[str, Any]]:
        """See `Proof`."""
        return [score_case(self, case) for case in cases]

    def report(self, scores: list[dict[str, Any]], labels: Mapping[str, Any], seal: str) -> tuple[dict[str, Any], str]:
        """See `Proof`."""
        content = {
            "seed": labels["seed"],
            "minutes": labels["minutes"],
            "seal": seal,
            "sealed": len(labels["cases"]),
            "cases": scores,
            "ageing": read_json(self.folder / AGEING) if (self.folder / AGEING).exists() else None,
        }
        write_tables(self.folder / FOLDER, {"learning_misled": misled_rows([case for case in scores if case["hostile"]])})
        return content, page(self.folder, content)


def grow_old(folder: Path, hours: float) -> None:
    """Keep an ageing run of so many hours in a folder, or none. It takes minutes, so one that is there is not repeated."""
    kept = folder / AGEING
    if hours <= 0.0:
        kept.unlink(missing_ok=True)
    elif not kept.exists() or len(read_json(kept)) != round(hours):
        kept.write_text(json.dumps(age(proof_of(folder).settings["seed"], hours)), encoding="utf-8")


def age(seed: int, hours: float) -> list[dict[str, float]]:
    """Drive so many hours at 2 Hz with a sensor that has its noise and nothing else: no value drifts, and memory stays as it is.

    Returns of each hour the error of the acting values [share of the torque] and the state size [bytes].
    """
    estimator = Estimator(load("xgd24d"))
    true, session, learner = estimator.session(), estimator.session(), Learner(estimator, "on")
    true.learned[at.Learned.on], at.Learned(true.learned).departures[at.OF_LOSS] = 1.0, TRUE_LOSS
    rng = np.random.default_rng([seed, 200])
    keep = np.exp(-0.5 / WANDERS_S)
    slow, result = 0.0, []
    per_hour = int(3600.0 / (STEP_NS * 1e-9))
    for hour in range(max(1, round(hours))):
        shocks = rng.normal(0.0, WANDERS_NM * np.sqrt(1.0 - keep * keep), per_hour).tolist()
        noise = rng.normal(0.0, NOISE_NM, per_hour).tolist()
        errors = []
        for i in range(per_hour):
            number = hour * per_hour + i
            stamp = START_NS + number * STEP_NS
            time = number * 0.5
            speed = max(0.0, 8.0 + 6.0 * np.sin(time / 70.0) + 2.0 * np.sin(time / 900.0))
            slow = keep * slow + shocks[i]
            torque = true.handle(at.SPEED, stamp, stamp, speed)
            assert torque is not None
            session.handle(at.TORQUE, stamp, stamp, torque["drive_torque_nm"] + slow + noise[i])
            estimate = session.handle(at.SPEED, stamp, stamp, speed)
            assert estimate is not None
            learner.take(stamp, estimate.row.tolist(), session)
            if i % 20 == 0 and speed > 1.0:
                errors.append((estimate.resistance_torque_nm - torque.resistance_torque_nm) / torque.resistance_torque_nm)
        size = float(len(json.dumps(learner_content(learner))))
        own = [float(learner.learned.applied[state]) for state in VEHICLES_OWN]
        result.append({"hour": hour + 1.0, "error": float(np.mean(np.abs(errors))), "bias": float(np.mean(errors)), "bytes": size,
                      "largest_departure": max(map(abs, own))})  # fmt: skip
    return result


def score_case(proof: Proof, case: LearningCase) -> dict[str, Any]:
    """Errors of one vehicle, over the torque that rolling takes."""
    text, name = proof.result(case.name), f"{case.name}.npz"
    with np.load(proof.folder / "results" / name) as rows, np.load(proof.folder / "sealed" / name) as truth:
        results = {key: _error(rows[key], truth, int(key.rpartition("_")[2])) for key in rows}
    errors = {key: error for key, (error, _, _) in results.items()}
    inside, mean_inside = ([results[f"learned_{i + 1}"][part] for i in range(DRIVES)] for part in (1, 2))
    return {
        "name": case.name, "hostile": case.hostile, "size": case.size, "build": case.build, "lumped": case.lumped,
        "errors": errors, "inside": inside, "mean_inside": mean_inside, "said": text,
        "worse": [errors[f"learned_{i + 1}"] - errors[f"file_{i + 1}"] for i in range(DRIVES)],
        "outside": any(text[str(i + 1)]["outside"] for i in range(DRIVES)),
    }  # fmt: skip


def _error(rows: Array, truth: Any, drive: int) -> tuple[float, float, bool]:
    """Mean error of the feed-forward over the mean torque; share of seconds with the torque in the interval; whether that
    of the mean is.
    """
    time = rows[:, 0] - rows[0, 0]
    true = truth[f"torque_{drive}"]
    at_rows = np.minimum(np.round(time / 0.1).astype(int), len(true) - 1)
    true, speed = true[at_rows], truth[f"speed_{drive}"][at_rows]
    rolls = (speed > ROLLS_MPS) & (time > SETTLED_S)
    feedforward, resistance, std = rows[rolls, 2], rows[rolls, 3], rows[rolls, 4]
    size = float(np.abs(truth[f"known_{drive}"][at_rows][rolls]).mean())
    inside = float((np.abs(resistance - true[rolls]) < WITHIN_STD * std).mean())
    mean_inside = bool(abs((resistance - true[rolls]).mean()) < WITHIN_STD * std.mean())
    return float(np.abs(feedforward - true[rolls]).mean()) / size, inside, mean_inside


PICTURE = "learning.png"
LAST = DRIVES
WAYS = (
    (f"file_{LAST}", "the vehicle file"),
    (f"after_one_{LAST}", "learned, one drive before"),
    (f"refit_one_{LAST}", "re-fitted to that drive"),
    (f"learned_{LAST}", "learned, two drives before"),
    (f"refit_{LAST}", "re-fitted to those two"),
    (f"oracle_{LAST}", "oracle: re-fitted to all three"),
)
MOST_WORSE = 0.02
SHORT = {
    "a disturbance of": "a disturbance",
    "is being checked": "a step is being checked",
    "disagree with the others": "torques disagree with the others",
}


def page(folder: Path, scores: Mapping[str, Any]) -> str:
    """The page, whose picture goes to the folder."""
    plain = [case for case in scores["cases"] if not case["hostile"]]
    hostile = [case for case in scores["cases"] if case["hostile"]]
    draw(plain, folder / PICTURE)
    parts = _head(scores, plain, hostile), _of_vehicles(plain), _of_hostile(hostile), _of_age(scores["ageing"])
    return "\n".join(line for part in parts for line in part) + "\n"


def _head(scores: Mapping[str, Any], plain: list[Any], hostile: list[Any]) -> list[str]:
    sealed, score_result = scores["sealed"], len(scores["cases"])
    first = (
        f"Of {sealed} sealed vehicles the first {score_result} by their drawn names"
        if score_result < sealed
        else f"{sealed} sealed vehicles"
    )
    return [
        f"{first}: {len(plain)} whose files are off, {len(hostile)} on whose drives something misleads. {DRIVES} drives of "
        f"{scores['minutes']:g} minutes each, two weeks apart, with a state file between. Seed: {scores['seed']}, SHA-256 of "
        "the labels",
        f"`{scores['seal']}`.",
        "",
    ]


def _of_vehicles(plain: list[Any]) -> list[str]:
    if not plain:
        return []
    lines = [
        f"![Error of the feed-forward over the third drive, of each vehicle.]({PICTURE})",
        "",
        "| Feed-forward on the third drive | Mean error, median [% of torque] | 90 % of vehicles below | Better than the file |",
        "|---|---|---|---|",
    ]
    file = np.array([case["errors"][WAYS[0][0]] for case in plain])
    for key, name in WAYS:
        errors = np.array([case["errors"][key] for case in plain])
        better = f"{int((errors < file).sum())} of {len(plain)}" if key != WAYS[0][0] else ""
        lines.append(f"| {name} | {100.0 * np.median(errors):.2f} | {100.0 * np.quantile(errors, 0.9):.2f} | {better} |")
    item = _ratio(plain, f"after_one_{LAST}", f"refit_one_{LAST}")
    two = _ratio(plain, f"learned_{LAST}", f"refit_{LAST}")
    seconds = [float(case["inside"][LAST - 1]) for case in plain]
    means = [bool(case["mean_inside"][LAST - 1]) for case in plain]
    worse = [float(case["worse"][i]) for case in plain for i in range(DRIVES)]
    return [
        *lines,
        "",
        f"Learned over re-fitted, median of the vehicles: {item:.2f} after one drive, {two:.2f} after two (target: at most 1.3). "
        f"Intervals of 95 % cover the torque in {100.0 * np.mean(seconds):.1f} % of all seconds of the third drive. They "
        f"cover its mean in {sum(means)} of {len(means)} drives. The target is 90 to 98 %. At worst, learning changed the error "
        f"of a drive by {100.0 * max(worse):+.1f} % of the torque. {_of_mass(plain)}",
        "",
    ]


def _of_mass(plain: list[Any]) -> str:
    """Learned error of a mass that is right in the file."""
    deviations = [
        case["said"][str(LAST)]["applied"][at.OF_MASS] for case in plain if at.OF_MASS in case["said"][str(LAST)]["counts"]
    ]
    if not deviations:
        return "No mass counts as learned."
    return (
        f"The rotating-mass factor is right in all files. It is learned on drives of {len(deviations)} vehicles and is then "
        f"off by {100.0 * float(np.median(deviations)):+.1f} % in the median, {100.0 * max(map(abs, deviations)):.1f} % at worst."
    )


def _ratio(plain: list[Any], key: str, over: str) -> float:
    return float(np.median([case["errors"][key] / case["errors"][over] for case in plain]))


def misled_rows(hostile: list[Any]) -> Rows:
    """What misleads, a row for each: the worst error over the file [% of the torque], and the statuses [s a drive]."""
    rows = []
    for kind in KINDS:
        cases = [case for case in hostile if case["hostile"] == kind]
        if not cases:
            continue
        worse = [float(x) for case in cases for x in case["worse"]]
        rows.append(
            {
                "misled_by": kind,
                "part": "sensor" if kind in SENSORS else "vehicle or ground",
                "vehicles": str(len(cases)),
                "worst_over_file_percent": f"{100.0 * max(worse):.1f}",
                "drives": str(len(worse)),
                "drives_worse_by_2_percent": str(sum(x > MOST_WORSE for x in worse)),
                "outside_the_ranges": str(sum(case["outside"] for case in cases)),
                "status_s_a_drive": _said(cases),
            }
        )
    return rows


def _of_hostile(hostile: list[Any]) -> list[str]:
    if not hostile:
        return []
    drives = [float(x) for case in hostile for x in case["worse"]]
    bad = sum(x > MOST_WORSE for x in drives)
    silent = [case["hostile"] for case in hostile for i in range(DRIVES) if not case["said"][str(i + 1)]["said_s"]]
    which = ", ".join(f"{kind} {count}" for kind, count in sorted(Counter(silent).items()))
    return [
        f"Worse than the file by more than 2 % of the torque: {bad} of {len(drives)} drives (target: none). Without a remark "
        f"in the status: {len(silent)} of {len(drives)} drives (target: none){': ' if which else ''}{which}.",
        "",
    ]


def _said(cases: list[Any]) -> str:
    """The most frequent statuses, with their mean time in a drive [s]."""
    seconds: dict[str, float] = {}
    for case in cases:
        for i in range(DRIVES):
            for text, s in case["said"][str(i + 1)]["said_s"].items():
                short = next((text_here for words, text_here in SHORT.items() if words in text), text)
                seconds[short] = seconds.get(short, 0.0) + s
    result = sorted(((s, text) for text, s in seconds.items()), reverse=True)
    drives = len(cases) * DRIVES
    return "; ".join(f"{text}: {s / len(cases) / DRIVES:.0f}" for s, text in result[:3] if s >= 0.5 * drives) or "nothing"


def _of_age(aged: list[dict[str, float]] | None) -> list[str]:
    if not aged:
        return []
    late = aged[len(aged) // 10 :]
    errors = [hour["error"] for hour in late]
    first, last = np.mean(errors[: len(errors) // 2]), np.mean(errors[len(errors) // 2 :])
    return [
        f"An age of {len(aged)} hours of driving: the error of the torque is {100.0 * first:.2f} % over the first half and "
        f"{100.0 * last:.2f} % over the second. In the worst hour it is {100.0 * max(errors):.2f} %. The state file has "
        f"{aged[0]['bytes']:.0f} bytes after the first hour and {aged[-1]['bytes']:.0f} after the last.",
        "",
    ]


def draw(plain: list[Any], path: Path) -> None:
    """Error of each method, of each vehicle, in the order of the file's error."""
    if not plain:
        return
    with picture(path, 8.0, 3.4) as figure:
        axes = figure.subplots()
        order = np.argsort([case["errors"][WAYS[0][0]] for case in plain])
        for (key, name), colour, mark in zip(WAYS, (GREY, BLUE, VERMILION, BLUE, VERMILION, BLACK), "osodD+", strict=True):
            if key in (f"after_one_{LAST}", f"refit_one_{LAST}"):
                continue
            errors = [100.0 * plain[i]["errors"][key] for i in order]
            axes.plot(errors, mark, color=colour, markersize=4, label=name, linestyle="none")
        axes.set_xlabel("vehicles, by what their file is off", color=BLACK)
        axes.set_ylabel("error of the feed-forward [% of torque]")
        axes.set_ylim(bottom=0.0)
        axes.legend(loc="upper left")
