# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Last process: opens the labels, counts, and writes the page.

`python -m trackres_ros.evaluation.learned.score FOLDER HOURS`
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackres_ros.evaluation.learned.ageing import age
from trackres_ros.evaluation.learned.cases import DRIVES
from trackres_ros.evaluation.learned.page import write_page

Array = NDArray[np.float64]

ROLLS_MPS = 1.0
WITHIN_STD = 1.96
SETTLED_S = 60.0  # of a drive, after which speeds and feed-forward have settled


def main(arguments: Sequence[str]) -> None:
    """See above."""
    folder, hours = Path(arguments[0]), float(arguments[1])
    labels = json.loads((folder / "sealed" / "labels.json").read_text(encoding="utf-8"))
    found = [score_case(folder, case) for case in labels["cases"] if (folder / "results" / f"{case['name']}.json").exists()]
    aged = _aged(folder, labels["seed"], hours) if hours > 0.0 else None
    scores = {
        "seed": labels["seed"],
        "minutes": labels["minutes"],
        "seal": (folder / "seal.txt").read_text(encoding="utf-8").strip(),
        "sealed": len(labels["cases"]),
        "cases": found,
        "ageing": aged,
    }
    (folder / "scores.json").write_text(json.dumps(scores, indent=1), encoding="utf-8")
    print(write_page(folder, scores))


def _aged(folder: Path, seed: int, hours: float) -> list[dict[str, float]]:
    """The ageing run, kept in the folder as it takes minutes."""
    kept = folder / "ageing.json"
    if kept.exists():
        found: list[dict[str, float]] = json.loads(kept.read_text(encoding="utf-8"))
        if len(found) == round(hours):
            return found
    found = age(seed, hours)
    kept.write_text(json.dumps(found), encoding="utf-8")
    return found


def score_case(folder: Path, case: dict[str, Any]) -> dict[str, Any]:
    """Errors of one vehicle, over the torque that rolling takes."""
    name = case["name"]
    said = json.loads((folder / "results" / f"{name}.json").read_text(encoding="utf-8"))
    with np.load(folder / "results" / f"{name}.npz") as rows, np.load(folder / "sealed" / f"{name}.npz") as truth:
        errors: dict[str, float] = {}
        for key in rows:
            errors[key] = _error(rows[key], truth, int(key.rpartition("_")[2]))[0]
        inside = [_error(rows[f"learned_{i + 1}"], truth, i + 1)[1] for i in range(DRIVES)]
        mean_inside = [_error(rows[f"learned_{i + 1}"], truth, i + 1)[2] for i in range(DRIVES)]
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


if __name__ == "__main__":
    main(sys.argv[1:])
