# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""First process of the proof with the groomer: draws its cases, seals them, and records their drives.

It writes the folder that `second` scores: labels.json and cases/NAME/session1.csv.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from proofs.processes import each
from proofs.sealed.drives import Array
from proofs.sealed.groomer import HIDDEN, MOTOR_NOISE_NM, RATIO, TOPICS, Groomer, Snow, snow_drives, write_table
from proofs.sealed.size import whitened
from trackres_ros.files.documents import read_yaml
from trackres_ros.files.resources import config_dir

VEHICLE = Path(__file__).with_name("groomer.yaml")
NONE, GEARBOX = "none", "drivetrain_efficiency"
KINDS = (NONE, *HIDDEN)
SIZES_NM, AT_DEGC, GEARS, DRIVES = (250.0, 500.0), (-8.0, -2.0), (0.90, 0.97), (3, 5)
DIRECT_SHARE = 0.2  # of the cases: the torque is measured behind the gearbox
LIGHT_T, HEAVY_T = (8.8, 9.5), (9.8, 10.4)
ABSOLUTE = 0.7979  # mean of the absolute value of a normal variable, over its standard deviation


def main(folder: Path, seed: int, *words: str) -> None:
    """Draw, seal and record cases; words are KIND=COUNT."""
    counts = {kind: int(count) for kind, count in (word.split("=") for word in words)}
    drawn = draw_groomers(counts, seed)
    told = each(label, drawn)
    names = np.random.default_rng([seed, *b"names"]).permutation(len(drawn))
    labels = [{"case": f"case{number:03d}", **one} for number, one in zip(names.tolist(), told, strict=True)]
    text = json.dumps({"seed": seed, "cases": labels}, indent=1)
    print(f"sealed: {len(drawn)} cases, SHA-256 {hashlib.sha256(text.encode()).hexdigest()}", flush=True)
    (folder / "labels.json").write_text(text, encoding="utf-8")
    each(partial(_recorded, folder / "cases"), [(one["case"], g) for one, g in zip(labels, drawn, strict=True)], "recorded")


def draw_groomers(counts: Mapping[str, int], seed: int) -> list[Groomer]:
    """Groomers with so many cases of each kind; each has light and heavy drives."""
    rng = np.random.default_rng(seed)
    return [_drawn(kind, rng) for kind, count in counts.items() for _ in range(count)]


def _drawn(kind: str, rng: np.random.Generator) -> Groomer:
    count = int(rng.integers(DRIVES[0], DRIVES[1] + 1))
    heavy = int(rng.integers(1, count))
    masses = [*rng.uniform(*HEAVY_T, heavy), *rng.uniform(*LIGHT_T, count - heavy)]
    gear = 1.0 if rng.random() < DIRECT_SHARE else float(rng.uniform(*GEARS))
    shown = tuple(round(float(mass), 1) for mass in rng.permutation(masses))
    return Groomer(kind, float(rng.uniform(*SIZES_NM)), float(rng.uniform(*AT_DEGC)), gear, shown, int(rng.integers(2**31)))


def label(g: Groomer) -> dict[str, Any]:
    """The label of a groomer's case, as `second` reads it."""
    effects: list[dict[str, Any]] = []
    if g.hide != NONE:
        numbers = {"threshold": g.at, "size_nm": g.size} if g.hide in ("cold", "cool") else {}
        effects = [{"name": g.hide, "d_prime": detectability(snow_drives(g)), "acceptable": [], **numbers}]
    one_s = ABSOLUTE * RATIO * MOTOR_NOISE_NM / np.sqrt(10.0)
    return {
        "level": "outside" if effects else NONE, "effects": effects, "identifiable": False, "given": [], "driving": "snow",
        "tolerated": [] if g.gear == 1.0 else [GEARBOX], "noise_mae": [{"one_s": float(one_s)}],
        "gear": g.gear, "masses": g.masses,
    }  # fmt: skip


def detectability(drives: list[Snow]) -> float:
    """Detectability d' of the hidden torque after a re-fit: without the part that load, belt
    temperature, speed and driving torque explain.
    """

    def white(of: list[Array]) -> Array:
        return whitened(of, [s.drive for s in drives])

    way = [np.sign(s.drive.speed) for s in drives]
    weights = [w * s.drive.weight for w, s in zip(way, drives, strict=True)]
    absorbed = [
        way, weights, [w * s.belt for w, s in zip(weights, drives, strict=True)],
        [s.drive.speed**2 for s in drives], [np.abs(s.torque) for s in drives], [s.drive.accel * s.drive.weight for s in drives],
    ]  # fmt: skip
    taken, added = np.linalg.qr(np.column_stack([white(of) for of in absorbed]))[0], white([s.hidden for s in drives])
    return float(np.linalg.norm(added - taken @ (taken.T @ added)))


def _recorded(cases: Path, task: tuple[str, Groomer]) -> None:
    name, g = task
    into = cases / name
    into.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng([g.seed, *b"sensors"])
    for number, (snow, mass) in enumerate(zip(snow_drives(g), g.masses, strict=True), start=1):
        write_table(into / f"session{number}.csv", snow, mass, rng)
    content = read_yaml(VEHICLE)
    content["rubber"]["file"] = str(config_dir() / content["rubber"]["file"])
    (into / "vehicle.yaml").write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    (into / "topics.yaml").write_text(TOPICS, encoding="utf-8")
