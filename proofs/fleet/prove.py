# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Counts how many changes of a concealed fleet are found, how soon and by which name, and the false alarms.

`generate` draws, seals and records; `score` opens the seal. Between them runs `trackres fleet`, which sees recordings and
fleet.yaml and nothing else.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import beta

from proofs.fleet.draw import GAIN, write_recording
from proofs.processes import check_seal, each, read_json, read_labels, write_scores, write_sealed
from trackres_ros.tools.fleet.dataset import FleetDataset
from trackres_ros.tools.fleet.pooling import Vehicles, pool
from trackres_ros.tools.fleet.sample import (
    BEARING,
    DAY_S,
    LOSS,
    RAMP,
    START_S,
    STEP,
    DrawnVehicle,
    Hidden,
    begin_recordings,
    draw_fleet,
)
from trackres_ros.tools.fleet.trends import NUMBERS, TEXTS

OPEN, RESULTS = "fleet", "results"
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


def generate(folder: Path, seed: int, vehicles: int, days: int, every: float, minutes: float) -> None:
    """Draw a fleet, seal its changes, and record it."""
    fleet = draw_fleet(vehicles, days, every, minutes, changes_of(vehicles), seed)
    labels = {"seed": seed, "fleet": [asdict(v) for v in fleet]}
    write_sealed(folder, f"{len(fleet)} vehicles", labels, labels)
    each(_record, begin_recordings(folder / OPEN, fleet, minutes), "recorded")


def _record(task: tuple[Path, DrawnVehicle, int, float]) -> None:
    write_recording(*task)


def score(folder: Path) -> None:
    """Open the seal, count, and write the counts and the page."""
    labels = read_labels(folder)
    seal = check_seal(folder, labels)
    fleet = [
        DrawnVehicle(**{**v, "days": tuple(v["days"]), "hidden": Hidden(**v["hidden"]) if v["hidden"] else None})
        for v in labels["fleet"]
    ]
    found = read_json(folder / "found.json")
    scored = [score_vehicle(v, found["vehicles"].get(v.name, {"changes": []})) for v in fleet]
    known = known_of_the_type(FleetDataset(folder / RESULTS))
    counts = summary(scored, labels["seed"], seal) | {"known_of_the_type": known}
    write_scores(folder, counts, "fleet.md", page(counts))


def known_of_the_type(dataset: FleetDataset) -> list[dict[str, Any]]:
    """How sure the parameters of the type are by so many vehicles, of each `RECORDINGS_OF_EACH` recordings: standard deviations
    over those of the vehicle file, and how many are below half of it; means over draws of the vehicles.
    """
    rows = [row for row in dataset.rows([*TEXTS, *NUMBERS]) if row["status"] == "good"]
    whole = max(Vehicles.of(rows), key=len)
    begins = np.concatenate(([0], np.flatnonzero(whole.vehicle[1:] != whole.vehicle[:-1]) + 1, [len(whole)]))
    some = np.concatenate([np.arange(a, min(a + RECORDINGS_OF_EACH, b)) for a, b in pairwise(begins)])
    few, rng = whole.some(some), np.random.default_rng(1)
    names = np.unique(few.vehicle)
    counts = [2**i for i in range(len(names).bit_length()) if 2**i < len(names)] + [len(names)]
    found = []
    for count in counts:
        stds = []
        for _ in range(DRAWS if count < len(names) else 1):
            chosen = rng.choice(names, count, replace=False)
            stds.append(np.sqrt(np.diag(pool(few.some(np.isin(few.vehicle, chosen))).covariance)))
        mean = dict(zip(few.names, np.mean(stds, axis=0).tolist(), strict=True))
        settled = float((np.array(stds) < SETTLED_STD).sum(axis=1).mean())
        found.append({"vehicles": count, "settled": settled, "std": mean})
    return found


def score_vehicle(vehicle: DrawnVehicle, found: Mapping[str, Any]) -> ScoredVehicle:
    """Findings on one vehicle. A change known before it began is false, and so is any second one."""
    hidden, changes = vehicle.hidden, found["changes"]
    months = (vehicle.days[-1] - vehicle.days[0]) * DAY_S / MONTH_S
    if hidden is None:
        return ScoredVehicle(vehicle.name, None, False, None, False, False, len(changes), months)
    begun = START_S + vehicle.days[hidden.first] * DAY_S
    after = [c for c in changes if c["known_s"] >= begun]
    if not after:
        return ScoredVehicle(vehicle.name, hidden, False, None, False, False, len(changes), months)
    first = min(after, key=lambda c: c["known_s"])
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
        "",
        "| vehicle | hidden | from recording | found within | name right | false |",
        "|---|---|---|---|---|---|",
    ]
    for s in found["each"]:
        h = s["hidden"]
        what = f"{h['parameter']} {h['kind']} {100.0 * h['size']:+.0f} %" if h else "-"
        named = "" if not h or not s["found"] else "yes" if s["named"] else "among others" if s["one_of"] else "no"
        first, within = (h["first"] + 1, s["recordings"] or "not found") if h else ("", "")
        lines.append(f"| {s['name']} | {what} | {first} | {within} | {named} | {s['false']} |")
    known = found["known_of_the_type"]
    lines += [
        "",
        f"How sure the type is, by number of vehicles with {RECORDINGS_OF_EACH} recordings each. The values are standard "
        f'deviations over those of the vehicle file; "settled" counts the parameters below {SETTLED_STD:g}.',
        "",
        f"| vehicles | settled | {' | '.join(known[0]['std'])} |",
        f"|---|---|{'---|' * len(known[0]['std'])}",
        *(f"| {k['vehicles']} | {k['settled']:.1f} | {' | '.join(f'{x:.2f}' for x in k['std'].values())} |" for k in known),
    ]
    return "\n".join(lines) + "\n"


def _interval(hits: int, of: int) -> tuple[float, float]:
    """Of a share, by Clopper and Pearson at 95 %."""
    low = float(beta.ppf(0.025, hits, of - hits + 1)) if hits else 0.0
    high = float(beta.ppf(0.975, hits + 1, of - hits)) if hits < of else 1.0
    return low, high
