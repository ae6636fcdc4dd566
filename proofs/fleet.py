# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The proof of the fleet's tools: how many changes of a concealed fleet are found, how soon, by which name, and false alarms.

It uses the truth of the sealed drives, which shares nothing with the model, and of the fleet's tools only their output.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import beta

from proofs.pipeline import Proof, each, read_json
from proofs.sealed.belt import read_data_sheet
from proofs.sealed.drives import SealedDrive, drive
from proofs.sealed.truth import Build, drawn_sensors, record, simulate_truth
from proofs.tables import FOLDER, Tables, write_tables
from trackres_ros.files.interpreter import python
from trackres_ros.files.own_files import PART
from trackres_ros.files.resources import find_vehicle
from trackres_ros.tools.fleet.dataset import FleetDataset
from trackres_ros.tools.fleet.pooling import Vehicles, pool
from trackres_ros.tools.fleet.sample import (
    BEARING,
    DAY_S,
    LOADS,
    LOSS,
    MOVES_MPS,
    MOVES_S,
    RAMP,
    START_S,
    STEP,
    VEHICLE,
    DrawnVehicle,
    Hidden,
    air_at,
    begin_recordings,
    change_at,
    draw_fleet,
)
from trackres_ros.tools.fleet.trends import NUMBERS, TEXTS

FASTEST_MPS = 16.7
WIND_MPS = 3.0  # most, from anywhere
RAIN_SHARE, RAIN = 0.12, (0.1, 0.8)  # of recordings; how much more a wet belt gives off
GAIN = "torque_gain.error"


def write_recording(folder: Path, vehicle: DrawnVehicle, number: int, minutes: float) -> Path:
    """Drive and record once; an existing file is kept."""
    begin = START_S + vehicle.days[number] * DAY_S
    path = folder / vehicle.name / f"drive_{number + 1:04d}.csv"
    if path.exists():
        return path
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet = find_vehicle(VEHICLE)
    numbers = read_data_sheet(sheet)
    rng = np.random.default_rng([vehicle.seed, number])
    air = air_at(vehicle.days[number], rng)
    weight = float(rng.choice(LOADS)) * numbers["weight"]
    item = drive(minutes, weight, air, FASTEST_MPS, rng)
    while _moves_s(item) < MOVES_S:  # the driver stood nearly all the time
        item = drive(minutes, weight, air, FASTEST_MPS, rng)
    weather = {"headwind": {"wind": rng.uniform(0.0, WIND_MPS), "towards": rng.uniform(0.0, 2.0 * np.pi)}}
    if rng.random() < RAIN_SHARE:
        weather["rain"] = {"factor": 1.0 + rng.uniform(*RAIN)}
    build, sensors = Build(**vehicle.build), drawn_sensors(np.random.default_rng([vehicle.seed, *b"sensors"]))
    if vehicle.hidden is not None:
        share = 1.0 + change_at(vehicle, number)
        if vehicle.hidden.parameter == GAIN:
            sensors = replace(sensors, torque_gain=sensors.torque_gain * share)
        else:
            name = "bearing" if vehicle.hidden.parameter == BEARING else "loss"
            build = replace(build, **{name: getattr(build, name) * share})
    (run,) = simulate_truth(sheet, build, weather, [item])
    part = path.with_name(path.name + PART)
    record(part, item, run, sensors, numbers["track.sprocket_radius"], begin, rng)
    return part.rename(path)


def _moves_s(one: SealedDrive) -> float:
    return float((one.speed > MOVES_MPS).sum()) * one.step


OPEN, FOUND = "fleet", "found.json"  # recordings and fleet.yaml; answers of `trackres fleet`
KINDS = (
    (BEARING, STEP, 0.10),
    (BEARING, STEP, -0.10),
    (BEARING, STEP, 0.10),
    (BEARING, RAMP, 0.30),
    (LOSS, STEP, 0.12),
    (GAIN, STEP, 0.05),
)
CHANGED_SHARE = 0.5  # of the vehicles
TEN_PERCENT = 0.10
SOON = 10  # recordings
RECORDINGS_OF_EACH, SETTLED_STD, DRAWS = 2, 0.5, 8
MONTH_S = 365.25 / 12.0 * DAY_S
TARGETS = "Targets: 95 % of changes of 10 % in bearing drag within 10 recordings; at most one false alarm in 50 vehicle-months"


