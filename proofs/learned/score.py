# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Last process: opens the seal, counts, and writes the page."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from proofs.learned.cases import DRIVES
from proofs.learned.page import write_page
from proofs.processes import check_seal, read_json, read_labels
from proofs.sealed.drives import Array
from trackres_ros.estimator import columns as at
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.learning.learner import Learner
from trackres_ros.learning.parameters import VEHICLES_OWN
from trackres_ros.learning.store import stored
from trackres_ros.vehicle import load

ROLLS_MPS = 1.0
WITHIN_STD = 1.96
SETTLED_S = 60.0  # of a drive, after which speeds and feed-forward have settled
# Of the ageing run.
STEP_NS = 500_000_000
TRUE_LOSS = 0.12
NOISE_NM, WANDERS_NM, WANDERS_S = 60.0, 60.0, 300.0
START_NS = 1_700_000_000_000_000_000


def main(folder: Path, hours: float) -> None:
    """Score what was learned, and an age of so many hours."""
    labels = read_labels(folder)
    seal = check_seal(folder, [labels["seed"], labels["cases"]])
    found = [score_case(folder, case) for case in labels["cases"] if (folder / "results" / f"{case['name']}.json").exists()]
    aged = _aged(folder, labels["seed"], hours) if hours > 0.0 else None
    scores = {
        "seed": labels["seed"],
        "minutes": labels["minutes"],
        "seal": seal,
        "sealed": len(labels["cases"]),
        "cases": found,
        "ageing": aged,
    }
    write_page(folder, scores)


def _aged(folder: Path, seed: int, hours: float) -> list[dict[str, float]]:
    """The ageing run, kept in the folder as it takes minutes."""
    kept = folder / "ageing.json"
    if kept.exists():
        found: list[dict[str, float]] = read_json(kept)
        if len(found) == round(hours):
            return found
    found = age(seed, hours)
    kept.write_text(json.dumps(found), encoding="utf-8")
    return found


def age(seed: int, hours: float) -> list[dict[str, float]]:
    """Drive so many hours at 2 Hz with a sensor that has its noise and nothing else: no value drifts, and memory stays as it is.

    Returns of each hour the error of the acting values [share of the torque] and the state size [bytes].
    """
    estimator = Estimator(load("xgd24d"))
    true, session, learner = estimator.session(), estimator.session(), Learner(estimator, "on")
    true.learned[at.Learned.on], at.Learned(true.learned).departures[at.OF_LOSS] = 1.0, TRUE_LOSS
    rng = np.random.default_rng([seed, 200])
    keep = np.exp(-0.5 / WANDERS_S)
    slow, found = 0.0, []
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
        size = float(len(json.dumps(stored(learner))))
        own = [float(learner.learned.applied[state]) for state in VEHICLES_OWN]
        found.append({"hour": hour + 1.0, "error": float(np.mean(np.abs(errors))), "bias": float(np.mean(errors)), "bytes": size,
                      "largest_departure": max(map(abs, own))})  # fmt: skip
    return found


def score_case(folder: Path, case: dict[str, Any]) -> dict[str, Any]:
    """Errors of one vehicle, over the torque that rolling takes."""
    name = case["name"]
    said = read_json(folder / "results" / f"{name}.json")
    with np.load(folder / "results" / f"{name}.npz") as rows, np.load(folder / "sealed" / f"{name}.npz") as truth:
        found = {key: _error(rows[key], truth, int(key.rpartition("_")[2])) for key in rows}
    errors = {key: error for key, (error, _, _) in found.items()}
    inside, mean_inside = ([found[f"learned_{i + 1}"][part] for i in range(DRIVES)] for part in (1, 2))
    return {
        "name": name, "hostile": case["hostile"], "size": case["size"], "build": case["build"], "lumped": case["lumped"],
        "errors": errors, "inside": inside, "mean_inside": mean_inside, "said": said,
        "worse": [errors[f"learned_{i + 1}"] - errors[f"file_{i + 1}"] for i in range(DRIVES)],
        "outside": any(said[str(i + 1)]["outside"] for i in range(DRIVES)),
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