@dataclass(frozen=True, slots=True)
class ScoredVehicle:
    """The concealed change of a vehicle and the findings: the first change after it, its number of recordings, whether its name
    is right, alone or among equally good explanations; and the number of false changes.
    """

    name: str
    hidden: Hidden | None
    found: bool
    recordings: int | None
    named: bool
    one_of: bool
    false: int
    months: float


def changes_of(count: int) -> list[tuple[str, str, float]]:
    """Changes of half of so many vehicles, the kinds one after the other."""
    return [KINDS[i % len(KINDS)] for i in range(int(CHANGED_SHARE * count))]


class FleetProof(Proof):
    """A drawn fleet, in which half of the vehicles change. Between drawing and score, `analyse` answers for all vehicles."""

    noun, key, page = "vehicles", "fleet", "fleet.md"

    def draw(self) -> list[DrawnVehicle]:
        """See `Proof`."""
        vehicles, days, every, minutes, seed = (self.settings[name] for name in ("vehicles", "days", "every", "minutes", "seed"))
        return draw_fleet(vehicles, days, every, minutes, changes_of(vehicles), seed)

    def record_all(self, cases: Sequence[DrawnVehicle]) -> None:
        """Write the file of the fleet and all recordings; those that are there are kept."""
        each(_record, begin_recordings(self.folder / OPEN, list(cases), self.settings["minutes"]), "recorded")

    def cases(self, labels: Mapping[str, Any]) -> list[DrawnVehicle]:
        """See `Proof`."""
        return [
            DrawnVehicle(**{**v, "days": tuple(v["days"]), "hidden": Hidden(**v["hidden"]) if v["hidden"] else None})
            for v in labels["fleet"]
        ]

    def scores(self, cases: Sequence[DrawnVehicle]) -> list[ScoredVehicle]:
        """See `Proof`."""
        vehicles = read_json(self.folder / FOUND)["vehicles"]
        return [score_vehicle(case, vehicles.get(case.name, {"changes": []})) for case in cases]

    def report(self, scores: list[ScoredVehicle], labels: Mapping[str, Any], seal: str) -> tuple[dict[str, Any], str]:
        """See `Proof`."""
        known = known_of_the_type(FleetDataset(self.folder / "results"))
        counts = summary(scores, labels["seed"], seal) | {"known_of_the_type": known}
        write_tables(self.folder / FOLDER, tables_of(counts))
        return counts, page(counts)


def _record(task: tuple[Path, DrawnVehicle, int, float]) -> None:
    write_recording(*task)


def analyse(folder: Path) -> None:
    """Have `trackres fleet` find the changes; it sees recordings and fleet.yaml and nothing else."""
    words = ["fleet", folder / OPEN / "recordings", "--vehicles", folder / OPEN / "fleet.yaml"]
    command = python("trackres_ros", *words, "--period", "none", "-o", folder / "results", "--json")
    with (folder / FOUND).open("w", encoding="utf-8") as file:
        code = subprocess.run(**command, stdout=file, check=False).returncode
    if code:
        sys.exit(code)


def known_of_the_type(dataset: FleetDataset) -> list[dict[str, Any]]:
    """How sure the parameters of the type are by so many vehicles, of each `RECORDINGS_OF_EACH` recordings: standard deviations
    over those of the vehicle file, and how many are below half of it; means over draws of the vehicles.
    """
    rows = [row for row in dataset.rows([*TEXTS, *NUMBERS]) if row["status"] == "good"]
    total = max(Vehicles.by_type(rows), key=len)
    begins = np.concatenate(([0], np.flatnonzero(total.vehicle[1:] != total.vehicle[:-1]) + 1, [len(total)]))
    some = np.concatenate([np.arange(a, min(a + RECORDINGS_OF_EACH, b)) for a, b in pairwise(begins)])
    few, rng = total.subset(some), np.random.default_rng(1)
    names = np.unique(few.vehicle)
    counts = [2**i for i in range(len(names).bit_length()) if 2**i < len(names)] + [len(names)]
    results = []
    for count in counts:
        stds = []
        for _ in range(DRAWS if count < len(names) else 1):
            choice = rng.choice(names, count, replace=False)
            stds.append(np.sqrt(np.diag(pool(few.subset(np.isin(few.vehicle, choice))).covariance)))
        mean = dict(zip(few.names, np.mean(stds, axis=0).tolist(), strict=True))
        settled = float((np.array(stds) < SETTLED_STD).sum(axis=1).mean())
        results.append({"vehicles": count, "settled": settled, "std": mean})
    return results


def score_vehicle(vehicle: DrawnVehicle, found: Mapping[str, Any]) -> ScoredVehicle:
    """Findings on one vehicle. A change known before it began is false, and so is any second one."""
    hidden, changes = vehicle.hidden, found["changes"]
    months = (vehicle.days[-1] - vehicle.days[0]) * DAY_S / MONTH_S
    if hidden is None:
        return ScoredVehicle(vehicle.name, None, False, None, False, False, len(changes), months)
    begun = START_S + vehicle.days[hidden.first] * DAY_S
    result_afters = [c for c in changes if c["known_s"] >= begun]
    if not result_afters:
        return ScoredVehicle(vehicle.name, hidden, False, None, False, False, len(changes), months)
    first = min(result_afters, key=lambda c: c["known_s"])
    passed = sum(begun <= START_S + day * DAY_S <= first["known_s"] + 1.0 for day in vehicle.days)
    named = first["parameter"] == hidden.parameter
    of_these = named or hidden.parameter in first["alike"]
    return ScoredVehicle(vehicle.name, hidden, True, passed, named, of_these, len(changes) - 1, months)


def summary(scored: Sequence[ScoredVehicle], seed: int, digest: str) -> dict[str, Any]:
    """Counts, ready for JSON."""
    changed = [s for s in scored if s.hidden is not None]
    tenth = BEARING, STEP, TEN_PERCENT
    tenths = [s for s in changed if s.hidden and (s.hidden.parameter, s.hidden.kind, abs(s.hidden.size)) == tenth]
    soon = [s for s in tenths if s.recordings is not None and s.recordings <= SOON]
    months, false = sum(s.months for s in scored), sum(s.false for s in scored)
    return {
        "seed": seed,
        "seal": digest,
        "vehicles": len(scored),
        "vehicle_months": months,
        "ten_percent_of_bearing": {
            "hidden": len(tenths),
            "within_10_recordings": len(soon),
            "interval_95": _interval(len(soon), len(tenths)),
        },
        "changes": {
            "hidden": len(changed),
            "found": sum(s.found for s in changed),
            "named": sum(s.named for s in changed),
            "among_those_named": sum(s.one_of for s in changed),
        },
        "false_alarms": {"count": false, "per_50_vehicle_months": 50.0 * false / months if months else None},
        "each": [asdict(s) for s in scored],
    }


def page(found: Mapping[str, Any]) -> str:
    """The counts as Markdown."""
    tenth, changes, false = found["ten_percent_of_bearing"], found["changes"], found["false_alarms"]
    low, high = tenth["interval_95"]
    lines = [
        f"Seed {found['seed']}, SHA-256 of the hidden changes {found['seal']}. {TARGETS}.",
        "",
        f"- changes of 10 % in bearing drag found within 10 recordings: {tenth['within_10_recordings']} of {tenth['hidden']} "
        f"(95 % interval of the share {low:.2f} to {high:.2f})",
        f"- all changes: {changes['found']} of {changes['hidden']} found, {changes['named']} by the right name, "
        f"{changes['among_those_named']} by that or with it among what would explain it as well",
        f"- false alarms: {false['count']} in {found['vehicle_months']:.0f} vehicle-months",
    ]
    return "\n".join(lines) + "\n"


def tables_of(found: Mapping[str, Any]) -> Tables:
    """The changes of each vehicle; how sure the type is [standard deviations of the vehicle file], by number of vehicles."""
    vehicles = []
    for s in found["each"]:
        h = s["hidden"]
        name = "" if not h or not s["found"] else "yes" if s["named"] else "among others" if s["one_of"] else "no"
        vehicles.append(
            {
                "vehicle": s["name"],
                "hidden": f"{h['parameter']} {h['kind']} {100.0 * h['size']:+.0f} %" if h else "",
                "from_recording": str(h["first"] + 1) if h else "",
                "detected_within": str(s["recordings"] or "not found") if h else "",
                "right_name": name,
                "false_alarms": str(s["false"]),
            }
        )
    sure = [
        {"vehicles": str(k["vehicles"]), "settled": f"{k['settled']:.1f}", **{name: f"{x:.2f}" for name, x in k["std"].items()}}
        for k in found["known_of_the_type"]
    ]
    return {"fleet": vehicles, "fleet_type": sure}


def _interval(hits: int, of: int) -> tuple[float, float]:
    """Of a share, by Clopper and Pearson at 95 %."""
    low = float(beta.ppf(0.025, hits, of - hits + 1)) if hits else 0.0
    high = float(beta.ppf(0.975, hits + 1, of - hits)) if hits < of else 1.0
    return low, high
